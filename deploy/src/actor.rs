//! `herd actor`: robots for a learner.

use crate::args::{ConfigArgs, DEFAULT_LEARNER};
use crate::out;
use anyhow::Context;
use herd_actor::run::{Ended, Options, run as run_actor};
use herd_common::shutdown;
use herd_proto::address::Address;

/// Run robots for a learner, until its run is complete. Waits for the learner for as long as it takes.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  herd actor --learner node-1:7447 --robots 8
  herd actor --learner file:/shared/runs/first/address     the learner writes this file, wherever it was put
  herd actor --learner node-1:7447 --config task.toml      exits with 78 if the learner trains another task")]
pub(crate) struct Args {
    /// HOST:PORT of the learner, or file:PATH of a file that holds it and is read again at every try.
    #[arg(long, value_name = "ADDRESS", default_value = DEFAULT_LEARNER)]
    learner: Address,
    /// Robots to simulate at once, each on a thread of its own.
    #[arg(long, value_name = "N", default_value_t = 1)]
    robots: u32,
    #[command(flatten)]
    config: ConfigArgs,
}

/// `herd actor`
pub(crate) fn run(args: Args) -> anyhow::Result<()> {
    let task = (!args.config.is_empty()).then(|| args.config.load(None)).transpose()?;
    let options = Options { learner: args.learner, robots: args.robots, task };
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().context("start the runtime")?;
    let ended = runtime.block_on(async {
        let shutdown = shutdown::on_signal().context("watch for signals")?;
        run_actor(options, shutdown).await.map_err(anyhow::Error::from)
    })?;
    out::print(match ended {
        Ended::Complete => "the run is complete",
        Ended::Stopped => "stopped",
    })
}
