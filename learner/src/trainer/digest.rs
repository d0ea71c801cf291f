//! Learning from one commit: its transitions into replay, the updates it pays for, then a new policy.

use super::{Error, Trainer};
use crate::ddpg::Update;
use crate::fold::fold;
use crate::history::journal::Position;
use crate::history::record::{Committed, Record};
use crate::metrics::{EpisodeLine, LossFields, OutcomeFields};
use crate::{export, shelf::Shelf};
use herd_common::config::ddpg;
use herd_common::config::run::Order;
use herd_common::policy::Provenance;
use std::sync::Arc;
use std::time::Instant;

/// A commit that is being learned from.
pub(super) struct Digest {
    line: EpisodeLine,
    /// Updates of the whole run after which it is digested.
    until: u64,
    /// The point of the journal behind the commit.
    behind: Position,
    critic: Mean,
    actor: Mean,
    value: Mean,
}

#[derive(Default)]
struct Mean {
    sum: f64,
    count: u32,
}

impl Mean {
    fn add(&mut self, x: f32) {
        self.sum += f64::from(x);
        self.count += 1;
    }

    fn get(&self) -> Option<f64> {
        (self.count > 0).then(|| self.sum / f64::from(self.count))
    }
}

/// In throughput order, versions that follow each other faster than this are not all published.
const PUBLISH_SECS: f64 = 0.05;

/// Updates that a run has earned once this many transitions are committed.
pub(super) fn updates_earned(config: &ddpg::Config, transitions: u64) -> u64 {
    (transitions.saturating_sub(config.warmup_transitions) as f64 * config.updates_per_transition).floor() as u64
}

impl Trainer {
    /// Takes a commit in; learning from it follows turn by turn.
    pub(super) fn begin_digest(&mut self, committed: &Committed, behind: Position) {
        let outcome = &committed.outcome;
        let staleness = self.version().saturating_sub(committed.version);
        self.replay.push(&fold(&committed.transitions, self.config.ddpg.n_step));
        self.tally.commit(outcome, committed.transitions.len(), staleness);
        let until = updates_earned(&self.config.ddpg, self.tally.transitions).max(self.ddpg.updates());
        let line = EpisodeLine {
            episode: committed.episode,
            version: committed.version,
            sigma: committed.sigma,
            value: outcome.reward.total(),
            speed_mps: outcome.mean_speed(),
            outcome: OutcomeFields::from(outcome),
            transitions: self.tally.transitions,
            updates: until,
            losses: LossFields::default(),
        };
        self.digest = Some(Digest {
            line,
            until,
            behind,
            critic: Mean::default(),
            actor: Mean::default(),
            value: Mean::default(),
        });
    }

    /// One update or a few, or, when all are done, the publication of what was learned.
    pub(super) fn digest_more(&mut self) -> Result<(), Error> {
        let Some(digest) = &self.digest else { return Ok(()) };
        let due = digest.until.saturating_sub(self.ddpg.updates());
        if due > 0 {
            return self.update(due);
        }
        let Some(digest) = self.digest.take() else { return Ok(()) };
        let mut line = digest.line;
        line.losses = LossFields {
            critic_loss: digest.critic.get(),
            actor_loss: digest.actor.get(),
            mean_value: digest.value.get(),
        };
        self.metrics.write(&line)?;
        self.learned = digest.behind;
        let commits = self.version();
        if !self.may_skip(commits) {
            self.publish()?;
        }
        if commits >= self.checkpointed.episodes + self.config.history.checkpoint_episodes && !self.restoring() {
            self.save_checkpoint()?;
        }
        Ok(())
    }

    /// Digests what is begun, so that the state is that of a whole number of commits. Those that wait stay in the
    /// journal.
    pub(super) fn finish_digest(&mut self) -> Result<(), Error> {
        while self.digest.is_some() {
            self.digest_more()?;
        }
        Ok(())
    }

    /// Version of the newest policy: commits digested.
    pub(super) fn version(&self) -> u64 {
        self.ledger.commits().count() - self.waiting().count() as u64 - u64::from(self.digest.is_some())
    }

    /// Commits that are not begun.
    fn waiting(&self) -> impl Iterator<Item = &Committed> {
        self.pending.iter().filter_map(|(record, _)| match record {
            Record::Episode(committed) => Some(committed),
            Record::Evaluation { .. } => None,
        })
    }

    /// Transitions of all commits.
    pub(super) fn transitions(&self) -> u64 {
        self.tally.transitions + self.waiting().map(|committed| committed.transitions.len() as u64).sum::<u64>()
    }

    /// True when this version need not be published: leases name the newest, and the next follows at once.
    fn may_skip(&self, version: u64) -> bool {
        let soon = self.now() - self.published_at < PUBLISH_SECS && self.waiting().next().is_some();
        let follows = self.restoring() || soon;
        follows && self.config.schedule.order == Order::Throughput && !self.ledger.evaluates(version)
    }

    /// Puts the policy as it is now on the shelf and says so to the ledger.
    pub(super) fn publish(&mut self) -> Result<(), Error> {
        let version = self.version();
        let policy = export::policy(&self.ddpg, Provenance { version, ..self.provenance.clone() })?;
        let mut shelf = Shelf::clone(&self.shelf.borrow());
        shelf.put(policy, super::unix_nanos());
        self.ledger.published(version);
        self.published_at = self.now();
        self.may_lease = true;
        shelf.keep(|version| self.ledger.wants(version));
        self.shelf.send_replace(Arc::new(shelf));
        Ok(())
    }

    #[expect(clippy::disallowed_methods, reason = "how long updates take is shown to people and decides nothing")]
    fn update(&mut self, most: u64) -> Result<(), Error> {
        let begun = Instant::now();
        let updates = self.ddpg.learn(&self.replay, most)?;
        self.time.updates_secs += begun.elapsed().as_secs_f64();
        for update in &updates {
            self.note_losses(update);
        }
        Ok(())
    }

    fn note_losses(&mut self, update: &Update) {
        if update.skipped {
            return;
        }
        let losses = &mut self.tally.losses;
        losses.critic = f64::from(update.critic_loss);
        losses.value = f64::from(update.mean_value);
        losses.skipped = self.ddpg.skipped();
        if let Some(actor) = update.actor_loss {
            losses.actor = f64::from(actor);
        }
        if let Some(digest) = &mut self.digest {
            digest.critic.add(update.critic_loss);
            digest.value.add(update.mean_value);
            if let Some(actor) = update.actor_loss {
                digest.actor.add(actor);
            }
        }
    }
}
