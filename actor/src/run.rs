//! An actor process: joins the learner, serves its leases, joins again when the stream breaks, until the run is over.
//!
//! An actor never gives up on a learner that does not answer, since an engine may start the two in any order and move
//! either. It does give up when the two cannot agree on the task, because no amount of trying would change that.

use crate::backoff::{Backoff, Complaints};
use crate::meter::Meter;
use crate::uplink::{End, Herd, Session};
use crate::worker::{Factory, Pool, Task};
use herd_common::caps;
use herd_common::config::Config;
use herd_common::hash::short;
use herd_common::seed::Seed;
use herd_common::work::Work;
use herd_proto::address::Address;
use herd_proto::client::{self, Client};
use herd_proto::link::{Hello, Welcome};
use std::collections::VecDeque;
use std::sync::Arc;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

/// How to run an actor.
#[derive(Clone, Debug)]
pub struct Options {
    /// Where the learner is; looked up again at each try.
    pub learner: Address,
    /// Robots to run at once, each in a thread of its own.
    pub robots: u32,
    /// The task to insist on; none takes the learner's.
    pub task: Option<Config>,
}

/// Why an actor ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ended {
    /// The run has all its episodes.
    Complete,
    /// It was asked to stop.
    Stopped,
}

/// Why an actor, or one of its streams, failed.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A number of robots that cannot be.
    #[error("robots is {0}, expected 1 to {max}", max = caps::ROBOTS_PER_ACTOR)]
    Robots(u32),
    /// The robots' threads could not be started.
    #[error("cannot start the robots' threads")]
    Threads(#[source] std::io::Error),
    /// The two builds understand the configuration differently.
    #[error("actor build {ours} and learner build {theirs} do not understand the task alike: {reason}")]
    Builds {
        /// Ours.
        ours: &'static str,
        /// The learner's.
        theirs: String,
        /// What differs.
        reason: String,
    },
    /// The learner will not have this actor.
    #[error("the learner at {address} refuses this actor")]
    Refused {
        /// Where it is.
        address: String,
        /// Its words.
        #[source]
        source: client::Error,
    },
    /// The connection failed.
    #[error(transparent)]
    Link(#[from] client::Error),
    /// The stream ended before the run was complete.
    #[error("the learner ended the stream")]
    Ended,
    /// More leases than robots.
    #[error("the learner leases {0} episodes at once, more than this actor has robots for")]
    Leases(usize),
    /// A policy that cannot be used.
    #[error("policy {version}: {reason}")]
    Policy {
        /// Its version.
        version: u64,
        /// What is wrong with it.
        reason: String,
    },
    /// A robot panicked.
    #[error("robot panicked in {work}: {reason}")]
    Panicked {
        /// What it ran.
        work: Work,
        /// Its words.
        reason: String,
    },
    /// Robots panic over and over.
    #[error("{count} robots panicked within {secs} s, the last one in {work}: {reason}")]
    Panics {
        /// How many.
        count: usize,
        /// Within which time, s.
        secs: u64,
        /// What the last one ran.
        work: Work,
        /// Its words.
        reason: String,
    },
    /// A promise between the parts of this process is broken.
    #[error("{0}")]
    Internal(String),
}

impl Error {
    /// True when actor and learner do not fit together, or the actor was told nonsense.
    pub fn is_config(&self) -> bool {
        matches!(
            self,
            Self::Robots(_) | Self::Builds { .. } | Self::Refused { .. } | Self::Link(client::Error::Address { .. })
        )
    }

    /// True when another try cannot help.
    fn is_final(&self) -> bool {
        self.is_config() || matches!(self, Self::Threads(_) | Self::Panics { .. })
    }
}

/// Runs an actor with simulated robots until the run is complete or `shutdown` is cancelled.
pub async fn run(options: Options, shutdown: CancellationToken) -> Result<Ended, Error> {
    run_with(options, &crate::simulated::factory(), shutdown).await
}

/// Runs an actor with robots of any make.
pub async fn run_with(options: Options, factory: &Factory, shutdown: CancellationToken) -> Result<Ended, Error> {
    if !(1..=caps::ROBOTS_PER_ACTOR).contains(&options.robots) {
        return Err(Error::Robots(options.robots));
    }
    let meter = Arc::<Meter>::default();
    let pool = Pool::start(options.robots, factory, &meter).map_err(Error::Threads)?;
    let mut actor = Actor::new(options, Herd { pool, meter });
    loop {
        let error = match actor.try_once(&shutdown).await {
            Ok(End::Complete) => return Ok(Ended::Complete),
            Ok(End::Stopped) => return Ok(Ended::Stopped),
            Err(error) => actor.weigh(error)?,
        };
        actor.complain(&error);
        let pause = actor.backoff.pause();
        tokio::select! {
            () = tokio::time::sleep(pause) => {}
            () = shutdown.cancelled() => return Ok(Ended::Stopped),
        }
    }
}

struct Actor {
    options: Options,
    herd: Herd,
    host: String,
    backoff: Backoff,
    complaints: Complaints,
    started: Instant,
    panics: VecDeque<Instant>,
}

impl Actor {
    fn new(options: Options, herd: Herd) -> Self {
        let host = host_name();
        let seed = Seed::from_number(u64::from(std::process::id())).child(&host, 0);
        Self {
            options,
            herd,
            host,
            backoff: Backoff::new(seed),
            complaints: Complaints::default(),
            started: Instant::now(),
            panics: VecDeque::new(),
        }
    }

    /// One stream, from looking up the address to its end.
    async fn try_once(&mut self, shutdown: &CancellationToken) -> Result<End, Error> {
        let joining = async {
            let address = self.options.learner.resolve()?;
            let client = Client::connect(&address).await?;
            let joined = client.join(self.hello()).await.map_err(|source| refused(&address, source))?;
            Ok::<_, Error>((client, joined))
        };
        let (client, (welcome, sender, receiver)) = tokio::select! {
            () = shutdown.cancelled() => return Ok(End::Stopped),
            joined = joining => joined?,
        };
        let task = agree(&welcome, self.options.task.as_ref())?;
        self.backoff.reset();
        tracing::info!(
            run = short(&welcome.run),
            epoch = welcome.epoch,
            actor = welcome.actor_id,
            robots = self.options.robots,
            task = task.config.task.kind.name(),
            "joined"
        );
        let (session, told) = Session::new(&self.herd, client, task);
        session.serve((sender, receiver), told, shutdown).await
    }

    fn hello(&self) -> Hello {
        let task = self.options.task.as_ref();
        Hello {
            task_hash: task.map(Config::task_hash).unwrap_or_default(),
            task: task.map(|config| config.task.kind.name().to_owned()).unwrap_or_default(),
            host: self.host.clone(),
            pid: std::process::id(),
            robots: self.options.robots,
        }
    }

    /// Gives back an error that another try may cure; panics are cured only so often.
    fn weigh(&mut self, error: Error) -> Result<Error, Error> {
        let Error::Panicked { work, reason } = error else {
            return if error.is_final() { Err(error) } else { Ok(error) };
        };
        let now = Instant::now();
        self.panics.push_back(now);
        self.panics.retain(|at| now.duration_since(*at) < caps::RESTART_WINDOW);
        let count = self.panics.len();
        if count > caps::RESTARTS {
            return Err(Error::Panics { count, secs: caps::RESTART_WINDOW.as_secs(), work, reason });
        }
        Ok(Error::Panicked { work, reason })
    }

    fn complain(&mut self, error: &Error) {
        if matches!(error, Error::Panicked { .. }) {
            tracing::error!(%error, "joining again with a new robot");
        } else if self.complaints.is_due(&error.to_string(), self.started.elapsed()) {
            tracing::warn!(learner = %self.options.learner, %error, "trying again until it works");
        }
    }
}

/// A refusal that another try cannot change, told apart from one that it can.
fn refused(address: &str, source: client::Error) -> Error {
    match source {
        client::Error::Refused { .. } if !source.is_transient() => Error::Refused { address: address.into(), source },
        source => Error::Link(source),
    }
}

/// The task that both sides mean.
fn agree(welcome: &Welcome, insisted: Option<&Config>) -> Result<Task, Error> {
    let differ = |reason: String| Error::Builds { ours: herd_proto::BUILD, theirs: welcome.build.clone(), reason };
    if welcome.config.len() > caps::CONFIG_BYTES {
        return Err(differ(format!("its configuration takes {} bytes", welcome.config.len())));
    }
    let config =
        Config::from_toml(&welcome.config, "the learner's configuration").map_err(|e| differ(e.to_string()))?;
    let hashes = [Some(config.task_hash()), insisted.map(Config::task_hash)];
    if let Some(hash) = hashes.into_iter().flatten().find(|hash| *hash != welcome.task_hash) {
        let (ours, theirs) = (short(&hash), short(&welcome.task_hash));
        return Err(differ(format!("task {ours} here, task {theirs} there")));
    }
    Ok(Task { config, hash: welcome.task_hash.clone() })
}

/// This host's name as the wire allows it.
fn host_name() -> String {
    let name = rustix::system::uname();
    let allowed = |c: &char| c.is_ascii_alphanumeric() || matches!(c, '.' | '_' | '-');
    let name: String = name.nodename().to_string_lossy().chars().filter(allowed).take(caps::NAME_BYTES).collect();
    if name.is_empty() { "unknown".to_owned() } else { name }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{Learner, Puppet, Script, order};
    use herd_common::work::Order;
    use std::time::Duration;

    async fn run_at(learner: &str, robots: u32, shutdown: CancellationToken) -> Result<Ended, Error> {
        let options = Options { learner: learner.parse().expect("an address"), robots, task: None };
        let factory = Puppet::factory();
        let running = run_with(options, &factory, shutdown);
        tokio::time::timeout(Duration::from_mins(2), running).await.expect("ends")
    }

    async fn run(script: Script, robots: u32) -> (Result<Ended, Error>, Learner) {
        let learner = Learner::new(script);
        let ended = run_at(&learner.serve().await, robots, CancellationToken::new()).await;
        (ended, learner)
    }

    fn leases(episodes: std::ops::Range<u64>) -> Script {
        Script { leases: episodes.map(order).collect(), ..Script::default() }
    }

    #[track_caller]
    fn all_whole(learner: &Learner, episodes: usize) {
        let finished = learner.seen().finished;
        assert_eq!(finished.len(), episodes);
        assert!(finished.values().all(|count| *count == Puppet::LENGTH), "{finished:?}");
    }

    #[tokio::test]
    async fn every_lease_comes_back_whole() {
        let (ended, learner) = run(leases(0..10), 3).await;
        assert_eq!(ended.expect("complete"), Ended::Complete);
        all_whole(&learner, 10);
        let hello = &learner.seen().hellos[0];
        assert_eq!((hello.robots, hello.pid), (3, std::process::id()));
        assert!(herd_proto::convert::hello_name("host", &hello.host).is_ok(), "{hello:?}");
    }

    #[tokio::test]
    async fn a_broken_stream_is_joined_again() {
        let (ended, learner) = run(Script { breaks_after: Some(4), ..leases(0..6) }, 2).await;
        assert_eq!(ended.expect("complete"), Ended::Complete);
        all_whole(&learner, 6);
        assert_eq!(learner.seen().hellos.len(), 2);
    }

    #[tokio::test]
    async fn a_missing_policy_is_fetched_once() {
        let needs = |episode| Order { random: false, policy_version: 7, ..order(episode) };
        let (ended, learner) = run(Script { leases: (0..4).map(needs).collect(), ..Script::default() }, 2).await;
        assert_eq!(ended.expect("complete"), Ended::Complete);
        all_whole(&learner, 4);
        assert_eq!(learner.seen().fetched, [7]);
    }

    #[tokio::test]
    async fn a_panic_costs_the_stream_and_no_more() {
        let mut script = leases(0..3);
        script.leases.push_front(order(Puppet::PANICS));
        let (ended, learner) = run(script, 1).await;
        assert_eq!(ended.expect("complete"), Ended::Complete);
        all_whole(&learner, 3);
        assert_eq!(learner.seen().hellos.len(), 2);
    }

    #[tokio::test]
    async fn a_refused_episode_frees_its_robot() {
        let mut script = leases(0..3);
        script.leases.push_front(order(Puppet::ENDLESS));
        let work = Work::Episode(Puppet::ENDLESS);
        let (ended, learner) = run(Script { drops: Some(work), ..script }, 1).await;
        assert_eq!(ended.expect("complete"), Ended::Complete);
        all_whole(&learner, 3);
    }

    #[tokio::test]
    async fn a_mismatch_is_final_and_names_both_sides() {
        let refuses = Some(tonic::Status::failed_precondition("task a here, task b there"));
        let (ended, _) = run(Script { refuses, ..leases(0..1) }, 1).await;
        let error = ended.expect_err("refused");
        assert!(error.is_config(), "{error}");

        let (ended, _) = run(Script { task_hash: Some("0123456789abcdef".into()), ..leases(0..1) }, 1).await;
        let error = ended.expect_err("refused");
        assert!(error.is_config() && error.to_string().contains("task 0123456789ab there"), "{error}");
    }

    #[tokio::test]
    async fn a_learner_that_is_full_or_late_is_waited_for() {
        let path = std::env::temp_dir().join(format!("herd-late-{}", std::process::id()));
        let address = format!("file:{}", path.display());
        let (learner, stop) = (Learner::new(leases(0..2)), CancellationToken::new());
        let served = learner.serve().await;
        let appears = async {
            // The actor has looked for the file by then.
            for _ in 0..100 {
                tokio::task::yield_now().await;
            }
            std::fs::write(&path, served).expect("writes");
        };
        let (ended, ()) = tokio::join!(run_at(&address, 1, stop), appears);
        assert_eq!(ended.expect("complete"), Ended::Complete);
        std::fs::remove_file(&path).expect("removes");
        assert!(!refused("a", client::Error::from(tonic::Status::resource_exhausted("full"))).is_final());
    }

    #[tokio::test]
    async fn an_actor_stops_when_asked() {
        let learner = Learner::new(leases(Puppet::ENDLESS..Puppet::ENDLESS + 1));
        let (address, stop) = (learner.serve().await, CancellationToken::new());
        let asks = async {
            while learner.seen().hellos.is_empty() {
                tokio::task::yield_now().await;
            }
            stop.cancel();
        };
        let (ended, ()) = tokio::join!(run_at(&address, 1, stop.clone()), asks);
        assert_eq!(ended.expect("stopped"), Ended::Stopped);
    }

    #[tokio::test]
    async fn a_number_of_robots_that_cannot_be_is_refused() {
        for robots in [0, caps::ROBOTS_PER_ACTOR + 1] {
            assert!(run_at("127.0.0.1:1", robots, CancellationToken::new()).await.expect_err("refused").is_config());
        }
    }
}
