//! Figures of evaluation episodes: means with their 95 % intervals, and the return under each reading of eq 10.
//!
//! | reading | what it takes eq 10 for |
//! |---|---|
//! | summed | r every T_s, added up: what herd trains on |
//! | per decision | r once, at the end of each decision, with the same T_s |
//! | normalised | τ over the torque limit, as in the original that eq 10 comes from |
//! | raw | τ in N·m, as the letter of the paper has it |

use crate::student::quantile_975;
use herd_actor::film::{Film, Frame};
use herd_common::config::Config;
use herd_common::config::task::TorqueUnit;
use herd_common::episode::{Ending, Outcome, Reward};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// A mean of independent figures, with its 95 % interval (Student's t).
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Interval {
    /// The mean.
    pub(super) mean: f64,
    /// Half the width of the interval; none for a single figure.
    pub(super) half: Option<f64>,
    /// Standard deviation of one figure.
    pub(super) deviation: f64,
}

/// The return under each reading of eq 10.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Readings<T> {
    /// Summed, normalised.
    pub(super) summed_normalised: T,
    /// Summed, raw.
    pub(super) summed_raw: T,
    /// Per decision, normalised.
    pub(super) per_decision_normalised: T,
    /// Per decision, raw.
    pub(super) per_decision_raw: T,
}

/// The figures of one policy or gait.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Evaluation {
    /// Episodes, one a seed.
    pub(super) episodes: usize,
    /// Return as the configuration has it.
    #[serde(rename = "return")]
    pub(super) value: Interval,
    /// Return under each reading.
    pub(super) readings: Readings<Interval>,
    /// Forward speed, m/s.
    pub(super) speed_mps: Interval,
    /// Variance of roll within an episode, rad².
    pub(super) roll_variance: Interval,
    /// Variance of pitch within an episode, rad².
    pub(super) pitch_variance: Interval,
    /// Simulated time of an episode, s.
    pub(super) seconds: Interval,
    /// Share of episodes that did not last to the time limit.
    pub(super) fall_rate: f64,
    /// Episodes by ending.
    pub(super) endings: BTreeMap<String, u64>,
    /// Return of each episode, in order of the seeds.
    pub(super) returns: Vec<f64>,
}

/// An evaluation with the pictures of its first episode.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Measured {
    /// The figures.
    pub(super) evaluation: Evaluation,
    /// The pictures.
    pub(super) frames: Vec<Frame>,
}

impl Measured {
    /// An evaluation with its pictures.
    pub(super) fn new(evaluation: Evaluation, frames: Vec<Frame>) -> Self {
        Self { evaluation, frames: cut(frames) }
    }
}

/// The pictures with their numbers cut to what can be seen: 10 µm, 10 µrad.
pub(super) fn cut(mut frames: Vec<Frame>) -> Vec<Frame> {
    for frame in &mut frames {
        let points = frame.trunk.iter_mut().chain(&mut frame.across).chain(frame.legs.iter_mut().flatten()).flatten();
        for number in points.chain(&mut frame.centre).chain(&mut frame.angles).chain([&mut frame.secs]) {
            *number = (*number * 1e5).round() / 1e5;
        }
    }
    frames
}

impl Interval {
    /// Of these figures.
    pub(super) fn of(figures: &[f64]) -> Self {
        let n = figures.len() as f64;
        if figures.is_empty() {
            return Self::default();
        }
        let mean = figures.iter().sum::<f64>() / n;
        if figures.len() == 1 {
            return Self { mean, half: None, deviation: 0.0 };
        }
        let variance = figures.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (n - 1.0);
        let half = quantile_975(figures.len() - 1) * (variance / n).sqrt();
        Self { mean, half: Some(half), deviation: variance.sqrt() }
    }
}

