//! What the paper claims, what came out here, and whether the claim holds, seed by seed.

use super::curves::{self, Curve};
use super::gather::{Pair, Trained};
use super::measure::Readings;
use crate::report::records::Evaluation;
use serde::Serialize;

/// Numbers that the paper gives.
pub(super) mod paper {
    /// Final return of Group_1.
    pub(in super::super) const GAIT_RETURN: f64 = 175.0;
    /// Final return of Group_0.
    pub(in super::super) const TORQUE_RETURN: f64 = 120.0;
    /// Group_1's return over Group_0's.
    pub(in super::super) const RATIO: f64 = 1.45;
    /// Episode of Group_1's rapid rise.
    pub(in super::super) const RISE_EPISODE: f64 = 1700.0;
    /// Episode from which Group_1 is above Group_0.
    pub(in super::super) const OVERTAKING_EPISODE: f64 = 2000.0;
    /// Roll variance of Group_1 and Group_0, rad².
    pub(in super::super) const ROLL: (f64, f64) = (8.9e-4, 2.5e-3);
    /// Pitch variance of Group_1 and Group_0, rad².
    pub(in super::super) const PITCH: (f64, f64) = (2.1e-3, 3.1e-3);
}

/// Figures of one group with one seed.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Side {
    /// Mean return without noise.
    #[serde(rename = "return")]
    pub(super) value: f64,
    /// The same under each reading of eq 10.
    pub(super) readings: Readings<f64>,
    /// rad²
    pub(super) roll_variance: f64,
    /// rad²
    pub(super) pitch_variance: f64,
    /// Share of evaluation episodes that ended early.
    pub(super) fall_rate: f64,
    /// Mean length of an evaluation episode, s.
    pub(super) seconds: f64,
    /// Episodes of its training.
    pub(super) episodes: u64,
    /// Episode at which the smoothed training return first reached the paper's final one.
    pub(super) reached_paper_at: Option<f64>,
}

/// Figures of both groups with one seed.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Facts {
    /// The seed.
    pub(super) seed: u64,
    /// Group_1.
    pub(super) gait: Side,
    /// Group_0.
    pub(super) torque: Side,
    /// Episode of Group_1 from which its smoothed return stays above Group_0's at equal transitions.
    pub(super) overtakes_at: Option<f64>,
    /// Lowest mean of Group_1's evaluations after the first that came near the best constant gait, that one included.
    pub(super) lowest_after: Option<f64>,
    /// Mean return of the best constant gait.
    pub(super) best_constant: f64,
}

/// One claim with its verdict.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Claim {
    /// What is claimed.
    #[serde(rename = "claim")]
    pub(super) text: String,
    /// The paper's figure.
    pub(super) paper: String,
    /// Ours.
    pub(super) ours: String,
    /// Seeds on which it holds.
    pub(super) holds_on: usize,
    /// Seeds that can tell.
    pub(super) seeds: usize,
    /// Seeds that cannot; the verdict says why.
    pub(super) left_out: usize,
    /// The verdict in words.
    pub(super) verdict: String,
}

impl Claim {
    /// True when it holds on every seed.
    pub(super) fn holds(&self) -> bool {
        self.seeds > 0 && self.holds_on == self.seeds
    }
}

fn verdict(holds_on: usize, seeds: usize, left_out: usize, why: &str) -> String {
    let verdict = match (holds_on, seeds) {
        (_, 0) => return format!("cannot be told on any of {left_out} seeds: {why}"),
        (on, of) if on == of => format!("holds on {on} of {of} seeds"),
        (0, of) => format!("does not hold on any of {of} seeds"),
        (on, of) => format!("holds on {on} of {of} seeds only"),
    };
    let rest = if left_out > 0 { format!("; cannot be told on {left_out} more: {why}") } else { String::new() };
    verdict + &rest
}

