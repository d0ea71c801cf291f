//! What a reproduction is made of: its seeds, sizes and configuration, all from the command line.

use super::search;
use super::store::write_whole;
use super::training::{Goal, Training};
use super::{Args, Stage};
use crate::exit::Failure;
use anyhow::Context;
use herd_common::config::Config;
use herd_common::seed::Seed;
use serde::Serialize;
use std::collections::BTreeSet;
use std::path::PathBuf;

/// Everything that was asked for.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Settings {
    /// Where everything lies.
    #[serde(skip)]
    pub(super) dir: PathBuf,
    /// The words of the command, after the name of the program.
    pub(super) command: String,
    /// The small version.
    pub(super) quick: bool,
    /// Seeds of the trainings.
    pub(super) seeds: Vec<u64>,
    /// Episodes of a gait training.
    pub(super) episodes: u64,
    /// Episodes of an evaluation.
    pub(super) evaluation_episodes: u64,
    /// The search for a constant gait.
    pub(super) search: search::Plan,
    /// Actor processes of a training, and threads of everything else.
    pub(super) actors: u32,
    /// Seeds of the ablations.
    pub(super) ablation_seeds: Vec<u64>,
    /// What is to be done.
    #[serde(skip)]
    pub(super) stages: BTreeSet<Stage>,
    /// The configuration that all trainings start from.
    #[serde(skip)]
    pub(super) base: Config,
}

/// Root of the evaluation episodes: no training has it, and all policies share it.
const EVALUATION_ROOT: u64 = 1_000_001;
/// Root of the episodes of the search.
const SEARCH_ROOT: u64 = 1_000_002;

impl Settings {
    /// The settings that these options mean; refuses a directory that holds a reproduction with another configuration.
    pub(super) fn new(args: &Args) -> anyhow::Result<Self> {
        let base = Config::load(args.config.as_deref(), &args.set)?;
        let full = |small: u64, large: u64| if args.quick { small } else { large };
        let episodes = args.episodes.unwrap_or(full(120, 400));
        let mut stages: BTreeSet<Stage> = args.stages.iter().copied().collect();
        if args.ablations {
            stages.insert(Stage::Ablations);
        }
        let settings = Self {
            dir: args.run_dir.clone(),
            command: std::env::args().skip(1).collect::<Vec<_>>().join(" "),
            quick: args.quick,
            seeds: distinct(&args.seeds, "--seeds")?,
            episodes,
            evaluation_episodes: args.evaluation_episodes.unwrap_or(full(10, 50)),
            search: search::Plan {
                budget: args.search_episodes.unwrap_or(episodes),
                points: 3,
                finalists: 5,
                repeats: full(1, 3) as usize,
            },
            actors: args.actors,
            ablation_seeds: among(&args.seeds, args.ablation_seeds.as_deref().unwrap_or(&args.seeds[..1]))?,
            stages,
            base,
        };
        settings.take_directory()?;
        Ok(settings)
    }

    /// The configuration that trainings start from, as a file.
    pub(super) fn base_file(&self) -> PathBuf {
        self.dir.join("base.toml")
    }

    /// The training of Group_1 with this seed.
    pub(super) fn gait(&self, seed: u64) -> Training {
        let sets = vec!["task.kind=gait".to_owned()];
        Training { name: format!("gait-seed-{seed}"), seed, sets, goal: Goal::Episodes(self.episodes) }
    }

    /// The training of Group_0 with this seed.
    pub(super) fn torque(&self, seed: u64) -> Training {
        let sets = vec!["task.kind=torque".to_owned()];
        let goal = Goal::TransitionsOf(self.gait(seed).name);
        Training { name: format!("torque-seed-{seed}"), seed, sets, goal }
    }

    /// The training of an ablation with this seed.
    pub(super) fn ablation(&self, ablation: &super::ablations::Ablation, seed: u64) -> Training {
        let sets = [vec!["task.kind=gait".to_owned()], ablation.sets.clone()].concat();
        let name = format!("ablation-{}-seed-{seed}", ablation.slug);
        Training { name, seed, sets, goal: Goal::Episodes(self.episodes) }
    }

    /// The seeds of the evaluation episodes.
    pub(super) fn evaluation_seeds(&self) -> Vec<Seed> {
        let root = Seed::from_number(EVALUATION_ROOT);
        (0..self.evaluation_episodes).map(|index| root.child("evaluation", index)).collect()
    }

    /// The seeds of the search, as many as it repeats a gait.
    pub(super) fn search_seeds(&self) -> Vec<Seed> {
        let root = Seed::from_number(SEARCH_ROOT);
        (0..self.search.repeats.max(1) as u64).map(|index| root.child("search", index)).collect()
    }

    fn take_directory(&self) -> anyhow::Result<()> {
        std::fs::create_dir_all(&self.dir).with_context(|| format!("make {}", self.dir.display()))?;
        let file = self.base_file();
        if file.exists() {
            let there = Config::load(Some(&file), &[])?;
            let differences = there.differences(&self.base);
            if let Some((key, theirs, ours)) = differences.first() {
                let (dir, more) = (self.dir.display(), differences.len() - 1);
                let text = format!(
                    "{dir} holds a reproduction with {key} = {theirs}, here it is {ours} ({more} more keys differ); \
                     choose another --run-dir, or give the same --config and --set"
                );
                return Err(Failure::config(text).into());
            }
            return Ok(());
        }
        write_whole(&file, self.base.to_toml().as_bytes())
    }
}

/// The ablations' seeds: the default that they are put beside is trained with `seeds` only.
fn among(seeds: &[u64], chosen: &[u64]) -> anyhow::Result<Vec<u64>> {
    match chosen.iter().find(|seed| !seeds.contains(seed)) {
        Some(stranger) => {
            let expected = format!("--ablation-seeds has {stranger}, expected only seeds of --seeds {seeds:?}");
            Err(Failure::usage(expected).into())
        }
        None => distinct(chosen, "--ablation-seeds"),
    }
}

fn distinct(seeds: &[u64], option: &str) -> anyhow::Result<Vec<u64>> {
    let known: BTreeSet<u64> = seeds.iter().copied().collect();
    if known.len() < seeds.len() || seeds.is_empty() {
        return Err(Failure::usage(format!("{option} is {seeds:?}, expected seeds that are all different")).into());
    }
    Ok(seeds.to_vec())
}
