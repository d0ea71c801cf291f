//! The steps of a reproduction in order: what each is called, whether it is done, about how long it takes, how it runs.

use super::Stage;
use super::ablations;
use super::course::Meter;
use super::measure::{Evaluation, Measured};
use super::play::{self, Player, play};
use super::report;
use super::search::{self, Action, Found, search};
use super::settings::Settings;
use super::store::Store;
use super::training::Training;
use crate::args::ConfigArgs;
use crate::exit::Failure;
use crate::wing;
use anyhow::Context;
use herd_common::config::Config;
use herd_common::hash::sha256_hex;
use herd_common::policy::Policy;
use serde::{Deserialize, Serialize};
use tokio_util::sync::CancellationToken;

/// One step.
#[derive(Clone, Debug)]
pub(super) enum Step {
    /// A training.
    Train(Training),
    /// The search for a constant gait.
    Search,
    /// The evaluation of somebody.
    Measure(Subject),
    /// The report.
    Report,
}

/// Who is evaluated.
#[derive(Clone, Debug)]
pub(super) enum Subject {
    /// The newest policy of a training.
    Trained(Training),
    /// The policy that a training started from.
    Untrained(Training),
    /// The constant gait that was found.
    Constant,
}

/// What the search found, and what it cost.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Searched {
    /// What was found.
    pub(super) found: Found,
    /// Simulated time, s.
    pub(super) simulated_secs: f64,
}

// Seconds on two cores, measured: an episode of training with its updates, an episode without.
const TRAINED_EPISODE_SECS: f64 = 0.25;
const PLAYED_EPISODE_SECS: f64 = 0.13;
const REPORT_SECS: f64 = 3.0;

/// The steps that these settings ask for.
pub(super) fn of(settings: &Settings) -> anyhow::Result<Vec<Step>> {
    let mut steps = Vec::new();
    let (gait, torque) = (|seed: &u64| settings.gait(*seed), |seed: &u64| settings.torque(*seed));
    for stage in &settings.stages {
        match stage {
            Stage::Gait => steps.extend(settings.seeds.iter().map(gait).map(Step::Train)),
            Stage::Torque => steps.extend(settings.seeds.iter().map(torque).map(Step::Train)),
            Stage::Constant => steps.push(Step::Search),
            Stage::Evaluation => steps.extend(subjects(settings).into_iter().map(Step::Measure)),
            Stage::Ablations => {
                for ablation in ablations::all()? {
                    for seed in &settings.ablation_seeds {
                        let training = settings.ablation(&ablation, *seed);
                        steps.extend([Step::Train(training.clone()), Step::Measure(Subject::Trained(training))]);
                    }
                }
            }
            Stage::Report => steps.push(Step::Report),
        }
    }
    Ok(steps)
}

/// Everybody that the report compares.
fn subjects(settings: &Settings) -> Vec<Subject> {
    let gait = settings.seeds.iter().map(|seed| Subject::Trained(settings.gait(*seed)));
    let torque = settings.seeds.iter().map(|seed| Subject::Trained(settings.torque(*seed)));
    let untrained = settings.seeds.first().map(|seed| Subject::Untrained(settings.gait(*seed)));
    gait.chain(torque).chain(untrained).chain([Subject::Constant]).collect()
}

impl Step {
    /// What people call it.
    pub(super) fn name(&self) -> String {
        match self {
            Self::Train(training) => format!("train {}", training.name),
            Self::Search => "search the best constant gait".to_owned(),
            Self::Measure(subject) => format!("evaluate {}", subject.name()),
            Self::Report => "write the report".to_owned(),
        }
    }

    /// True when nothing is left to do.
    pub(super) fn is_done(&self, settings: &Settings) -> anyhow::Result<bool> {
        Ok(match self {
            // Its budget is known only once the other run is there.
            Self::Train(training) => training.next_target(&settings.dir).is_ok_and(|target| target.is_none()),
            Self::Search => searched(settings)?.is_some(),
            Self::Measure(subject) => subject.is_ready(settings) && subject.measured(settings)?.is_some(),
            Self::Report => false,
        })
    }

    /// About how long it takes on two cores, s.
    pub(super) fn expected_secs(&self, settings: &Settings) -> f64 {
        match self {
            Self::Train(_) => settings.episodes as f64 * TRAINED_EPISODE_SECS,
            Self::Search => settings.search.budget as f64 * PLAYED_EPISODE_SECS,
            Self::Measure(_) => settings.evaluation_episodes as f64 * PLAYED_EPISODE_SECS,
            Self::Report => REPORT_SECS,
        }
    }

    /// Does what is left to do.
    pub(super) async fn run(&self, settings: &Settings, stop: &CancellationToken) -> anyhow::Result<()> {
        if let Self::Train(training) = self {
            return training.run(settings, stop).await;
        }
        // Episodes take this process's threads; meanwhile this one listens for signals.
        let (step, settings, stop) = (self.clone(), settings.clone(), stop.clone());
        let work = tokio::task::spawn_blocking(move || step.work(&settings, &stop));
        work.await.with_context(|| format!("{} panicked", self.name()))?
    }

    fn work(&self, settings: &Settings, stop: &CancellationToken) -> anyhow::Result<()> {
        match self {
            Self::Train(_) => Ok(()),
            Self::Search if searched(settings)?.is_some() => Ok(()),
            Self::Search => seek(settings, stop),
            Self::Measure(subject) => subject.measure(settings, stop),
            Self::Report => report::write(settings),
        }
    }
}

impl Subject {
    /// Name of its result.
    pub(super) fn name(&self) -> String {
        match self {
            Self::Trained(training) => training.name.clone(),
            Self::Untrained(training) => format!("{}-untrained", training.name),
            Self::Constant => "constant".to_owned(),
        }
    }

