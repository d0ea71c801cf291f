//! Runs the suite for its subjects and sums every case up.

use super::conditions::{DIRECTIONS, Group, IMPULSES_NS, PUSHED_SECS, direction_rad, groups, pushes, speeds};
use super::interval;
use crate::eval::bench::{self, Job, Push};
use crate::eval::cases::Case;
use crate::eval::figures::{Episode, Mean};
use crate::meter::Meter;
use herd_common::config::task::Constant;
use herd_common::seed::Seed;
use herd_common::spaces::Task;
use serde::Serialize;
use std::collections::BTreeMap;

/// How much is run.
#[derive(Clone, Copy, Debug)]
pub(super) struct Effort {
    /// Episodes of a case.
    pub(super) episodes: u64,
    /// Fewer phases for each push.
    pub(super) quick: bool,
    /// Episodes at once.
    pub(super) threads: usize,
}

/// What was found about one subject.
#[derive(Debug, Serialize)]
pub(super) struct Findings {
    /// What it is called.
    pub(super) label: String,
    /// Its gait, if it has but one.
    pub(super) gait: Option<Constant>,
    /// Level ground, nothing unexpected.
    pub(super) plain: Row,
    /// One quantity after the other.
    pub(super) groups: Vec<Varied>,
    /// From every side, all phases together.
    pub(super) pushes: Vec<Pushed>,
}

/// One quantity and what came of its values.
#[derive(Debug, Serialize)]
pub(super) struct Varied {
    pub(super) name: &'static str,
    pub(super) quantity: &'static str,
    /// Empty for a bare number.
    pub(super) unit: &'static str,
    /// By ascending value, the plain case among them.
    pub(super) rows: Vec<Row>,
}

/// The figures of one case.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Row {
    /// Of the quantity that is varied; 0 for the plain case by itself.
    pub(super) value: f64,
    pub(super) episodes: u64,
    #[serde(rename = "return")]
    pub(super) mean_return: f64,
    /// 95 %, of the mean.
    pub(super) return_interval: Option<[f64; 2]>,
    pub(super) fall_rate: f64,
    /// 95 %
    pub(super) fall_interval: [f64; 2],
    pub(super) seconds: f64,
    pub(super) speed_mps: f64,
    /// Mean of |speed − command| / |command|, for a gait with a command.
    pub(super) speed_error: Option<f64>,
    pub(super) roll_variance: f64,
    pub(super) pitch_variance: f64,
    /// Over the episodes without a fall.
    pub(super) cost_of_transport: Option<f64>,
    pub(super) distance_m: f64,
    pub(super) endings: BTreeMap<&'static str, u64>,
}

/// What came of pushes from one direction.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Pushed {
    /// Whereto: from forwards towards the left.
    pub(super) direction_deg: f64,
    pub(super) impulse_ns: f64,
    pub(super) episodes: u64,
    pub(super) falls: u64,
    /// 95 %, of the share that fell.
    pub(super) fall_interval: [f64; 2],
}

/// All cases and episodes, in the order in which they are read again.
#[derive(Default)]
struct Plan {
    cases: Vec<Case>,
    jobs: Vec<Job>,
}

/// Runs everything for these subjects; `meter` is told how many episodes there are, and gives what counts them.
pub(super) fn run(
    subjects: &[Case],
    root: Seed,
    effort: Effort,
    meter: &dyn Fn(u64) -> Meter,
) -> anyhow::Result<Vec<Findings>> {
    let seeds: Vec<Seed> = (0..effort.episodes.max(100)).map(|index| root.child("evaluation", index)).collect();
    let mut plan = Plan::default();
    for subject in subjects {
        plan.add_subject(subject, &seeds, effort)?;
    }
    let meter = meter(plan.jobs.len() as u64);
    let episodes = bench::episodes(&plan.cases, &plan.jobs, effort.threads, &|| meter.tick())?;
    let mut left = &episodes[..];
    Ok(subjects.iter().map(|subject| findings(subject, effort, &mut left)).collect())
}

/// The groups that are for this subject.
fn groups_of(subject: &Case) -> Vec<Group> {
    let sweep = (subject.config.task.kind == Task::Constant).then(|| speeds(&subject.config));
    sweep.into_iter().chain(groups(&subject.config)).collect()
}

/// Directions and impulses of the push map.
fn cells() -> impl Iterator<Item = (usize, f64)> {
    IMPULSES_NS.into_iter().flat_map(|impulse| (0..DIRECTIONS).map(move |direction| (direction, impulse)))
}

fn pushes_of(subject: &Case, (direction, impulse): (usize, f64), effort: Effort) -> Vec<Push> {
    pushes(direction, impulse, &subject.config.task.constant, effort.quick)
}

impl Plan {
    fn add_subject(&mut self, subject: &Case, seeds: &[Seed], effort: Effort) -> anyhow::Result<()> {
        let settings = groups_of(subject).into_iter().flat_map(|group| group.settings);
        let sets = std::iter::once(Vec::new()).chain(settings.map(|setting| setting.sets));
        for sets in sets {
            self.add(subject, &sets, seeds.iter().take(effort.episodes as usize).map(|seed| (*seed, None)))?;
        }
        let pushes = cells().flat_map(|cell| pushes_of(subject, cell, effort).into_iter().enumerate());
        let runs: Vec<_> = pushes.map(|(phase, push)| (seeds[phase], Some(push))).collect();
        self.add(subject, &[format!("task.episode_secs={PUSHED_SECS:?}")], runs.into_iter())
    }

