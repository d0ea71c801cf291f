//! Every bound of the system in one place: queues, messages, retries, loops, waits.
//!
//! A bound that users tune is a config key instead; these are the limits beyond which something is wrong.

use std::time::Duration;

// ---- wire ----

/// Largest gRPC message either side decodes; a policy of the default networks takes 0.65 MB.
pub const MESSAGE_BYTES: usize = 16 << 20;
/// Most transitions in one message; an episode of 10 s has at most 400 (torque task).
pub const TRANSITIONS_PER_MESSAGE: usize = 4096;
/// Most transitions in one episode: 100 s at one decision each 10 ms.
pub const TRANSITIONS_PER_EPISODE: usize = 10_000;
/// Longest name (host, actor) accepted from the wire.
pub const NAME_BYTES: usize = 64;
/// Longest configuration text accepted from the wire or a file.
pub const CONFIG_BYTES: usize = 1 << 20;
/// Longest address of a learner.
pub const ADDRESS_BYTES: usize = 300;
/// Most layers in a policy, and most numbers in one of them.
pub const POLICY_LAYERS: usize = 16;
/// Most weights in one policy layer.
pub const POLICY_LAYER_WEIGHTS: usize = 16 << 20;
/// Most robots one actor process may run.
pub const ROBOTS_PER_ACTOR: u32 = 256;
/// Largest HTTP/2 frame either side takes: a policy of the default networks fits into one, and so is not put together.
pub const FRAME_BYTES: u32 = 1 << 20;
/// Streams one connection may hold open.
pub const STREAMS_PER_CONNECTION: u32 = 64;

// ---- learner ----

/// Actors connected at once; the next one is refused with `RESOURCE_EXHAUSTED`.
pub const ACTORS: usize = 1024;
/// Connections accepted at once (actors, status clients, probes).
pub const CONNECTIONS: usize = 4096;
/// Commands waiting for the trainer; senders wait when it is full, and so the network does.
pub const TRAINER_QUEUE: usize = 1024;
/// Episodes that one sync of the journal may cover; each is acknowledged when the sync has returned.
pub const COMMITS_PER_SYNC: usize = 256;
/// Commands handled between two updates, so that neither starves the other.
pub const COMMANDS_PER_TURN: usize = 64;
/// Messages waiting for one actor; an actor that does not read them is disconnected. One sync may acknowledge
/// `COMMITS_PER_SYNC` episodes to it at once, with leases for `ROBOTS_PER_ACTOR` behind them.
pub const ACTOR_QUEUE: usize = 1024;
/// Messages of one actor that may break the contract before its stream is ended.
pub const REFUSALS_PER_ACTOR: u32 = 16;
/// How often one episode is leased before the run stops: beyond it the episode itself is at fault.
pub const LEASES_PER_EPISODE: u32 = 100;
/// Evaluations that may be unfinished when a new episode is leased; beyond it episodes wait for them.
pub const EVALUATIONS_BEHIND: usize = 8;
/// Episodes that the journal may hold.
pub const EPISODES: u64 = 1 << 40;
/// Bytes of one journal record.
pub const JOURNAL_RECORD_BYTES: usize = 64 << 20;
/// Checkpoints kept.
pub const CHECKPOINTS_KEPT: usize = 3;
/// Consecutive updates skipped for a non-finite loss before training stops.
pub const SKIPPED_UPDATES: u32 = 100;
/// Updates that a GPU is given in one round; nobody waits for an answer, or looks at commands, in between.
pub const UPDATES_PER_ROUND: usize = 64;
/// Transitions in the minibatches of one round, so that large ones do not make it longer; a single one may be larger.
pub const TRANSITIONS_PER_ROUND: usize = 1 << 17;
/// Numbers of networks and minibatch on a GPU: its kernels count places in 32 bits.
pub const DEVICE_NUMBERS: usize = u32::MAX as usize;
/// Decisions that one learned transition may fold (n-step returns).
pub const FOLDED_DECISIONS: usize = 64;
/// Recent episodes that status averages over.
pub const RETURN_WINDOW: usize = 100;

// ---- actor ----

/// Policies an actor keeps; the deterministic schedule asks for versions up to `lag` old.
pub const POLICIES_CACHED: usize = 64;
/// Events a robot thread may have waiting for the uplink; it blocks beyond.
pub const UPLINK_QUEUE: usize = 1024;
/// Control ticks of one decision: 5 s at 500 Hz.
pub const TICKS_PER_DECISION: usize = 2500;
/// Most ticks by which a scenario may delay torques: 0.2 s at 500 Hz.
pub const DELAY_TICKS: u32 = 100;
/// Iterations of one quadratic programme before the fallback takes over.
pub const QP_ITERATIONS: usize = 400;

// ---- waits ----

/// Bounds of the pause before an actor connects again; it never gives up.
pub const RECONNECT_PAUSE: (Duration, Duration) = (Duration::from_millis(200), Duration::from_secs(5));
/// Time for one TCP connect, and for one unary call.
pub const CALL_TIMEOUT: Duration = Duration::from_secs(10);
/// HTTP/2 pings: after this much silence …
pub const KEEPALIVE_INTERVAL: Duration = Duration::from_secs(5);
/// … the peer has this long to answer before the connection is closed.
pub const KEEPALIVE_TIMEOUT: Duration = Duration::from_secs(4);
/// A new connection must have sent its HTTP/2 preface by then.
pub const HANDSHAKE_TIMEOUT: Duration = Duration::from_secs(5);
/// How often an actor reports its counters.
pub const HEARTBEAT_INTERVAL: Duration = Duration::from_secs(1);
/// An actor that says nothing for this long has left.
pub const ACTOR_SILENCE: Duration = Duration::from_secs(10);
/// How long a shutdown waits for streams to end before it drops them.
pub const DRAIN_TIMEOUT: Duration = Duration::from_secs(5);
/// Restarts of a child that `herd train` allows within `RESTART_WINDOW`.
pub const RESTARTS: usize = 20;
/// See `RESTARTS`.
pub const RESTART_WINDOW: Duration = Duration::from_mins(1);
/// Pause of `herd train` before it restarts a dead child.
pub const RESTART_PAUSE: Duration = Duration::from_millis(500);
