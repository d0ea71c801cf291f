//! `herd learner`: owns a run, trains, serves actors and operators.

use crate::args::{ConfigArgs, DEFAULT_LEARNER};
use crate::wing::run::{Ended, Options, run as run_learner};
use crate::{out, wing};
use anyhow::Context;
use herd_common::shutdown;
use std::net::SocketAddr;
use std::path::PathBuf;

/// Run the learner of a run; takes the run up where it stopped.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  herd learner --run-dir runs/first
  herd learner --run-dir runs/first --episodes 2000          a run may be made longer
  herd learner --run-dir runs/big --listen 0.0.0.0:7447 --insecure
The address is written to DIR/address, for actors with --learner file:DIR/address.")]
pub(crate) struct Args {
    /// Where the run lies: configuration, journal, checkpoints, policy, metrics.
    #[arg(long, value_name = "DIR")]
    run_dir: PathBuf,
    /// Where to listen; port 0 takes a free one.
    #[arg(long, value_name = "ADDRESS", default_value = DEFAULT_LEARNER)]
    listen: SocketAddr,
    /// Allow an address that other machines can reach: there is no encryption and no password.
    #[arg(long)]
    insecure: bool,
    /// Episodes of the run: short for --set episodes=N.
    #[arg(long, value_name = "N")]
    episodes: Option<u64>,
    #[command(flatten)]
    config: ConfigArgs,
}

/// `herd learner`
pub(crate) fn run(args: Args) -> anyhow::Result<()> {
    let sets = with_episodes(&args.config, args.episodes);
    let Args { run_dir, listen, insecure, config, .. } = args;
    let options = Options { run_dir, config_file: config.config, sets, listen, insecure };
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(SERVICE_THREADS).enable_all().build();
    let ended = runtime.context("start the runtime")?.block_on(async {
        let shutdown = shutdown::on_signal().context("watch for signals")?;
        run_learner(options, shutdown).await.map_err(wing::told)
    })?;
    out::print(match ended {
        Ended::Complete => "the run is complete",
        Ended::Stopped => "stopped; starting it again continues the run",
    })
}

/// Threads that serve the network; training has one of its own.
const SERVICE_THREADS: usize = 2;

/// All overrides as `key=value`.
pub(crate) fn with_episodes(config: &ConfigArgs, episodes: Option<u64>) -> Vec<String> {
    let mut sets = config.sets();
    sets.extend(episodes.map(|n| format!("episodes={n}")));
    sets
}
