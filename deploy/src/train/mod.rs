//! `herd train`: a learner and its actors on this machine, watched over until the run is over.

pub(crate) mod child;
mod progress;
mod summary;

use crate::args::ConfigArgs;
use crate::learner::with_episodes;
use crate::{out, wing};
use anyhow::Context;
use child::{Child, End};
use herd_common::config::Config;
use herd_common::shutdown;
use std::path::{Path, PathBuf};
use tokio::task::JoinSet;
use tokio_util::sync::CancellationToken;

/// Train on this machine: one learner, N actors, progress as it happens. Takes a run up where it stopped.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  herd train --actors 2 --run-dir runs/first --episodes 200
  herd train --actors 2 --run-dir runs/first --episodes 500      the same run, made longer
  herd train --actors 2 --run-dir runs/torque --set task.kind=torque --seed 7
Logs of the parts are in DIR/logs.")]
pub(crate) struct Args {
    /// Where the run lies; a run that is there is continued.
    #[arg(long, value_name = "DIR")]
    run_dir: PathBuf,
    /// Actor processes to start.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=256))]
    actors: u32,
    /// Robots of each actor.
    #[arg(long, value_name = "M", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=256))]
    robots: u32,
    /// Episodes of the run: short for --set episodes=N.
    #[arg(long, value_name = "N")]
    episodes: Option<u64>,
    #[command(flatten)]
    config: ConfigArgs,
    /// Print the summary as JSON.
    #[arg(long)]
    json: bool,
}

/// `herd train`
pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let sets = with_episodes(&args.config, args.episodes);
    let config = wing::run::effective_config(Some(&args.run_dir), args.config.config.as_deref(), &sets);
    let config = config.map_err(wing::told)?;
    let done = episodes_done(&args.run_dir)?.filter(|done| *done >= config.episodes);
    // Of another run than the one that lies here nothing is complete: the learner refuses it by name.
    if let Some(done) = done.filter(|_| is_run_of(&args.run_dir, &config)) {
        return out::print(&summary::already_complete(&args.run_dir, done, config.episodes));
    }
    std::fs::create_dir_all(args.run_dir.join("logs")).context("make the directory of logs")?;
    // One thread: the kernel ends our children when the thread that started them ends.
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().context("start the runtime")?;
    runtime.block_on(train(args, &config, &sets))
}

async fn train(args: &Args, config: &Config, sets: &[String]) -> anyhow::Result<()> {
    let stop = shutdown::on_signal().context("watch for signals")?;
    let (learner_stop, actors_stop) = (CancellationToken::new(), CancellationToken::new());
    let mut learner = tokio::spawn(child::supervise(learner(args, sets)?, learner_stop.clone()));
    let mut actors = JoinSet::new();
    for index in 0..args.actors {
        actors.spawn(child::supervise(actor(args, index)?, actors_stop.clone()));
    }
    let mut progress = progress::Progress::start(&args.run_dir, config.episodes);
    let ended = loop {
        tokio::select! {
            ended = &mut learner => break ended.context("watch the learner")?,
            Some(ended) = actors.join_next() => if let Err(error) = ended.context("watch an actor")? {
                break Err(error);
            },
            () = stop.cancelled() => break Ok(End::Stopped),
            () = progress.advance() => {}
        }
    };
    let last = progress.finish();
    // Actors leave first, so that their streams are not torn from under them; then the learner writes its checkpoint.
    actors_stop.cancel();
    while actors.join_next().await.is_some() {}
    learner_stop.cancel();
    if !learner.is_finished() {
        learner.await.context("watch the learner")??;
    }
    ended?;
    let done = episodes_done(&args.run_dir)?.unwrap_or(0);
    summary::tell(&args.run_dir, &summary::Run { status: last, done, target: config.episodes }, args.json)
}

fn is_run_of(run_dir: &Path, config: &Config) -> bool {
    ConfigArgs::default().load(Some(run_dir)).is_ok_and(|stored| stored.run_name() == config.run_name())
}

fn episodes_done(run_dir: &Path) -> anyhow::Result<Option<u64>> {
    Ok(wing::run::peek(run_dir).map_err(wing::told)?.map(|progress| progress.episodes))
}

fn learner(args: &Args, sets: &[String]) -> anyhow::Result<Child> {
    let mut words = vec!["learner".into(), "--listen".into(), "127.0.0.1:0".into()];
    words.extend(["--run-dir".into(), args.run_dir.clone().into_os_string()]);
    if let Some(file) = &args.config.config {
        words.extend(["--config".into(), file.clone().into_os_string()]);
    }
    for set in sets {
        words.extend(["--set".into(), set.into()]);
    }
    Child::new("learner", words, &args.run_dir)
}

fn actor(args: &Args, index: u32) -> anyhow::Result<Child> {
    let mut address = std::ffi::OsString::from("file:");
    address.push(args.run_dir.join("address"));
    let words = vec!["actor".into(), "--learner".into(), address, "--robots".into(), args.robots.to_string().into()];
    Child::new(&format!("actor-{index}"), words, &args.run_dir)
}
