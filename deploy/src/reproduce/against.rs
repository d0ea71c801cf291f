//! Planners against the best constant gait of a place: verdicts by 95 % intervals, and what the difference is made of.

use super::measure::{Evaluation, Interval};
use super::place::Place;
use crate::table::percent;
use serde::Serialize;

/// What intervals tell.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Verdict {
    /// The whole interval lies above the other.
    Better,
    /// They overlap.
    Equal,
    /// The whole interval lies below the other.
    Worse,
    /// One of them has a single episode, which tells nothing of the spread.
    Open,
}

/// One planner.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Contest {
    /// The seed of its training.
    pub(super) seed: u64,
    /// By the intervals of both means.
    pub(super) verdict: Verdict,
    /// Planner less constant gait, seed by seed of the evaluation: what both meet alike falls out.
    pub(super) difference: Interval,
}

/// All planners of a place.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Against {
    /// Where.
    pub(super) place: Place,
    /// One after the other.
    pub(super) contests: Vec<Contest>,
    /// The verdict over all seeds, in words.
    pub(super) words: String,
    /// What the difference is made of, in words.
    pub(super) why: String,
}

/// Returns whose ratio is closer to one than this hardly differ.
const HARDLY: f64 = 0.005;

impl Verdict {
    /// Of the first against the second.
    pub(super) fn of(planner: &Interval, constant: &Interval) -> Self {
        let (Some(a), Some(b)) = (planner.half, constant.half) else { return Self::Open };
        match () {
            () if planner.mean - a > constant.mean + b => Self::Better,
            () if planner.mean + a < constant.mean - b => Self::Worse,
            () => Self::Equal,
        }
    }

    /// For people.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Better => "better",
            Self::Equal => "equal within intervals",
            Self::Worse => "worse",
            Self::Open => "cannot be told",
        }
    }
}

impl Against {
    /// These planners, by the seed of their training, against a constant gait; all were evaluated on the same seeds.
    pub(super) fn of(place: Place, planners: &[(u64, &Evaluation)], constant: &Evaluation) -> Self {
        let contest = |(seed, planner): &(u64, &Evaluation)| Contest {
            seed: *seed,
            verdict: Verdict::of(&planner.value, &constant.value),
            difference: difference(planner, constant),
        };
        let contests: Vec<Contest> = planners.iter().map(contest).collect();
        let words = words(place, &contests, constant);
        let planners: Vec<&Evaluation> = planners.iter().map(|(_, planner)| *planner).collect();
        Self { place, contests, words, why: why(&planners, constant) }
    }
}

/// Planner less constant gait, seed by seed.
pub(super) fn difference(planner: &Evaluation, constant: &Evaluation) -> Interval {
    let differences = planner.returns.iter().zip(&constant.returns).map(|(a, b)| a - b);
    Interval::of(&differences.collect::<Vec<_>>())
}

fn words(place: Place, contests: &[Contest], constant: &Evaluation) -> String {
    let count = |verdict: Verdict| contests.iter().filter(|contest| contest.verdict == verdict).count();
    let n = contests.len();
    let all = [Verdict::Better, Verdict::Equal, Verdict::Worse, Verdict::Open].into_iter().find(|v| count(*v) == n);
    let head = format!("On {} ground, by 95 % intervals over {} episodes,", place.name(), constant.episodes);
    let value = constant.value.mean;
    let means = match all {
        Some(Verdict::Open) => return format!("{head} nothing can be told."),
        Some(verdict) => {
            let relation = match verdict {
                Verdict::Better => "better than",
                Verdict::Worse => "worse than",
                Verdict::Equal | Verdict::Open => "equal within intervals to",
            };
            format!("{head} the planner is {relation} the best constant gait ({value:.1}) on each of {n} seeds.")
        }
        None => format!(
            "{head} the planner is better than the best constant gait ({value:.1}) on {}, equal within intervals on {} \
             and worse on {} of {n} seeds.",
            count(Verdict::Better),
            count(Verdict::Equal),
            count(Verdict::Worse)
        ),
    };
    let beyond_zero = |sign: f64| {
        let clear = |interval: &Interval| interval.half.is_some_and(|half| sign * interval.mean > half);
        contests.iter().filter(|contest| clear(&contest.difference)).count()
    };
    let (above, below) = (beyond_zero(1.0), beyond_zero(-1.0));
    format!(
        "{means} Episode by episode its difference is clearly above 0 on {above} and clearly below 0 on {below} of {n}."
    )
}