impl Facts {
    /// The figures of a pair of trainings, beside the return of the best constant gait.
    pub(super) fn of(pair: &Pair, best_constant: f64) -> Self {
        let transitions = pair.gait.over_transitions();
        let overtakes = overtaking(&transitions, &pair.torque.over_transitions());
        let lines = &pair.gait.lines;
        let episode_at =
            |x: f64| lines.iter().find(|line| line.transitions as f64 >= x).map(|line| line.episode as f64);
        Self {
            seed: pair.seed,
            gait: Side::of(&pair.gait, paper::GAIT_RETURN),
            torque: Side::of(&pair.torque, paper::TORQUE_RETURN),
            overtakes_at: overtakes.and_then(episode_at),
            lowest_after: lowest_after(&pair.gait.evaluations, NEAR * best_constant),
            best_constant,
        }
    }
}

impl Side {
    fn of(trained: &Trained, level: f64) -> Self {
        let evaluation = &trained.measured.evaluation;
        Self {
            value: evaluation.value.mean,
            readings: evaluation.readings.map(|interval| interval.mean),
            roll_variance: evaluation.roll_variance.mean,
            pitch_variance: evaluation.pitch_variance.mean,
            fall_rate: evaluation.fall_rate,
            seconds: evaluation.seconds.mean,
            episodes: trained.cost.episodes,
            reached_paper_at: curves::reaches(&trained.over_episodes(), level),
        }
    }
}

/// The x from which `a` stays at or above `b`, as far as both go; none if it ends below.
fn overtaking(a: &Curve, b: &Curve) -> Option<f64> {
    let (from, to) = (a.first()?.0.max(b.first()?.0), a.last()?.0.min(b.last()?.0));
    let common: Vec<f64> = a.iter().chain(b).map(|(x, _)| *x).filter(|x| (from..=to).contains(x)).collect();
    let below = |x: &&f64| curves::at(a, **x) < curves::at(b, **x);
    let last_below = common.iter().filter(below).copied().fold(f64::MIN, f64::max);
    common.into_iter().filter(|x| *x > last_below).min_by(f64::total_cmp)
}

/// The lowest of the evaluations from the first on that reached `level`; none if none did.
fn lowest_after(evaluations: &[Evaluation], level: f64) -> Option<f64> {
    let returns = evaluations.iter().map(|evaluation| evaluation.mean_return);
    returns.skip_while(|value| *value < level).min_by(f64::total_cmp)
}

/// Whether something that came at this episode, if it came, came in time. A training that ended before the time was over
/// cannot tell what would have come.
fn in_time(at: Option<f64>, episodes: u64, limit: f64) -> Option<bool> {
    match at {
        Some(at) => Some(at <= limit),
        None => (episodes as f64 >= limit).then_some(false),
    }
}

/// True when Group_1's return is above Group_0's by the paper's factor; a return of Group_0 that is not positive has no
/// factor, there Group_1 must be above it by the same share of its size.
pub(super) fn beats(gait: f64, torque: f64) -> bool {
    gait >= torque + (paper::RATIO - 1.0) * torque.abs()
}

/// Mean length of Group_0's episodes from which its variances can be compared, s: a few strides.
const COMPARABLE_SECS: f64 = 2.0;

/// Share of the best constant gait's return that is near it.
const NEAR: f64 = 0.95;

/// Why a seed cannot tell.
const ALL_TELL: &str = "";
const TOO_FEW: &str = "too few episodes";
const FALLS: &str = "Group_0 falls too soon";
const NEVER_NEAR: &str = "no evaluation of its training came near the best constant gait";

/// Every claim that can be checked.
pub(super) fn all(facts: &[Facts]) -> Vec<Claim> {
    let court = Court(facts);
    [court.returns(), court.course(), court.steadiness(), vec![court.lasting()]].concat()
}

/// Judges claims by the facts of some seeds.
struct Court<'a>(&'a [Facts]);

