//! Synthetic actors: connections that speak the whole protocol and simulate nothing, many in one process.
//!
//! Each takes leases, streams prepared episodes, waits for their commits and, unless it is deaf, follows the policies as
//! real actors do. So what is measured is the learner and the wire, nothing else.

use super::meter::Meter;
use super::payload::Payload;
use anyhow::Context;
use herd_common::caps;
use herd_common::status::Heartbeat;
use herd_common::work::{Order, Work};
use herd_proto::client::{self, Client};
use herd_proto::link::{Answer, Hello, Receiver, Report, Sender};
use std::collections::{BTreeMap, VecDeque};
use std::future::Future;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::time::{Duration, SystemTime, UNIX_EPOCH};
use tokio::task::JoinSet;
use tokio::time::{Instant, MissedTickBehavior};
use tokio_util::sync::CancellationToken;

/// What every synthetic actor does.
pub(crate) struct Plan {
    /// Episodes.
    pub(crate) payload: Payload,
    /// Episodes at once, per actor.
    pub(crate) robots: u32,
    /// Does not follow the policies.
    pub(crate) deaf: bool,
    /// Least time between two beginnings of episodes of one actor.
    pub(crate) pause: Duration,
}

/// Running synthetic actors; they end with their runtime.
pub(crate) struct Load {
    /// There until it is dropped.
    runtime: Option<tokio::runtime::Runtime>,
    actors: JoinSet<Result<(), client::Error>>,
    stop: CancellationToken,
    /// What they count.
    pub(crate) meter: Arc<Meter>,
}

/// Tries of one actor to join.
const TRIES: u32 = 10;
/// Threads of all synthetic actors together.
const THREADS: usize = 2;

impl Load {
    /// Starts this many actors of the learner at `address`.
    pub(crate) fn start(actors: u32, address: &str, plan: Plan) -> anyhow::Result<Self> {
        let mut load = Self::empty()?;
        let plan = Arc::new(plan);
        for index in 0..actors {
            // Spread, so that they do not all begin at once after each pause.
            let delay = plan.pause.mul_f64(f64::from(index) / f64::from(actors));
            load.spawn(live(address.to_owned(), plan.clone(), load.meter.clone(), (delay, load.stop.clone())));
        }
        Ok(load)
    }

    /// Only follows the policies of the learner at `address`, to time them on their way.
    pub(crate) fn probe(address: &str) -> anyhow::Result<Self> {
        let mut load = Self::empty()?;
        let (address, meter) = (address.to_owned(), load.meter.clone());
        load.spawn(async move {
            subscribe(Client::connect(&address).await?, meter, Arc::default()).await;
            Ok(())
        });
        Ok(load)
    }

    fn empty() -> anyhow::Result<Self> {
        let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(THREADS).enable_all().build();
        let runtime = Some(runtime.context("start the runtime of the synthetic actors")?);
        Ok(Self { runtime, actors: JoinSet::new(), stop: CancellationToken::new(), meter: Arc::default() })
    }

    fn spawn(&mut self, actor: impl Future<Output = Result<(), client::Error>> + Send + 'static) {
        if let Some(runtime) = &self.runtime {
            self.actors.spawn_on(actor, runtime.handle());
        }
    }

    /// The failure of an actor; waits for as long as there is none. Safe to drop while it waits.
    pub(crate) async fn failed(&mut self) -> anyhow::Error {
        loop {
            match self.actors.join_next().await {
                Some(Ok(Ok(()))) => {}
                Some(Ok(Err(error))) => return error.into(),
                Some(Err(error)) => return error.into(),
                None => std::future::pending().await,
            }
        }
    }

    /// Has every actor finish what it has begun, waits until all of it is acknowledged, and ends them.
    pub(crate) async fn finish(mut self, patience: Duration) -> anyhow::Result<Arc<Meter>> {
        self.stop.cancel();
        let all = async {
            while let Some(ended) = self.actors.join_next().await {
                ended.context("watch a synthetic actor")??;
            }
            anyhow::Ok(())
        };
        tokio::time::timeout(patience, all).await.context("episodes stay without acknowledgement")??;
        Ok(self.meter.clone())
    }
}

impl Drop for Load {
    /// Without waiting, which an asynchronous caller may not.
    fn drop(&mut self) {
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_background();
        }
    }
}

/// One actor from its first word to its last.
async fn live(
    address: String,
    plan: Arc<Plan>,
    meter: Arc<Meter>,
    (delay, stop): (Duration, CancellationToken),
) -> Result<(), client::Error> {
    let (client, sender, receiver) = join(&address, plan.robots).await?;
    let version = Arc::new(AtomicU64::new(0));
    let _follower = (!plan.deaf).then(|| {
        let follower = tokio::spawn(subscribe(client.clone(), meter.clone(), version.clone()));
        tokio_util::task::AbortOnDropHandle::new(follower)
    });
    let actor = Actor {
        plan,
        meter,
        version,
        waiting: VecDeque::new(),
        outgoing: VecDeque::new(),
        sent: BTreeMap::new(),
        next_start: Instant::now() + delay,
    };
    actor.serve(sender, receiver, &stop).await
}

