//! Saving all that a run is, and taking it up again to the bit.
//!
//! A checkpoint holds what cannot be read off the journal cheaply: networks, moments, counters, the policies that leases
//! may still name. Replay memory, commits and evaluations are read from the journal. What the journal holds beyond the
//! checkpoint is lived through again, updates included.

use super::seats::Seats;
use super::tally::{Meter, Tally};
use super::{Checkpointed, Error, Trainer};
use crate::ddpg;
use crate::fold::fold;
use crate::history::checkpoint::{self, Checkpoint, Tensor};
use crate::history::commits::Commits;
use crate::history::epoch::Epoch;
use crate::history::journal::{Journal, Position};
use crate::history::ledger::{Ledger, Rules};
use crate::history::record::Record;
use crate::metrics::Lines;
use crate::replay::Replay;
use crate::run::new_learner;
use crate::run_dir::{RunDir, write_whole};
use crate::shelf::Shelf;
use herd_common::config::Config;
use herd_common::policy::{Policy, Provenance};
use herd_common::seed::Seed;
use herd_common::status::Time;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use std::time::Instant;
use tokio::sync::watch;

/// The small state of a run that only the trainer reads.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Memo {
    metrics_bytes: u64,
    evaluations_bytes: u64,
    counters: ddpg::Counters,
    tally: Tally,
}

impl Trainer {
    /// Takes up the run that lies in `dir`, or begins it.
    #[expect(clippy::disallowed_methods, reason = "the one clock of the trainer: waits and what people are shown")]
    pub fn restore(config: Config, dir: RunDir, epoch: Epoch, shelf: watch::Sender<Arc<Shelf>>) -> Result<Self, Error> {
        let run = config.run_name();
        let (mut journal, recovery) = Journal::open(&dir.journal(), &run, epoch.number())?;
        if recovery.torn_bytes > 0 {
            tracing::warn!(bytes = recovery.torn_bytes, "the journal's last record was torn and is cut");
        }
        let checkpoint = load_newest(&dir, &run, |position| journal.holds(position))?;
        let memo = checkpoint.as_ref().map(|found| found.state.clone());
        let position = checkpoint.as_ref().map_or(Position::START, |found| found.journal);
        let known = read_known(&config, &mut journal, position)?;

        let mut ddpg = new_learner(&config)?;
        if let (Some(checkpoint), Some(memo)) = (&checkpoint, &memo) {
            let record =
                |t: &Tensor| ddpg::Record { name: t.name.clone(), shape: t.shape.clone(), values: t.values.clone() };
            let records = checkpoint.tensors.iter().map(record).collect();
            ddpg.load(&ddpg::Snapshot { counters: memo.counters, records })?;
        }
        let episodes = known.commits.count();
        let learned = Position { sequence: position.sequence, ..journal.position() };
        let provenance = Provenance { version: 0, run: run.clone(), task_hash: config.task_hash() };
        let mut trainer = Self {
            seed: Seed::from_number(config.seed),
            ledger: Ledger::new(rules(&config), known.commits, known.evaluated),
            metrics: Lines::open(&dir.metrics(), memo.as_ref().map_or(0, |memo| memo.metrics_bytes))?,
            evaluations: Lines::open(&dir.evaluations(), memo.as_ref().map_or(0, |memo| memo.evaluations_bytes))?,
            tally: memo.map_or_else(Tally::new, |memo| memo.tally),
            replay: known.replay,
            config,
            dir,
            epoch,
            journal,
            ddpg,
            shelf,
            pending: VecDeque::new(),
            committed_at: 0.0,
            published_at: 0.0,
            digest: None,
            learned,
            authors: BTreeMap::new(),
            may_lease: true,
            housekept_at: 0.0,
            provenance,
            checkpointed: Checkpointed { episodes, at: None },
            seats: Seats::default(),
            meter: Meter::default(),
            time: Time::default(),
            phase: "restoring",
            started: Instant::now(),
        };
        trainer.fill_shelf(checkpoint)?;
        trainer.live_through_the_rest(position)?;
        trainer.phase = "training";
        Ok(trainer)
    }

