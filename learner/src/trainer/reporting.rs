//! What the trainer says of itself.

use super::Trainer;
use super::tally::Sample;
use herd_common::config::run::{Durability, Order};
use herd_common::status::{History, Losses, Rates, Replay, Status, Traffic};

/// Share of time in updates above which learning is the bottleneck.
const BUSY_SHARE: f64 = 0.85;

impl Trainer {
    /// A snapshot.
    pub(super) fn status(&self) -> Status {
        let now = self.now();
        let (rates, busy) = self.meter.rates();
        let episodes = self.ledger.commits().count();
        Status {
            run: self.provenance.run.clone(),
            epoch: self.epoch.number(),
            phase: self.phase.to_owned(),
            schedule: match self.config.schedule.order {
                Order::Deterministic => "deterministic",
                Order::Throughput => "throughput",
            }
            .to_owned(),
            durability: match self.config.history.durability {
                Durability::Disk => "disk",
                Durability::Memory => "memory",
            }
            .to_owned(),
            episodes,
            episodes_target: self.config.episodes,
            transitions: self.transitions(),
            updates: self.ddpg.updates(),
            policy_version: self.version(),
            uptime_secs: now,
            eta_secs: eta(self.config.episodes.saturating_sub(episodes), &rates),
            rates,
            returns: self.tally.returns(),
            replay: Replay {
                len: self.replay.len() as u64,
                capacity: self.replay.capacity() as u64,
                staleness: self.tally.staleness(),
            },
            losses: Losses { skipped: self.ddpg.skipped(), ..self.tally.losses },
            history: History {
                journal_bytes: self.journal.bytes(),
                episodes_since_checkpoint: episodes - self.checkpointed.episodes,
                checkpoint_age_secs: self.checkpointed.at.map(|at| now - at),
            },
            qp: self.seats.qp(),
            endings: self.tally.endings(),
            actors: self.seats.rows(now, |actor| self.ledger.leases_of(actor)),
            bottleneck: self.bottleneck(busy),
            time: self.time,
            traffic: Traffic::default(),
        }
    }

    pub(super) fn sample_rates(&mut self, now: f64) {
        self.meter.sample(Sample {
            at: now,
            episodes: self.ledger.commits().count(),
            transitions: self.transitions(),
            updates: self.ddpg.updates(),
            busy_secs: self.time.updates_secs,
        });
    }

    fn bottleneck(&self, busy: f64) -> String {
        let share = format!("{:.0} % of the time in updates", busy * 100.0);
        if self.phase != "training" {
            "none: no more episodes are needed".to_owned()
        } else if self.seats.len() == 0 {
            "actors: none is connected".to_owned()
        } else if busy > BUSY_SHARE {
            format!("learner: {share}")
        } else {
            format!("actors: the learner waits for episodes, {share}")
        }
    }
}

fn eta(missing: u64, rates: &Rates) -> Option<f64> {
    (rates.episodes > 0.0).then(|| missing as f64 / rates.episodes)
}
