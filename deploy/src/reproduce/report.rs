//! The report: every number as JSON, every figure as SVG and PNG, and one page that has it all.

use super::against::Against;
use super::claims::{self, Claim, Facts};
use super::curves::{Band, Curve, band};
use super::figures::{self, Figure};
use super::gather::{self, ConstantGait, Gathered, Lacking, Trained, best};
use super::html;
use super::measure::{Evaluation, Measured};
use super::place::Place;
use super::search::Found;
use super::settings::Settings;
use super::store::write_whole;
use super::training::Cost;
use super::{Stage, ablations};
use crate::report::{png, records};
use crate::table::facts as aligned;
use crate::version;
use anyhow::Context;
use herd_common::config::task;
use serde::Serialize;
use std::path::PathBuf;

/// Every number of a reproduction.
#[derive(Serialize)]
pub(super) struct Report<'a> {
    /// Of herd.
    pub(super) version: &'static str,
    /// That the herd which wrote this was built from.
    pub(super) commit: &'static str,
    /// What was asked for.
    pub(super) settings: &'a Settings,
    /// The paper's claims with their verdicts.
    pub(super) claims: Vec<Claim>,
    /// The figures that the verdicts stand on, seed by seed.
    pub(super) facts: Vec<Facts>,
    /// Group_1: a planner over the MPC.
    pub(super) group_1: Vec<Run<'a>>,
    /// Group_0: torques.
    pub(super) group_0: Vec<Run<'a>>,
    /// What the first training of Group_1 started from.
    pub(super) untrained: &'a Evaluation,
    /// The best constant gait.
    pub(super) constant: Constant<'a>,
    /// The same on rough ground, if it was done.
    pub(super) rough: Option<Rough<'a>>,
    /// Group_1 against the best constant gait: on flat ground, and on rough ground if it was trained there.
    pub(super) against: Vec<Against>,
    /// What each part of the learner does; the default comes first.
    pub(super) ablations: Vec<Part<'a>>,
    /// Figure 7.
    pub(super) curves: Curves,
    /// Figures 5 and 6.
    pub(super) walks: Vec<Walk>,
}

/// One training.
#[derive(Serialize)]
pub(super) struct Run<'a> {
    /// Its seed.
    pub(super) seed: u64,
    /// What it cost.
    pub(super) cost: Cost,
    /// Smoothed return at its end, exploration noise included.
    pub(super) last_training_return: Option<f64>,
    /// Episode at which the smoothed return first reached the paper's of Group_1.
    pub(super) reached_175_at: Option<f64>,
    /// Evaluations while it went on, without noise.
    pub(super) evaluations: &'a [records::Evaluation],
    /// Its last policy, without noise.
    pub(super) evaluation: &'a Evaluation,
}

/// What came of rough ground.
#[derive(Serialize)]
pub(super) struct Rough<'a> {
    /// Group_1, trained there.
    pub(super) group_1: Vec<Run<'a>>,
    /// Group_1, trained on flat ground: its evaluation on rough ground.
    pub(super) flat_group_1: Vec<Abroad<'a>>,
    /// The best constant gait of rough ground.
    pub(super) constant: Constant<'a>,
    /// The best constant gait of flat ground, on rough ground.
    pub(super) flat_constant: &'a Evaluation,
}

/// A training of another place.
#[derive(Serialize)]
pub(super) struct Abroad<'a> {
    /// Its seed.
    pub(super) seed: u64,
    /// Its last policy, without noise.
    pub(super) evaluation: &'a Evaluation,
}

/// The best constant gait.
#[derive(Serialize)]
pub(super) struct Constant<'a> {
    /// The gait.
    pub(super) gait: task::Constant,
    /// How it was found.
    pub(super) search: Found,
    /// What it is worth.
    pub(super) evaluation: &'a Evaluation,
}

/// An ablation.
#[derive(Serialize)]
pub(super) struct Part<'a> {
    /// What it is called.
    pub(super) name: &'a str,
    /// In what it differs from the default.
    pub(super) sets: &'a [String],
    /// Its trainings.
    pub(super) runs: Vec<Run<'a>>,
}

/// Return while learning.
#[derive(Serialize)]
pub(super) struct Curves {
    over_episodes: Groups,
    over_transitions: Groups,
}

/// Both groups' returns along one axis.
#[derive(Serialize)]
struct Groups {
    group_1: Band,
    group_0: Band,
}

/// One walk through time, as columns.
#[derive(Serialize)]
pub(super) struct Walk {
    name: String,
    secs: Vec<f64>,
    x_m: Vec<f64>,
    y_m: Vec<f64>,
    z_m: Vec<f64>,
    roll_rad: Vec<f64>,
    pitch_rad: Vec<f64>,
}

/// Writes all of it.
pub(super) fn write(settings: &Settings) -> anyhow::Result<()> {
    let gathered = Gathered::read(settings)?;
    let report = Report::new(settings, &gathered);
    let figures = figures::all(&gathered, settings);
    let directory = directory(settings);
    std::fs::create_dir_all(&directory).context("make the directory of the report")?;
    for Figure { name, svg, .. } in &figures {
        write_whole(&directory.join(format!("{name}.svg")), svg.as_bytes())?;
        let picture = png::render(svg).with_context(|| format!("draw {name}"))?;
        write_whole(&directory.join(format!("{name}.png")), &picture)?;
    }
    write_whole(&directory.join("report.json"), &serde_json::to_vec_pretty(&report)?)?;
    write_whole(&directory.join("index.html"), html::page(&report, &figures).as_bytes())
}

