//! What the paper does not try, to be looked at: the constant gait of the configuration up a slope, over steps, pushed.

use super::measure::cut;
use super::play::shoot;
use super::settings::Settings;
use super::store::Store;
use crate::eval::bench::{self, Job, Push};
use crate::eval::cases::Case;
use crate::meter::Meter;
use herd_actor::env::Env;
use herd_actor::film::Frame;
use herd_common::episode::Ending;
use herd_common::hash::sha256_hex;
use herd_common::seed::Seed;
use serde::{Deserialize, Serialize};
use tokio_util::sync::CancellationToken;

/// One episode to be looked at.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Shown {
    /// Why it ended.
    pub(super) ending: Ending,
    /// How long it took, s.
    pub(super) seconds: f64,
    /// How far the robot came, m.
    pub(super) distance_m: f64,
    /// Its pictures.
    pub(super) frames: Vec<Frame>,
    /// Height (m) of the ground along x (m) where it bends, from behind the start to ahead of the end.
    pub(super) ground: Vec<(f64, f64)>,
}

/// All three.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Beyond {
    /// Up `SLOPE_DEG`.
    pub(super) slope: Shown,
    /// Over steps of `STEP_M`.
    pub(super) steps: Shown,
    /// Pushed to the left by `PUSH_NS` after `PUSH_AT_SECS`.
    pub(super) push: Shown,
}

/// Of the ground, uphill, degrees.
pub(super) const SLOPE_DEG: f64 = 10.0;
/// Of the ground, up and down, m.
pub(super) const STEP_M: f64 = 0.02;
/// To the left, N·s: 1 m/s for 13.6 kg.
pub(super) const PUSH_NS: f64 = 13.6;
/// When the robot has long been at its speed, s.
pub(super) const PUSH_AT_SECS: f64 = 2.0;
/// Longest of these episodes, s.
const LONGEST_SECS: f64 = 6.0;
/// The ground is looked at this often (m), from this far behind the start and ahead of the end.
const GROUND_EVERY_M: f64 = 0.001;
const GROUND_AROUND_M: f64 = 2.5;
/// A robot that was thrown further than this shows no ground below it, m.
const REACH_M: f64 = 50.0;
/// Root of their seeds.
const ROOT: u64 = 1_000_003;
/// Part of the key: another number than that of the films that lie there makes new ones.
const FILMS: u32 = 1;
const NAME: &str = "beyond";

/// The films, if they were made from what the settings say.
pub(super) fn shown(settings: &Settings) -> anyhow::Result<Option<Beyond>> {
    Store::of(&settings.dir).get(NAME, &key(&cases(settings)?))
}

/// Makes the films, unless that was done before.
pub(super) fn show(settings: &Settings, stop: &CancellationToken) -> anyhow::Result<()> {
    if shown(settings)?.is_some() {
        return Ok(());
    }
    let (cases, meter) = (cases(settings)?, Meter::new("films", 3));
    let push = Push { at_secs: PUSH_AT_SECS, impulse_ns: [0.0, PUSH_NS] };
    let seed = Seed::from_number(ROOT).child("evaluation", 0);
    let jobs = [None, None, Some(push)].into_iter().enumerate().map(|(case, push)| Job { case, seed, push });
    let (stop, done) = (|| stop.is_cancelled(), || meter.tick());
    let pool = bench::Options { threads: settings.actors as usize, stop: &stop, done: &done };
    let films = bench::each(&cases, &jobs.collect::<Vec<_>>(), &pool, &film)?;
    let [slope, steps, push] = <[Shown; 3]>::try_from(films).expect("as many as jobs");
    Store::of(&settings.dir).put(NAME, &key(&cases), &Beyond { slope, steps, push })
}

fn film(env: &mut Env, case: &Case, job: &Job) -> Shown {
    let film = shoot(env, case, job, true);
    let ends = film.frames.iter().map(|frame| frame.centre[0]);
    let (from, to) = ends.fold((0.0_f64, 0.0_f64), |(from, to), x| (from.min(x), to.max(x)));
    let (from, to) = (from.max(-REACH_M), to.min(REACH_M));
    let (from, count) = (from - GROUND_AROUND_M, ((to - from + 2.0 * GROUND_AROUND_M) / GROUND_EVERY_M).ceil() as u32);
    let xs = (0..=count).map(|i| from + GROUND_EVERY_M * f64::from(i));
    let ground: Vec<(f64, f64)> = xs.map(|x| (x, env.ground().height(x, 0.0))).collect();
    let outcome = film.outcome;
    Shown {
        ending: outcome.ending,
        seconds: outcome.seconds,
        distance_m: outcome.distance_m,
        frames: cut(film.frames),
        ground: corners(&ground),
    }
}

/// The ends of a line and the points where it bends.
fn corners(line: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let bends = |window: &&[(f64, f64)]| {
        let [(x0, z0), (x1, z1), (x2, z2)] = [window[0], window[1], window[2]];
        ((z1 - z0) * (x2 - x1) - (z2 - z1) * (x1 - x0)).abs() > 1e-12
    };
    let inner = line.windows(3).filter(bends).map(|window| window[1]);
    line.first().into_iter().copied().chain(inner).chain(line.last().copied()).collect()
}

/// Slope, steps, push.
fn cases(settings: &Settings) -> anyhow::Result<[Case; 3]> {
    let secs = settings.base.task.episode_secs.min(LONGEST_SECS);
    let case = |scenario: &str| -> anyhow::Result<Case> {
        let mut config = settings.base.clone();
        config.scenario = herd_common::config::scenario::Config::plain();
        let sets = ["task.kind=constant".to_owned(), format!("task.episode_secs={secs:?}"), scenario.to_owned()];
        Ok(Case { label: String::new(), config: config.overridden(&sets)?, policy: None })
    };
    let span = |key: &str, value: f64| format!("scenario.{key}=[{value:?}, {value:?}]");
    Ok([case(&span("slope_deg", SLOPE_DEG))?, case(&span("step_m", STEP_M))?, case(&span("push_ns", 0.0))?])
}

fn key(cases: &[Case; 3]) -> String {
    let tasks = cases.iter().map(|case| case.config.task_hash()).collect::<Vec<_>>().join(" ");
    sha256_hex(format!("{FILMS} {tasks} {PUSH_AT_SECS} {PUSH_NS}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_is_its_corners() {
        let step = |x: f64| if (0.5..1.0).contains(&x) { 0.02 } else { 0.0 };
        let line: Vec<(f64, f64)> = (0..=2000).map(|i| f64::from(i) * 1e-3).map(|x| (x, step(x))).collect();
        let xs: Vec<f64> = corners(&line).into_iter().map(|(x, _)| (x * 1e3).round()).collect();
        assert_eq!(xs, [0.0, 499.0, 500.0, 999.0, 1000.0, 2000.0]);
        let slope: Vec<(f64, f64)> = line.iter().map(|(x, _)| (*x, 0.17 * x)).collect();
        assert_eq!(corners(&slope), [slope[0], slope[2000]]);
    }
}
