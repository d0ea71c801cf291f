//! One training of the reproduction: a run directory that is brought to its goal, from wherever it is.

use super::budget;
use super::settings::Settings;
use super::store::Store;
use crate::args::ConfigArgs;
use crate::exit::Failure;
use crate::report::records::lines;
use crate::{train, wing};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use tokio_util::sync::CancellationToken;

/// What to train.
#[derive(Clone, Debug)]
pub(super) struct Training {
    /// Name of its run directory.
    pub(super) name: String,
    /// Root of its random numbers.
    pub(super) seed: u64,
    /// In what it differs from the base, each `key=value`.
    pub(super) sets: Vec<String>,
    /// When it is done.
    pub(super) goal: Goal,
}

/// When a training is done.
#[derive(Clone, Debug)]
pub(super) enum Goal {
    /// After so many episodes.
    Episodes(u64),
    /// Once it has at least as many transitions as the run of this name.
    TransitionsOf(String),
}

/// One committed episode, as far as reports need it.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub(super) struct Line {
    /// Its number.
    pub(super) episode: u64,
    /// Eq 10 summed, noise included.
    #[serde(rename = "return")]
    pub(super) value: f64,
    /// Simulated time, s.
    pub(super) seconds: f64,
    /// Its decisions.
    pub(super) decisions: u64,
    /// Transitions committed, its own included.
    pub(super) transitions: u64,
    /// Updates done, those it triggered included.
    pub(super) updates: u64,
}

/// What a training cost.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Cost {
    /// Episodes.
    pub(super) episodes: u64,
    /// Transitions.
    pub(super) transitions: u64,
    /// Updates of the networks.
    pub(super) updates: u64,
    /// Simulated time, s.
    pub(super) simulated_secs: f64,
    /// Wall time, s: learner, actors, start and end of the processes; of the sessions that came to an orderly end.
    pub(super) wall_secs: f64,
}

/// Time between two looks at whether a training goes beyond its budget.
const LOOK: Duration = Duration::from_secs(2);

impl Training {
    /// Its run directory.
    pub(super) fn run_dir(&self, dir: &Path) -> PathBuf {
        dir.join(&self.name)
    }

    /// Episodes that the run is to have next; none when its goal is reached.
    pub(super) fn next_target(&self, dir: &Path) -> anyhow::Result<Option<u64>> {
        let progress = wing::run::peek(&self.run_dir(dir)).map_err(wing::told)?;
        let (done, target) = progress.map_or((0, 0), |progress| (progress.episodes, progress.target));
        match &self.goal {
            Goal::Episodes(goal) => Ok((done < *goal).then_some(*goal)),
            Goal::TransitionsOf(_) => {
                let wanted = self.wanted(dir)?;
                let decisions: Vec<u64> = history(&self.run_dir(dir))?.iter().map(|line| line.decisions).collect();
                let broken_off = decisions.iter().sum::<u64>() >= budget::too_many(wanted);
                // A round that was interrupted comes first: goals must not depend on interruptions.
                if done < target && !broken_off {
                    return Ok(Some(target));
                }
                Ok(budget::next_target(&decisions, wanted))
            }
        }
    }

    /// Transitions that are its goal; without end if episodes are.
    fn wanted(&self, dir: &Path) -> anyhow::Result<u64> {
        let Goal::TransitionsOf(other) = &self.goal else { return Ok(u64::MAX / 2) };
        let last = history(&dir.join(other))?.last().map(|line| line.transitions);
        last.ok_or_else(|| {
            let text = format!("the budget of {} is the transitions of {other}: train that first", self.name);
            Failure::usage(text + " (--stages gait)").into()
        })
    }

    /// Trains until the goal is reached or `stop` is cancelled.
    pub(super) async fn run(&self, settings: &Settings, stop: &CancellationToken) -> anyhow::Result<()> {
        let store = Store::of(&settings.dir);
        while let Some(target) = self.next_target(&settings.dir)? {
            let job = train::Job {
                run_dir: self.run_dir(&settings.dir),
                actors: settings.actors,
                robots: 1,
                episodes: Some(target),
                config: ConfigArgs {
                    config: Some(settings.base_file()),
                    set: self.sets.clone(),
                    seed: Some(self.seed),
                },
            };
            #[expect(clippy::disallowed_methods, reason = "tells what a training cost; nothing else depends on it")]
            let start = Instant::now();
            let (run, broken_off) = self.session(&job, settings, stop).await?;
            let wall_secs = start.elapsed().as_secs_f64() + store.get(&self.wall_name(), "")?.unwrap_or(0.0);
            store.put(&self.wall_name(), "", &wall_secs)?;
            if run?.done < target && !broken_off {
                anyhow::bail!("{} stopped before it was done", self.name);
            }
        }
        Ok(())
    }

    /// One start of learner and actors, until they are done or have to stop; true if it went beyond its budget.
    async fn session(
        &self,
        job: &train::Job,
        settings: &Settings,
        stop: &CancellationToken,
    ) -> anyhow::Result<(anyhow::Result<train::Run>, bool)> {
        let (enough, run_dir) = (stop.child_token(), self.run_dir(&settings.dir));
        let limit = budget::too_many(self.wanted(&settings.dir)?);
        let training = train::train(job, &enough);
        tokio::pin!(training);
        loop {
            tokio::select! {
                run = &mut training => return Ok((run, enough.is_cancelled() && !stop.is_cancelled())),
                () = tokio::time::sleep(LOOK) => {
                    if history(&run_dir)?.last().is_some_and(|line| line.transitions >= limit) {
                        enough.cancel();
                    }
                }
            }
        }
    }

    /// What it cost so far.
    pub(super) fn cost(&self, dir: &Path) -> anyhow::Result<Cost> {
        let lines = history(&self.run_dir(dir))?;
        let wall_secs = Store::of(dir).get(&self.wall_name(), "")?.unwrap_or(0.0);
        Ok(Cost { wall_secs, ..Cost::of(&lines) })
    }

    fn wall_name(&self) -> String {
        format!("{}-wall-secs", self.name)
    }
}

impl Cost {
    /// What these episodes cost, but for the wall time.
    pub(super) fn of(lines: &[Line]) -> Self {
        Self {
            episodes: lines.len() as u64,
            transitions: lines.last().map_or(0, |line| line.transitions),
            updates: lines.last().map_or(0, |line| line.updates),
            simulated_secs: lines.iter().map(|line| line.seconds).sum(),
            wall_secs: 0.0,
        }
    }
}

/// The episodes of a run; none if there is no run.
pub(super) fn history(run_dir: &Path) -> anyhow::Result<Vec<Line>> {
    let file = run_dir.join("metrics.jsonl");
    if file.exists() { lines(&file) } else { Ok(Vec::new()) }
}
