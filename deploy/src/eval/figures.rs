//! Figures of episodes: each one, and means over those of a case.

use super::cases::Case;
use super::commands;
use herd_actor::env::Following;
use herd_common::config::task::Constant;
use herd_common::episode::{Ending, Outcome};
use serde::Serialize;
use std::collections::BTreeMap;

/// One episode with the time it took.
#[derive(Clone, Copy, Debug, Serialize)]
pub(crate) struct Episode {
    /// Its summary.
    #[serde(flatten)]
    pub(crate) outcome: Outcome,
    /// Work of the motors per weight and distance.
    pub(crate) cost_of_transport: f64,
    /// How well it followed its commands, in the command task.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) following: Option<Following>,
    /// Wall time, s.
    pub(crate) wall_secs: f64,
}

/// The episodes of one case.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Result {
    /// What it is called.
    pub(crate) label: String,
    /// The gait of a case without a policy.
    pub(crate) gait: Option<Constant>,
    /// Means.
    pub(crate) mean: Mean,
    /// Every episode, in order of the seeds.
    pub(crate) episodes: Vec<Episode>,
}

/// Means over the episodes of a case.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Mean {
    /// Return, eq 10 summed.
    #[serde(rename = "return")]
    pub(crate) value: f64,
    /// Its standard deviation over the episodes.
    pub(crate) return_deviation: f64,
    /// Term of eq 10.
    pub(crate) velocity: f64,
    /// Term of eq 10.
    pub(crate) survival: f64,
    /// Term of eq 10.
    pub(crate) heading: f64,
    /// Term of eq 10.
    pub(crate) effort: f64,
    /// Simulated time, s.
    pub(crate) seconds: f64,
    /// Forward speed, m/s.
    pub(crate) speed_mps: f64,
    /// Mean over episodes of |speed − command| / |command|, for a gait with a command.
    pub(crate) speed_error: Option<f64>,
    /// How well the robot followed its commands, in the command task.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) following: Option<Following>,
    /// rad²
    pub(crate) roll_variance: f64,
    /// rad²
    pub(crate) pitch_variance: f64,
    /// Distance along world x, m.
    pub(crate) distance_m: f64,
    /// Work of the motors per weight and distance, over the episodes without a fall; none if all fell.
    pub(crate) cost_of_transport: Option<f64>,
    /// Share of episodes that ended in a fall.
    pub(crate) fall_rate: f64,
    /// Episodes by ending.
    pub(crate) endings: BTreeMap<&'static str, u64>,
    /// Quadratic programmes solved, all episodes.
    pub(crate) qp_solves: u64,
    /// Of those, given up on by the primary solver.
    pub(crate) qp_failures: u64,
    /// Simulated seconds per second of one thread.
    pub(crate) realtime_factor: f64,
}

impl Result {
    /// The figures of these episodes.
    pub(crate) fn new(case: &Case, episodes: Vec<Episode>) -> Self {
        let gait = case.gait();
        let mean = Mean::of(&episodes, gait.map(|gait| gait.velocity_mps).filter(|command| *command != 0.0));
        Self { label: case.label.clone(), gait, mean, episodes }
    }
}

impl Mean {
    /// Means over these episodes; with a command (m/s) also of how far they missed it.
    pub(crate) fn of(episodes: &[Episode], command: Option<f64>) -> Self {
        let n = episodes.len().max(1) as f64;
        let sum = |figure: &dyn Fn(&Outcome) -> f64| episodes.iter().map(|e| figure(&e.outcome)).sum::<f64>();
        let mean = |figure: &dyn Fn(&Outcome) -> f64| sum(figure) / n;
        let value = mean(&|o| o.reward.total());
        let mut endings = BTreeMap::new();
        for episode in episodes {
            *endings.entry(episode.outcome.ending.name()).or_default() += 1;
        }
        let stood = |e: &&Episode| e.outcome.ending == Ending::TimedOut;
        let costs: Vec<f64> = episodes.iter().filter(stood).map(|e| e.cost_of_transport).collect();
        Self {
            value,
            return_deviation: mean(&|o| (o.reward.total() - value).powi(2)).sqrt(),
            velocity: mean(&|o| o.reward.velocity),
            survival: mean(&|o| o.reward.survival),
            heading: mean(&|o| o.reward.heading),
            effort: mean(&|o| o.reward.effort),
            seconds: mean(&|o| o.seconds),
            speed_mps: mean(&Outcome::mean_speed),
            speed_error: command.map(|v| mean(&|o| (o.mean_speed() - v).abs() / v.abs())),
            following: commands::mean(&episodes.iter().filter_map(|e| e.following).collect::<Vec<_>>()),
            roll_variance: mean(&|o| o.roll_variance),
            pitch_variance: mean(&|o| o.pitch_variance),
            distance_m: mean(&|o| o.distance_m),
            cost_of_transport: (!costs.is_empty()).then(|| costs.iter().sum::<f64>() / costs.len() as f64),
            fall_rate: mean(&|o| f64::from(u8::from(o.ending != Ending::TimedOut))),
            endings,
            qp_solves: episodes.iter().map(|e| e.outcome.counts.qp_solves).sum(),
            qp_failures: episodes.iter().map(|e| e.outcome.counts.qp_failures).sum(),
            realtime_factor: sum(&|o| o.seconds) / episodes.iter().map(|e| e.wall_secs).sum::<f64>().max(1e-9),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use herd_common::episode::{Counts, Fall, Reward};

    fn episode(ending: Ending, distance_m: f64, survival: f64) -> Episode {
        let reward = Reward { survival, effort: -1.0, ..Reward::default() };
        let counts = Counts { qp_solves: 10, qp_failures: 1, ..Counts::default() };
        let (roll_variance, pitch_variance) = (1e-4, 2e-4);
        let (seconds, decisions) = (10.0, 50);
        let outcome = Outcome { ending, decisions, seconds, reward, distance_m, roll_variance, pitch_variance, counts };
        let cost_of_transport = if ending == Ending::TimedOut { 0.8 } else { 70.0 };
        Episode { outcome, cost_of_transport, following: None, wall_secs: 2.0 }
    }

    #[test]
    fn means_are_those_of_the_episodes() {
        let episodes = [episode(Ending::TimedOut, 4.0, 31.0), episode(Ending::Fell(Fall::Roll), 6.0, 11.0)];
        let mean = Mean::of(&episodes, Some(0.4));
        assert_eq!((mean.value, mean.return_deviation), (20.0, 10.0));
        assert_eq!((mean.speed_mps, mean.fall_rate, mean.qp_failures), (0.5, 0.5, 2));
        assert!((mean.speed_error.expect("has a command") - 0.25).abs() < 1e-12);
        assert_eq!((mean.distance_m, mean.cost_of_transport), (5.0, Some(0.8)));
        assert_eq!(mean.realtime_factor, 5.0);
        assert_eq!(mean.endings, BTreeMap::from([("fell_roll", 1), ("timed_out", 1)]));
    }
}