impl Court<'_> {
    /// What the groups end at.
    fn returns(&self) -> Vec<Claim> {
        let plain = |of: fn(&Facts) -> f64| self.tell(of, |x| format!("{x:.1}"));
        vec![
            self.claim(
                "Group_1 ends at this return",
                format!("{:.0}", paper::GAIT_RETURN),
                plain(|f| f.gait.value),
                ALL_TELL,
                |f| Some(f.gait.value >= paper::GAIT_RETURN),
            ),
            self.claim(
                "Group_0 ends at this return",
                format!("{:.0}", paper::TORQUE_RETURN),
                plain(|f| f.torque.value),
                ALL_TELL,
                |f| Some(f.torque.value >= paper::TORQUE_RETURN),
            ),
            self.claim(
                "Group_1 earns this many times what Group_0 does, after as many transitions",
                format!("{:.2}", paper::RATIO),
                multiples(&self.figures(|f| f.gait.value), &self.figures(|f| f.torque.value), |x| format!("{x:.2}")),
                ALL_TELL,
                |f| Some(beats(f.gait.value, f.torque.value)),
            ),
        ]
    }

    /// How fast Group_1 learns.
    fn course(&self) -> Vec<Claim> {
        let episodes = |of: fn(&Facts) -> Option<f64>| {
            let reached: Vec<f64> = self.0.iter().filter_map(of).collect();
            if reached.is_empty() { "never".to_owned() } else { spread(&reached, |x| format!("{x:.0}")) }
        };
        vec![
            self.claim(
                "Group_1 has risen by this episode (ours: smoothed return reaches the paper's)",
                format!("{:.0}", paper::RISE_EPISODE),
                episodes(|f| f.gait.reached_paper_at),
                TOO_FEW,
                |f| in_time(f.gait.reached_paper_at, f.gait.episodes, paper::RISE_EPISODE),
            ),
            self.claim(
                "Group_1 is above Group_0 from this episode on (ours: at equal transitions)",
                format!("{:.0}", paper::OVERTAKING_EPISODE),
                episodes(|f| f.overtakes_at),
                TOO_FEW,
                |f| in_time(f.overtakes_at, f.gait.episodes, paper::OVERTAKING_EPISODE),
            ),
        ]
    }

    /// How steady the trunk is.
    fn steadiness(&self) -> Vec<Claim> {
        let variances = |of: fn(&Facts) -> f64| self.tell(of, |x| format!("{x:.1e}"));
        let against = |(gait, torque): (f64, f64)| format!("{gait:.1e} against {torque:.1e}");
        let both = |gait, torque| format!("{} against {}", variances(gait), variances(torque));
        let times = |of: fn(&Facts) -> f64, paper: f64| {
            let worst = self.0.iter().map(of).fold(0.0, f64::max) / paper;
            format!("{}; at most {worst:.2} times the paper's", variances(of))
        };
        let comparable = |facts: &Facts| facts.torque.seconds >= COMPARABLE_SECS;
        vec![
            self.claim(
                "Group_1 rolls less than Group_0 (variance, rad²)",
                against(paper::ROLL),
                both(|f| f.gait.roll_variance, |f| f.torque.roll_variance),
                FALLS,
                |f| comparable(f).then_some(f.gait.roll_variance < f.torque.roll_variance),
            ),
            self.claim(
                "Group_1 pitches less than Group_0 (variance, rad²)",
                against(paper::PITCH),
                both(|f| f.gait.pitch_variance, |f| f.torque.pitch_variance),
                FALLS,
                |f| comparable(f).then_some(f.gait.pitch_variance < f.torque.pitch_variance),
            ),
            self.claim(
                "Group_1 rolls no more than the paper's (variance, rad²)",
                format!("{:.1e}", paper::ROLL.0),
                times(|f| f.gait.roll_variance, paper::ROLL.0),
                ALL_TELL,
                |f| Some(f.gait.roll_variance <= paper::ROLL.0),
            ),
            self.claim(
                "Group_1 pitches no more than the paper's (variance, rad²)",
                format!("{:.1e}", paper::PITCH.0),
                times(|f| f.gait.pitch_variance, paper::PITCH.0),
                ALL_TELL,
                |f| Some(f.gait.pitch_variance <= paper::PITCH.0),
            ),
        ]
    }

    /// Whether what was learned stays; ours, for the paper shows no more than one rise.
    fn lasting(&self) -> Claim {
        let lowest: Vec<f64> = self.0.iter().filter_map(|f| f.lowest_after).collect();
        let constant = self.0.first().map_or(f64::NAN, |f| f.best_constant);
        let near = format!("{:.0} %", 100.0 * NEAR);
        self.claim(
            &format!(
                "Group_1 does not decay (ours: lowest evaluation once at {near} of the best constant gait's return)"
            ),
            "not told".to_owned(),
            format!("{}; {near} is {:.1}", spread(&lowest, |x| format!("{x:.1}")), NEAR * constant),
            NEVER_NEAR,
            |f| f.lowest_after.map(|lowest| lowest >= NEAR * f.best_constant),
        )
    }

    /// A claim with its verdict; a seed for which `holds` has no answer is left out, and `why` says why.
    fn claim(
        &self,
        text: &str,
        paper: String,
        ours: String,
        why: &str,
        holds: impl Fn(&Facts) -> Option<bool>,
    ) -> Claim {
        let answers: Vec<bool> = self.0.iter().filter_map(holds).collect();
        let (holds_on, seeds) = (answers.iter().filter(|holds| **holds).count(), answers.len());
        let left_out = self.0.len() - seeds;
        let verdict = verdict(holds_on, seeds, left_out, why);
        Claim { text: text.to_owned(), paper, ours, holds_on, seeds, left_out, verdict }
    }

    fn tell(&self, of: impl Fn(&Facts) -> f64, tell: impl Fn(f64) -> String) -> String {
        spread(&self.figures(of), tell)
    }

    fn figures(&self, of: impl Fn(&Facts) -> f64) -> Vec<f64> {
        self.0.iter().map(of).collect()
    }
}

