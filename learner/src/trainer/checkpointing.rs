//! Saving all that a run is, and taking it up again to the bit.
//!
//! A checkpoint holds what cannot be read off the journal cheaply: networks, moments, counters, the policies that leases
//! may still name. Replay memory, commits and evaluations are read from the journal. What the journal holds beyond the
//! checkpoint is lived through again, updates included.

use super::seats::Seats;
use super::tally::{Meter, Tally};
use super::{Checkpointed, Error, Trainer};
use crate::history::checkpoint::{self, Checkpoint};
use crate::history::commits::Commits;
use crate::history::epoch::Epoch;
use crate::history::journal::Journal;
use crate::history::ledger::{Ledger, Rules};
use crate::history::record::Record;
use crate::metrics::Lines;
use crate::replay::Replay;
use crate::run::new_ddpg;
use crate::run_dir::{RunDir, write_whole};
use crate::shelf::Shelf;
use herd_common::config::Config;
use herd_common::policy::{Policy, Provenance};
use herd_common::seed::Seed;
use herd_common::spaces::OBSERVATION_DIM;
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use std::time::Instant;
use tokio::sync::watch;

/// The part of a checkpoint that only the trainer reads.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Memo {
    /// Journal records that the checkpoint includes.
    records: u64,
    metrics_bytes: u64,
    evaluations_bytes: u64,
    counters: crate::ddpg::Counters,
    tally: Tally,
}

impl Trainer {
    /// Takes up the run that lies in `dir`, or begins it.
    #[expect(clippy::disallowed_methods, reason = "the one clock of the trainer: waits and what people are shown")]
    pub fn restore(config: Config, dir: RunDir, epoch: Epoch, shelf: watch::Sender<Arc<Shelf>>) -> Result<Self, Error> {
        let run = config.run_name();
        let (journal, recovery) = Journal::open(&dir.journal(), &run)?;
        if recovery.torn_bytes > 0 {
            tracing::warn!(bytes = recovery.torn_bytes, "the journal's last record was torn and is cut");
        }
        let checkpoint = load_newest(&dir, &run)?;
        let memo: Option<Memo> = checkpoint.as_ref().map(memo_of).transpose()?;
        let records = memo.as_ref().map_or(0, |memo| memo.records);
        let known = read_known(&config, &journal, records)?;

        let mut ddpg = new_ddpg(&config)?;
        if let (Some(checkpoint), Some(memo)) = (&checkpoint, &memo) {
            ddpg.load(&crate::ddpg::Snapshot { counters: memo.counters, records: checkpoint.tensors.clone() })?;
        }
        let episodes = known.commits.count();
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
            records,
            ddpg,
            shelf,
            digest: None,
            checkpointed: Checkpointed { episodes, at: None },
            seats: Seats::default(),
            meter: Meter::default(),
            busy_secs: 0.0,
            phase: "restoring",
            started: Instant::now(),
        };
        trainer.fill_shelf(checkpoint)?;
        trainer.live_through_the_rest()?;
        trainer.phase = "training";
        Ok(trainer)
    }

    /// Writes a checkpoint; gives its episodes and its file name.
    pub(super) fn save_checkpoint(&mut self) -> Result<(u64, String), Error> {
        if !self.epoch.is_current()? {
            return Err(Error::Fenced(self.epoch.number()));
        }
        self.journal.sync()?;
        self.metrics.sync()?;
        self.evaluations.sync()?;
        let snapshot = self.ddpg.save()?;
        let memo = Memo {
            records: self.records,
            metrics_bytes: self.metrics.bytes(),
            evaluations_bytes: self.evaluations.bytes(),
            counters: snapshot.counters,
            tally: self.tally.clone(),
        };
        let shelf = self.shelf.borrow().clone();
        let episodes = self.ledger.commits().count();
        let checkpoint = Checkpoint {
            run: self.config.run_name(),
            commits: episodes,
            memo: serde_json::to_value(&memo).map_err(std::io::Error::from)?,
            tensors: snapshot.records,
            policies: shelf.iter().map(|policy| (policy.provenance.version, policy.layers().to_vec())).collect(),
        };
        let file = checkpoint::save(&self.dir.checkpoints(), &checkpoint)?;
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
    fn fill_shelf(&mut self, checkpoint: Option<Checkpoint>) -> Result<(), Error> {
        let (run, task_hash) = (self.config.run_name(), self.config.task_hash());
        let mut shelf = Shelf::default();
        for (version, layers) in checkpoint.map(|found| found.policies).unwrap_or_default() {
            let provenance = Provenance { version, run: run.clone(), task_hash: task_hash.clone() };
            shelf.put(Policy::new(provenance, layers).map_err(crate::export::Error::from)?);
        }
        self.shelf.send_replace(Arc::new(shelf));
        self.publish()
    }

    /// Commits and evaluations that the journal holds beyond the checkpoint happen again, as they did.
    fn live_through_the_rest(&mut self) -> Result<(), Error> {
        let rest = self.journal.replay()?.skip(self.records as usize).collect::<Result<Vec<_>, _>>()?;
        if !rest.is_empty() {
            tracing::info!(records = rest.len(), "living through what the journal holds beyond the checkpoint");
        }
        for record in rest {
            self.records += 1;
            match record {
                Record::Episode(committed) => {
                    self.ledger.recommit(committed.episode);
                    self.begin_digest(&committed);
                    self.finish_digest()?;
                }
                Record::Evaluation { version, outcomes } => {
                    self.ledger.reevaluate(version);
                    self.conclude_evaluation(version, &outcomes)?;
                }
            }
        }
        Ok(())
    }
}

/// What the journal says up to the checkpoint.
struct Known {
    commits: Commits,
    evaluated: Option<u64>,
    replay: Replay,
}

fn read_known(config: &Config, journal: &Journal, records: u64) -> Result<Known, Error> {
    let replay = Replay::new(config.ddpg.replay_capacity, OBSERVATION_DIM, config.task.kind.action_dim());
    let mut known = Known { commits: Commits::default(), evaluated: None, replay };
    for record in journal.replay()?.take(records as usize) {
        match record? {
            Record::Episode(committed) => {
                known.commits.insert(committed.episode);
                known.replay.push(&committed.transitions);
            }
            Record::Evaluation { version, .. } => known.evaluated = known.evaluated.max(Some(version)),
        }
    }
    Ok(known)
}

fn load_newest(dir: &RunDir, run: &str) -> Result<Option<Checkpoint>, Error> {
    let Some(found) = checkpoint::load_newest(&dir.checkpoints(), run)? else { return Ok(None) };
    for (file, reason) in &found.skipped {
        tracing::warn!(file, reason, "checkpoint is damaged, an older one is used");
    }
    Ok(Some(found.checkpoint))
}

fn memo_of(checkpoint: &Checkpoint) -> Result<Memo, Error> {
    Ok(serde_json::from_value(checkpoint.memo.clone()).map_err(std::io::Error::from)?)
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
        action_dim: config.task.kind.action_dim(),
    }
}
