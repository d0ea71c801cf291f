//! `herd eval`: episodes without noise and without a learner, and the figures of them.

pub(crate) mod bench;
pub(crate) mod cases;
mod commands;
mod figures;
mod suite;
mod view;

use crate::args::ConfigArgs;
use crate::exit::Failure;
use crate::out;
use herd_common::config::Config;
use herd_common::config::command::Command;
use herd_common::seed::Seed;
use std::path::PathBuf;

/// Measure a policy, or the controller with constant gaits, on this machine.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  herd eval --policy runs/first/policy.safetensors      with the configuration that lies beside it
  herd eval --run-dir runs/first --episodes 100 --json
  herd eval --run-dir runs/first --untrained            what the run started from
  herd eval --task constant --set task.constant.velocity_mps=0.6 --set task.constant.stride_m=0.09
  herd eval --task constant --speeds 0.2,0.4,0.6,0.8,1.0
  herd eval --task constant --command 0.5,0,0.3 --command 0,0.2,0
  herd eval --run-dir runs/told --command 0.5,0.1,0.3   the command task's policy, told this all through
  herd eval --task constant --grid 3 --episodes 2       81 gaits over the action box
  herd eval --task constant --suite --out suite         how it fares on rough ground, under load, when pushed
  herd eval --run-dir runs/first --suite --beside constant --quick
A policy of another task is refused with exit code 78.")]
pub(crate) struct Args {
    /// Policy to evaluate.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["untrained", "speeds", "grid"])]
    policy: Option<PathBuf>,
    /// Take configuration and policy of this run.
    #[arg(long, value_name = "DIR")]
    run_dir: Option<PathBuf>,
    /// Task: short for --set task.kind=KIND.
    #[arg(long, value_name = "KIND", value_parser = ["gait", "torque", "constant", "command"])]
    task: Option<String>,
    /// Evaluate the policy that a run with this configuration and seed starts from.
    #[cfg(feature = "learner")]
    #[arg(long, conflicts_with_all = ["speeds", "grid"])]
    untrained: bool,
    /// Constant gaits of these speeds, m/s; the stride is speed × step.
    #[arg(long, value_name = "M/S", value_delimiter = ',', conflicts_with = "grid", allow_negative_numbers = true)]
    speeds: Vec<f64>,
    /// Tell the robot this velocity (forwards m/s, to the left m/s, turning left rad/s); may be repeated.
    #[arg(
        long = "command",
        value_name = "FORWARD,LEFT,YAW",
        value_parser = commands::parse,
        allow_hyphen_values = true,
        conflicts_with_all = ["speeds", "grid"]
    )]
    commands: Vec<Command>,
    /// Constant gaits on a grid of K points a dimension over the action box (velocity, stride, lift, step).
    #[arg(long, value_name = "K", value_parser = clap::value_parser!(u32).range(1..=6))]
    grid: Option<u32>,
    /// Episodes of each gait or policy.
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = clap::value_parser!(u64).range(1..=100_000))]
    episodes: u64,
    /// Episodes to run at once.
    #[arg(long, value_name = "N", default_value_t = 2, value_parser = clap::value_parser!(u32).range(1..=256))]
    threads: u32,
    #[command(flatten)]
    config: ConfigArgs,
    #[command(flatten)]
    suite: SuiteArgs,
    /// Print JSON: every episode, exact; of a suite every case.
    #[arg(long)]
    json: bool,
}

/// The options of the suite.
#[derive(clap::Args)]
struct SuiteArgs {
    /// Try slopes, bumps, steps, payload, little grip, noise, delay and pushes from all sides, and speeds for a gait.
    #[arg(long, conflicts_with_all = ["speeds", "grid", "commands"])]
    suite: bool,
    /// Suite: at most 4 episodes a case and 2 phases a push.
    #[arg(long, requires = "suite")]
    quick: bool,
    /// Suite: the constant gait of the configuration beside the policy.
    #[arg(long, requires = "suite", value_name = "WHAT", value_parser = ["constant"])]
    beside: Option<String>,
    /// Suite: write suite.json and pictures there.
    #[arg(long, requires = "suite", value_name = "DIR")]
    out: Option<PathBuf>,
}

/// `herd eval`
pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let config = load(args)?;
    if args.suite.suite {
        return suite::run(args, &config);
    }
    let cases = cases::of(args, &config)?;
    let root = Seed::from_number(config.seed);
    let seeds = (0..args.episodes).map(|index| root.child("evaluation", index)).collect::<Vec<_>>();
    let results = bench::run(&cases, &seeds, args.threads as usize)?;
    if args.json {
        return out::json(&view::Json::new(&config, &results));
    }
    out::print(&match args.grid {
        Some(_) => view::grid(&results),
        None if !args.commands.is_empty() => commands::table(&results),
        None if results.len() > 1 => view::sweep(&results),
        None => view::single(&results[0]),
    })
}

/// The configuration: the run's, or the file's, or the one beside the policy, with the overrides on top.
fn load(args: &Args) -> anyhow::Result<Config> {
    let wants_constant = !args.speeds.is_empty() || args.grid.is_some();
    let task = args.task.clone().or_else(|| wants_constant.then(|| "constant".to_owned()));
    if wants_constant && task.as_deref() != Some("constant") {
        return Err(Failure::usage("--speeds and --grid are for --task constant").into());
    }
    let mut config = args.config.clone();
    // The task first, so that --set has the last word.
    config.set.splice(0..0, task.map(|kind| format!("task.kind={kind}")));
    let beside = args.policy.as_ref().and_then(|file| file.parent());
    Ok(config.load(args.run_dir.as_deref().or(beside))?)
}
