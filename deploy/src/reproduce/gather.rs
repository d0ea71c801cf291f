//! Everything that a report is made of, read from where the steps have left it.

use super::ablations::{self, Ablation};
use super::beyond::{self, Beyond};
use super::curves::{Curve, smooth};
use super::measure::Measured;
use super::place::Place;
use super::search::Found;
use super::seek::searched;
use super::settings::Settings;
use super::steps;
use super::subject::{Subject, Who};
use super::training::{Cost, Line, Training, history};
use crate::exit::Failure;
use crate::report::records::{self, Records};
use herd_common::config::task;

/// All of it.
pub(super) struct Gathered {
    /// The two groups, seed by seed.
    pub(super) pairs: Vec<Pair>,
    /// What the first training of Group_1 started from.
    pub(super) untrained: Measured,
    /// The best constant gait.
    pub(super) constant: ConstantGait,
    /// The same on rough ground, if it was done.
    pub(super) rough: Option<Rough>,
    /// What the paper does not try, on film.
    pub(super) beyond: Beyond,
    /// Ablations of which there is at least one training, and the default beside them.
    pub(super) ablations: Vec<Lacking>,
}

/// Everything on rough ground.
pub(super) struct Rough {
    /// Group_1, trained there.
    pub(super) gaits: Vec<Trained>,
    /// Group_1, trained on flat ground: the evaluation there, by seed.
    pub(super) flat_gaits: Vec<(u64, Measured)>,
    /// The best constant gait of rough ground.
    pub(super) constant: ConstantGait,
    /// The best constant gait of flat ground.
    pub(super) flat_constant: Measured,
}

/// The trainings of one seed.
pub(super) struct Pair {
    /// The seed.
    pub(super) seed: u64,
    /// Group_1.
    pub(super) gait: Trained,
    /// Group_0.
    pub(super) torque: Trained,
}

/// A training that was evaluated.
pub(super) struct Trained {
    /// Its seed.
    pub(super) seed: u64,
    /// Its episodes.
    pub(super) lines: Vec<Line>,
    /// What it cost.
    pub(super) cost: Cost,
    /// Evaluations while it went on, without noise.
    pub(super) evaluations: Vec<records::Evaluation>,
    /// Its last policy.
    pub(super) measured: Measured,
}

/// The best constant gait.
pub(super) struct ConstantGait {
    /// How it was found.
    pub(super) found: Found,
    /// The gait.
    pub(super) gait: task::Constant,
    /// What it is worth.
    pub(super) measured: Measured,
}

/// An ablation.
pub(super) struct Lacking {
    /// Which; none is the default itself.
    pub(super) ablation: Option<Ablation>,
    /// Its trainings.
    pub(super) runs: Vec<Trained>,
}

impl Gathered {
    /// Reads what lies in the directory; what is missing is named.
    pub(super) fn read(settings: &Settings) -> anyhow::Result<Self> {
        let pair = |seed: &u64| -> anyhow::Result<Pair> {
            let (gait, torque) = (settings.gait(*seed), settings.torque(*seed));
            let (gait, torque) = (trained(settings, &gait, Place::Flat)?, trained(settings, &torque, Place::Flat)?);
            Ok(Pair { seed: *seed, gait, torque })
        };
        let pairs = settings.seeds.iter().map(pair).collect::<anyhow::Result<Vec<_>>>()?;
        let untrained = measured(settings, &Subject::flat(Who::Untrained(settings.gait(settings.seeds[0]))))?;
        let beyond =
            beyond::shown(settings)?.ok_or_else(|| missing("the films of slope, steps and push", "evaluation"))?;
        let (constant, rough) = (constant(settings, Place::Flat)?, rough(settings)?);
        Ok(Self { pairs, untrained, constant, rough, beyond, ablations: lacking(settings)? })
    }

    /// The trainings of Group_1.
    pub(super) fn gaits(&self) -> impl Iterator<Item = &Trained> {
        self.pairs.iter().map(|pair| &pair.gait)
    }

    /// The trainings of Group_0.
    pub(super) fn torques(&self) -> impl Iterator<Item = &Trained> {
        self.pairs.iter().map(|pair| &pair.torque)
    }
}

