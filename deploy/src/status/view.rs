//! A status snapshot as text.

use crate::table::{bytes, columns, count, duration, facts, percent};
use herd_common::hash::short;
use herd_common::status::{Actor, Status};

/// The whole snapshot.
pub(crate) fn render(status: &Status) -> String {
    let mut text = facts(&[
        ("run", run(status)),
        ("progress", progress(status)),
        ("return", returns(status)),
        ("episodes", episodes(status)),
        ("rates", rates(status)),
        ("replay", replay(status)),
        ("losses", losses(status)),
        ("history", history(status)),
        ("QP", qp(status)),
        ("endings", endings(status)),
        ("bottleneck", status.bottleneck.clone()),
    ]);
    text.push('\n');
    text + &actors(&status.actors)
}

fn run(s: &Status) -> String {
    format!("{}, epoch {}, {}, {}, up {}", short(&s.run), s.epoch, s.phase, s.schedule, duration(s.uptime_secs))
}

fn progress(s: &Status) -> String {
    let share = if s.episodes_target > 0 { s.episodes as f64 / s.episodes_target as f64 } else { 1.0 };
    let eta = s.eta_secs.map(|eta| format!(", {} to go", duration(eta))).unwrap_or_default();
    format!("{} of {} episodes ({}){eta}", count(s.episodes), count(s.episodes_target), percent(share))
}

fn returns(s: &Status) -> String {
    let evaluation = s.returns.evaluation.map(|mean| format!(", evaluation {mean:.1}")).unwrap_or_default();
    format!("mean {:.1}, last {:.1}, best {:.1}{evaluation}", s.returns.mean, s.returns.last, s.returns.best)
}

fn episodes(s: &Status) -> String {
    format!("mean length {:.1} s, {} end in a fall", s.returns.seconds, percent(s.returns.fall_rate))
}

fn rates(s: &Status) -> String {
    let rates = &s.rates;
    format!(
        "{:.2} episodes/s, {:.0} transitions/s, {:.0} updates/s, {:.1}× real time",
        rates.episodes,
        rates.transitions,
        rates.updates,
        realtime_factor(s)
    )
}

/// Simulated seconds per second over all actors.
pub(crate) fn realtime_factor(s: &Status) -> f64 {
    // An empty sum of floats is −0.
    s.actors.iter().map(|actor| actor.realtime_factor).sum::<f64>() + 0.0
}

fn replay(s: &Status) -> String {
    format!(
        "{} of {} transitions ({} committed, {} updates), policies {:.1} versions old",
        count(s.replay.len),
        count(s.replay.capacity),
        count(s.transitions),
        count(s.updates),
        s.replay.staleness
    )
}

fn losses(s: &Status) -> String {
    let skipped = if s.losses.skipped > 0 { format!(", {} updates skipped", s.losses.skipped) } else { String::new() };
    format!("critic {:.4}, actor {:.4}, mean value {:.3}{skipped}", s.losses.critic, s.losses.actor, s.losses.value)
}

fn history(s: &Status) -> String {
    let age = s.history.checkpoint_age_secs.map_or("none yet".to_owned(), |age| format!("{} old", duration(age)));
    format!(
        "journal {}, checkpoint {age}, {} episodes since; kept in {}",
        bytes(s.history.journal_bytes),
        s.history.episodes_since_checkpoint,
        s.durability
    )
}

fn qp(s: &Status) -> String {
    let qp = &s.qp;
    format!(
        "{} solved, {} given up, median {:.0} µs, 99 % within {:.0} µs",
        count(qp.solves),
        count(qp.failures),
        qp.p50_micros,
        qp.p99_micros
    )
}

/// How episodes ended, most frequent first.
pub(crate) fn endings(s: &Status) -> String {
    let mut endings: Vec<_> = s.endings.iter().filter(|(_, n)| *n > 0).collect();
    endings.sort_by_key(|(_, n)| std::cmp::Reverse(*n));
    let told: Vec<String> = endings.iter().map(|(name, n)| format!("{name} {}", count(*n))).collect();
    if told.is_empty() { "none yet".to_owned() } else { told.join(", ") }
}

fn actors(actors: &[Actor]) -> String {
    if actors.is_empty() {
        return "no actors\n".to_owned();
    }
    let head = "actor host pid robots leases episodes falls realtime policy QP50µs QP99µs seen";
    let head = head.split(' ').map(str::to_owned).collect();
    let rows = actors.iter().map(|a| {
        let text = [a.id.to_string(), a.host.clone(), a.pid.to_string(), a.robots.to_string(), a.leases.to_string()];
        let work =
            [count(a.episodes), count(a.falls), format!("{:.1}×", a.realtime_factor), a.policy_version.to_string()];
        let rest = [
            format!("{:.0}", a.qp.p50_micros),
            format!("{:.0}", a.qp.p99_micros),
            format!("{:.1} s ago", a.last_seen_secs),
        ];
        text.into_iter().chain(work).chain(rest).collect::<Vec<_>>()
    });
    columns(&std::iter::once(head).chain(rows).collect::<Vec<_>>())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_actor_has_a_row_and_endings_are_sorted() {
        let actor = |id| Actor { id, host: "node".into(), realtime_factor: 4.5, ..Actor::default() };
        let status = Status {
            actors: vec![actor(1), actor(2)],
            endings: vec![("fell_roll".into(), 2), ("diverged".into(), 0), ("timed_out".into(), 30)],
            bottleneck: "the learner".into(),
            ..Status::default()
        };
        let text = render(&status);
        assert!(text.contains("timed_out 30, fell_roll 2\n"), "{text}");
        assert!(text.contains("9.0× real time"), "{text}");
        assert_eq!(text.lines().filter(|line| line.contains("node")).count(), 2, "{text}");
        assert!(text.contains("bottleneck  the learner"), "{text}");
    }

    #[test]
    fn an_empty_snapshot_has_a_text() {
        let text = render(&Status::default());
        assert!(text.ends_with("no actors\n") && text.contains(" 0.0× real time"), "{text}");
    }
}
