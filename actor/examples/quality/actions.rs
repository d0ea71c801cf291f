//! Does any action make the robot fall? Constant ones, redrawn ones, and jumps between corners of the box.

use crate::each;
use herd_actor::env::Env;
use herd_actor::rollout::run_episode;
use herd_common::config::{Config, task};
use herd_common::episode::{Ending, Outcome};
use herd_common::seed::Seed;
use herd_common::spaces::Task;
use rand::{Rng, RngExt};
use std::collections::BTreeMap;
use std::fmt::Write as _;

/// Points of the grid along each of the four dimensions.
const GRID: usize = 4;
/// Random constant actions, and episodes of changing ones.
const POINTS: u64 = 200;

type Action = [f32; 4];

/// One episode of a trial.
enum Trial {
    /// The same action at every decision.
    Held(Action, u64),
    /// Uniform over the box at every decision.
    Redrawn(u64),
    /// A corner of the box at every decision.
    Corners(u64),
    /// Uniform, but held for half a second to two.
    Phased(u64),
}

fn uniform(rng: &mut impl Rng) -> Action {
    std::array::from_fn(|_| rng.random_range(-1.0..=1.0))
}

fn corner(rng: &mut impl Rng) -> Action {
    std::array::from_fn(|_| if rng.random_bool(0.5) { 1.0 } else { -1.0 })
}

fn run(config: &Config, trial: &Trial) -> Outcome {
    let task = task::Config { kind: Task::Gait, ..config.task.clone() };
    let mut env = Env::new(&Config { task, ..config.clone() });
    let seed = Seed::from_number(match trial {
        Trial::Held(_, seed) | Trial::Redrawn(seed) | Trial::Corners(seed) | Trial::Phased(seed) => *seed,
    });
    let mut rng = seed.child("trial", 0).rng();
    let (mut left, mut kept) = (0, [0.0; 4]);
    let mut act = |_: &_| {
        let action = match trial {
            Trial::Held(action, _) => *action,
            Trial::Redrawn(_) => uniform(&mut rng),
            Trial::Corners(_) => corner(&mut rng),
            Trial::Phased(_) => {
                if left == 0 {
                    (left, kept) = (rng.random_range(3..12), uniform(&mut rng));
                }
                left -= 1;
                kept
            }
        };
        action.to_vec()
    };
    run_episode(&mut env, seed, &mut act, &mut |_| {})
}

/// Falls of each kind of trial, of `most` episodes each, and which constant actions fell.
pub(crate) fn table(config: &Config, seeds: u64, most: usize) -> anyhow::Result<String> {
    let level = |i: usize| -1.0 + 2.0 * i as f32 / (GRID - 1) as f32;
    let points = (0..GRID.pow(4)).map(|n| std::array::from_fn(|axis| level(n / GRID.pow(axis as u32) % GRID)));
    let grid = points.flat_map(|action: Action| (0..seeds.min(2)).map(move |seed| Trial::Held(action, seed)));
    let random = (0..POINTS).map(|n| Trial::Held(uniform(&mut Seed::from_number(n).child("point", 0).rng()), n));
    let groups: [(&str, Vec<Trial>); 5] = [
        ("constant, grid", grid.collect()),
        ("constant, random", random.collect()),
        ("redrawn at each decision", (0..POINTS).map(Trial::Redrawn).collect()),
        ("corners", (0..POINTS).map(Trial::Corners).collect()),
        ("redrawn every 3 to 11 decisions", (0..POINTS).map(Trial::Phased).collect()),
    ];
    let mut out = "Falls over the action box\n\n| actions | falls | endings |\n|---|---|---|\n".to_owned();
    let mut fallen = String::new();
    for (name, mut trials) in groups {
        trials.truncate(most);
        let outcomes = each(&trials, |trial| run(config, trial));
        let mut endings: BTreeMap<String, usize> = BTreeMap::new();
        let mut falls = 0;
        for (trial, outcome) in trials.iter().zip(&outcomes) {
            if outcome.ending != Ending::TimedOut {
                falls += 1;
                *endings.entry(format!("{:?}", outcome.ending)).or_default() += 1;
                if let Trial::Held(action, _) = trial {
                    let gait = config.task.gait.from_action(action);
                    writeln!(
                        fallen,
                        "v {:+.2} m/s, S {:+.3} m, H {:.3} m, Δt {:.3} s: {:?} after {:.1} s",
                        gait.velocity_mps, gait.stride_m, gait.lift_m, gait.step_secs, outcome.ending, outcome.seconds
                    )?;
                }
            }
        }
        writeln!(out, "| {name} | {falls} of {} | {endings:?} |", trials.len())?;
    }
    write!(out, "\n{fallen}")?;
    Ok(out)
}
