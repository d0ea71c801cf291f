//! The trainer: one thread that owns everything a run consists of, and moves it on commit by commit.
//!
//! ```text
//! commands ─► ledger ─► journal ─► replay ─► ddpg ─► shelf ─► leases
//! ```
//! Episodes that may be committed at the same time share one sync of the journal and are acknowledged together; they
//! are learned from one by one, in order, so it makes no difference to the run how many there were.
//!
//! A turn does one small thing (an update or what a GPU takes at once, a commit, a publication), then looks at the
//! commands again, so that neither learning nor the network starves the other. When commits are synced depends on the
//! clock; what is learned from them, and in which order, does not in deterministic order: there the weights are a
//! function of seed and configuration.

mod checkpointing;
pub mod command;
mod digest;
mod reporting;
mod seats;
mod tally;

use crate::ddpg::{self, Learner};
use crate::history::checkpoint;
use crate::history::epoch::{self, Epoch};
use crate::history::journal::{self, Journal, Position};
use crate::history::lease::{Claim, Exhausted};
use crate::history::ledger::Ledger;
use crate::history::record::{Committed, Record};
use crate::history::refusal::Refusal;
use crate::metrics::{EvaluationLine, Lines};
use crate::replay::Replay;
use crate::run_dir::RunDir;
use crate::shelf::Shelf;
pub(crate) use checkpointing::commits_in_checkpoint;
use command::{Command, Notice};
use digest::Digest;
use herd_common::caps;
use herd_common::config::{Config, run::Durability};
use herd_common::episode::Outcome;
use herd_common::policy::Provenance;
use herd_common::seed::Seed;
use herd_common::status::Time;
use herd_common::work::{Order, Work};
use seats::Seats;
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use std::time::{Duration, Instant};
use tally::{Meter, Tally};
use tokio::sync::{mpsc, watch};

/// How a trainer ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ended {
    /// The run has all its episodes.
    Complete,
    /// It was asked to stop; checkpoint and journal together hold everything.
    Stopped,
}

