//! What a reproduction is made of: its seeds, sizes and configuration, all from the command line.

use super::place::Place;
use super::search::Plan;
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
    /// Episodes of a training on rough ground.
    pub(super) rough_episodes: u64,
    /// Episodes whose time may be spent on the search for the best constant gait on flat ground. On rough ground it is
    /// the simulated time of a training there.
    pub(super) search_episodes: u64,
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
            rough_episodes: args.rough_episodes.unwrap_or(full(1, 2) * episodes),
            search_episodes: args.search_episodes.unwrap_or(episodes),
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

    /// The training of Group_1 on rough ground with this seed.
    pub(super) fn rough(&self, seed: u64) -> Training {
        let sets = [vec!["task.kind=gait".to_owned()], Place::Rough.sets()].concat();
        Training { name: format!("rough-seed-{seed}"), seed, sets, goal: Goal::Episodes(self.rough_episodes) }
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

    /// The search for the best constant gait of a place. On rough ground it may take as much simulated time as the
    /// longest of the trainings there; none before they are over.
    pub(super) fn plan(&self, place: Place) -> anyhow::Result<Option<Plan>> {
        let episode_secs = self.base.task.episode_secs;
        if place == Place::Flat {
            let budget_secs = self.search_episodes as f64 * episode_secs;
            let repeats = if self.quick { 1 } else { 3 };
            return Ok(Some(Plan { budget_secs, episode_secs, points: 3, grid_repeats: 1, finalists: 5, repeats }));
        }
        let mut budget_secs = 0.0_f64;
        for training in self.seeds.iter().map(|seed| self.rough(*seed)) {
            if training.next_target(&self.dir)?.is_some() {
                return Ok(None);
            }
            budget_secs = budget_secs.max(training.cost(&self.dir)?.simulated_secs);
        }
        // Episodes differ here, so a gait needs several before it can be told from its neighbours.
        let (grid_repeats, finalists, repeats) = if self.quick { (1, 5, 3) } else { (3, 10, 16) };
        Ok(Some(Plan { budget_secs, episode_secs, points: 3, grid_repeats, finalists, repeats }))
    }

    /// The same; that it is too early is an error.
    pub(super) fn expect_plan(&self, place: Place) -> anyhow::Result<Plan> {
        let text = "the search on rough ground may take as long as a training there: train first (--stages rough)";
        self.plan(place)?.ok_or_else(|| Failure::usage(text).into())
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
