//! One stream to the learner, from `Hello` to its end: leases down, episodes up.
//!
//! A single task owns everything here. Robots hand it what they gathered through a bounded queue that it empties only
//! as fast as the network takes it, so a slow learner slows the robots down. What ends the stream ends every episode
//! on it: the learner leases those again, and the next stream starts with free robots.

use crate::meter::{Meter, Realtime};
use crate::policies::{Need, Shelf};
use crate::run::Error;
use crate::worker::{Assignment, Event, Pool, Task, What};
use herd_common::caps;
use herd_common::policy::Policy;
use herd_common::status::Heartbeat;
use herd_common::work::{Order, Work};
use herd_proto::client::{self, Client};
use herd_proto::link::{Answer, Receiver, Report, Sender};
use herd_proto::watch::PolicyStream;
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::mpsc;
use tokio::task::JoinSet;
use tokio::time::{Instant, MissedTickBehavior};
use tokio_util::sync::CancellationToken;

/// Why a stream came to its proper end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum End {
    /// The run has all its episodes.
    Complete,
    /// The actor was asked to stop.
    Stopped,
}

/// What outlives a stream.
#[derive(Debug)]
pub(crate) struct Herd {
    /// The robots.
    pub pool: Pool,
    /// What they measure.
    pub meter: Arc<Meter>,
}

/// One joined stream.
#[derive(Debug)]
pub(crate) struct Session<'a> {
    herd: &'a Herd,
    client: Client,
    task: Arc<Task>,
    shelf: Shelf,
    /// Leases that wait for a policy or a robot.
    waiting: VecDeque<Order>,
    running: BTreeMap<usize, Running>,
    fetches: JoinSet<Result<Policy, client::Error>>,
    events: mpsc::Sender<Event>,
    cancel: CancellationToken,
    joined: Instant,
    realtime: Realtime,
}

#[derive(Debug)]
struct Running {
    work: Work,
    attempt: u32,
    cancel: CancellationToken,
}

impl Drop for Session<'_> {
    fn drop(&mut self) {
        self.cancel.cancel();
    }
}

impl<'a> Session<'a> {
    /// A session of `task` over `client`, and the queue that its robots report to.
    pub(crate) fn new(herd: &'a Herd, client: Client, task: Task) -> (Self, mpsc::Receiver<Event>) {
        let (events, told) = mpsc::channel(caps::UPLINK_QUEUE);
        let session = Self {
            joined: Instant::now(),
            realtime: Realtime::new(Duration::ZERO, herd.meter.simulated_secs()),
            herd,
            client,
            task: Arc::new(task),
            shelf: Shelf::default(),
            waiting: VecDeque::new(),
            running: BTreeMap::new(),
            fetches: JoinSet::new(),
            events,
            cancel: CancellationToken::new(),
        };
        (session, told)
    }

