//! Who is evaluated where: a trained policy, an untrained one or a constant gait, on flat ground or rough.

use super::measure::{Evaluation, Measured};
use super::place::Place;
use super::play::{self, play};
use super::seek::{constant_gait, searched};
use super::settings::Settings;
use super::store::Store;
use super::training::Training;
use crate::args::ConfigArgs;
use crate::eval::cases::Case;
use crate::exit::Failure;
use crate::meter::Meter;
use crate::wing;
use anyhow::Context;
use herd_common::hash::sha256_hex;
use herd_common::policy::Policy;
use std::sync::Arc;
use tokio_util::sync::CancellationToken;

/// Someone somewhere.
#[derive(Clone, Debug)]
pub(super) struct Subject {
    /// Who.
    pub(super) who: Who,
    /// Where.
    pub(super) place: Place,
}

/// Who walks.
#[derive(Clone, Debug)]
pub(super) enum Who {
    /// The newest policy of a training.
    Trained(Training),
    /// The policy that a training started from.
    Untrained(Training),
    /// The best constant gait of a place.
    Constant(Place),
}

/// Part of every evaluation's key: another number than that of the pictures that lie there makes new ones.
const PICTURES: u32 = 2;

impl Subject {
    /// Someone on flat ground.
    pub(super) fn flat(who: Who) -> Self {
        Self { who, place: Place::Flat }
    }

    /// Someone on rough ground.
    pub(super) fn rough(who: Who) -> Self {
        Self { who, place: Place::Rough }
    }

    /// Name of its result.
    pub(super) fn name(&self) -> String {
        let who = match &self.who {
            Who::Trained(training) => training.name.clone(),
            Who::Untrained(training) => format!("{}-untrained", training.name),
            Who::Constant(Place::Flat) => "constant".to_owned(),
            Who::Constant(Place::Rough) => "constant-of-rough".to_owned(),
        };
        match self.place {
            Place::Flat => who,
            Place::Rough => format!("{who}-on-rough"),
        }
    }

    /// Its evaluation, if it was made from what lies here now.
    pub(super) fn measured(&self, settings: &Settings) -> anyhow::Result<Option<Measured>> {
        let case = self.case(settings)?;
        Store::of(&settings.dir).get(&self.store_name(), &key(settings, &case)?)
    }

    fn store_name(&self) -> String {
        format!("evaluation-{}", self.name())
    }

    /// True when there is something to evaluate.
    pub(super) fn is_ready(&self, settings: &Settings) -> bool {
        match &self.who {
            Who::Trained(training) => training.run_dir(&settings.dir).join("policy.safetensors").exists(),
            Who::Untrained(_) => true,
            Who::Constant(place) => searched(settings, *place).is_ok_and(|searched| searched.is_some()),
        }
    }

    /// Evaluates it, unless that was done before.
    pub(super) fn measure(&self, settings: &Settings, stop: &CancellationToken) -> anyhow::Result<()> {
        let case = self.case(settings)?;
        let (store, key) = (Store::of(&settings.dir), key(settings, &case)?);
        if store.get::<Measured>(&self.store_name(), &key)?.is_some() {
            return Ok(());
        }
        let seeds = settings.evaluation_seeds();
        let meter = Meter::new(&format!("episodes of {}", self.name()), seeds.len() as u64);
        let options = play::Options { threads: settings.actors as usize, filmed: true, stop, meter: &meter };
        let films = play(std::slice::from_ref(&case), &seeds, &options)?.remove(0);
        let evaluation = Evaluation::of(&films, &case.config);
        let frames = films.into_iter().next().map(|film| film.frames).unwrap_or_default();
        store.put(&self.store_name(), &key, &Measured::new(evaluation, frames))
    }

    /// What to run.
    fn case(&self, settings: &Settings) -> anyhow::Result<Case> {
        let (config, policy) = match &self.who {
            Who::Trained(training) => {
                let run_dir = training.run_dir(&settings.dir);
                let path = run_dir.join("policy.safetensors");
                let bytes = std::fs::read(&path).map_err(|e| {
                    Failure::usage(format!("read {}: {e}; the training must come first", path.display()))
                })?;
                let config = ConfigArgs::default().load(Some(&run_dir))?;
                let policy = Policy::from_safetensors(&bytes).with_context(|| format!("read {}", path.display()))?;
                policy.expect_task(&config.task_hash())?;
                (config, Some(policy))
            }
            Who::Untrained(training) => {
                let seed = format!("seed={}", training.seed);
                let config = settings.base.overridden(&[training.sets.clone(), vec![seed]].concat())?;
                let policy = wing::run::untrained_policy(&config).map_err(wing::told)?;
                (config, Some(policy))
            }
            Who::Constant(place) => {
                let found = searched(settings, *place)?;
                let text = format!("no constant gait was searched on {} ground yet", place.name());
                let found = found.ok_or_else(|| Failure::usage(text))?;
                (constant_gait(settings, &found.action, *place)?, None)
            }
        };
        let config = config.overridden(&self.place.sets())?;
        Ok(Case { label: self.name(), config, policy: policy.map(Arc::new) })
    }
}

/// What an evaluation is made from: the task, which has the place in it, the policy, the seeds.
fn key(settings: &Settings, case: &Case) -> anyhow::Result<String> {
    let policy = case.policy.as_ref().map(|policy| policy.to_safetensors()).transpose()?;
    let policy = policy.map(sha256_hex).unwrap_or_default();
    let (task, episodes) = (case.config.task_hash(), settings.evaluation_episodes);
    Ok(sha256_hex(format!("{PICTURES} {task} {policy} {episodes}")))
}
