//! Settings of the run itself: order, exploration, evaluation, history.

use super::{Error, check};
use serde::{Deserialize, Serialize};

/// Whether equal seeds give equal bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Order {
    /// Commits in episode order; the policy of episode e is the one after commit e − 1 − lag.
    Deterministic,
    /// Commits in order of arrival, with the newest policy.
    Throughput,
}

/// Order of commits and age of policies.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Schedule {
    /// See [`Order`].
    pub order: Order,
    /// Episodes that a policy may be behind.
    pub lag: u64,
    /// Patience with an episode that makes no progress, s.
    pub lease_secs: f64,
}

/// Exploration noise by episode number.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Exploration {
    /// Lowest standard deviation, in units of the action box's half width.
    pub sigma_min: f64,
    /// Highest standard deviation.
    pub sigma_max: f64,
    /// Steps of the ladder between them.
    pub rungs: u64,
    /// Share of the last decision's noise kept.
    pub sigma_smoothing: f64,
    /// Episodes that act at random first.
    pub warmup_episodes: u64,
}

/// Evaluation during training.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Evaluation {
    /// Commits between two evaluations; 0 for none.
    pub every_episodes: u64,
    /// Episodes of one evaluation.
    pub episodes: u64,
}

/// When a commit counts as kept.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Durability {
    /// After fdatasync.
    #[default]
    Disk,
    /// Once written to the operating system.
    Memory,
}

/// Journal and checkpoints.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct History {
    /// See [`Durability`].
    pub durability: Durability,
    /// Commits between two checkpoints.
    pub checkpoint_episodes: u64,
}

impl Exploration {
    /// Standard deviation of the noise of an episode: rungs of equal ratio, visited in turn (Ape-X ladder by episode).
    pub fn sigma(&self, episode: u64) -> f64 {
        if self.rungs <= 1 || self.sigma_min <= 0.0 {
            return self.sigma_max;
        }
        // A fixed stride coprime to most ladder sizes spreads neighbours over the rungs.
        let rung = episode.wrapping_mul(5) % self.rungs;
        self.sigma_min * (self.sigma_max / self.sigma_min).powf(rung as f64 / (self.rungs - 1) as f64)
    }

    pub(super) fn validate(&self) -> Result<(), Error> {
        check("exploration.sigma_min", self.sigma_min, 0.0..=2.0)?;
        check("exploration.sigma_max", self.sigma_max, self.sigma_min..=2.0)?;
        check("exploration.rungs", self.rungs, 1..=1024)?;
        check("exploration.sigma_smoothing", self.sigma_smoothing, 0.0..=0.999)
    }
}

impl Schedule {
    pub(super) fn validate(&self) -> Result<(), Error> {
        check("schedule.lag", self.lag, 0..=4096)?;
        check("schedule.lease_secs", self.lease_secs, 0.1..=86_400.0)
    }
}

impl Evaluation {
    pub(super) fn validate(&self) -> Result<(), Error> {
        check("evaluation.episodes", self.episodes, 1..=1000)
    }
}

impl History {
    pub(super) fn validate(&self) -> Result<(), Error> {
        check("history.checkpoint_episodes", self.checkpoint_episodes, 1..=1_000_000)
    }
}

#[cfg(test)]
mod tests {
    use super::super::Config;

    #[test]
    fn the_ladder_spans_its_ends() {
        let ladder = Config::default().exploration;
        let mut sigmas: Vec<f64> = (0..ladder.rungs).map(|e| ladder.sigma(e)).collect();
        sigmas.sort_by(f64::total_cmp);
        assert!((sigmas[0] - ladder.sigma_min).abs() < 1e-12);
        assert!((sigmas[sigmas.len() - 1] - ladder.sigma_max).abs() < 1e-12);
        assert_eq!(ladder.sigma(0), ladder.sigma(ladder.rungs));
    }
}