    /// Its evaluation, if it was made from what lies here now.
    pub(super) fn measured(&self, settings: &Settings) -> anyhow::Result<Option<Measured>> {
        let player = self.player(settings)?;
        Store::of(&settings.dir).get(&self.store_name(), &key(settings, &player)?)
    }

    fn store_name(&self) -> String {
        format!("evaluation-{}", self.name())
    }

    /// True when there is something to evaluate.
    fn is_ready(&self, settings: &Settings) -> bool {
        match self {
            Self::Trained(training) => training.run_dir(&settings.dir).join("policy.safetensors").exists(),
            Self::Untrained(_) => true,
            Self::Constant => searched(settings).is_ok_and(|searched| searched.is_some()),
        }
    }

    fn measure(&self, settings: &Settings, stop: &CancellationToken) -> anyhow::Result<()> {
        let player = self.player(settings)?;
        let (store, key) = (Store::of(&settings.dir), key(settings, &player)?);
        if store.get::<Measured>(&self.store_name(), &key)?.is_some() {
            return Ok(());
        }
        let seeds = settings.evaluation_seeds();
        let meter = Meter::new(&format!("episodes of {}", self.name()), seeds.len() as u64);
        let options = play::Options { threads: settings.actors as usize, filmed: 1, stop, meter: &meter };
        let films = play(std::slice::from_ref(&player), &seeds, &options)?.remove(0);
        let evaluation = Evaluation::of(&films, &player.config);
        let frames = films.into_iter().next().map(|film| film.frames).unwrap_or_default();
        store.put(&self.store_name(), &key, &Measured::new(evaluation, frames))
    }

    fn player(&self, settings: &Settings) -> anyhow::Result<Player> {
        match self {
            Self::Trained(training) => {
                let run_dir = training.run_dir(&settings.dir);
                let path = run_dir.join("policy.safetensors");
                let bytes = std::fs::read(&path).map_err(|e| {
                    Failure::usage(format!("read {}: {e}; the training must come first", path.display()))
                })?;
                let config = ConfigArgs::default().load(Some(&run_dir))?;
                let policy = Policy::from_safetensors(&bytes).with_context(|| format!("read {}", path.display()))?;
                policy.expect_task(&config.task_hash())?;
                Ok(Player { config, policy: Some(policy) })
            }
            Self::Untrained(training) => {
                let seed = format!("seed={}", training.seed);
                let config = settings.base.overridden(&[training.sets.clone(), vec![seed]].concat())?;
                let policy = wing::run::untrained_policy(&config).map_err(wing::told)?;
                Ok(Player { config, policy: Some(policy) })
            }
            Self::Constant => {
                let found = searched(settings)?;
                let found =
                    found.ok_or_else(|| Failure::usage("no constant gait was searched yet (--stages constant)"))?;
                Ok(Player { config: constant(settings, &found.found.action)?, policy: None })
            }
        }
    }
}

/// What the search found, if it was made as these settings say.
pub(super) fn searched(settings: &Settings) -> anyhow::Result<Option<Searched>> {
    Store::of(&settings.dir).get("search", &search_key(settings)?)
}

fn seek(settings: &Settings, stop: &CancellationToken) -> anyhow::Result<()> {
    let (seeds, mut simulated_secs) = (settings.search_seeds(), 0.0);
    let meter = Meter::new("episodes of constant gaits", settings.search.budget);
    let options = play::Options { threads: settings.actors as usize, filmed: 0, stop, meter: &meter };
    let mut judge = |actions: &[Action], repeats: usize| {
        let configs = actions.iter().map(|action| constant(settings, action));
        let players = configs.map(|config| Ok(Player { config: config?, policy: None }));
        let played = play(&players.collect::<anyhow::Result<Vec<_>>>()?, &seeds[..repeats], &options)?;
        simulated_secs += played.iter().flatten().map(|film| film.outcome.seconds).sum::<f64>();
        let value = |films: &Vec<_>| films.iter().map(worth).sum::<f64>() / films.len() as f64;
        Ok(played.iter().map(value).collect())
    };
    let found = search(&settings.search, &mut judge)?;
    Store::of(&settings.dir).put("search", &search_key(settings)?, &Searched { found, simulated_secs })
}

fn worth(film: &herd_actor::film::Film) -> f64 {
    film.outcome.reward.total()
}

/// The configuration of a constant gait.
fn constant(settings: &Settings, action: &Action) -> anyhow::Result<Config> {
    let gait = settings.base.task.gait.from_action(action);
    let set = |key: &str, value: f64| format!("task.constant.{key}={value:?}");
    Ok(settings.base.overridden(&[
        "task.kind=constant".to_owned(),
        set("velocity_mps", gait.velocity_mps),
        set("stride_m", gait.stride_m),
        set("lift_m", gait.lift_m),
        set("step_secs", gait.step_secs),
    ])?)
}

/// What an evaluation is made from: the task, the policy, the seeds.
fn key(settings: &Settings, player: &Player) -> anyhow::Result<String> {
    let policy = player.policy.as_ref().map(Policy::to_safetensors).transpose()?;
    let policy = policy.map(sha256_hex).unwrap_or_default();
    Ok(sha256_hex(format!("{} {policy} {}", player.config.task_hash(), settings.evaluation_episodes)))
}

fn search_key(settings: &Settings) -> anyhow::Result<String> {
    let task = constant(settings, &search::Action::default())?.task_hash();
    let box_of_actions = serde_json::to_string(&settings.base.task.gait)?;
    Ok(sha256_hex(format!("{task} {box_of_actions} {}", serde_json::to_string(&settings.search)?)))
}