impl Readings<f64> {
    /// The returns of one episode.
    pub(super) fn of(film: &Film, config: &Config) -> Self {
        let max = config.robot.torque_max_nm;
        // The effort of the configured unit, times these, is that of the other units.
        let (normalised, raw) = match config.task.reward.torque_unit {
            TorqueUnit::Normalised => (1.0, max * max),
            TorqueUnit::NewtonMetre => (1.0 / (max * max), 1.0),
        };
        let with = |reward: &Reward, factor: f64| reward.total() + reward.effort * (factor - 1.0);
        Self {
            summed_normalised: with(&film.outcome.reward, normalised),
            summed_raw: with(&film.outcome.reward, raw),
            per_decision_normalised: with(&film.per_decision, normalised),
            per_decision_raw: with(&film.per_decision, raw),
        }
    }
}

impl<T> Readings<T> {
    /// The same with each of them replaced.
    pub(super) fn map<U>(&self, of: impl Fn(&T) -> U) -> Readings<U> {
        Readings {
            summed_normalised: of(&self.summed_normalised),
            summed_raw: of(&self.summed_raw),
            per_decision_normalised: of(&self.per_decision_normalised),
            per_decision_raw: of(&self.per_decision_raw),
        }
    }

    /// Each with its name, for rewards that are sampled every `sample_secs`.
    pub(super) fn named(&self, sample_secs: f64) -> [(String, &T); 4] {
        let summed = |unit: &str| format!("summed every {} ms, {unit}", millis(sample_secs));
        let once = |unit: &str| format!("once per decision, {unit}");
        let [normalised, raw] = [TorqueUnit::Normalised, TorqueUnit::NewtonMetre].map(unit_name);
        [
            (summed(normalised), &self.summed_normalised),
            (summed(raw), &self.summed_raw),
            (once(normalised), &self.per_decision_normalised),
            (once(raw), &self.per_decision_raw),
        ]
    }
}

/// How a reading tells the unit of torque.
pub(super) fn unit_name(unit: TorqueUnit) -> &'static str {
    match unit {
        TorqueUnit::Normalised => "τ normalised",
        TorqueUnit::NewtonMetre => "τ in N·m",
    }
}

/// Whole milliseconds where they are whole.
pub(super) fn millis(secs: f64) -> String {
    let ms = (secs * 1e6).round() / 1e3;
    format!("{ms}")
}