    /// Writes a checkpoint; gives its episodes and its file name.
    pub(super) fn save_checkpoint(&mut self) -> Result<(u64, String), Error> {
        self.assert_current()?;
        // In throughput order the newest version may have been left out.
        if self.shelf.borrow().newest().is_none_or(|newest| newest.policy.provenance.version != self.version()) {
            self.publish()?;
        }
        self.journal.sync()?;
        self.metrics.sync()?;
        self.evaluations.sync()?;
        let snapshot = self.ddpg.save()?;
        let memo = Memo {
            metrics_bytes: self.metrics.bytes(),
            evaluations_bytes: self.evaluations.bytes(),
            counters: snapshot.counters,
            tally: self.tally.clone(),
        };
        let shelf = self.shelf.borrow().clone();
        let episodes = self.version();
        let checkpoint = Checkpoint {
            run: self.provenance.run.clone(),
            commits: episodes,
            journal: self.learned,
            state: memo,
            tensors: snapshot.records.into_iter().map(tensor).collect(),
            policies: shelf.iter().map(|policy| (policy.provenance.version, policy.layers().to_vec())).collect(),
        };
        let file = checkpoint.save(&self.dir.checkpoints())?;
        let file = file.file_name().unwrap_or_default().to_string_lossy().into_owned();
        if let Some(newest) = shelf.newest() {
            write_whole(&self.dir.policy(), &newest.policy.to_safetensors().map_err(crate::export::Error::from)?)?;
        }
        self.checkpointed = Checkpointed { episodes, at: Some(self.now()) };
        tracing::info!(episodes, file, "checkpoint written");
        Ok((episodes, file))
    }

    pub(super) fn restoring(&self) -> bool {
        self.phase == "restoring"
    }

    /// Puts the policies that leases may name back on the shelf.
    fn fill_shelf(&mut self, checkpoint: Option<Checkpoint<Memo>>) -> Result<(), Error> {
        let mut shelf = Shelf::default();
        for (version, layers) in checkpoint.map(|found| found.policies).unwrap_or_default() {
            let provenance = Provenance { version, ..self.provenance.clone() };
            shelf.put(Policy::new(provenance, layers).map_err(crate::export::Error::from)?, super::unix_nanos());
        }
        self.shelf.send_replace(Arc::new(shelf));
        self.publish()
    }

    /// Commits and evaluations that the journal holds beyond the checkpoint happen again, as they did.
    fn live_through_the_rest(&mut self, since: Position) -> Result<(), Error> {
        let records = self.journal.position().sequence - since.sequence;
        if records > 0 {
            tracing::info!(records, "living through what the journal holds beyond the checkpoint");
        }
        let end = self.journal.position();
        for record in self.journal.replay_from(since)? {
            let sequence = self.learned.sequence + 1;
            let behind = Position { epoch: end.epoch, sequence };
            match record? {
                Record::Episode(committed) => {
                    self.ledger.recommit(committed.episode);
                    self.begin_digest(&committed, behind);
                    self.finish_digest()?;
                }
                Record::Evaluation { version, outcomes } => {
                    self.ledger.reevaluate(version);
                    self.conclude_evaluation(version, &outcomes, behind)?;
                }
            }
        }
        // Of those that were skipped on the way the last may be the newest.
        if records > 0 { self.publish() } else { Ok(()) }
    }
}

/// What the journal says up to the checkpoint.
struct Known {
    commits: Commits,
    evaluated: Option<u64>,
    replay: Replay,
}

fn read_known(config: &Config, journal: &mut Journal, until: Position) -> Result<Known, Error> {
    let dims = config.task.kind.dims();
    let replay = Replay::new(config.ddpg.replay_capacity, dims.observation, dims.action);
    let mut known = Known { commits: Commits::default(), evaluated: None, replay };
    for record in journal.replay_from(Position::START)?.take(until.sequence as usize) {
        match record? {
            Record::Episode(committed) => {
                known.commits.insert(committed.episode);
                known.replay.push(&fold(&committed.transitions, config.ddpg.n_step));
            }
            Record::Evaluation { version, .. } => known.evaluated = known.evaluated.max(Some(version)),
        }
    }
    Ok(known)
}

fn load_newest(dir: &RunDir, run: &str, holds: impl Fn(Position) -> bool) -> Result<Option<Checkpoint<Memo>>, Error> {
    let found = checkpoint::load_newest(&dir.checkpoints(), run, holds)?;
    for reason in &found.skipped {
        tracing::warn!(%reason, "a checkpoint cannot be used, an older one is");
    }
    Ok(found.checkpoint)
}

/// Commits in the newest checkpoint of a run.
pub(crate) fn commits_in_checkpoint(dir: &RunDir, run: &str) -> Result<Option<u64>, Error> {
    Ok(load_newest(dir, run, |_| true)?.map(|found| found.commits))
}

fn tensor(record: ddpg::Record) -> Tensor {
    Tensor { name: record.name, shape: record.shape, values: record.values }
}

fn rules(config: &Config) -> Rules {
    Rules {
        order: config.schedule.order,
        lag: config.schedule.lag,
        target: config.episodes,
        lease_secs: config.schedule.lease_secs,
        evaluation_every: config.evaluation.every_episodes,
        evaluation_episodes: config.evaluation.episodes,
        exploration: config.exploration.clone(),
        dims: config.task.kind.dims(),
    }
}
