//! The section that puts planners beside constant gaits, on flat ground and on rough.

use super::{heading, paragraph, table};
use crate::reproduce::against::{Against, Verdict, difference};
use crate::reproduce::claims::spread;
use crate::reproduce::measure::{Evaluation, Interval};
use crate::reproduce::place::ROUGH_IN_WORDS;
use crate::reproduce::report::{Constant, Report, Rough, Run};
use crate::table::{count, duration, percent};

const HEAD: [&str; 8] = [
    "without noise",
    "return ± 95 %",
    "less the constant gait's, episode by episode",
    "verdict",
    "speed, m/s",
    "roll variance, rad²",
    "pitch variance, rad²",
    "falls",
];

/// All of it.
pub(super) fn section(report: &Report<'_>) -> String {
    let text = "The paper does not ask what a fixed gait would earn. Here the same action box was searched for one: a grid, \
                then steps around the best. A verdict is by whether the 95 % intervals of two means overlap. All meet the \
                same episodes, so the difference episode by episode is known better than the means are.";
    let [flat, rest @ ..] = report.against.as_slice() else { return paragraph(text) };
    let rough = match (&report.rough, rest.first()) {
        (Some(rough), Some(against)) => on_rough(report, rough, against),
        _ => paragraph("Rough ground was not tried: that is --stages rough."),
    };
    paragraph(text) + &heading("Flat ground") + &on_flat(report, flat) + &heading("Rough ground") + &rough
}

fn on_flat(report: &Report<'_>, against: &Against) -> String {
    let best = report.constant.evaluation;
    let group = |name: &'static str, runs: &[Run<'_>]| -> Vec<Vec<String>> {
        runs.iter().map(|run| row(format!("{name}, seed {}", run.seed), run.evaluation, Some(best))).collect()
    };
    let constant = row(gait("best constant gait", &report.constant), best, None);
    let untrained = row("untrained planner".to_owned(), report.untrained, Some(best));
    let rows = [group("Group_1", &report.group_1), vec![constant, untrained], group("Group_0", &report.group_0)];
    search(&report.constant, &report.group_1) + &verdict(against) + &table(&HEAD, rows.concat().into_iter())
}

fn on_rough(report: &Report<'_>, rough: &Rough<'_>, against: &Against) -> String {
    let best = rough.constant.evaluation;
    let trained = rough
        .group_1
        .iter()
        .map(|run| row(format!("Group_1 trained on rough ground, seed {}", run.seed), run.evaluation, Some(best)));
    let abroad = rough.flat_group_1.iter().map(|abroad| {
        row(format!("Group_1 trained on flat ground, seed {}", abroad.seed), abroad.evaluation, Some(best))
    });
    let constants = [
        row(gait("best constant gait of rough ground", &rough.constant), best, None),
        row(gait("best constant gait of flat ground", &report.constant), rough.flat_constant, Some(best)),
    ];
    let text = format!(
        "Every episode draws {ROUGH_IN_WORDS}. Group_1 was trained there for {} episodes, and the constant gait searched \
         there too.",
        spread(&rough.group_1.iter().map(|run| run.cost.episodes as f64).collect::<Vec<_>>(), |x| count(x as u64)),
    );
    let rows = trained.chain(constants).chain(abroad);
    paragraph(&text) + &search(&rough.constant, &rough.group_1) + &verdict(against) + &table(&HEAD, rows)
}

/// What the search for a constant gait cost, beside trainings.
fn search(constant: &Constant<'_>, trainings: &[Run<'_>]) -> String {
    let search = &constant.search;
    let trainings: Vec<f64> = trainings.iter().map(|run| run.cost.simulated_secs).collect();
    paragraph(&format!(
        "The search tried {} gaits in {} episodes, {} of simulated time; a training of Group_1 had {}.",
        count(search.gaits),
        count(search.episodes),
        duration(search.simulated_secs),
        spread(&trainings, duration),
    ))
}

fn verdict(against: &Against) -> String {
    paragraph(&format!("{} {}", against.words, against.why))
}

fn gait(name: &str, constant: &Constant<'_>) -> String {
    let gait = &constant.gait;
    format!(
        "{name}: v_x {:.2} m/s, S {:.3} m, H {:.4} m, Δt {:.3} s",
        gait.velocity_mps, gait.stride_m, gait.lift_m, gait.step_secs
    )
}

fn row(name: String, evaluation: &Evaluation, constant: Option<&Evaluation>) -> Vec<String> {
    let (less, verdict) = constant.map_or(("–".to_owned(), "–"), |constant| {
        let verdict = Verdict::of(&evaluation.value, &constant.value);
        (interval(&difference(evaluation, constant), 1), verdict.name())
    });
    vec![
        name,
        interval(&evaluation.value, 1),
        less,
        verdict.to_owned(),
        interval(&evaluation.speed_mps, 3),
        format!("{:.1e}", evaluation.roll_variance.mean),
        format!("{:.1e}", evaluation.pitch_variance.mean),
        percent(evaluation.fall_rate),
    ]
}

fn interval(interval: &Interval, decimals: usize) -> String {
    let half = interval.half.map(|half| format!(" ± {half:.decimals$}")).unwrap_or_default();
    format!("{:.decimals$}{half}", interval.mean)
}
