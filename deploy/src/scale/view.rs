//! Scaling figures as a table, and as a plot.

use super::figures::Figures;
use super::meter::{Latency, Lost};
use crate::report::svg::{Plot, Scale, Series, Style};
use crate::table::{bytes, columns, count};

/// The table of all points, then the bottleneck of each.
pub(crate) fn table(points: &[Figures]) -> String {
    let head = [
        "actors",
        "transitions/s",
        "updates/s",
        "episodes/s",
        "in/s",
        "out/s",
        "stale",
        "learner cores",
        "actor cores",
        "commit p50/p99",
        "broadcast p50/p99",
        "policy",
    ];
    let head = head.map(str::to_owned).to_vec();
    let mut text = columns(&std::iter::once(head).chain(points.iter().map(row)).collect::<Vec<_>>());
    text.push('\n');
    text + &points.iter().map(told).collect::<String>()
}

/// What is to be known about a point beside its row.
fn told(f: &Figures) -> String {
    let name = f.setting.name();
    let bottleneck = format!("{name} actors: {}\n", f.bottleneck);
    let Some(Lost { subscribers, why }) = &f.lost else { return bottleneck };
    let lost = "WARNING: subscribers that stopped following";
    format!("{bottleneck}{name} actors: {lost}: {subscribers}; the first: {why}\n")
}

fn row(f: &Figures) -> Vec<String> {
    let whole = |x: f64| count(x.round() as u64);
    vec![
        f.setting.name(),
        whole(f.transitions_per_sec),
        format!("{:.1}", f.updates_per_sec),
        format!("{:.1}", f.episodes_per_sec),
        bytes(f.received_bytes_per_sec as u64),
        bytes(f.sent_bytes_per_sec as u64),
        format!("{:.1}", f.staleness),
        format!("{:.2}", f.signs.learner_cores),
        format!("{:.2}", f.signs.actors_cores),
        latency(f.commit),
        latency(f.broadcast),
        f.policy_bytes.map_or("–".to_owned(), bytes),
    ]
}

fn latency(latency: Option<Latency>) -> String {
    latency.map_or("–".to_owned(), |l| format!("{:.1} / {:.1} ms", l.p50_ms, l.p99_ms))
}

/// Transitions and updates per second over the number of actors.
pub(crate) fn plot(points: &[Figures]) -> String {
    let line = |of: fn(&Figures) -> f64| points.iter().map(|f| (f64::from(f.setting.actors), of(f))).collect();
    let series = |name: &str, style, points| Series { name: name.to_owned(), style, points };
    let mut drawn = vec![
        series("transitions per second", Style::Line, line(|f| f.transitions_per_sec)),
        series("", Style::Dots, line(|f| f.transitions_per_sec)),
    ];
    if points.iter().any(|f| f.updates_per_sec > 0.0) {
        drawn.push(series("updates per second", Style::Faint, line(|f| f.updates_per_sec)));
    }
    let plot = Plot {
        title: "Scaling: what one learner takes in".into(),
        x_label: "actors".into(),
        y_label: "per second".into(),
        x_scale: Scale::Decades,
        series: drawn,
    };
    plot.to_svg()
}

#[cfg(test)]
mod tests {
    use super::super::figures::{Setting, Sight};
    use super::*;

    #[test]
    fn every_point_has_a_row_a_bottleneck_and_a_mark() {
        let point = |actors| {
            let setting = Setting { actors, robots: 1, cores: 2, allowed: 17, ..Setting::default() };
            let mut to = Sight { at: 1.0, ..Sight::default() };
            (to.status.transitions, to.status.time.idle_secs) = (u64::from(actors) * 1500, 1.0);
            Figures::between(setting, &Sight::default(), &to)
        };
        let mut points = [point(1), point(2), point(2)];
        points[2].setting.round = 2;
        points[2].lost = Some(Lost { subscribers: 3, why: "gone".into() });
        let text = table(&points);
        assert!(text.contains("3,000") && text.contains("2 actors: actors: the time that episodes take"), "{text}");
        assert!(
            text.contains("2 #2 actors: WARNING: subscribers that stopped following: 3; the first: gone"),
            "{text}"
        );
        assert!(text.matches("WARNING").count() == 1, "{text}");
        assert_eq!(plot(&points).matches("<circle").count(), 3, "three marks, and none in the legend");
    }
}
