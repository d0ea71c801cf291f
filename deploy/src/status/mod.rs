//! `herd status`: how training goes.

mod view;

use crate::args::LearnerArgs;
use crate::{ask, out};
use herd_common::status::Status;
use herd_proto::client;
use std::io::IsTerminal;

pub(crate) use view::render;
#[cfg(all(feature = "actor", feature = "learner"))]
pub(crate) use view::{endings, realtime_factor};

/// Show how a run goes.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  herd status                                    the learner on this machine
  herd status --run-dir runs/first --watch
  herd status --learner node-1:7447 --json | jq .returns.mean")]
pub(crate) struct Args {
    #[command(flatten)]
    learner: LearnerArgs,
    /// Show it again every second until the run ends.
    #[arg(long)]
    watch: bool,
    /// Print JSON, one line a snapshot.
    #[arg(long)]
    json: bool,
}

/// `herd status`
pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    if args.watch {
        return ask::block_on(watch(args));
    }
    let status = ask::block_on(async { ask::connect(&args.learner).await?.status().await })?;
    show(args, &status)
}

async fn watch(args: &Args) -> anyhow::Result<()> {
    let mut snapshots = ask::connect(&args.learner).await?.watch_status(PERIOD_SECS).await?;
    loop {
        match snapshots.next().await {
            Ok(Some(status)) => {
                if std::io::stdout().is_terminal() && !args.json {
                    out::print("\x1b[H\x1b[2J")?;
                }
                show(args, &status)?;
            }
            Ok(None) => return Ok(()),
            Err(error @ client::Error::Refused { code: tonic::Code::Unavailable | tonic::Code::Cancelled, .. }) => {
                tracing::warn!(%error, "the learner ended");
                return Ok(());
            }
            Err(error) => return Err(error.into()),
        }
    }
}

const PERIOD_SECS: f64 = 1.0;

fn show(args: &Args, status: &Status) -> anyhow::Result<()> {
    if args.json { out::json(status) } else { out::print(&render(status)) }
}