impl Trained {
    /// Return over episodes, smoothed.
    pub(super) fn over_episodes(&self) -> Curve {
        smooth(&self.lines.iter().map(|line| (line.episode as f64, line.value)).collect::<Vec<_>>())
    }

    /// Return over transitions, smoothed over episodes.
    pub(super) fn over_transitions(&self) -> Curve {
        smooth(&self.lines.iter().map(|line| (line.transitions as f64, line.value)).collect::<Vec<_>>())
    }
}

/// The training with the highest mean return without noise.
pub(super) fn best<'a>(trained: impl Iterator<Item = &'a Trained>) -> Option<&'a Trained> {
    trained.max_by(|a, b| a.measured.evaluation.value.mean.total_cmp(&b.measured.evaluation.value.mean))
}

fn trained(settings: &Settings, training: &Training, place: Place) -> anyhow::Result<Trained> {
    let run_dir = training.run_dir(&settings.dir);
    if training.next_target(&settings.dir)?.is_some() {
        return Err(missing(&format!("the rest of training {}", training.name), "gait,torque"));
    }
    Ok(Trained {
        seed: training.seed,
        lines: history(&run_dir)?,
        cost: training.cost(&settings.dir)?,
        evaluations: Records::read(&run_dir)?.evaluations,
        measured: measured(settings, &Subject { who: Who::Trained(training.clone()), place })?,
    })
}

/// The best constant gait of a place, measured there.
fn constant(settings: &Settings, place: Place) -> anyhow::Result<ConstantGait> {
    let found = searched(settings, place)?.ok_or_else(|| missing("the search for a constant gait", "constant"))?;
    Ok(ConstantGait {
        gait: settings.base.task.gait.from_action(&found.action),
        measured: measured(settings, &Subject { who: Who::Constant(place), place })?,
        found,
    })
}

/// What there is of rough ground: all of it, or none.
fn rough(settings: &Settings) -> anyhow::Result<Option<Rough>> {
    for subject in steps::rough_subjects(settings) {
        if !subject.is_ready(settings) || subject.measured(settings)?.is_none() {
            return Ok(None);
        }
    }
    let gait = |seed: &u64| trained(settings, &settings.rough(*seed), Place::Rough);
    let flat_gait = |seed: &u64| -> anyhow::Result<(u64, Measured)> {
        Ok((*seed, measured(settings, &Subject::rough(Who::Trained(settings.gait(*seed))))?))
    };
    Ok(Some(Rough {
        gaits: settings.seeds.iter().map(gait).collect::<anyhow::Result<_>>()?,
        flat_gaits: settings.seeds.iter().map(flat_gait).collect::<anyhow::Result<_>>()?,
        constant: constant(settings, Place::Rough)?,
        flat_constant: measured(settings, &Subject::rough(Who::Constant(Place::Flat)))?,
    }))
}

fn measured(settings: &Settings, subject: &Subject) -> anyhow::Result<Measured> {
    subject.measured(settings)?.ok_or_else(|| missing(&format!("the evaluation of {}", subject.name()), "evaluation"))
}

fn missing(what: &str, stage: &str) -> anyhow::Error {
    Failure::usage(format!("the report needs {what}, which is not there yet: --stages {stage}")).into()
}

/// The ablations that are there, with the default of the same seeds before them.
fn lacking(settings: &Settings) -> anyhow::Result<Vec<Lacking>> {
    let mut found = Vec::new();
    for ablation in ablations::all()? {
        let mut runs = Vec::new();
        for seed in &settings.ablation_seeds {
            let training = settings.ablation(&ablation, *seed);
            let subject = Subject::flat(Who::Trained(training.clone()));
            if training.next_target(&settings.dir)?.is_none() && subject.measured(settings)?.is_some() {
                runs.push(trained(settings, &training, Place::Flat)?);
            }
        }
        if !runs.is_empty() {
            found.push(Lacking { ablation: Some(ablation), runs });
        }
    }
    if found.is_empty() {
        return Ok(found);
    }
    let mut default = Vec::new();
    for seed in settings.ablation_seeds.iter().filter(|seed| settings.seeds.contains(seed)) {
        default.push(trained(settings, &settings.gait(*seed), Place::Flat)?);
    }
    found.insert(0, Lacking { ablation: None, runs: default });
    Ok(found)
}
