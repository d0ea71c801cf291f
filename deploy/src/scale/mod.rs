//! `herd scale`: how far one learner goes, measured with more and more actors, and what stops it there.

mod bottleneck;
mod cpu;
mod figures;
mod load;
mod meter;
mod model;
mod path;
mod payload;
mod point;
mod view;

use crate::args::ConfigArgs;
use crate::exit::Failure;
use crate::out;
use anyhow::Context;
use figures::Figures;
use herd_common::caps;
use herd_common::config::Config;
use herd_common::config::run::Order;
use point::{Method, Synthetic};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Measure a learner with more and more actors, and name what limits it.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  herd scale --run-dir runs/scale --actors 1,2,4 --secs 30
  herd scale --run-dir runs/ingest --synthetic --deaf --actors 1,10,100 --robots 2    take in as much as goes
  herd scale --run-dir runs/waves --synthetic --actors 10,100 --pace 2                the way of a policy
  herd scale --run-dir runs/learn --synthetic --set ddpg.updates_per_transition=1     with updates
  herd scale --model --model-updates 70 --model-ingest 250000                         up to 100,000 robots, on paper
Writes scale.json and scale.svg into the run directory. Synthetic actors speak the whole protocol and simulate nothing;
they share this machine with the learner. Evaluations are off; with synthetic actors updates are off too, the order is
throughput and schedule.lag is wide, unless --set says otherwise.")]
pub(crate) struct Args {
    /// Where the measured runs and the report lie.
    #[arg(long, value_name = "DIR", required_unless_present = "model")]
    run_dir: Option<PathBuf>,
    /// Numbers of actors to measure with.
    #[arg(long, value_name = "N,N,…", value_delimiter = ',', default_values_t = [1, 2, 4],
          value_parser = clap::value_parser!(u32).range(1..=caps::ACTORS as i64))]
    actors: Vec<u32>,
    /// Robots of each actor.
    #[arg(long, value_name = "M", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=256))]
    robots: u32,
    /// How long to measure at each number, s.
    #[arg(long, value_name = "SECONDS", default_value_t = 20.0, value_parser = crate::ask::positive)]
    secs: f64,
    /// How long to wait before that, s.
    #[arg(long, value_name = "SECONDS", default_value_t = 5.0, value_parser = crate::ask::positive)]
    warmup: f64,
    #[command(flatten)]
    load: LoadArgs,
    #[command(flatten)]
    config: ConfigArgs,
    /// Keep the run of each point.
    #[arg(long)]
    keep: bool,
    #[command(flatten)]
    paper: ModelArgs,
    /// Print JSON: every figure of every point.
    #[arg(long)]
    json: bool,
}

/// Actors without physics.
#[derive(clap::Args)]
struct LoadArgs {
    /// Actors without physics, as connections of this process.
    #[arg(long)]
    synthetic: bool,
    /// Transitions of a synthetic episode.
    #[arg(long, value_name = "N", default_value_t = 100, requires = "synthetic",
          value_parser = clap::value_parser!(u32).range(1..=caps::TRANSITIONS_PER_EPISODE as i64))]
    decisions: u32,
    /// Transitions of a synthetic message; real actors send up to 32.
    #[arg(long, value_name = "N", default_value_t = 32, requires = "synthetic",
          value_parser = clap::value_parser!(u32).range(1..=caps::TRANSITIONS_PER_MESSAGE as i64))]
    piece: u32,
    /// Synthetic actors do not follow the policies.
    #[arg(long, requires = "synthetic")]
    deaf: bool,
    /// Episodes per second of all synthetic actors together; as many as go without it.
    #[arg(long, value_name = "RATE", requires = "synthetic", value_parser = rate)]
    pace: Option<f64>,
}

/// The model.
#[derive(clap::Args)]
struct ModelArgs {
    /// Measure nothing: print what a queueing model predicts for up to 100,000 robots.
    #[arg(long, conflicts_with_all = ["run_dir", "synthetic", "json"])]
    model: bool,
    /// Updates per second that the model goes by.
    #[arg(long, value_name = "RATE", default_value_t = 370.0, value_parser = rate)]
    model_updates: f64,
    /// Durable transitions per second that the model goes by.
    #[arg(long, value_name = "RATE", default_value_t = 650_000.0, value_parser = rate)]
    model_ingest: f64,
}