/// How many times the second figure each first one is; of a loss there is no multiple.
pub(super) fn multiples(gait: &[f64], torque: &[f64], tell: impl Fn(f64) -> String) -> String {
    if torque.iter().any(|torque| *torque <= 0.0) {
        return "–".to_owned();
    }
    spread(&gait.iter().zip(torque).map(|(gait, torque)| gait / torque).collect::<Vec<_>>(), tell)
}

/// The median of some figures, and their ends where they differ.
pub(super) fn spread(figures: &[f64], tell: impl Fn(f64) -> String) -> String {
    let mut sorted = figures.to_vec();
    sorted.sort_by(f64::total_cmp);
    let (Some(low), Some(high)) = (sorted.first(), sorted.last()) else { return "–".to_owned() };
    let (low, median, high) = (tell(*low), tell(curves::median(&sorted)), tell(*high));
    if low == high { median } else { format!("{median} ({low} to {high})") }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn side(value: f64, roll_variance: f64) -> Side {
        Side {
            value,
            readings: Readings::default(),
            roll_variance,
            pitch_variance: 1e-4,
            fall_rate: 0.0,
            seconds: 10.0,
            episodes: 4000,
            reached_paper_at: (value > 175.0).then_some(60.0),
        }
    }

    fn facts(gait: f64, torque: f64) -> Facts {
        let (gait, torque) = (side(gait, 1e-4), side(torque, 2e-5));
        let (lowest_after, best_constant) = (Some(gait.value - 10.0), 900.0);
        Facts { seed: 1, gait, torque, overtakes_at: Some(80.0), lowest_after, best_constant }
    }

    #[test]
    fn verdicts_count_seeds() {
        let claims = all(&[facts(1800.0, 120.0), facts(160.0, 130.0), facts(900.0, -20.0)]);
        let found: Vec<(usize, bool)> = claims.iter().map(|claim| (claim.holds_on, claim.holds())).collect();
        let steadiness = [(0, false), (0, false), (3, true), (3, true)];
        let rest = [(2, false), (2, false), (2, false), (2, false), (3, true)];
        assert_eq!(found, [&rest[..], &steadiness, &[(2, false)]].concat(), "{claims:#?}");
        assert_eq!(claims[0].verdict, "holds on 2 of 3 seeds only");
        assert_eq!(claims[5].verdict, "does not hold on any of 3 seeds");
        assert_eq!(claims[7].verdict, "holds on 3 of 3 seeds");
        assert_eq!(claims[0].ours, "900.0 (160.0 to 1800.0)");
    }

    #[test]
    fn who_falls_at_once_is_not_steady() {
        let mut toppled = facts(1800.0, 2.0);
        (toppled.torque.seconds, toppled.torque.roll_variance) = (0.1, 1.0);
        let claims = all(&[toppled.clone(), facts(1800.0, 120.0)]);
        assert_eq!((claims[5].holds_on, claims[5].seeds, claims[5].left_out), (0, 1, 1));
        assert_eq!(
            claims[5].verdict,
            "does not hold on any of 1 seeds; cannot be told on 1 more: Group_0 falls too soon"
        );
        let alone = all(&[toppled]);
        assert!(!alone[5].holds() && alone[5].verdict.starts_with("cannot be told"), "{:?}", alone[5]);
    }

    #[test]
    fn a_short_training_refutes_nothing() {
        let mut short = facts(100.0, 90.0);
        (short.gait.episodes, short.overtakes_at, short.lowest_after) = (19, None, None);
        let claims = all(&[short.clone()]);
        for index in [3, 4, 9] {
            assert!(claims[index].verdict.starts_with("cannot be told on any of 1 seeds: "), "{:?}", claims[index]);
        }
        short.gait.episodes = 4000;
        assert_eq!(all(&[short])[3].verdict, "does not hold on any of 1 seeds");
    }

    #[test]
    fn decay_counts_from_the_first_that_came_near() {
        let evaluations = |returns: &[f64]| -> Vec<Evaluation> {
            let of = |(version, mean_return): (u64, &f64)| Evaluation { version, mean_return: *mean_return };
            (0..).zip(returns).map(of).collect()
        };
        let lowest = |returns: &[f64]| lowest_after(&evaluations(returns), 95.0);
        assert_eq!(lowest(&[0.0, 50.0, 96.0, 99.0, 97.0]), Some(96.0));
        assert_eq!(lowest(&[0.0, 96.0, 20.0, 99.0]), Some(20.0));
        assert_eq!((lowest(&[0.0, 94.0]), lowest(&[])), (None, None));
    }

    #[test]
    fn a_factor_of_what_is_not_positive_is_a_distance() {
        assert!(beats(145.0, 100.0) && !beats(144.0, 100.0));
        assert!(beats(-50.0, -100.0) && !beats(-60.0, -100.0) && beats(0.0, 0.0));
    }

    #[test]
    fn overtaking_is_for_good() {
        let flat: Curve = vec![(0.0, 10.0), (100.0, 10.0)];
        let rise: Curve = vec![(0.0, 0.0), (20.0, 20.0), (30.0, 5.0), (50.0, 30.0), (90.0, 30.0)];
        assert_eq!(overtaking(&rise, &flat), Some(50.0));
        assert_eq!(overtaking(&flat, &rise), None);
        assert_eq!(overtaking(&Vec::new(), &flat), None);
    }

    #[test]
    fn spreads_read_well() {
        let tell = |x: f64| format!("{x:.0}");
        assert_eq!(multiples(&[4.0, 9.0], &[2.0, 3.0], |x| format!("{x:.1}")), "2.5 (2.0 to 3.0)");
        assert_eq!(multiples(&[4.0, 9.0], &[2.0, -3.0], tell), "–");
        assert_eq!(spread(&[3.0, 1.0, 2.0], tell), "2 (1 to 3)");
        assert_eq!((spread(&[2.0, 2.0], tell), spread(&[], tell)), ("2".to_owned(), "–".to_owned()));
    }
}