    /// Serves the stream to its end.
    pub(crate) async fn serve(
        mut self,
        (sender, mut receiver): (Sender, Receiver),
        mut told: mpsc::Receiver<Event>,
        shutdown: &CancellationToken,
    ) -> Result<End, Error> {
        let mut policies = self.client.watch_policies(None).await.ok();
        let mut beat = tokio::time::interval(caps::HEARTBEAT_INTERVAL);
        beat.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            tokio::select! {
                () = shutdown.cancelled() => return Ok(End::Stopped),
                answer = receiver.next() => {
                    if self.hear(answer?)? {
                        return Ok(End::Complete);
                    }
                }
                policy = newest(&mut policies) => {
                    if let (Some(unused), Some(stream)) = (self.add(policy)?, &mut policies) {
                        stream.give_back(unused);
                    }
                }
                Some(fetched) = self.fetches.join_next() => {
                    self.add(fetched.map_err(|e| Error::Internal(e.to_string()))??)?;
                }
                (permit, event) = reportable(&sender, &mut told) => {
                    if let Some(report) = self.report(event)? {
                        permit.send(report);
                    }
                }
                _ = beat.tick() => {
                    sender.try_send(Report::Heartbeat(self.heartbeat()));
                }
            }
            self.dispatch()?;
        }
    }

    /// Takes an answer; true when the run is complete.
    fn hear(&mut self, answer: Option<Answer>) -> Result<bool, Error> {
        match answer {
            None => return Err(Error::Ended),
            Some(Answer::RunComplete) => return Ok(true),
            Some(Answer::Lease(order)) => {
                if self.waiting.len() >= self.herd.pool.len() {
                    return Err(Error::Leases(self.waiting.len() + self.running.len() + 1));
                }
                self.waiting.push_back(order);
            }
            Some(Answer::Refused { work, attempt, reason }) => {
                tracing::info!(%work, attempt, reason, "the learner refuses an episode");
                self.waiting.retain(|order| (order.work, order.attempt) != (work, attempt));
                for running in self.running.values().filter(|r| (r.work, r.attempt) == (work, attempt)) {
                    running.cancel.cancel();
                }
            }
            Some(Answer::Committed(episode)) => tracing::trace!(episode, "committed"),
        }
        Ok(false)
    }

    fn add(&mut self, policy: Policy) -> Result<Option<Policy>, Error> {
        let version = policy.provenance.version;
        tracing::debug!(version, "policy");
        self.shelf.add(policy, &self.task.config, &self.task.hash).map_err(|reason| Error::Policy { version, reason })
    }

    /// Gives each waiting order that has all it needs to a free robot; asks for the policies that are missing.
    fn dispatch(&mut self) -> Result<(), Error> {
        for order in std::mem::take(&mut self.waiting) {
            let policy = match self.shelf.need(&order, &self.task.config) {
                Need::Missing(version) => {
                    if self.shelf.request(version) {
                        self.fetches.spawn(fetch(self.client.clone(), version));
                    }
                    self.waiting.push_back(order);
                    continue;
                }
                Need::Nothing => None,
                Need::Policy(policy) => Some(policy),
            };
            let Some(robot) = (0..self.herd.pool.len()).find(|robot| !self.running.contains_key(robot)) else {
                self.waiting.push_back(order);
                continue;
            };
            let cancel = self.cancel.child_token();
            let running = Running { work: order.work, attempt: order.attempt, cancel: cancel.clone() };
            self.running.insert(robot, running);
            let (task, events) = (self.task.clone(), self.events.clone());
            if !self.herd.pool.assign(robot, Assignment { order, policy, task, cancel, events }) {
                return Err(Error::Internal(format!("robot {robot} takes no orders any more")));
            }
        }
        Ok(())
    }

    /// The report that a robot's event makes, if the learner still wants to know.
    fn report(&mut self, event: Event) -> Result<Option<Report>, Error> {
        let Event { robot, work, attempt, what } = event;
        let wanted = self.running.get(&robot).is_some_and(|running| !running.cancel.is_cancelled());
        let report = match what {
            What::Piece { first, batch } => {
                return Ok(wanted.then_some(Report::Transitions { work, attempt, first, batch }));
            }
            What::Finished(outcome) => wanted.then_some(Report::Finished { work, attempt, outcome }),
            What::Dropped if wanted => return Err(Error::Internal(format!("{work} was dropped though it is wanted"))),
            What::Dropped => None,
            What::Panicked(reason) => return Err(Error::Panicked { work, reason }),
        };
        self.running.remove(&robot);
        Ok(report)
    }

    fn heartbeat(&mut self) -> Heartbeat {
        let realtime_factor = self.realtime.factor(self.joined.elapsed(), self.herd.meter.simulated_secs());
        Heartbeat { realtime_factor, policy_version: self.shelf.newest(), qp: self.herd.meter.qp() }
    }
}

/// The next published policy. When that stream fails, single policies are fetched instead, and a connection that is
/// gone ends the stream of leases as well.
async fn newest(policies: &mut Option<PolicyStream>) -> Policy {
    if let Some(stream) = policies {
        match stream.next().await {
            Ok(Some(policy)) => return policy,
            Ok(None) => tracing::debug!("the stream of policies ended"),
            Err(error) => tracing::warn!(%error, "the stream of policies broke"),
        }
        *policies = None;
    }
    std::future::pending().await
}

/// The next event, once there is room for what it may have to say; nothing is lost when this is dropped half way. Waits
/// for ever when the stream is closed: the receiving half says why.
async fn reportable<'s>(sender: &'s Sender, told: &mut mpsc::Receiver<Event>) -> (herd_proto::link::Permit<'s>, Event) {
    match sender.reserve().await {
        Some(permit) => match told.recv().await {
            Some(event) => (permit, event),
            None => std::future::pending().await,
        },
        None => std::future::pending().await,
    }
}

/// Fetches one policy; tries again a few times when the network is at fault.
async fn fetch(client: Client, version: u64) -> Result<Policy, client::Error> {
    for _ in 1..FETCHES {
        match client.policy(version).await {
            Err(client::Error::Refused { code: tonic::Code::Unavailable | tonic::Code::DeadlineExceeded, .. }) => {
                tokio::time::sleep(caps::RECONNECT_PAUSE.0).await;
            }
            answer => return answer,
        }
    }
    client.policy(version).await
}

/// Tries to fetch one policy before the stream is given up.
const FETCHES: u32 = 5;
