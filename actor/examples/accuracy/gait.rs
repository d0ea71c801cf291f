//! Closed loop: the same trot under the whole controller with every step, over speeds and seeds, calm and pushed.
//!
//! A calm trot rolls by a milliradian, the pattern in which steps and footfalls meet; pushes from all sides make it roll
//! in earnest. Differences are paired by seed, every speed counts alike; beside each mean stands its standard error. A
//! walk that ends in a fall is in them as far as it went: where there are falls, a row means little.

use crate::Steps;
use anyhow::Context;
use herd_actor::rollout::run_constant;
use herd_common::config::{Config, task};
use herd_common::episode::Ending;
use herd_common::seed::Seed;
use std::fmt::Write as _;
use std::num::NonZero;
use std::thread;

/// What the others are compared with.
const YARDSTICK: Steps = Steps::new(0.002, 4);
/// The default, told at each speed.
const ONE_STEP: Steps = Steps::new(0.002, 1);
/// Speeds asked for, m/s.
const SPEEDS: [f64; 13] = [0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.1, 1.2, 1.3, 1.4];
/// Names of the conditions, and their settings.
const CONDITIONS: [(&str, &[&str]); 2] =
    [("calm", &[]), ("pushed", &["scenario.push_ns=[5.0, 5.0]", "scenario.push_every_secs=[0.5, 0.5]"])];
/// Figures of an episode, in the order of `Figures`.
const NAMES: [&str; 6] =
    ["falls", "mean speed", "roll variance", "pitch variance", "vertical force / weight", "cost of transport"];

type Figures = [f64; NAMES.len()];
/// Of every seed the figures at every speed.
type Walks = Vec<[Figures; SPEEDS.len()]>;

/// Figures of the yardstick, and how far the others are from them in percent.
pub(crate) fn tables(seeds: u64) -> anyhow::Result<String> {
    let mut out = format!("{seeds} seeds of 10 s a speed. Yardstick {}:\n\n", YARDSTICK.name());
    let known: Vec<Walks> =
        CONDITIONS.iter().map(|(_, sets)| walks(YARDSTICK, sets, seeds)).collect::<anyhow::Result<_>>()?;
    write!(out, "{}", head("condition, m/s"))?;
    for ((condition, _), walks) in CONDITIONS.iter().zip(&known) {
        for (speed, wanted) in SPEEDS.iter().enumerate() {
            let of = |i: usize| mean(walks.iter().map(|seed| seed[speed][i]));
            let [v, roll, pitch, load, cost] = [1, 2, 3, 4, 5].map(of);
            let falls = of(0) * seeds as f64;
            writeln!(
                out,
                "| {condition}, {wanted} | {falls} | {v:.4} | {roll:.3e} | {pitch:.3e} | {load:.4} | {cost:.4} |"
            )?;
        }
    }
    let (mut pooled, mut each) = (head("step, condition"), head("one step, m/s"));
    for steps in Steps::JUDGED.into_iter().filter(|steps| *steps != YARDSTICK) {
        for ((condition, sets), yardstick) in CONDITIONS.iter().zip(&known) {
            let found = walks(steps, sets, seeds)?;
            let all: Vec<usize> = (0..SPEEDS.len()).collect();
            writeln!(pooled, "| {}, {condition} {}", steps.name(), differences(&found, yardstick, &all)?)?;
            for (speed, wanted) in SPEEDS.iter().enumerate().filter(|_| steps == ONE_STEP) {
                writeln!(each, "| {condition}, {wanted} {}", differences(&found, yardstick, &[speed])?)?;
            }
        }
    }
    write!(out, "\nDifference from it, all speeds together, % ± standard error:\n\n{pooled}")?;
    write!(out, "\nThe same of {} at each speed:\n\n{each}", ONE_STEP.name())?;
    Ok(out)
}

fn head(first: &str) -> String {
    format!("| {first} | {} |\n|{}\n", NAMES.join(" | "), "---|".repeat(NAMES.len() + 1))
}

/// The figures of every seed at every speed, seeds on as many threads as there are processors.
fn walks(steps: Steps, sets: &[&str], seeds: u64) -> anyhow::Result<Walks> {
    let config = steps.config(&sets.iter().map(|set| (*set).to_owned()).collect::<Vec<_>>())?;
    let threads = thread::available_parallelism().map_or(1, NonZero::get) as u64;
    let mut found: Vec<(u64, [Figures; SPEEDS.len()])> = thread::scope(|scope| {
        let own = |first: u64| {
            let config = &config;
            scope.spawn(move || (first..seeds).step_by(threads as usize).map(|n| (n, walk(config, n))).collect())
        };
        let workers: Vec<_> = (0..threads).map(own).collect();
        let joined = workers.into_iter().map(|worker| worker.join().ok().context("a walk panicked"));
        joined.collect::<anyhow::Result<Vec<Vec<_>>>>()
    })?
    .concat();
    found.sort_by_key(|(seed, _)| *seed);
    Ok(found.into_iter().map(|(_, figures)| figures).collect())
}

/// The figures of a seed at every speed.
fn walk(config: &Config, seed: u64) -> [Figures; SPEEDS.len()] {
    SPEEDS.map(|speed| {
        let gait = task::Constant { velocity_mps: speed, stride_m: 0.15 * speed, lift_m: 0.03, step_secs: 0.15 };
        let (outcome, figures) = run_constant(config, &gait, Seed::from_number(seed));
        let fell = f64::from(u8::from(outcome.ending != Ending::TimedOut));
        let (roll, pitch) = (outcome.roll_variance, outcome.pitch_variance);
        [fell, figures.mean_speed, roll, pitch, figures.load, figures.cost_of_transport]
    })
}

/// Falls, and how far each other figure is from the yardstick's, mean over these speeds, as cells of a table.
fn differences(found: &Walks, yardstick: &Walks, speeds: &[usize]) -> anyhow::Result<String> {
    let falls: f64 = found.iter().flat_map(|seed| speeds.iter().map(|speed| seed[*speed][0])).sum();
    let mut cells = format!("| {falls} |");
    for i in 1..NAMES.len() {
        let bases: Vec<f64> = speeds.iter().map(|speed| mean(yardstick.iter().map(|seed| seed[*speed][i]))).collect();
        let of_seed = |(ours, theirs): (&[Figures; SPEEDS.len()], &[Figures; SPEEDS.len()])| {
            mean(speeds.iter().zip(&bases).map(|(speed, base)| 100.0 * (ours[*speed][i] - theirs[*speed][i]) / base))
        };
        let percent: Vec<f64> = found.iter().zip(yardstick).map(of_seed).collect();
        let middle = mean(percent.iter().copied());
        let squares: f64 = percent.iter().map(|d| (d - middle).powi(2)).sum();
        let count = percent.len() as f64;
        let error = (squares / (count * (count - 1.0).max(1.0))).sqrt();
        write!(cells, " {middle:+.2} ± {error:.2} |")?;
    }
    Ok(cells)
}

fn mean(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len() as f64;
    values.sum::<f64>() / count
}