/// Why a trainer cannot go on. The run on disk is as good as its last commit.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// Reading or writing the run directory failed.
    #[error("run directory: {0}")]
    Io(#[from] std::io::Error),
    /// The journal.
    #[error(transparent)]
    Journal(#[from] journal::Error),
    /// A checkpoint.
    #[error(transparent)]
    Checkpoint(#[from] checkpoint::Error),
    /// The epoch.
    #[error(transparent)]
    Epoch(#[from] epoch::Error),
    /// The learner's mathematics.
    #[error(transparent)]
    Ddpg(#[from] ddpg::Error),
    /// What was learned is not a policy.
    #[error(transparent)]
    Export(#[from] crate::export::Error),
    /// An episode that no actor finishes.
    #[error(transparent)]
    Exhausted(#[from] Exhausted),
    /// Another learner took over the run directory.
    #[error("another learner was started on this run directory, so this one (epoch {0}) ends")]
    Fenced(u64),
}

/// The state of a run. See the module's drawing for who feeds whom.
pub struct Trainer {
    config: Config,
    seed: Seed,
    dir: RunDir,
    epoch: Epoch,
    ledger: Ledger,
    journal: Journal,
    replay: Replay,
    ddpg: Learner,
    tally: Tally,
    metrics: Lines,
    evaluations: Lines,
    shelf: watch::Sender<Arc<Shelf>>,
    /// What the journal has and was not learned from yet, with the point of the journal behind each.
    pending: VecDeque<(Record, Position)>,
    committed_at: f64,
    published_at: f64,
    /// The commit that is being learned from.
    digest: Option<Digest>,
    /// The point of the journal behind everything that was learned from.
    learned: Position,
    /// Who finished which episode, until its commit is acknowledged.
    authors: BTreeMap<u64, u64>,
    /// Something happened after which there may be leases to give.
    may_lease: bool,
    housekept_at: f64,
    provenance: Provenance,
    checkpointed: Checkpointed,
    seats: Seats,
    meter: Meter,
    time: Time,
    phase: &'static str,
    started: Instant,
}

/// When the newest checkpoint was written.
#[derive(Clone, Copy, Debug, Default)]
struct Checkpointed {
    episodes: u64,
    at: Option<f64>,
}

/// What a turn came to.
enum Turn {
    Worked,
    Idle,
    Complete,
}

/// Longest wait for a command when there is nothing else to do.
const IDLE_WAIT: Duration = Duration::from_millis(100);
/// Time after which episodes are committed though earlier ones are still to be learned from: nobody waits much longer
/// for an acknowledgement, and syncs take little of the time for learning.
const COMMIT_SECS: f64 = 0.05;
/// Time between two looks at who is silent and what has expired.
const HOUSEKEEPING_SECS: f64 = 0.05;
/// After completion the learner answers this long, so that everybody hears of it.
const FAREWELL_SECS: (f64, f64) = (1.5, 5.0);

impl Trainer {
    /// Runs until the run is complete or somebody says stop.
    pub fn run(mut self, mut inbox: mpsc::Receiver<Command>, runtime: &tokio::runtime::Handle) -> Result<Ended, Error> {
        loop {
            if self.obey(&mut inbox)? {
                return Ok(Ended::Stopped);
            }
            self.keep_house();
            match self.turn()? {
                Turn::Worked => {}
                Turn::Complete => return self.bid_farewell(&mut inbox, runtime),
                Turn::Idle => {
                    let wait = async { tokio::time::timeout(IDLE_WAIT, inbox.recv()).await };
                    let begun = self.now();
                    let waited = runtime.block_on(wait);
                    self.time.idle_secs += self.now() - begun;
                    if let Ok(Some(command)) = waited
                        && self.handle(command)?
                    {
                        return Ok(Ended::Stopped);
                    }
                }
            }
            self.offer_leases()?;
        }
    }

    /// One small step of the run.
    fn turn(&mut self) -> Result<Turn, Error> {
        if self.pending.is_empty() || self.now() - self.committed_at > COMMIT_SECS {
            self.commit_all()?;
        }
        if self.digest.is_some() {
            self.digest_more()?;
        } else if let Some((record, behind)) = self.pending.pop_front() {
            match record {
                Record::Episode(committed) => self.begin_digest(&committed, behind),
                Record::Evaluation { version, outcomes } => self.conclude_evaluation(version, &outcomes, behind)?,
            }
        } else {
            return Ok(if self.ledger.is_complete() { Turn::Complete } else { Turn::Idle });
        }
        Ok(Turn::Worked)
    }

    /// Commits what is over and whose turn it is with one sync, then acknowledges each episode.
    fn commit_all(&mut self) -> Result<(), Error> {
        let known = self.pending.len();
        let mut due = Vec::new();
        while let Some((version, outcomes)) = self.ledger.next_evaluation() {
            due.push(Record::Evaluation { version, outcomes });
        }
        while known + due.len() < caps::COMMITS_PER_SYNC {
            let Some(committed) = self.ledger.next_commit() else { break };
            due.push(Record::Episode(committed));
        }
        if due.is_empty() {
            return Ok(());
        }
        self.assert_current()?;
        for record in due {
            self.journal.append(&record)?;
            self.pending.push_back((record, self.journal.position()));
        }
        self.keep()?;
        for (record, _) in self.pending.iter().skip(known) {
            if let Record::Episode(Committed { episode, .. }) = record
                && let Some(actor) = self.authors.remove(episode)
            {
                // One that left or does not read loses nothing but the news.
                self.seats.tell(actor, Notice::Committed(*episode));
            }
        }
        self.committed_at = self.now();
        self.may_lease = true;
        Ok(())
    }

    /// Fails once another learner has taken the run over: before anything is written, and before it is said to be kept.
    fn assert_current(&self) -> Result<(), Error> {
        if self.epoch.is_current()? { Ok(()) } else { Err(Error::Fenced(self.epoch.number())) }
    }

    /// Makes what was appended to the journal as durable as the configuration asks.
    fn keep(&mut self) -> Result<(), Error> {
        self.assert_current()?;
        let begun = self.now();
        match self.config.history.durability {
            Durability::Disk => self.journal.sync()?,
            Durability::Memory => self.journal.flush()?,
        }
        self.time.sync_secs += self.now() - begun;
        Ok(())
    }

    fn conclude_evaluation(&mut self, version: u64, outcomes: &[Outcome], behind: Position) -> Result<(), Error> {
        self.learned = behind;
        self.tally.evaluate(outcomes);
        Ok(self.evaluations.write(&EvaluationLine::new(version, outcomes))?)
    }

    // ---- commands ----

    /// Handles the commands that wait, up to a bound; true means stop.
    fn obey(&mut self, inbox: &mut mpsc::Receiver<Command>) -> Result<bool, Error> {
        for _ in 0..caps::COMMANDS_PER_TURN {
            let Ok(command) = inbox.try_recv() else { break };
            if self.handle(command)? {
                return Ok(true);
            }
        }
        Ok(false)
    }

    fn handle(&mut self, command: Command) -> Result<bool, Error> {
        let now = self.now();
        self.may_lease |= !matches!(command, Command::Transitions { .. } | Command::Heartbeat { .. });
        match command {
            Command::Join { newcomer, outbox, reply } => {
                tracing::info!(host = newcomer.host, pid = newcomer.pid, robots = newcomer.robots, "actor joined");
                let joined = self.seats.join(newcomer, outbox, now);
                let actor = joined.as_ref().ok().copied();
                if let (Err(_), Some(actor)) = (reply.send(joined), actor) {
                    self.leave(actor);
                }
            }
            Command::Transitions { actor, work, attempt, first, batch } => {
                self.seats.seen(actor, now);
                let claim = Claim { actor, work, attempt };
                let staged = self.ledger.transitions(&claim, first, &batch, now);
                self.answer(claim, staged);
            }
            Command::Finished { actor, work, attempt, outcome } => {
                self.seats.seen(actor, now);
                self.seats.finished(actor, &outcome);
                let claim = Claim { actor, work, attempt };
                let finished = self.ledger.finish(&claim, outcome);
                if let (Ok(()), Work::Episode(episode)) = (&finished, work) {
                    self.authors.insert(episode, actor);
                }
                self.answer(claim, finished);
            }
            Command::Reject { actor, work, attempt, reason } => {
                self.seats.seen(actor, now);
                self.refuse(Claim { actor, work, attempt }, reason);
            }
            Command::Heartbeat { actor, beat } => {
                self.seats.seen(actor, now);
                self.seats.beat(actor, beat);
            }
            Command::Leave { actor } => self.leave(actor),
            Command::Status(reply) => {
                let _ = reply.send(self.status());
            }
            Command::Checkpoint(reply) => {
                self.finish_digest()?;
                let saved = self.save_checkpoint();
                let _ = reply.send(saved.as_ref().map(Clone::clone).map_err(ToString::to_string));
                saved?;
            }
            Command::Stop(reply) => {
                self.phase = "stopping";
                self.finish_digest()?;
                let (episodes, _) = self.save_checkpoint()?;
                if let Some(reply) = reply {
                    let _ = reply.send(episodes);
                }
                return Ok(true);
            }
        }
        Ok(false)
    }

    fn answer(&mut self, claim: Claim, result: Result<(), Refusal>) {
        if let Err(refusal) = result {
            tracing::debug!(%refusal, "refused a message");
            self.refuse(claim, refusal.reason.to_string());
        }
    }

    /// Tells an actor that something was not taken, and gives the episode to somebody else if it held the lease.
    fn refuse(&mut self, claim: Claim, reason: String) {
        self.ledger.surrender(&claim);
        self.may_lease = true;
        self.tell(claim.actor, Notice::Refused { work: claim.work, attempt: claim.attempt, reason });
    }

    fn tell(&mut self, actor: u64, notice: Notice) {
        if !self.seats.tell(actor, notice) {
            self.leave(actor);
        }
    }

    fn leave(&mut self, actor: u64) {
        let freed = self.ledger.release(actor);
        self.may_lease = true;
        self.seats.leave(actor);
        tracing::info!(actor, episodes = freed.len(), "actor left, its episodes are free again");
    }

    // ---- leases and housekeeping ----

    /// Gives every free robot the most urgent work.
    fn offer_leases(&mut self) -> Result<(), Error> {
        if !std::mem::take(&mut self.may_lease) || !self.ledger.has_work() {
            return Ok(());
        }
        let now = self.now();
        for (actor, robots) in self.seats.robots() {
            while self.ledger.leases_of(actor) < robots as usize {
                let Some(lease) = self.ledger.lease(actor, now)? else { return Ok(()) };
                let random = matches!(lease.work, Work::Episode(e) if e < self.config.exploration.warmup_episodes);
                let order = Order {
                    work: lease.work,
                    attempt: lease.attempt,
                    seed: lease.work.seed(self.seed),
                    policy_version: lease.version,
                    sigma: lease.sigma,
                    random,
                };
                if !self.seats.tell(actor, Notice::Lease(order)) {
                    self.leave(actor);
                    break;
                }
            }
        }
        Ok(())
    }

    fn keep_house(&mut self) {
        let now = self.now();
        if now - self.housekept_at < HOUSEKEEPING_SECS {
            return;
        }
        self.housekept_at = now;
        for actor in self.seats.silent(now) {
            tracing::warn!(actor, "actor is silent");
            self.leave(actor);
        }
        for (actor, work) in self.ledger.expire(now) {
            tracing::warn!(actor, %work, "no progress, leased to another");
            self.may_lease = true;
            let reason = "no progress in time, the lease was taken back".to_owned();
            self.tell(actor, Notice::Refused { work, attempt: 0, reason });
        }
        self.sample_rates(now);
    }

    /// Saves everything, tells everybody, and answers questions a little longer.
    fn bid_farewell(
        mut self,
        inbox: &mut mpsc::Receiver<Command>,
        runtime: &tokio::runtime::Handle,
    ) -> Result<Ended, Error> {
        self.phase = "complete";
        self.save_checkpoint()?;
        self.seats.tell_all(&Notice::RunComplete);
        let (least, most) = FAREWELL_SECS;
        let since = self.now();
        while self.now() - since < least || (self.seats.len() > 0 && self.now() - since < most) {
            let wait = async { tokio::time::timeout(IDLE_WAIT, inbox.recv()).await };
            match runtime.block_on(wait) {
                Ok(Some(command)) => {
                    if self.handle(command)? {
                        break;
                    }
                }
                Ok(None) => break,
                Err(_) => {}
            }
        }
        Ok(Ended::Complete)
    }

    fn now(&self) -> f64 {
        self.started.elapsed().as_secs_f64()
    }
}

/// The system's clock, ns since 1970: to measure how long a policy is on its way.
#[expect(clippy::disallowed_methods, reason = "it decides nothing and enters no file")]
fn unix_nanos() -> u64 {
    let since = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
    since.map_or(0, |since| since.as_nanos() as u64)
}

#[cfg(test)]
mod tests;