/// What to say when everything that was asked for is done.
pub(super) fn farewell(settings: &Settings) -> anyhow::Result<String> {
    if !settings.stages.contains(&Stage::Report) {
        return Ok(format!("done; the report needs --stages report: {}", settings.dir.display()));
    }
    let gathered = Gathered::read(settings)?;
    let report = Report::new(settings, &gathered);
    let claims: Vec<(&str, String)> = report
        .claims
        .iter()
        .map(|claim| (claim.text.as_str(), format!("{} · {}", claim.verdict, claim.ours)))
        .collect();
    let page = directory(settings).join("index.html");
    let against: Vec<&str> = report.against.iter().map(|against| against.words.as_str()).collect();
    Ok(format!("{}\n{}\n{}", aligned(&claims), against.join("\n"), page.display()))
}

fn directory(settings: &Settings) -> PathBuf {
    settings.dir.join("report")
}

impl<'a> Report<'a> {
    fn new(settings: &'a Settings, gathered: &'a Gathered) -> Self {
        let constant = &gathered.constant;
        let best_constant = constant.measured.evaluation.value.mean;
        let facts: Vec<Facts> = gathered.pairs.iter().map(|pair| Facts::of(pair, best_constant)).collect();
        Self {
            version: env!("CARGO_PKG_VERSION"),
            commit: version::COMMIT,
            settings,
            claims: claims::all(&facts),
            facts,
            group_1: gathered.gaits().map(Run::of).collect(),
            group_0: gathered.torques().map(Run::of).collect(),
            untrained: &gathered.untrained.evaluation,
            constant: Constant::of(constant),
            rough: gathered.rough.as_ref().map(Rough::of),
            against: against(gathered),
            ablations: gathered.ablations.iter().map(Part::of).collect(),
            curves: Curves::of(gathered),
            walks: walks(gathered),
        }
    }
}

impl<'a> Run<'a> {
    fn of(trained: &'a Trained) -> Self {
        let curve = trained.over_episodes();
        Self {
            seed: trained.seed,
            cost: trained.cost,
            last_training_return: curve.last().map(|(_, value)| *value),
            reached_175_at: super::curves::reaches(&curve, claims::paper::GAIT_RETURN),
            evaluations: &trained.evaluations,
            evaluation: &trained.measured.evaluation,
        }
    }
}

impl<'a> Constant<'a> {
    fn of(constant: &'a ConstantGait) -> Self {
        Self { gait: constant.gait, search: constant.found, evaluation: &constant.measured.evaluation }
    }
}

impl<'a> Rough<'a> {
    fn of(rough: &'a gather::Rough) -> Self {
        let abroad = |(seed, measured): &'a (u64, Measured)| Abroad { seed: *seed, evaluation: &measured.evaluation };
        Self {
            group_1: rough.gaits.iter().map(Run::of).collect(),
            flat_group_1: rough.flat_gaits.iter().map(abroad).collect(),
            constant: Constant::of(&rough.constant),
            flat_constant: &rough.flat_constant.evaluation,
        }
    }
}

/// Each place's planners against its best constant gait.
fn against(gathered: &Gathered) -> Vec<Against> {
    fn planners<'a>(trained: impl Iterator<Item = &'a Trained>) -> Vec<(u64, &'a Evaluation)> {
        trained.map(|trained| (trained.seed, &trained.measured.evaluation)).collect()
    }
    let flat = Against::of(Place::Flat, &planners(gathered.gaits()), &gathered.constant.measured.evaluation);
    let rough = gathered
        .rough
        .as_ref()
        .map(|rough| Against::of(Place::Rough, &planners(rough.gaits.iter()), &rough.constant.measured.evaluation));
    [flat].into_iter().chain(rough).collect()
}

impl<'a> Part<'a> {
    fn of(lacking: &'a Lacking) -> Self {
        let ablation: Option<&ablations::Ablation> = lacking.ablation.as_ref();
        Self {
            name: ablation.map_or("the default", |ablation| ablation.name),
            sets: ablation.map_or(&[], |ablation| ablation.sets.as_slice()),
            runs: lacking.runs.iter().map(Run::of).collect(),
        }
    }
}

impl Curves {
    fn of(gathered: &Gathered) -> Self {
        let along = |curve: fn(&Trained) -> Curve| Groups {
            group_1: band(&gathered.gaits().map(curve).collect::<Vec<_>>()),
            group_0: band(&gathered.torques().map(curve).collect::<Vec<_>>()),
        };
        Self { over_episodes: along(Trained::over_episodes), over_transitions: along(Trained::over_transitions) }
    }
}

fn walks(gathered: &Gathered) -> Vec<Walk> {
    let of = |name: String, measured: &Measured| Walk {
        name,
        secs: measured.frames.iter().map(|frame| frame.secs).collect(),
        x_m: measured.frames.iter().map(|frame| frame.centre[0]).collect(),
        y_m: measured.frames.iter().map(|frame| frame.centre[1]).collect(),
        z_m: measured.frames.iter().map(|frame| frame.centre[2]).collect(),
        roll_rad: measured.frames.iter().map(|frame| frame.angles[0]).collect(),
        pitch_rad: measured.frames.iter().map(|frame| frame.angles[1]).collect(),
    };
    let gait = best(gathered.gaits()).map(|t| of(format!("Group_1, seed {}", t.seed), &t.measured));
    let torque = best(gathered.torques()).map(|t| of(format!("Group_0, seed {}", t.seed), &t.measured));
    let constant = of("best constant gait".to_owned(), &gathered.constant.measured);
    gait.into_iter().chain(torque).chain([constant]).collect()
}