    fn add(
        &mut self,
        subject: &Case,
        sets: &[String],
        runs: impl Iterator<Item = (Seed, Option<Push>)>,
    ) -> anyhow::Result<()> {
        let case = self.cases.len();
        self.cases.push(Case { config: subject.config.overridden(sets)?, ..subject.clone() });
        self.jobs.extend(runs.map(|(seed, push)| Job { case, seed, push }));
        Ok(())
    }
}

/// Reads a subject's episodes in the order of its plan.
fn findings(subject: &Case, effort: Effort, left: &mut &[Episode]) -> Findings {
    let mut next = |count: usize| left.split_off(..count).expect("as many as were planned");
    let command = |value: f64, name: &str| {
        let own = subject.gait().map(|gait| gait.velocity_mps);
        own.map(|own| if name == "speed" { value } else { own }).filter(|command| *command != 0.0)
    };
    let mut row = |value: f64, name: &str| Row::of(value, next(effort.episodes as usize), command(value, name));
    let plain = row(0.0, "");
    let varied = |group: Group| {
        let mut rows: Vec<Row> = group.settings.iter().map(|setting| row(setting.value, group.name)).collect();
        rows.extend(group.plain.map(|value| Row { value, ..plain.clone() }));
        rows.sort_by(|a, b| a.value.total_cmp(&b.value));
        Varied { name: group.name, quantity: group.quantity, unit: group.unit, rows }
    };
    let groups = groups_of(subject).into_iter().map(varied).collect();
    let pushes = cells().map(|cell| Pushed::of(cell, next(pushes_of(subject, cell, effort).len()))).collect();
    Findings { label: subject.label.clone(), gait: subject.gait(), plain, groups, pushes }
}

impl Row {
    fn of(value: f64, episodes: &[Episode], command: Option<f64>) -> Self {
        let mean = Mean::of(episodes, command);
        let returns: Vec<f64> = episodes.iter().map(|episode| episode.outcome.reward.total()).collect();
        let count = episodes.len() as u64;
        Self {
            value,
            episodes: count,
            mean_return: mean.value,
            return_interval: interval::of_mean(&returns),
            fall_rate: mean.fall_rate,
            fall_interval: interval::of_share((mean.fall_rate * count as f64).round() as u64, count),
            seconds: mean.seconds,
            speed_mps: mean.speed_mps,
            speed_error: mean.speed_error,
            roll_variance: mean.roll_variance,
            pitch_variance: mean.pitch_variance,
            cost_of_transport: mean.cost_of_transport,
            distance_m: mean.distance_m,
            endings: mean.endings,
        }
    }
}

impl Pushed {
    fn of((direction, impulse_ns): (usize, f64), episodes: &[Episode]) -> Self {
        let count = episodes.len() as u64;
        let falls = (Mean::of(episodes, None).fall_rate * count as f64).round() as u64;
        Self {
            direction_deg: direction_rad(direction).to_degrees(),
            impulse_ns,
            episodes: count,
            falls,
            fall_interval: interval::of_share(falls, count),
        }
    }

    /// Share of the pushes that the robot stood.
    pub(super) fn stood(&self) -> f64 {
        1.0 - self.falls as f64 / self.episodes as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use herd_common::config::Config;

    #[test]
    fn every_case_is_summed_up_in_its_place() {
        // A robot that is too low from the start falls at once: much is run in no time.
        let sets = ["task.kind=constant", "task.ending.height_m=1.0"].map(str::to_owned);
        let config = Config::load(None, &sets).expect("valid");
        let subject = Case { label: "gait".into(), config, policy: None };
        let effort = Effort { episodes: 2, quick: true, threads: 2 };
        let found = run(&[subject], Seed::from_number(1), effort, &|total| {
            assert_eq!(total, 2 * (1 + 27) + 2 * 32);
            Meter::new("episodes", total)
        });
        let found = found.expect("runs").remove(0);
        let names: Vec<&str> = found.groups.iter().map(|group| group.name).collect();
        assert_eq!(names, ["speed", "friction", "payload", "slope", "bumps", "steps", "noise", "delay"]);
        for row in found.groups.iter().flat_map(|group| &group.rows).chain([&found.plain]) {
            assert_eq!((row.episodes, row.fall_rate, row.fall_interval[1]), (2, 1.0, 1.0));
        }
        for group in &found.groups {
            assert!(group.rows.windows(2).all(|pair| pair[0].value < pair[1].value), "{}", group.name);
        }
        let sides: Vec<f64> = found.pushes.iter().map(|pushed| pushed.direction_deg).collect();
        assert_eq!((found.pushes.len(), sides[1], sides[8]), (32, 45.0, 0.0));
        assert!(found.pushes.iter().all(|pushed| (pushed.episodes, pushed.falls) == (2, 2)));
    }
}
