//! Figures as text, and as JSON without rounding.

use super::figures::{Mean, Result};
use crate::table::{columns, count, facts, percent};
use herd_common::config::Config;
use serde::Serialize;

/// Everything, exact.
#[derive(Serialize)]
pub(crate) struct Json<'a> {
    task: &'static str,
    task_hash: String,
    seed: u64,
    results: &'a [Result],
}

impl<'a> Json<'a> {
    /// These results under this configuration.
    pub(crate) fn new(config: &Config, results: &'a [Result]) -> Self {
        Self { task: config.task.kind.name(), task_hash: config.task_hash(), seed: config.seed, results }
    }
}

/// One case: a row an episode, then the means.
pub(crate) fn single(result: &Result) -> String {
    let head = "episode return seconds ending m/s roll² pitch² realtime".split(' ').map(str::to_owned).collect();
    let rows = result.episodes.iter().enumerate().map(|(index, episode)| {
        let o = &episode.outcome;
        vec![
            index.to_string(),
            format!("{:.1}", o.reward.total()),
            format!("{:.2}", o.seconds),
            o.ending.name().to_owned(),
            format!("{:.3}", o.mean_speed()),
            format!("{:.1e}", o.roll_variance),
            format!("{:.1e}", o.pitch_variance),
            format!("{:.1}×", o.seconds / episode.wall_secs.max(1e-9)),
        ]
    });
    let table = columns(&std::iter::once(head).chain(rows).collect::<Vec<_>>());
    format!("{}\n\n{table}\n{}", result.label, means(&result.mean))
}

fn means(mean: &Mean) -> String {
    let error = mean.speed_error.map(|error| format!(", {} off its command", percent(error))).unwrap_or_default();
    let terms = format!(
        "velocity {:+.1}, survival {:+.1}, heading {:+.2}, effort {:+.2}",
        mean.velocity, mean.survival, mean.heading, mean.effort
    );
    let qp = format!("{} solved, {} given up", count(mean.qp_solves), count(mean.qp_failures));
    let following = mean.following.map(|following| {
        let (velocity, turn) = (following.velocity_error, following.turn_error);
        ("off its command", format!("{velocity:.3} m/s, {turn:.3} rad/s, root mean square"))
    });
    let lines = [
        ("mean return", format!("{:.1} ± {:.1}: {terms}", mean.value, mean.return_deviation)),
        ("mean length", format!("{:.2} s", mean.seconds)),
        ("mean speed", format!("{:.3} m/s{error}", mean.speed_mps)),
        ("variance", format!("roll {:.2e}, pitch {:.2e} rad²", mean.roll_variance, mean.pitch_variance)),
        ("endings", endings(mean)),
        ("QP", qp),
        ("speed", format!("{:.1}× real time on one thread", mean.realtime_factor)),
    ];
    facts(&lines.into_iter().chain(following).collect::<Vec<_>>())
}

/// One row a case.
pub(crate) fn sweep(results: &[Result]) -> String {
    rows(results.iter())
}

/// Best, median and mean of a grid, and how much of it falls.
pub(crate) fn grid(results: &[Result]) -> String {
    let mut ranked: Vec<&Result> = results.iter().collect();
    ranked.sort_by(|a, b| b.mean.value.total_cmp(&a.mean.value));
    let n = ranked.len();
    let of_all = |figure: &dyn Fn(&Mean) -> f64| results.iter().map(|r| figure(&r.mean)).sum::<f64>() / n as f64;
    let middle = ranked[n / 2];
    let lines = facts(&[
        ("gaits", n.to_string()),
        ("best return", format!("{:.1}: {}", ranked[0].mean.value, ranked[0].label)),
        ("median return", format!("{:.1}: {}", middle.mean.value, middle.label)),
        ("mean return", format!("{:.1}", of_all(&|mean| mean.value))),
        ("falls", percent(of_all(&|mean| mean.fall_rate))),
        ("gaits that never fall", ranked.iter().filter(|r| r.mean.fall_rate == 0.0).count().to_string()),
    ]);
    let (best, worst) = (ranked.iter().take(SHOWN), ranked.iter().rev().take(SHOWN).rev());
    let shown = if n > 2 * SHOWN { rows(best.chain(worst).copied()) } else { rows(ranked.iter().copied()) };
    format!("{lines}\n{shown}")
}

/// Rows of the best and of the worst gaits of a grid.
const SHOWN: usize = 5;

fn rows<'a>(results: impl Iterator<Item = &'a Result>) -> String {
    let head = "case|return|seconds|m/s|error|roll²|pitch²|falls|endings".split('|').map(str::to_owned).collect();
    let rows = results.map(|result| {
        let mean = &result.mean;
        vec![
            result.label.clone(),
            format!("{:.1}", mean.value),
            format!("{:.2}", mean.seconds),
            format!("{:.3}", mean.speed_mps),
            mean.speed_error.map_or("–".to_owned(), percent),
            format!("{:.1e}", mean.roll_variance),
            format!("{:.1e}", mean.pitch_variance),
            percent(mean.fall_rate),
            endings(mean),
        ]
    });
    columns(&std::iter::once(head).chain(rows).collect::<Vec<_>>())
}

fn endings(mean: &Mean) -> String {
    mean.endings.iter().map(|(name, n)| format!("{name} {n}")).collect::<Vec<_>>().join(", ")
}
