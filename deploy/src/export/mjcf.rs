//! `herd export mjcf`: the robot and level ground for MuJoCo.

use crate::args::ConfigArgs;
use herd_actor::robot::{Model, mjcf};
use std::path::PathBuf;

/// Write the robot and level ground as MJCF, MuJoCo's model format.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  herd export mjcf > robot.xml
  herd export mjcf --run-dir runs/first --out robot.xml          the robot of that run
  herd export mjcf --set robot.trunk_mass_kg=14 --set sim.ground_friction=0.3
Torques go in at the motors (N·m, within the joints' limits); the model steps 0.1 ms with RK4.")]
pub(crate) struct Args {
    /// Take the configuration of this run.
    #[arg(long, value_name = "DIR")]
    run_dir: Option<PathBuf>,
    #[command(flatten)]
    config: ConfigArgs,
    /// File to write; standard output without it.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

pub(super) fn run(args: &Args) -> anyhow::Result<()> {
    let config = args.config.load(args.run_dir.as_deref())?;
    super::write(args.out.as_ref(), &mjcf(&Model::new(&config.robot), &config.sim))
}
