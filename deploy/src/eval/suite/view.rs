//! The suite's figures as text.

use super::conditions::{DIRECTIONS, IMPULSES_NS};
use super::interval;
use super::measure::{Findings, Pushed, Row};
use crate::table::{columns, percent};

/// One subject: a row a case, then the push map.
pub(super) fn subject(found: &Findings) -> String {
    let head = "case|n|return|95 %|falls|95 %|m/s|off|roll²|pitch²|CoT|m".split('|').map(str::to_owned).collect();
    let mut rows: Vec<Vec<String>> = vec![head, row("plain".to_owned(), &found.plain)];
    for group in &found.groups {
        let label = |case: &Row| format!("{} {} {}", group.quantity, case.value, group.unit);
        rows.extend(group.rows.iter().map(|case| row(label(case), case)));
    }
    format!("{}\n\n{}\n{}", found.label, columns(&rows), pushes(&found.pushes))
}

fn row(label: String, row: &Row) -> Vec<String> {
    let range = |[low, high]: [f64; 2], decimals: usize| format!("{low:.decimals$}–{high:.decimals$}");
    vec![
        label,
        row.episodes.to_string(),
        format!("{:.1}", row.mean_return),
        row.return_interval.map_or("–".to_owned(), |interval| range(interval, 1)),
        percent(row.fall_rate),
        range(row.fall_interval.map(|share| 100.0 * share), 0),
        format!("{:.3}", row.speed_mps),
        row.speed_error.map_or("–".to_owned(), percent),
        format!("{:.1e}", row.roll_variance),
        format!("{:.1e}", row.pitch_variance),
        row.cost_of_transport.map_or("–".to_owned(), |cost| format!("{cost:.2}")),
        format!("{:.2}", row.distance_m),
    ]
}

/// Share of pushes that were stood, by impulse and direction.
fn pushes(pushes: &[Pushed]) -> String {
    let directions = pushes.iter().take(DIRECTIONS).map(|pushed| format!("{:.0}°", pushed.direction_deg));
    let head = ["pushes stood"].map(str::to_owned).into_iter().chain(directions);
    let head: Vec<String> = head.chain(["all", "95 %"].map(str::to_owned)).collect();
    let rows = IMPULSES_NS.into_iter().zip(pushes.chunks(DIRECTIONS)).map(|(impulse, ring)| {
        let (falls, of) = ring.iter().fold((0, 0), |(falls, of), one| (falls + one.falls, of + one.episodes));
        let [low, high] = interval::of_share(of - falls, of).map(|share| 100.0 * share);
        let cells = ring.iter().map(|one| format!("{:.0} %", 100.0 * one.stood()));
        let all = [percent(1.0 - falls as f64 / of as f64), format!("{low:.0}–{high:.0}")];
        std::iter::once(format!("{impulse} N·s")).chain(cells).chain(all).collect()
    });
    columns(&std::iter::once(head).chain(rows).collect::<Vec<Vec<String>>>())
}