/// Joins as real actors do, who try again when a thousand knock at once.
async fn join(address: &str, robots: u32) -> Result<(Client, Sender, Receiver), client::Error> {
    let hello = Hello { host: "synthetic".into(), pid: std::process::id(), robots, ..Hello::default() };
    let mut tries = 1;
    loop {
        let joined = async {
            let client = Client::connect(address).await?;
            let (_, sender, receiver) = client.join(hello.clone()).await?;
            Ok::<_, client::Error>((client, sender, receiver))
        };
        match joined.await {
            Err(error) if tries < TRIES && error.is_transient() => {
                tracing::warn!(%error, "a synthetic actor tries to join again");
                tries += 1;
                tokio::time::sleep(caps::RECONNECT_PAUSE.0).await;
            }
            joined => return joined,
        }
    }
}

/// Follows the policies; that it has ended is counted, because from then on nothing is timed.
async fn subscribe(client: Client, meter: Arc<Meter>, newest: Arc<AtomicU64>) {
    match follow(client, &meter, &newest).await {
        Ok(()) => meter.lost("the learner ended the stream"),
        Err(error) => meter.lost(&error.to_string()),
    }
}

/// Decodes, checks and keeps each policy, as an actor does before it acts with it.
async fn follow(client: Client, meter: &Meter, newest: &AtomicU64) -> Result<(), client::Error> {
    let mut policies = client.watch_policies(None).await?;
    // The first was published before this actor was there.
    let mut kept = policies.next().await?;
    while let Some(received) = policies.next_received().await? {
        newest.store(received.policy.provenance.version, Relaxed);
        if let Some(unused) = kept.replace(received.policy) {
            policies.give_back(unused);
        }
        if let Some(published) = received.published_unix_nanos {
            meter.applied(Duration::from_nanos(unix_nanos().saturating_sub(published)), received.bytes);
        }
    }
    drop(kept);
    Ok(())
}

struct Actor {
    plan: Arc<Plan>,
    meter: Arc<Meter>,
    version: Arc<AtomicU64>,
    /// Leases whose episodes are not begun.
    waiting: VecDeque<Order>,
    /// What is to be said next.
    outgoing: VecDeque<Report>,
    /// Episodes that wait for their commit, and since when.
    sent: BTreeMap<u64, Instant>,
    next_start: Instant,
}

impl Actor {
    async fn serve(
        mut self,
        sender: Sender,
        mut receiver: Receiver,
        stop: &CancellationToken,
    ) -> Result<(), client::Error> {
        let mut beat = tokio::time::interval(caps::HEARTBEAT_INTERVAL);
        beat.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            let stopping = stop.is_cancelled();
            if stopping && self.outgoing.is_empty() && self.sent.is_empty() {
                return Ok(());
            }
            let may_begin = self.outgoing.is_empty() && !self.waiting.is_empty() && !stopping;
            tokio::select! {
                answer = receiver.next() => if !self.hear(answer?.as_ref()) { return Ok(()) },
                permit = sender.reserve(), if !self.outgoing.is_empty() => {
                    let (Some(permit), Some(report)) = (permit, self.outgoing.pop_front()) else { return Ok(()) };
                    if let Report::Finished { work: Work::Episode(episode), .. } = &report {
                        self.sent.insert(*episode, Instant::now());
                    }
                    permit.send(report);
                }
                () = tokio::time::sleep_until(self.next_start), if may_begin => self.begin(),
                () = stop.cancelled(), if !stopping => {}
                _ = beat.tick() => {
                    let policy_version = self.version.load(Relaxed);
                    sender.try_send(Report::Heartbeat(Heartbeat { policy_version, ..Heartbeat::default() }));
                }
            }
        }
    }

    /// Takes an answer; false at the end of the run.
    fn hear(&mut self, answer: Option<&Answer>) -> bool {
        match answer {
            None | Some(Answer::RunComplete) => return false,
            Some(Answer::Lease(order)) => self.waiting.push_back(*order),
            Some(Answer::Committed(episode)) => {
                if let Some(since) = self.sent.remove(episode) {
                    self.meter.committed(self.plan.payload.decisions(), since.elapsed());
                }
            }
            Some(Answer::Refused { work, .. }) => {
                self.meter.refused();
                if let Work::Episode(episode) = work {
                    self.sent.remove(episode);
                }
            }
        }
        true
    }

    /// Lines up the next leased episode.
    fn begin(&mut self) {
        let Some(Order { work, attempt, .. }) = self.waiting.pop_front() else { return };
        self.next_start = (self.next_start + self.plan.pause).max(Instant::now());
        let payload = &self.plan.payload;
        if let Work::Episode(episode) = work {
            let piece = |(first, piece)| Report::Packed { work, attempt, first, piece };
            self.outgoing.extend(payload.episode(episode).map(piece));
        }
        self.outgoing.push_back(Report::Finished { work, attempt, outcome: payload.outcome() });
    }
}

/// The clock that the learner stamps policies with: on one machine they are the same.
#[expect(clippy::disallowed_methods, reason = "how long things take is what is measured")]
fn unix_nanos() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_nanos() as u64)
}
