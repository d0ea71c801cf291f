//! `herd reproduce`: the paper's experiment, from training through the service to a report. Every step that is done is
//! kept, so the same command goes on where it stopped.

mod ablations;
mod against;
mod beyond;
mod budget;
mod claims;
mod course;
mod curves;
mod figures;
mod gather;
mod html;
mod measure;
mod place;
mod play;
mod report;
mod search;
mod seek;
mod settings;
mod steps;
mod store;
mod strips;
mod subject;
mod training;

use crate::out;
use anyhow::Context;
use course::Course;
use herd_common::shutdown;
use settings::Settings;
use std::path::PathBuf;
use std::time::Instant;
use tokio_util::sync::CancellationToken;

/// Repeat the paper's experiment and report how its claims fare. Takes up where it stopped.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  herd reproduce --run-dir runs/paper --quick          seven minutes on two cores
  herd reproduce --run-dir runs/paper-full             half an hour
  herd reproduce --run-dir runs/paper-full --ablations what each part of the learner does, twenty minutes more
  herd reproduce --run-dir runs/paper-full --stages report
The report is DIR/report/index.html, its figures lie beside it as SVG and PNG, its numbers in report.json.")]
pub(crate) struct Args {
    /// Where trainings, results and report lie; what is there is taken up.
    #[arg(long, value_name = "DIR")]
    run_dir: PathBuf,
    /// The small version: fewer episodes to train, search and evaluate.
    #[arg(long)]
    quick: bool,
    /// Seeds of the trainings.
    #[arg(long, value_name = "SEEDS", value_delimiter = ',', default_values_t = [1, 2, 3])]
    seeds: Vec<u64>,
    /// Episodes of each gait training [default: 400, or 120 with --quick]; torque trainings get as many transitions.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=1_000_000))]
    episodes: Option<u64>,
    /// Episodes of each evaluation [default: 50, or 10 with --quick].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=100_000))]
    evaluation_episodes: Option<u64>,
    /// Episodes of each training on rough ground [default: twice --episodes, or as many with --quick].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=1_000_000))]
    rough_episodes: Option<u64>,
    /// Episodes whose time may go into the search on flat ground [default: as many as a gait training has].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=1_000_000))]
    search_episodes: Option<u64>,
    /// Actor processes of each training, and threads of search and evaluation.
    #[arg(long, value_name = "N", default_value_t = 2, value_parser = clap::value_parser!(u32).range(1..=256))]
    actors: u32,
    /// What to do, in this order whatever the order here.
    #[arg(long, value_name = "STAGES", value_delimiter = ',', value_enum,
          default_values_t = [
              Stage::Gait, Stage::Torque, Stage::Constant, Stage::Evaluation, Stage::Rough, Stage::Report,
          ])]
    stages: Vec<Stage>,
    /// Train what the learner is made of, part by part, too: short for adding it to --stages.
    #[arg(long)]
    ablations: bool,
    /// Seeds of the ablations [default: the first of --seeds].
    #[arg(long, value_name = "SEEDS", value_delimiter = ',')]
    ablation_seeds: Option<Vec<u64>>,
    /// TOML file whose keys override the default configuration, for all trainings.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Override one key for all trainings. May be repeated.
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
}

/// A part of the experiment.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, clap::ValueEnum)]
pub(crate) enum Stage {
    /// Train Group_1.
    Gait,
    /// Train Group_0, after Group_1.
    Torque,
    /// Search the best constant gait.
    Constant,
    /// Measure what was trained and found on flat ground.
    Evaluation,
    /// Train Group_1 on slopes, under load, with little grip and pushed; search a constant gait for that; measure both.
    Rough,
    /// Train and measure what lacks a part.
    Ablations,
    /// Write the report.
    Report,
}

/// `herd reproduce`
pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let settings = Settings::new(args)?;
    // One thread: the kernel ends the children of a training when the thread that started them ends.
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().context("start the runtime")?;
    runtime.block_on(async {
        let stop = shutdown::on_signal().context("watch for signals")?;
        match all(&settings, &stop).await {
            Err(error) if stop.is_cancelled() => {
                out::print(&format!("{error:#}\nstopped; the same command goes on from here"))
            }
            ended => ended,
        }
    })
}

async fn all(settings: &Settings, stop: &CancellationToken) -> anyhow::Result<()> {
    let steps = steps::of(settings)?;
    let mut expected = Vec::new();
    for step in &steps {
        expected.push(if step.is_done(settings)? { 0.0 } else { step.expected_secs(settings) });
    }
    let course = Course::new(expected);
    #[expect(clippy::disallowed_methods, reason = "progress for people")]
    let start = Instant::now();
    for (index, step) in steps.iter().enumerate() {
        eprintln!("{}", course.headline(index, &step.name(), start.elapsed().as_secs_f64()));
        step.run(settings, stop).await?;
    }
    out::print(&report::farewell(settings)?)
}
