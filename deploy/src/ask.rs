//! Commands that ask the learner one thing: `checkpoint`, `stop`, `wait-ready`.

use crate::args::LearnerArgs;
use crate::exit::Failure;
use crate::{out, table};
use anyhow::Context;
use herd_common::caps;
use herd_proto::client::{self, Client};
use std::future::Future;
use std::time::Duration;

/// Write a checkpoint now.
#[derive(clap::Args)]
#[command(
    after_help = "Examples:\n  herd checkpoint --run-dir runs/first\n  herd checkpoint --learner node-1:7447 --json"
)]
pub(crate) struct CheckpointArgs {
    #[command(flatten)]
    learner: LearnerArgs,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

/// Write a checkpoint and end the learner; starting it again continues the run.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  herd stop --run-dir runs/first\n  herd stop --learner node-1:7447")]
pub(crate) struct StopArgs {
    #[command(flatten)]
    learner: LearnerArgs,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

/// Wait until the learner serves, for scripts and engines; exits with 75 when it does not in time.
#[derive(clap::Args)]
#[command(
    after_help = "Examples:\n  herd wait-ready --run-dir runs/first --timeout 60 && herd status --run-dir runs/first"
)]
pub(crate) struct WaitReadyArgs {
    #[command(flatten)]
    learner: LearnerArgs,
    /// How long to wait, s.
    #[arg(long, value_name = "SECONDS", default_value_t = 60.0, value_parser = positive)]
    timeout: f64,
}

/// `herd checkpoint`
pub(crate) fn checkpoint(args: &CheckpointArgs) -> anyhow::Result<()> {
    let (episodes, file) = block_on(async { connect(&args.learner).await?.checkpoint().await })?;
    if args.json {
        return out::json(&serde_json::json!({ "episodes": episodes, "file": file }));
    }
    out::print(&format!("checkpoint of {} episodes: {file}", table::count(episodes)))
}

/// `herd stop`
pub(crate) fn stop(args: &StopArgs) -> anyhow::Result<()> {
    let episodes = block_on(async { connect(&args.learner).await?.stop().await })?;
    if args.json {
        return out::json(&serde_json::json!({ "episodes": episodes }));
    }
    out::print(&format!("stopped after {} episodes", table::count(episodes)))
}

/// `herd wait-ready`
pub(crate) fn wait_ready(args: &WaitReadyArgs) -> anyhow::Result<()> {
    let address = args.learner.address();
    let answered = async {
        loop {
            let status = async { connect(&args.learner).await?.status().await };
            match status.await {
                Ok(status) => return Ok(status),
                Err(error) if error.is_transient() => tokio::time::sleep(caps::RECONNECT_PAUSE.0).await,
                Err(error) => return Err(error),
            }
        }
    };
    let timeout = Duration::from_secs_f64(args.timeout);
    let status = block_on(async {
        let late = |_| Failure::retry(format!("no learner answers at {address} within {} s", args.timeout));
        Ok::<_, anyhow::Error>(tokio::time::timeout(timeout, answered).await.map_err(late)??)
    })?;
    out::print(&format!("ready: {} of {} episodes", status.episodes, status.episodes_target))
}

/// Connects to the learner that these options mean.
pub(crate) async fn connect(learner: &LearnerArgs) -> Result<Client, client::Error> {
    Client::connect(&learner.address().resolve()?).await
}

/// Runs a future on this thread.
pub(crate) fn block_on<T, E: Into<anyhow::Error>>(future: impl Future<Output = Result<T, E>>) -> anyhow::Result<T> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().context("start the runtime")?;
    runtime.block_on(future).map_err(Into::into)
}

/// Seconds or the like from a command line.
pub(crate) fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(secs) if secs > 0.0 && secs <= 1e6 => Ok(secs),
        _ => Err("expected seconds, more than 0 and at most 1000000".to_owned()),
    }
}
