//! The path from ten robots to a hundred thousand: designs, each one step from the last, through the model.

use super::model::{Demand, Design, Prediction, predict};
use crate::table::{columns, count, percent};

/// What was measured on one machine, from which the rest follows.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Measured {
    /// Updates per second at batch 64 on the CPU.
    pub(crate) updates_per_sec: f64,
    /// Transitions per second, durable.
    pub(crate) ingest_per_sec: f64,
}

/// Real time, ten seconds, a decision every eighth of a second.
const EPISODE: (f64, f64) = (10.0, 80.0);
const ROBOTS: [u64; 5] = [10, 100, 1_000, 10_000, 100_000];
/// The default network as f32.
const POLICY_BYTES: f64 = 643_088.0;
/// 10 Gbit/s.
const LINK: f64 = 1.25e9;
/// Plain DDPG at batch 4096 on an NVIDIA H200, measured: `docs/gpu.md`.
const GPU_UPDATES_PER_SEC: f64 = 1670.0;

fn designs(measured: Measured) -> [Design; 4] {
    let today = Design {
        name: "one learner, batch 64, an update a transition",
        updates_per_transition: 1.0,
        updates_per_sec: measured.updates_per_sec,
        ingest_per_sec: measured.ingest_per_sec,
        shards: 1,
        robots_per_actor: 8,
        fan_out: u64::MAX,
        policy_bytes: POLICY_BYTES,
        link_bytes_per_sec: LINK,
    };
    // As many samples a transition as before, in batches 64 times as large.
    let gpu = Design {
        name: "GPU learner, batch 4096, an update each 64 transitions",
        updates_per_transition: 1.0 / 64.0,
        updates_per_sec: GPU_UPDATES_PER_SEC,
        ..today
    };
    let relays =
        Design { name: "and relays, 32 below each node, f16", fan_out: 32, policy_bytes: POLICY_BYTES / 2.0, ..gpu };
    let sharded = Design {
        name: "and 8 ingest shards, an update each 1024 transitions",
        shards: 8,
        updates_per_transition: 1.0 / 1024.0,
        ..relays
    };
    [today, gpu, relays, sharded]
}

/// The table of every design with every number of robots.
pub(crate) fn table(measured: Measured) -> String {
    let [episode_secs, decisions] = [EPISODE.0, EPISODE.1];
    let mut text = String::new();
    for design in designs(measured) {
        let head = "robots transitions/s updates/s updates ingest broadcast stale wait delivery bottleneck";
        let mut rows = vec![head.split(' ').map(str::to_owned).collect::<Vec<_>>()];
        for robots in ROBOTS {
            rows.push(row(robots, &predict(Demand { robots, episode_secs, decisions }, design)));
        }
        text += design.name;
        text.push('\n');
        text += &columns(&rows);
        text.push('\n');
    }
    text
}

fn row(robots: u64, p: &Prediction) -> Vec<String> {
    let whole = |x: f64| count(x.round() as u64);
    // A full queue grows with the time that is looked at; its length says nothing.
    let full = p.learner.max(p.ingest) > 0.99;
    let settled = |figure: String| if full { "–".to_owned() } else { figure };
    vec![
        count(robots),
        whole(p.transitions_per_sec),
        whole(p.updates_per_sec),
        percent(p.learner),
        percent(p.ingest),
        percent(p.broadcast),
        settled(whole(p.staleness)),
        settled(format!("{:.2} s", p.wait_secs)),
        format!("{:.3} s", p.delivery_secs),
        p.bottleneck().to_owned(),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_step_lifts_what_stopped_the_one_before() {
        let designs = designs(Measured { updates_per_sec: 70.0, ingest_per_sec: 250_000.0 });
        let at = |design: usize, robots| {
            predict(Demand { robots, episode_secs: EPISODE.0, decisions: EPISODE.1 }, designs[design])
        };
        assert_eq!(at(0, 100).bottleneck(), "updates");
        assert_ne!(at(1, 1_000).bottleneck(), "updates");
        assert_eq!(at(2, 100_000).bottleneck(), "updates");
        assert!(at(3, 100_000).transitions_per_sec > 10.0 * at(2, 100_000).transitions_per_sec.min(64_000.0));
    }
}
