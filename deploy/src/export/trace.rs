//! `herd export trace`: an episode as JSON lines, or torques of one replayed without feedback.

use crate::exit::Failure;
use crate::walker::{self, WalkerArgs};
use anyhow::Context;
use herd_actor::env::Observation;
use herd_actor::robot::{GRAVITY, Model};
use herd_actor::sim::Snapshot;
use herd_actor::trace::{self, Record};
use herd_common::config::Config;
use herd_common::episode::Outcome;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Write an episode tick by tick as JSON lines: header, start, ticks, outcome.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  herd export trace --task constant --set task.episode_secs=2 --out trot.jsonl
  herd export trace --run-dir runs/first --episode 3 > episode.jsonl
  herd export trace --replay trot.jsonl --at 1.05 --secs 0.5                  its torques, without feedback
  herd export trace --replay trot.jsonl --set sim.tick_secs=0.0001            the same in finer steps
A tick holds t (s, after it), the decision it belongs to, joint torques over it (N·m, FL FR RL RR, each hip roll, hip
pitch, knee) and the robot after it: world frame, quaternion w x y z, forces are means over the tick, feet tells which are
on the ground at its end.")]
pub(crate) struct Args {
    #[command(flatten)]
    walker: WalkerArgs,
    /// Replay the torques of this trace from one of its states on, each held as long as there.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["policy", "run_dir", "task", "episode"])]
    replay: Option<PathBuf>,
    /// Where in the trace to begin, s.
    #[arg(long, value_name = "SECS", default_value_t = 0.0, requires = "replay")]
    at: f64,
    /// How long to replay, s; to the end of the trace without it.
    #[arg(long, value_name = "SECS", requires = "replay")]
    secs: Option<f64>,
    /// File to write; standard output without it.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

/// One line of a trace.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Line {
    Header(Header),
    Start(Snapshot),
    Tick(Tick),
    Outcome(Outcome),
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Header {
    task_hash: String,
    seed: u64,
    episode: u64,
    /// Time from line to line, s.
    tick_secs: f64,
    /// The simulator's own, s.
    sim_tick_secs: f64,
    sim_substeps: usize,
    weight_n: f64,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Tick {
    t: f64,
    decision: u64,
    torques: [f64; 12],
    after: Snapshot,
}

pub(super) fn run(args: &Args) -> anyhow::Result<()> {
    let config = args.walker.load()?;
    let lines = match &args.replay {
        Some(file) => replay(&config, file, args.at, args.secs)?,
        None => record(args, &config)?,
    };
    let lines = lines.iter().map(serde_json::to_string).collect::<Result<Vec<_>, _>>()?;
    super::write(args.out.as_ref(), &(lines.join("\n") + "\n"))
}

fn record(args: &Args, config: &Config) -> anyhow::Result<Vec<Line>> {
    let policy = args.walker.policy(config)?;
    if policy.is_none() && config.task.kind != herd_common::spaces::Task::Constant {
        let task = config.task.kind.name();
        return Err(Failure::usage(format!("the {task} task needs --policy or --run-dir, or --task constant")).into());
    }
    let (episode, seed) = args.walker.episode(config);
    let mut act = |observation: &Observation| policy.as_ref().map_or_else(Vec::new, |policy| policy.act(observation));
    let trace = trace::record(config, seed, &mut act);
    let tick_secs = config.sim.tick_secs;
    let mut lines = vec![Line::Header(header(config, episode, tick_secs)), Line::Start(trace.start)];
    lines.extend(ticks(trace.ticks, 0, tick_secs));
    lines.push(Line::Outcome(trace.outcome));
    Ok(lines)
}

fn replay(config: &Config, file: &Path, at: f64, secs: Option<f64>) -> anyhow::Result<Vec<Line>> {
    walker::expect_level(config)?;
    let text =
        std::fs::read_to_string(file).map_err(|e| Failure::usage(format!("read trace {}: {e}", file.display())))?;
    let (held, start, recorded) = read(&text).with_context(|| format!("read trace {}", file.display()))?;
    let hold_ticks = (held.tick_secs / config.sim.tick_secs).round();
    if hold_ticks < 1.0 || (hold_ticks * config.sim.tick_secs - held.tick_secs).abs() > 1e-9 {
        let text =
            format!("sim.tick_secs is {}, expected a part of the trace's {}", config.sim.tick_secs, held.tick_secs);
        return Err(Failure::usage(text).into());
    }
    let index = |secs: f64| (secs / held.tick_secs).round().max(0.0) as usize;
    let (first, count) = (index(at), secs.map_or(recorded.len(), index));
    let last = first.saturating_add(count).min(recorded.len());
    if first >= last {
        let length = recorded.len() as f64 * held.tick_secs;
        return Err(Failure::usage(format!("--at is {at} s, expected a moment of the trace's {length:.3} s")).into());
    }
    let start = if first == 0 { start } else { recorded[first - 1].after };
    let torques: Vec<_> = recorded[first..last].iter().map(|tick| tick.torques).collect();
    let again = trace::replay(config, &start, &torques, hold_ticks as u32);
    let numbered = again.into_iter().zip(&recorded[first..]).map(|(record, tick)| (tick.decision, record));
    let mut lines = vec![Line::Header(header(config, held.episode, held.tick_secs)), Line::Start(start)];
    lines.extend(ticks(numbered, first, held.tick_secs));
    Ok(lines)
}

fn header(config: &Config, episode: u64, tick_secs: f64) -> Header {
    Header {
        task_hash: config.task_hash(),
        seed: config.seed,
        episode,
        tick_secs,
        sim_tick_secs: config.sim.tick_secs,
        sim_substeps: config.sim.substeps,
        weight_n: Model::new(&config.robot).mass() * GRAVITY,
    }
}

/// Lines of these ticks, the first of which is the `first`-th of its trace.
fn ticks(records: impl IntoIterator<Item = (u64, Record)>, first: usize, secs: f64) -> impl Iterator<Item = Line> {
    records.into_iter().enumerate().map(move |(i, (decision, record))| {
        let t = (first + i + 1) as f64 * secs;
        Line::Tick(Tick { t, decision, torques: record.torques, after: record.after })
    })
}

/// Header, start and ticks of a trace.
fn read(text: &str) -> anyhow::Result<(Header, Snapshot, Vec<Tick>)> {
    let (mut header, mut start, mut ticks) = (None, None, Vec::new());
    for (i, line) in text.lines().enumerate() {
        match serde_json::from_str(line).map_err(|e| Failure::config(format!("line {}: {e}", i + 1)))? {
            Line::Header(found) => header = Some(found),
            Line::Start(found) => start = Some(found),
            Line::Tick(found) => ticks.push(found),
            Line::Outcome(_) => {}
        }
    }
    let missing = || Failure::config("a trace begins with a header and a start");
    Ok((header.ok_or_else(missing)?, start.ok_or_else(missing)?, ticks))
}