/// Episodes of a measured run: it never gets there.
const EPISODES: u64 = 1_000_000_000;

/// `herd scale`
pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let Some(run_dir) = &args.run_dir else {
        let measured =
            path::Measured { updates_per_sec: args.paper.model_updates, ingest_per_sec: args.paper.model_ingest };
        return out::print(&path::table(measured));
    };
    std::fs::create_dir_all(run_dir).with_context(|| format!("make {}", run_dir.display()))?;
    // One thread: the kernel ends our children when the thread that started them ends.
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().context("start the runtime")?;
    let mut points = Vec::new();
    for (index, &actors) in args.actors.iter().enumerate() {
        let method = method(args, run_dir, actors)?;
        let round = args.actors[..=index].iter().filter(|other| **other == actors).count() as u32;
        let figures = runtime.block_on(point::measure(&method, actors, round))?;
        if !args.json {
            let name = figures.setting.name();
            eprintln!("{name} actors: {:.0} transitions/s; {}", figures.transitions_per_sec, figures.bottleneck);
        }
        points.push(figures);
    }
    report(run_dir, &points, args.json)
}

fn report(run_dir: &Path, points: &[Figures], as_json: bool) -> anyhow::Result<()> {
    let value = serde_json::json!({ "points": points });
    let (json, svg) = (run_dir.join("scale.json"), run_dir.join("scale.svg"));
    let text = serde_json::to_string_pretty(&value)? + "\n";
    std::fs::write(&json, text).with_context(|| format!("write {}", json.display()))?;
    std::fs::write(&svg, view::plot(points)).with_context(|| format!("write {}", svg.display()))?;
    if as_json {
        return out::json(&value);
    }
    out::print(&format!("{}\n{}\n{}", view::table(points), json.display(), svg.display()))
}

fn method(args: &Args, run_dir: &Path, actors: u32) -> anyhow::Result<Method> {
    let sets = sets(args, actors);
    let config = Config::load(args.config.config.as_deref(), &sets)?;
    if args.load.synthetic && u64::from(actors) * u64::from(args.robots) > 4 * config.schedule.lag {
        tracing::warn!(lag = config.schedule.lag, "the schedule keeps most synthetic actors waiting");
    }
    if args.load.synthetic && actors > 1 && config.schedule.order == Order::Deterministic {
        let told = "--synthetic with several actors needs --set schedule.order=throughput: in deterministic order those \
                    that are done wait for the episodes of those that have stopped";
        return Err(Failure::usage(told).into());
    }
    if args.load.pace.is_some_and(|pace| f64::from(actors) / pace > 86_400.0) {
        return Err(Failure::usage("--pace is less than an episode a day for each actor").into());
    }
    let synthetic = Synthetic {
        decisions: args.load.decisions as usize,
        piece: args.load.piece as usize,
        deaf: args.load.deaf,
        pace: args.load.pace,
    };
    Ok(Method {
        run_dir: run_dir.to_owned(),
        sets,
        config,
        config_file: args.config.config.clone(),
        robots: args.robots,
        window: Duration::from_secs_f64(args.secs),
        warmup: Duration::from_secs_f64(args.warmup),
        synthetic: args.load.synthetic.then_some(synthetic),
        keep: args.keep,
    })
}

fn rate(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(rate) if (1e-3..=1e9).contains(&rate) => Ok(rate),
        _ => Err("expected a rate a second, 0.001 to 1000000000".to_owned()),
    }
}

/// What a measured run is configured with; the user's words come last and win.
fn sets(args: &Args, actors: u32) -> Vec<String> {
    let mut sets = vec![format!("episodes={EPISODES}"), "evaluation.every_episodes=0".to_owned()];
    if args.load.synthetic {
        // Wide enough that no actor waits for a lease while its last episodes wait for the disk.
        let lag = (4 * u64::from(actors) * u64::from(args.robots)).clamp(16, 4096);
        sets.push(format!("schedule.lag={lag}"));
        sets.extend(["schedule.order=throughput", "ddpg.updates_per_transition=0"].map(str::to_owned));
        sets.push("history.checkpoint_episodes=1000000".to_owned());
    } else {
        // Learning begins at once, so that the first window sees it.
        sets.extend(["ddpg.warmup_transitions=100", "exploration.warmup_episodes=0"].map(str::to_owned));
    }
    sets.extend(args.config.sets());
    sets
}
