//! Closed loop: the same trot under the whole controller with every step, over speeds and seeds.
//!
//! Differences are paired by seed; beside each mean difference from the yardstick stands its standard error, since single
//! episodes of a chaotic system differ whatever the step.

use crate::Steps;
use herd_actor::rollout::run_constant;
use herd_common::config::task;
use herd_common::episode::Ending;
use herd_common::seed::Seed;
use std::fmt::Write as _;

/// What the others are compared with.
const YARDSTICK: Steps = Steps::new(0.002, 4);
/// Speeds asked for, m/s.
const SPEEDS: [f64; 4] = [0.2, 0.6, 1.0, 1.4];
/// Figures of an episode, in the order of `Figures`.
const NAMES: [&str; 5] =
    ["mean speed", "roll variance", "pitch variance", "vertical force / weight", "cost of transport"];

type Figures = [f64; NAMES.len()];

/// Figures of the yardstick, and how far the others are from them in percent.
pub(crate) fn table(seeds: u64) -> anyhow::Result<String> {
    let head = format!("| {} |\n|{}\n", NAMES.join(" | "), "---|".repeat(NAMES.len() + 2));
    let mut out = format!("{seeds} seeds of 10 s. Yardstick {}:\n\n| m/s | falls {head}", YARDSTICK.name());
    let mut known = Vec::new();
    for speed in SPEEDS {
        let (figures, falls) = walk(YARDSTICK, speed, seeds)?;
        let means = std::array::from_fn::<_, { NAMES.len() }, _>(|i| mean(figures.iter().map(|f| f[i])));
        let [v, roll, pitch, load, cost] = means;
        writeln!(out, "| {speed} | {falls} | {v:.4} | {roll:.3e} | {pitch:.3e} | {load:.4} | {cost:.4} |")?;
        known.push(figures);
    }
    write!(out, "\nDifference from it, % ± standard error:\n\n| step, m/s | falls {head}")?;
    for steps in Steps::JUDGED.into_iter().filter(|steps| *steps != YARDSTICK) {
        for (speed, yardstick) in SPEEDS.into_iter().zip(&known) {
            let (figures, falls) = walk(steps, speed, seeds)?;
            write!(out, "| {}, {speed} | {falls} |", steps.name())?;
            for i in 0..NAMES.len() {
                let (difference, error) = compare(&figures, yardstick, i);
                write!(out, " {difference:+.2} ± {error:.2} |")?;
            }
            writeln!(out)?;
        }
    }
    Ok(out)
}

/// The figures of every seed at a speed, and how many fell.
fn walk(steps: Steps, speed: f64, seeds: u64) -> anyhow::Result<(Vec<Figures>, usize)> {
    let config = steps.config(&[])?;
    let gait = task::Constant { velocity_mps: speed, stride_m: 0.15 * speed, lift_m: 0.03, step_secs: 0.15 };
    let mut falls = 0;
    let figures = (0..seeds).map(|seed| {
        let (outcome, figures) = run_constant(&config, &gait, Seed::from_number(seed));
        falls += usize::from(outcome.ending != Ending::TimedOut);
        let (roll, pitch) = (outcome.roll_variance, outcome.pitch_variance);
        [figures.mean_speed, roll, pitch, figures.load, figures.cost_of_transport]
    });
    Ok((figures.collect(), falls))
}

/// Mean difference of a figure over seeds, % of the yardstick's mean, and its standard error.
fn compare(figures: &[Figures], yardstick: &[Figures], i: usize) -> (f64, f64) {
    let base = mean(yardstick.iter().map(|f| f[i]));
    let differences: Vec<f64> = figures.iter().zip(yardstick).map(|(a, b)| 100.0 * (a[i] - b[i]) / base).collect();
    let middle = mean(differences.iter().copied());
    let squares: f64 = differences.iter().map(|d| (d - middle).powi(2)).sum();
    let count = differences.len() as f64;
    (middle, (squares / (count * (count - 1.0).max(1.0))).sqrt())
}

fn mean(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len() as f64;
    values.sum::<f64>() / count
}