/// The return is what a second pays, times the seconds before a fall: which of them makes the difference, in words.
fn why(planners: &[&Evaluation], constant: &Evaluation) -> String {
    let mean = |of: &dyn Fn(&Evaluation) -> f64| planners.iter().map(|e| of(e)).sum::<f64>() / planners.len() as f64;
    let (value, secs) = (mean(&|e| e.value.mean), mean(&|e| e.seconds.mean));
    let (other, other_secs) = (constant.value.mean, constant.seconds.mean);
    let told = format!(
        "Over all seeds the planner falls in {} of its episodes, stays up for {secs:.1} s and walks at {:.2} m/s; the \
         constant gait falls in {}, stays up for {other_secs:.1} s and walks at {:.2} m/s.",
        percent(mean(&|e| e.fall_rate)),
        mean(&|e| e.speed_mps.mean),
        percent(constant.fall_rate),
        constant.speed_mps.mean,
    );
    let positive = [value, secs, other, other_secs].iter().all(|figure| *figure > 0.0);
    if !positive {
        return told;
    }
    // ln(R/R′) = ln((R/t)/(R′/t′)) + ln(t/t′)
    let (all, up) = ((value / other).ln(), (secs / other_secs).ln());
    let pay = all - up;
    let share = |part: f64| format!("{:+.1} %", 100.0 * part.exp_m1());
    let cause = match () {
        () if pay.abs() < HARDLY && up.abs() < HARDLY => "neither makes a difference to speak of",
        () if up.abs() >= pay.abs() && up > 0.0 => "it is above all that the planner stays up longer",
        () if up.abs() >= pay.abs() => "it is above all that the planner falls sooner",
        () if pay > 0.0 => "it is above all that the planner earns more while it is up",
        () => "it is above all that the planner earns less while it is up",
    };
    format!(
        "{told} What it earns a second differs by {} and the time that it stays up by {}: {cause}.",
        share(pay),
        share(up)
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn evaluation(returns: &[f64], secs: f64, fall_rate: f64) -> Evaluation {
        let constant = |figure: f64| Interval { mean: figure, half: Some(0.0), deviation: 0.0 };
        Evaluation {
            episodes: returns.len(),
            value: Interval::of(returns),
            readings: super::super::measure::Readings::default(),
            speed_mps: constant(1.5),
            roll_variance: constant(0.0),
            pitch_variance: constant(0.0),
            seconds: constant(secs),
            fall_rate,
            endings: std::collections::BTreeMap::new(),
            returns: returns.to_vec(),
        }
    }

    #[test]
    fn verdicts_go_by_whether_intervals_overlap() {
        let interval = |mean: f64, half: f64| Interval { mean, half: Some(half), deviation: half };
        let of = |mean| Verdict::of(&interval(mean, 1.0), &interval(10.0, 2.0));
        assert_eq!([13.1, 12.9, 7.1, 6.9].map(of), [Verdict::Better, Verdict::Equal, Verdict::Equal, Verdict::Worse]);
        assert_eq!(Verdict::of(&Interval::of(&[9.0]), &interval(1.0, 0.1)), Verdict::Open);
    }

    #[test]
    fn the_difference_is_taken_seed_by_seed() {
        let (planner, constant) = (evaluation(&[110.0, 1010.0], 10.0, 0.0), evaluation(&[100.0, 1000.0], 10.0, 0.0));
        let against = Against::of(Place::Rough, &[(7, &planner)], &constant);
        let contest = &against.contests[0];
        assert_eq!((contest.seed, contest.verdict), (7, Verdict::Equal));
        assert_eq!((contest.difference.mean, contest.difference.half), (10.0, Some(0.0)));
        assert!(against.words.contains("equal within intervals to") && against.words.contains("each of 1 seeds"));
        assert!(against.words.ends_with("clearly above 0 on 1 and clearly below 0 on 0 of 1."), "{}", against.words);
    }

    #[test]
    fn the_reason_is_the_larger_part() {
        let constant = evaluation(&[1000.0, 1002.0], 10.0, 0.0);
        let why = |value: f64, secs: f64| {
            let planner = evaluation(&[value, value + 1.0], secs, 0.2);
            Against::of(Place::Rough, &[(1, &planner)], &constant).why
        };
        assert!(why(1500.0, 10.0).contains("earns more while it is up"), "{}", why(1500.0, 10.0));
        assert!(why(800.0, 10.0).contains("earns less while it is up"));
        assert!(why(700.0, 7.0).contains("falls sooner") && why(700.0, 7.0).contains("-30.0 %"), "{}", why(700.0, 7.0));
        assert!(why(1001.0, 10.0).contains("neither"));
        assert!(!why(-5.0, 10.0).contains("above all"), "a loss has no share");
    }

    #[test]
    fn seeds_that_disagree_are_counted() {
        let constant = evaluation(&[10.0, 11.0, 10.0, 11.0], 10.0, 0.0);
        let (good, bad) =
            (evaluation(&[20.0, 21.0, 20.0, 21.0], 10.0, 0.0), evaluation(&[1.0, 2.0, 1.0, 2.0], 1.0, 1.0));
        let words = Against::of(Place::Flat, &[(1, &good), (2, &bad), (3, &bad)], &constant).words;
        assert!(
            words.starts_with("On flat ground")
                && words.contains("on 1, equal within intervals on 0 and worse on 2 of 3")
        );
    }
}
