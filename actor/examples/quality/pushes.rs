//! Who survives a push? Horizontal impulses from eight sides at ten phases of the gait cycle.

use crate::each;
use herd_actor::env::Env;
use herd_common::config::{Config, task};
use herd_common::episode::Ending;
use herd_common::seed::Seed;
use herd_common::spaces::Task;
use nalgebra::Vector3;
use std::f64::consts::TAU;
use std::fmt::Write as _;

/// Impulses, N·s, and how long each lasts, s.
const IMPULSES: [f64; 4] = [6.8, 13.6, 20.4, 27.2];
const PUSH_SECS: f64 = 0.05;
const SIDES: u32 = 8;
const PHASES: u32 = 10;
/// Swings before the cycle in which the push comes: two seconds of the default gait.
const SWINGS_BEFORE: u64 = 14;

/// How the episode of a robot that is pushed once ends.
fn ending(config: &Config, impulse: f64, side: u32, phase: u32) -> Ending {
    let task = task::Config { kind: Task::Constant, ..config.task.clone() };
    let step_secs = task.constant.step_secs;
    let mut env = Env::new(&Config { task, ..config.clone() });
    env.reset(Seed::from_number(u64::from(phase)));
    let angle = TAU * f64::from(side) / f64::from(SIDES);
    let force = Vector3::new(angle.cos(), angle.sin(), 0.0) * (impulse / PUSH_SECS);
    // A cycle is two swings.
    let delay = 2.0 * step_secs * f64::from(phase) / f64::from(PHASES);
    for swing in 0.. {
        if swing == SWINGS_BEFORE {
            env.push_after(delay, &force, PUSH_SECS);
        }
        if let Some(ending) = env.step(&[]).ending {
            return ending;
        }
    }
    unreachable!("every episode ends")
}

/// Survivors by impulse and direction.
pub(crate) fn table(config: &Config) -> anyhow::Result<String> {
    let mut out = format!(
        "Pushes of {PUSH_SECS} s at {} m/s, Δt {} s: survivors of {PHASES} phases\n\n| N·s |",
        config.task.constant.velocity_mps, config.task.constant.step_secs
    );
    for side in 0..SIDES {
        write!(out, " {}° |", 360 * side / SIDES)?;
    }
    write!(out, " all, % |\n|{}\n", "---|".repeat(SIDES as usize + 2))?;
    for impulse in IMPULSES {
        let cases: Vec<(u32, u32)> = (0..SIDES).flat_map(|side| (0..PHASES).map(move |phase| (side, phase))).collect();
        let endings = each(&cases, |(side, phase)| ending(config, impulse, *side, *phase));
        write!(out, "| {impulse} |")?;
        let mut all = 0;
        for of_side in endings.chunks(PHASES as usize) {
            let alive = of_side.iter().filter(|ending| **ending == Ending::TimedOut).count();
            all += alive;
            write!(out, " {alive} |")?;
        }
        writeln!(out, " {:.0} |", 100.0 * all as f64 / endings.len() as f64)?;
    }
    Ok(out)
}
