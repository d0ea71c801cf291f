//! `herd export`: the robot, a policy, an episode, for other programs.

mod mjcf;
#[cfg(feature = "learner")]
mod policy;
mod trace;

use crate::out;
use anyhow::Context;
use std::path::{Path, PathBuf};

/// Write the robot, a policy or an episode in a form that other programs read.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  herd export mjcf --out robot.xml                               the robot and its ground for MuJoCo
  herd export policy --run-dir runs/first --out policy.onnx      and policy.golden.json beside it
  herd export trace --task constant --set task.episode_secs=2 --out trot.jsonl
  herd export trace --replay trot.jsonl --at 1.05 --secs 0.5 --set sim.tick_secs=0.0001")]
pub(crate) struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(clap::Subcommand)]
enum What {
    Mjcf(mjcf::Args),
    #[cfg(feature = "learner")]
    Policy(policy::Args),
    Trace(trace::Args),
}

/// `herd export`
pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    match &args.what {
        What::Mjcf(args) => mjcf::run(args),
        #[cfg(feature = "learner")]
        What::Policy(args) => policy::run(args),
        What::Trace(args) => trace::run(args),
    }
}

/// Writes a text to a file, or to standard output without one.
fn write(file: Option<&PathBuf>, text: &str) -> anyhow::Result<()> {
    file.map_or_else(|| out::print(text), |file| write_bytes(file, text.as_bytes()))
}

fn write_bytes(file: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    std::fs::write(file, bytes).with_context(|| format!("write {}", file.display()))
}