impl Evaluation {
    /// The figures of these episodes under this configuration.
    pub(super) fn of(films: &[Film], config: &Config) -> Self {
        let figures = |of: &dyn Fn(&Outcome) -> f64| films.iter().map(|film| of(&film.outcome)).collect::<Vec<_>>();
        let interval = |of: &dyn Fn(&Outcome) -> f64| Interval::of(&figures(of));
        let readings: Vec<Readings<f64>> = films.iter().map(|film| Readings::of(film, config)).collect();
        let reading = |of: fn(&Readings<f64>) -> f64| Interval::of(&readings.iter().map(of).collect::<Vec<_>>());
        let mut endings = BTreeMap::new();
        for film in films {
            *endings.entry(film.outcome.ending.name().to_owned()).or_default() += 1;
        }
        Self {
            episodes: films.len(),
            value: interval(&|outcome| outcome.reward.total()),
            readings: Readings {
                summed_normalised: reading(|r| r.summed_normalised),
                summed_raw: reading(|r| r.summed_raw),
                per_decision_normalised: reading(|r| r.per_decision_normalised),
                per_decision_raw: reading(|r| r.per_decision_raw),
            },
            speed_mps: interval(&Outcome::mean_speed),
            roll_variance: interval(&|outcome| outcome.roll_variance),
            pitch_variance: interval(&|outcome| outcome.pitch_variance),
            seconds: interval(&|outcome| outcome.seconds),
            fall_rate: interval(&|outcome| f64::from(u8::from(outcome.ending != Ending::TimedOut))).mean,
            endings,
            returns: figures(&|outcome| outcome.reward.total()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use herd_common::episode::{Counts, Fall};

    fn film(ending: Ending, reward: Reward, per_decision: Reward) -> Film {
        let (roll_variance, pitch_variance, distance_m) = (1e-4, 3e-4, 5.0);
        let (seconds, decisions, counts) = (10.0, 2, Counts::default());
        let outcome = Outcome { ending, decisions, seconds, reward, distance_m, roll_variance, pitch_variance, counts };
        Film { outcome, per_decision, frames: Vec::new() }
    }

    /// Two decisions of 0.1 s at 1 m/s and then 2 m/s, no yaw, Σ τ² = 36 (N·m)² throughout, by hand:
    /// eight samples of 3 v_x + 0.075 − 0.01·36/900, and two of them at the decisions' ends.
    fn by_hand() -> Film {
        let effort = -0.01 * 36.0 / 900.0;
        let summed = Reward { velocity: 3.0 * 12.0, survival: 8.0 * 0.075, heading: 0.0, effort: 8.0 * effort };
        let once = Reward { velocity: 3.0 * 3.0, survival: 2.0 * 0.075, heading: 0.0, effort: 2.0 * effort };
        film(Ending::TimedOut, summed, once)
    }

    #[test]
    fn readings_are_those_of_the_hand_made_episode() {
        let config = Config::default();
        let readings = Readings::of(&by_hand(), &config);
        let close = |a: f64, b: f64| assert!((a - b).abs() < 1e-9, "{a} {b}");
        close(readings.summed_normalised, 36.6 - 0.0032);
        close(readings.summed_raw, 36.6 - 2.88);
        close(readings.per_decision_normalised, 9.15 - 0.0008);
        close(readings.per_decision_raw, 9.15 - 0.72);
        // A run that was paid in N·m tells the same under both readings.
        let raw = config.overridden(&["task.reward.torque_unit=newton_metre".into()]).expect("valid");
        let mut paid_raw = by_hand();
        paid_raw.outcome.reward.effort *= 900.0;
        paid_raw.per_decision.effort *= 900.0;
        let other = Readings::of(&paid_raw, &raw);
        for ((_, a), (_, b)) in readings.named(0.025).into_iter().zip(other.named(0.025)) {
            close(*a, *b);
        }
    }

    #[test]
    fn readings_are_named_by_how_often_they_are_paid() {
        let names = |secs| Readings::<f64>::default().named(secs).map(|(name, _)| name);
        assert_eq!(names(0.025)[0], "summed every 25 ms, τ normalised");
        assert_eq!(names(0.0125)[1], "summed every 12.5 ms, τ in N·m");
        assert_eq!(names(0.025)[3], "once per decision, τ in N·m");
    }

    #[test]
    fn intervals_are_students() {
        let interval = Interval::of(&[1.0, 2.0, 3.0, 4.0, 5.0]);
        assert_eq!(interval.mean, 3.0);
        assert!((interval.deviation - 2.5_f64.sqrt()).abs() < 1e-12);
        assert!((interval.half.expect("five figures") - 2.776 * (2.5_f64 / 5.0).sqrt()).abs() < 1e-9);
        assert_eq!(Interval::of(&[7.0]), Interval { mean: 7.0, half: None, deviation: 0.0 });
    }

    #[test]
    fn evaluations_are_means_of_episodes() {
        let survival = |survival: f64| Reward { survival, ..Reward::default() };
        let films = [
            film(Ending::TimedOut, survival(30.0), survival(3.0)),
            film(Ending::Fell(Fall::Roll), survival(10.0), survival(1.0)),
        ];
        let evaluation = Evaluation::of(&films, &Config::default());
        assert_eq!((evaluation.value.mean, evaluation.fall_rate, evaluation.speed_mps.mean), (20.0, 0.5, 0.5));
        assert_eq!(evaluation.readings.per_decision_normalised.mean, 2.0);
        assert_eq!(evaluation.endings, BTreeMap::from([("fell_roll".to_owned(), 1), ("timed_out".to_owned(), 1)]));
        assert_eq!(evaluation.returns, [30.0, 10.0]);
    }
}
