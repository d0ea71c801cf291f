//! The steps of a reproduction in order: what each is called, whether it is done, about how long it takes, how it runs.

use super::Stage;
use super::ablations;
use super::beyond;
use super::place::Place;
use super::report;
use super::seek::{searched, seek};
use super::settings::Settings;
use super::subject::{Subject, Who};
use super::training::{Goal, Training};
use anyhow::Context;
use tokio_util::sync::CancellationToken;

/// One step.
#[derive(Clone, Debug)]
pub(super) enum Step {
    /// A training.
    Train(Training),
    /// The search for the constant gait of a place.
    Search(Place),
    /// The evaluation of somebody.
    Measure(Subject),
    /// The films of what the paper does not try.
    Beyond,
    /// The report.
    Report,
}

// Seconds on two cores, measured: an episode of training with its updates, an episode without.
const TRAINED_EPISODE_SECS: f64 = 0.25;
const PLAYED_EPISODE_SECS: f64 = 0.13;
const REPORT_SECS: f64 = 3.0;

/// The steps that these settings ask for.
pub(super) fn of(settings: &Settings) -> anyhow::Result<Vec<Step>> {
    let mut steps = Vec::new();
    let seeds = || settings.seeds.iter().copied();
    for stage in &settings.stages {
        match stage {
            Stage::Gait => steps.extend(seeds().map(|seed| Step::Train(settings.gait(seed)))),
            Stage::Torque => steps.extend(seeds().map(|seed| Step::Train(settings.torque(seed)))),
            Stage::Constant => steps.push(Step::Search(Place::Flat)),
            Stage::Evaluation => {
                steps.extend(subjects(settings).into_iter().map(Step::Measure));
                steps.push(Step::Beyond);
            }
            Stage::Rough => {
                steps.extend(seeds().map(|seed| Step::Train(settings.rough(seed))));
                steps.push(Step::Search(Place::Rough));
                steps.extend(rough_subjects(settings).into_iter().map(Step::Measure));
            }
            Stage::Ablations => {
                for ablation in ablations::all()? {
                    for seed in &settings.ablation_seeds {
                        let training = settings.ablation(&ablation, *seed);
                        let trained = Subject::flat(Who::Trained(training.clone()));
                        steps.extend([Step::Train(training), Step::Measure(trained)]);
                    }
                }
            }
            Stage::Report => steps.push(Step::Report),
        }
    }
    Ok(steps)
}

/// Everybody that the report compares on flat ground.
fn subjects(settings: &Settings) -> Vec<Subject> {
    let gait = settings.seeds.iter().map(|seed| Who::Trained(settings.gait(*seed)));
    let torque = settings.seeds.iter().map(|seed| Who::Trained(settings.torque(*seed)));
    let untrained = settings.seeds.first().map(|seed| Who::Untrained(settings.gait(*seed)));
    gait.chain(torque).chain(untrained).chain([Who::Constant(Place::Flat)]).map(Subject::flat).collect()
}

/// The same on rough ground.
pub(super) fn rough_subjects(settings: &Settings) -> Vec<Subject> {
    let rough = settings.seeds.iter().map(|seed| Who::Trained(settings.rough(*seed)));
    let flat = settings.seeds.iter().map(|seed| Who::Trained(settings.gait(*seed)));
    let constant = [Place::Rough, Place::Flat].map(Who::Constant);
    rough.chain(flat).chain(constant).map(Subject::rough).collect()
}

impl Step {
    /// What people call it.
    pub(super) fn name(&self) -> String {
        match self {
            Self::Train(training) => format!("train {}", training.name),
            Self::Search(place) => format!("search the best constant gait on {} ground", place.name()),
            Self::Measure(subject) => format!("evaluate {}", subject.name()),
            Self::Beyond => "film slope, steps and push".to_owned(),
            Self::Report => "write the report".to_owned(),
        }
    }

    /// True when nothing is left to do.
    pub(super) fn is_done(&self, settings: &Settings) -> anyhow::Result<bool> {
        Ok(match self {
            // Its budget is known only once the other run is there.
            Self::Train(training) => training.next_target(&settings.dir).is_ok_and(|target| target.is_none()),
            Self::Search(place) => searched(settings, *place)?.is_some(),
            Self::Measure(subject) => subject.is_ready(settings) && subject.measured(settings)?.is_some(),
            Self::Beyond => beyond::shown(settings)?.is_some(),
            Self::Report => false,
        })
    }

    /// About how long it takes on two cores, s.
    pub(super) fn expected_secs(&self, settings: &Settings) -> f64 {
        match self {
            Self::Train(Training { goal: Goal::Episodes(episodes), .. }) => *episodes as f64 * TRAINED_EPISODE_SECS,
            Self::Train(_) => settings.episodes as f64 * TRAINED_EPISODE_SECS,
            Self::Search(Place::Flat) => settings.search_episodes as f64 * PLAYED_EPISODE_SECS,
            Self::Search(Place::Rough) => settings.rough_episodes as f64 * PLAYED_EPISODE_SECS,
            Self::Measure(_) => settings.evaluation_episodes as f64 * PLAYED_EPISODE_SECS,
            Self::Beyond => 3.0 * PLAYED_EPISODE_SECS,
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
            Self::Search(place) => seek(settings, *place, stop),
            Self::Measure(subject) => subject.measure(settings, stop),
            Self::Beyond => beyond::show(settings, stop),
            Self::Report => report::write(settings),
        }
    }
}
