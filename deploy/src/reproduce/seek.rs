//! The search for the best constant gait of a place, run in the simulator and kept.

use super::place::Place;
use super::play::{self, play};
use super::search::{Action, Found, Plan, Tried, search};
use super::settings::Settings;
use super::store::Store;
use crate::eval::cases::{Case, gait_sets};
use crate::meter::Meter;
use herd_actor::film::Film;
use herd_common::config::Config;
use herd_common::hash::sha256_hex;
use herd_common::seed::Seed;
use tokio_util::sync::CancellationToken;

/// Root of the episodes of a search: no training and no evaluation has it.
const ROOT: u64 = 1_000_002;

/// What the search found, if it was made as these settings say.
pub(super) fn searched(settings: &Settings, place: Place) -> anyhow::Result<Option<Found>> {
    let Some(plan) = settings.plan(place)? else { return Ok(None) };
    Store::of(&settings.dir).get(store_name(place), &key(settings, place, &plan)?)
}

/// Searches, unless that was done before.
pub(super) fn seek(settings: &Settings, place: Place, stop: &CancellationToken) -> anyhow::Result<()> {
    let plan = settings.expect_plan(place)?;
    if searched(settings, place)?.is_some() {
        return Ok(());
    }
    let root = Seed::from_number(ROOT);
    let count = plan.repeats.max(plan.grid_repeats) as u64;
    let seeds: Vec<Seed> = (0..count).map(|index| root.child("search", index)).collect();
    let meter = Meter::new(&format!("episodes of constant gaits on {} ground", place.name()), plan.most_episodes());
    let options = play::Options { threads: settings.actors as usize, filmed: false, stop, meter: &meter };
    let mut judge = |actions: &[Action], repeats: usize| {
        let case = |action| -> anyhow::Result<Case> {
            Ok(Case { label: String::new(), config: constant_gait(settings, action, place)?, policy: None })
        };
        let cases = actions.iter().map(case).collect::<anyhow::Result<Vec<_>>>()?;
        Ok(play(&cases, &seeds[..repeats], &options)?.iter().map(|films| worth(films)).collect())
    };
    let found = search(&plan, &mut judge)?;
    Store::of(&settings.dir).put(store_name(place), &key(settings, place, &plan)?, &found)
}

fn worth(films: &[Film]) -> Tried {
    let value = films.iter().map(|film| film.outcome.reward.total()).sum::<f64>() / films.len() as f64;
    Tried { value, secs: films.iter().map(|film| film.outcome.seconds).sum() }
}

/// The configuration of a constant gait somewhere.
pub(super) fn constant_gait(settings: &Settings, action: &Action, place: Place) -> anyhow::Result<Config> {
    let gait = gait_sets(&settings.base.task.gait.from_action(action));
    Ok(settings.base.overridden(&[vec!["task.kind=constant".to_owned()], gait.into(), place.sets()].concat())?)
}

fn store_name(place: Place) -> &'static str {
    match place {
        Place::Flat => "search",
        Place::Rough => "search-on-rough",
    }
}

fn key(settings: &Settings, place: Place, plan: &Plan) -> anyhow::Result<String> {
    let task = constant_gait(settings, &Action::default(), place)?.task_hash();
    let box_of_actions = serde_json::to_string(&settings.base.task.gait)?;
    Ok(sha256_hex(format!("{task} {box_of_actions} {}", serde_json::to_string(plan)?)))
}
