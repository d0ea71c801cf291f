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
pub(crate) use summary::Run;
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
    #[command(flatten)]
    job: Job,
    /// Print the summary as JSON.
    #[arg(long)]
    json: bool,
}

/// One training: what to run, and where.
#[derive(clap::Args, Clone, Debug)]
pub(crate) struct Job {
    /// Where the run lies; a run that is there is continued.
    #[arg(long, value_name = "DIR")]
    pub(crate) run_dir: PathBuf,
    /// Actor processes to start.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=256))]
    pub(crate) actors: u32,
    /// Robots of each actor.
    #[arg(long, value_name = "M", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=256))]
    pub(crate) robots: u32,
    /// Episodes of the run: short for --set episodes=N.
    #[arg(long, value_name = "N")]
    pub(crate) episodes: Option<u64>,
    #[command(flatten)]
    pub(crate) config: ConfigArgs,
}

/// `herd train`
pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let job = &args.job;
    let (config, _) = job.effective()?;
    let done = episodes_done(&job.run_dir)?.filter(|done| *done >= config.episodes);
    // Of another run than the one that lies here nothing is complete: the learner refuses it by name.
    if let Some(done) = done.filter(|_| is_run_of(&job.run_dir, &config)) {
        return out::print(&summary::already_complete(&job.run_dir, done, config.episodes));
    }
    // One thread: the kernel ends our children when the thread that started them ends.
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().context("start the runtime")?;
    let run = runtime.block_on(async {
        let stop = shutdown::on_signal().context("watch for signals")?;
        train(job, &stop).await
    })?;
    summary::tell(&job.run_dir, &run, args.json)
}

/// Trains with processes of this machine until the run is complete or `stop` is cancelled, and shows how it goes.
///
/// The children end with the thread that this runs on.
pub(crate) async fn train(job: &Job, stop: &CancellationToken) -> anyhow::Result<Run> {
    let (config, sets) = job.effective()?;
    std::fs::create_dir_all(job.run_dir.join("logs")).context("make the directory of logs")?;
    let (learner_stop, actors_stop) = (CancellationToken::new(), CancellationToken::new());
    let mut learner = tokio::spawn(child::supervise(learner(job, &sets)?, learner_stop.clone()));
    let mut actors = JoinSet::new();
    for index in 0..job.actors {
        actors.spawn(child::supervise(actor(job, index)?, actors_stop.clone()));
    }
    let mut progress = progress::Progress::start(&job.run_dir, config.episodes);
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
    Ok(Run { status: last, done: episodes_done(&job.run_dir)?.unwrap_or(0), target: config.episodes })
}

impl Job {
    /// The configuration that it means, and all overrides of it.
    fn effective(&self) -> anyhow::Result<(Config, Vec<String>)> {
        let sets = with_episodes(&self.config, self.episodes);
        let config = wing::run::effective_config(Some(&self.run_dir), self.config.config.as_deref(), &sets);
        Ok((config.map_err(wing::told)?, sets))
    }
}

fn is_run_of(run_dir: &Path, config: &Config) -> bool {
    ConfigArgs::default().load(Some(run_dir)).is_ok_and(|stored| stored.run_name() == config.run_name())
}

fn episodes_done(run_dir: &Path) -> anyhow::Result<Option<u64>> {
    Ok(wing::run::peek(run_dir).map_err(wing::told)?.map(|progress| progress.episodes))
}

fn learner(job: &Job, sets: &[String]) -> anyhow::Result<Child> {
    let mut words = vec!["learner".into(), "--listen".into(), "127.0.0.1:0".into()];
    words.extend(["--run-dir".into(), job.run_dir.clone().into_os_string()]);
    if let Some(file) = &job.config.config {
        words.extend(["--config".into(), file.clone().into_os_string()]);
    }
    for set in sets {
        words.extend(["--set".into(), set.into()]);
    }
    Child::new("learner", words, &job.run_dir)
}

fn actor(job: &Job, index: u32) -> anyhow::Result<Child> {
    let mut address = std::ffi::OsString::from("file:");
    address.push(job.run_dir.join("address"));
    let words = vec!["actor".into(), "--learner".into(), address, "--robots".into(), job.robots.to_string().into()];
    Child::new(&format!("actor-{index}"), words, &job.run_dir)
}
