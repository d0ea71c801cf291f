//! Constant gaits: how fast, how exactly, and how still.

use crate::each;
use herd_actor::env::{Env, Figures};
use herd_actor::rollout::run_constant;
use herd_common::config::{Config, task};
use herd_common::episode::Outcome;
use herd_common::seed::Seed;
use herd_common::spaces::Task;
use std::fmt::Write as _;

/// Swing durations of the tables, s.
const STEPS: [f64; 3] = [0.10, 0.15, 0.20];

fn gait(velocity_mps: f64, lift_m: f64, step_secs: f64) -> task::Constant {
    task::Constant { velocity_mps, stride_m: velocity_mps * step_secs, lift_m, step_secs }
}

/// Every seed's episode with this gait.
fn walk(config: &Config, gait: &task::Constant, seeds: u64) -> Vec<(Outcome, Figures)> {
    let seeds: Vec<u64> = (0..seeds).collect();
    each(&seeds, |seed| run_constant(config, gait, Seed::from_number(*seed)))
}

fn mean(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len() as f64;
    values.sum::<f64>() / count
}

fn falls(walks: &[(Outcome, Figures)]) -> usize {
    walks.iter().filter(|(outcome, _)| outcome.ending.is_fall()).count()
}

/// One line a gait: speed, falls, variances, cost.
fn line(out: &mut String, walks: &[(Outcome, Figures)], gait: &task::Constant) -> std::fmt::Result {
    let speed = mean(walks.iter().map(|(_, figures)| figures.mean_speed));
    let error = if gait.velocity_mps == 0.0 { 0.0 } else { 100.0 * (speed / gait.velocity_mps - 1.0) };
    let roll = mean(walks.iter().map(|(outcome, _)| outcome.roll_variance));
    let pitch = mean(walks.iter().map(|(outcome, _)| outcome.pitch_variance));
    let cost = mean(walks.iter().map(|(_, figures)| figures.cost_of_transport));
    let paid = mean(walks.iter().map(|(outcome, _)| outcome.reward.total()));
    writeln!(
        out,
        "| {:.2} | {:.2} | {:.2} | {speed:.3} | {error:+.1} | {} of {} | {roll:.1e} | {pitch:.1e} | {cost:.2} | {paid:.0} |",
        gait.step_secs,
        gait.lift_m,
        gait.velocity_mps,
        falls(walks),
        walks.len()
    )
}

const HEAD: &str = "| Δt, s | H, m | asked, m/s | mean, m/s | error, % | falls | roll, rad² | pitch, rad² | cost | return |\n\
                    |---|---|---|---|---|---|---|---|---|---|\n";

/// The fast end.
pub(crate) fn speed(config: &Config, seeds: u64) -> anyhow::Result<String> {
    let mut out = format!("Top speed\n\n{HEAD}");
    for step_secs in [0.10, 0.11] {
        for velocity in [1.6, 1.8, 2.0, 2.2, 2.4, 2.6, 2.8] {
            let gait = gait(velocity, 0.03, step_secs);
            line(&mut out, &walk(config, &gait, seeds), &gait)?;
        }
    }
    Ok(out)
}

/// Speeds from 0.2 to 1.2 m/s.
pub(crate) fn tracking(config: &Config, seeds: u64) -> anyhow::Result<String> {
    let mut out = format!("Velocity tracking, S = v Δt\n\n{HEAD}");
    for step_secs in STEPS {
        for tenths in 2..=12 {
            let gait = gait(f64::from(tenths) / 10.0, 0.03, step_secs);
            line(&mut out, &walk(config, &gait, seeds), &gait)?;
        }
    }
    Ok(out)
}

/// Drift and oscillation when no speed is asked for.
pub(crate) fn standing(config: &Config, seeds: u64) -> anyhow::Result<String> {
    let mut out = "Standing: v = 0, S = 0\n\n| Δt, s | drift after 1 s, mm | falls | roll rms 1–4 s | 7–10 s, rad | pitch rms 1–4 s \
                   | 7–10 s, rad |\n|---|---|---|---|---|---|---|\n"
        .to_owned();
    for step_secs in STEPS {
        let all: Vec<u64> = (0..seeds).collect();
        let still = each(&all, |seed| stand(config, &gait(0.0, 0.03, step_secs), *seed));
        let worst = still.iter().map(|s| s.drift).fold(0.0, f64::max);
        let fell = still.iter().filter(|s| s.fell).count();
        let rms = |i: usize| mean(still.iter().map(|s| s.rms[i]));
        let [a, b, c, d] = [rms(0), rms(1), rms(2), rms(3)];
        writeln!(
            out,
            "| {step_secs:.2} | {:.1} | {fell} of {seeds} | {a:.4} | {b:.4} | {c:.4} | {d:.4} |",
            1e3 * worst
        )?;
    }
    Ok(out)
}

/// How still one robot stood.
struct Stand {
    /// Farthest from where it was after 1 s, m.
    drift: f64,
    fell: bool,
    /// Root mean square of roll early and late, of pitch early and late, rad.
    rms: [f64; 4],
}

fn stand(config: &Config, gait: &task::Constant, seed: u64) -> Stand {
    let task = task::Config { kind: Task::Constant, constant: *gait, ..config.task.clone() };
    let mut env = Env::new(&Config { task, ..config.clone() });
    env.reset(Seed::from_number(seed));
    let (mut time, mut home, mut drift) = (0.0, None, 0.0_f64);
    let mut angles: [Vec<(f64, f64)>; 2] = [Vec::new(), Vec::new()];
    loop {
        let step = env.step(&[]);
        time += gait.step_secs;
        let state = env.state();
        if time >= 1.0 {
            let here = state.position.xy();
            drift = drift.max((here - *home.get_or_insert(here)).norm());
        }
        for (window, list) in [(1.0..4.0), (7.0..10.0)].iter().zip(&mut angles) {
            if window.contains(&time) {
                list.push((state.angles().x, state.angles().y));
            }
        }
        if let Some(ending) = step.ending {
            let rms = |list: &[(f64, f64)], pick: fn(&(f64, f64)) -> f64| {
                mean(list.iter().map(|pair| pick(pair).powi(2))).sqrt()
            };
            let [early, late] = &angles;
            let rms = [rms(early, |a| a.0), rms(late, |a| a.0), rms(early, |a| a.1), rms(late, |a| a.1)];
            return Stand { drift, fell: ending.is_fall(), rms };
        }
    }
}
