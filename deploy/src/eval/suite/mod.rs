//! `herd eval --suite`: how a policy or a gait fares when the world is not what it expects.
//!
//! `conditions` says what is tried, `measure` runs it, `interval` bounds what chance did; `view` tells it, `panels` and
//! `push_map` draw it.

mod conditions;
mod interval;
mod measure;
mod panels;
mod push_map;
mod view;

use super::cases::{self, Case};
use super::{Args, SuiteArgs};
use crate::exit::Failure;
use crate::meter::Meter;
use crate::out;
use anyhow::Context;
use herd_common::config::{Config, scenario, task};
use herd_common::seed::Seed;
use herd_common::spaces::Task;
use measure::{Effort, Findings};
use serde::Serialize;
use std::path::Path;

/// Episodes of a case under `--quick`, at most.
const QUICK_EPISODES: u64 = 4;

/// Everything that was found, exact; equal suites give equal bytes.
#[derive(Serialize)]
struct Report {
    task_hash: String,
    seed: u64,
    subjects: Vec<Findings>,
}

/// Runs the suite and shows it.
pub(super) fn run(args: &Args, config: &Config) -> anyhow::Result<()> {
    let subjects = subjects(args, config)?;
    let SuiteArgs { quick, out, .. } = &args.suite;
    let episodes = if *quick { args.episodes.min(QUICK_EPISODES) } else { args.episodes };
    let effort = Effort { episodes, quick: *quick, threads: args.threads as usize };
    let found =
        measure::run(&subjects, Seed::from_number(config.seed), effort, &|total| Meter::new("episodes", total))?;
    let report = Report { task_hash: config.task_hash(), seed: config.seed, subjects: found };
    if let Some(directory) = out {
        write(&report, directory).with_context(|| format!("write the suite to {}", directory.display()))?;
    }
    if args.json {
        return out::json(&report);
    }
    out::print(&report.subjects.iter().map(view::subject).collect::<Vec<_>>().join("\n"))
}

/// What is to be evaluated, on plain ground.
fn subjects(args: &Args, config: &Config) -> anyhow::Result<Vec<Case>> {
    let mut subjects = cases::of(args, config)?;
    if args.suite.beside.is_some() {
        if config.task.kind == Task::Constant {
            return Err(Failure::usage("--beside constant compares a policy with the constant gait").into());
        }
        let task = task::Config { kind: Task::Constant, ..config.task.clone() };
        subjects.extend(cases::of_gaits(&Config { task, ..config.clone() }, &[config.task.constant])?);
    }
    for subject in &mut subjects {
        subject.config.scenario = scenario::Config::plain();
    }
    Ok(subjects)
}

/// Writes `suite.json`, a picture of every quantity, and the push map.
fn write(report: &Report, directory: &Path) -> anyhow::Result<()> {
    std::fs::create_dir_all(directory)?;
    let put = |name: String, text: String| std::fs::write(directory.join(&name), text).context(name);
    put("suite.json".into(), serde_json::to_string_pretty(report)? + "\n")?;
    let subjects = &report.subjects;
    let mut names: Vec<&str> = subjects.iter().flat_map(|found| &found.groups).map(|group| group.name).collect();
    names.sort_unstable();
    names.dedup();
    for name in names {
        let drawn: Vec<_> = subjects
            .iter()
            .flat_map(|found| found.groups.iter().map(|group| (found.label.as_str(), group)))
            .filter(|(_, group)| group.name == name)
            .collect();
        put(format!("{name}.svg"), panels::svg(&drawn))?;
    }
    let maps: Vec<_> = subjects.iter().map(|found| (found.label.as_str(), &found.pushes[..])).collect();
    put("push-map.svg".into(), push_map::svg(&maps))
}
