//! What a run says of itself when asked: one snapshot, in the words that users read.

use serde::{Deserialize, Serialize};

/// The state of a run.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Status {
    /// Content name of the run: seed and configuration.
    pub run: String,
    /// How often a learner has been started on this run directory.
    pub epoch: u64,
    /// `training`, `complete` or `stopping`.
    pub phase: String,
    /// `deterministic` or `throughput`.
    pub schedule: String,
    /// `disk` or `memory`.
    pub durability: String,
    /// Episodes committed.
    pub episodes: u64,
    /// Episodes the run is to have.
    pub episodes_target: u64,
    /// Transitions committed.
    pub transitions: u64,
    /// Updates done.
    pub updates: u64,
    /// Newest published policy.
    pub policy_version: u64,
    /// Time since this learner was started, s.
    pub uptime_secs: f64,
    /// Expected time to the end at the recent rate, s; absent before the first commit.
    pub eta_secs: Option<f64>,
    /// Recent rates.
    pub rates: Rates,
    /// Returns of recent episodes.
    pub returns: Returns,
    /// Replay memory.
    pub replay: Replay,
    /// Last losses.
    pub losses: Losses,
    /// Durable state.
    pub history: History,
    /// Solver figures over all connected actors.
    pub qp: Qp,
    /// Endings since the run began, by name.
    pub endings: Vec<(String, u64)>,
    /// Connected actors, by id.
    pub actors: Vec<Actor>,
    /// What limits the run now.
    pub bottleneck: String,
    /// Where the trainer's time went.
    pub time: Time,
    /// What went over the wire.
    pub traffic: Traffic,
}

/// Where the time of the trainer thread went since the learner was started; the rest is messages and bookkeeping.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Time {
    /// Updates, s.
    pub updates_secs: f64,
    /// Waiting until commits are on disk, s.
    pub sync_secs: f64,
    /// Waiting for episodes, s.
    pub idle_secs: f64,
}

/// What went over the learner's connections since it was started, HTTP/2 included.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Traffic {
    /// From actors and operators.
    pub received_bytes: u64,
    /// To them.
    pub sent_bytes: u64,
}

/// Per second, over the last ten seconds or so.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Rates {
    /// Episodes committed per second.
    pub episodes: f64,
    /// Transitions committed per second.
    pub transitions: f64,
    /// Updates per second.
    pub updates: f64,
}

/// Returns (eq 10 summed over an episode).
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Returns {
    /// Mean over the recent episodes.
    pub mean: f64,
    /// The last committed one.
    pub last: f64,
    /// The best so far.
    pub best: f64,
    /// Mean of the last evaluation (no noise).
    pub evaluation: Option<f64>,
    /// Mean episode length over the recent episodes, s.
    pub seconds: f64,
    /// Share of recent episodes that ended in a fall.
    pub fall_rate: f64,
}

/// Fill of the replay memory.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Replay {
    /// Transitions held.
    pub len: u64,
    /// Transitions it can hold.
    pub capacity: u64,
    /// Mean age, in policy versions, of the policies that gathered the last committed episodes.
    pub staleness: f64,
}

/// Figures of the last update.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Losses {
    /// Eq 6.
    pub critic: f64,
    /// Minus the mean value of the actor's own actions.
    pub actor: f64,
    /// Mean value of the batch.
    pub value: f64,
    /// Updates skipped because a number was not finite.
    pub skipped: u64,
}

/// Journal and checkpoints.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct History {
    /// Bytes in the journal.
    pub journal_bytes: u64,
    /// Episodes committed since the newest checkpoint.
    pub episodes_since_checkpoint: u64,
    /// Age of the newest checkpoint, s; absent when there is none yet.
    pub checkpoint_age_secs: Option<f64>,
}

/// Quadratic programmes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Qp {
    /// Solved.
    pub solves: u64,
    /// Given up on by the primary solver.
    pub failures: u64,
    /// Median time of one, µs.
    pub p50_micros: f64,
    /// 99th percentile, µs.
    pub p99_micros: f64,
}

/// One connected actor.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Actor {
    /// Number the learner gave it.
    pub id: u64,
    /// Its host.
    pub host: String,
    /// Its process.
    pub pid: u32,
    /// Robots it runs.
    pub robots: u32,
    /// Episodes it holds a lease for.
    pub leases: u32,
    /// Episodes it has finished.
    pub episodes: u64,
    /// Of those, falls.
    pub falls: u64,
    /// Simulated seconds per second, summed over its robots.
    pub realtime_factor: f64,
    /// Newest policy it used.
    pub policy_version: u64,
    /// Time since its last message, s.
    pub last_seen_secs: f64,
    /// Its solver figures.
    pub qp: Qp,
}

/// Counters an actor reports while it runs; they depend on the clock and never enter the journal.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Heartbeat {
    /// Simulated seconds per second since the last report, summed over robots.
    pub realtime_factor: f64,
    /// Newest policy in use.
    pub policy_version: u64,
    /// Solver figures since the actor started.
    pub qp: Qp,
}
