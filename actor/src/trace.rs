//! Traces: an episode written down tick by tick, and torques of one replayed without feedback.

use crate::env::{Env, Observation};
use crate::robot::Model;
use crate::sim::{Contacts, Snapshot, Start, World, flat, legs};
use herd_common::config::Config;
use herd_common::episode::Outcome;
use herd_common::seed::Seed;
use std::sync::{Arc, Mutex, PoisonError};

/// One tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Record {
    /// Joint torques over the tick, N·m.
    pub torques: [f64; 12],
    /// The robot after it.
    pub after: Snapshot,
}

/// An episode, tick by tick.
#[derive(Clone, Debug)]
pub struct Trace {
    /// The robot at t = 0.
    pub start: Snapshot,
    /// Its ticks, each with the number of the decision that it belongs to.
    pub ticks: Vec<(u64, Record)>,
    /// How it ended.
    pub outcome: Outcome,
}

/// Records the episode of `seed`; `act` chooses as in `rollout`.
pub fn record(config: &Config, seed: Seed, act: &mut dyn FnMut(&Observation) -> Vec<f32>) -> Trace {
    let tape = Arc::new(Mutex::new(Vec::new()));
    let sink = Arc::clone(&tape);
    let mut env = Env::new(config);
    let mut observation = env.reset(seed);
    let start = Snapshot::new(env.state(), env.contacts());
    env.set_observer(Some(Box::new(move |state, contacts, torques| {
        let record = Record { torques: flat(torques), after: Snapshot::new(state, contacts) };
        sink.lock().unwrap_or_else(PoisonError::into_inner).push(record);
    })));
    let mut ticks = Vec::new();
    for decision in 0.. {
        let step = env.step(&act(&observation));
        let records = std::mem::take(&mut *tape.lock().unwrap_or_else(PoisonError::into_inner));
        ticks.extend(records.into_iter().map(|record| (decision, record)));
        if step.ending.is_some() {
            break;
        }
        observation = step.observation;
    }
    Trace { start, ticks, outcome: env.outcome() }
}

/// Replays torques (N·m), each held for `hold_ticks` of this configuration's ticks, from this state on, on level ground,
/// without feedback. Gives one record a hold; its ground forces are means over the hold.
pub fn replay(config: &Config, start: &Snapshot, torques: &[[f64; 12]], hold_ticks: u32) -> Vec<Record> {
    let model = Model::new(&config.robot);
    let state = start.state();
    let pose = Start { position: state.position, rotation: state.rotation, joints: state.joints };
    let mut world = World::new(&model, &config.sim, &pose);
    world.set_speeds(&state);
    let hold = |torques: &[f64; 12]| {
        let held = legs(torques);
        let mut mean = Contacts::default();
        for _ in 0..hold_ticks {
            world.tick(&held);
            add_share(&mut mean, &world.contacts(), 1.0 / f64::from(hold_ticks));
        }
        Record { torques: *torques, after: Snapshot::new(&world.state(), &mean) }
    };
    torques.iter().map(hold).collect()
}

/// Adds a share of these forces; any touch of trunk or knees counts, of the feet the last.
fn add_share(sum: &mut Contacts, contacts: &Contacts, share: f64) {
    for leg in 0..4 {
        sum.normal[leg] += share * contacts.normal[leg];
        sum.friction[leg] += share * contacts.friction[leg];
    }
    sum.feet = contacts.feet;
    sum.trunk |= contacts.trunk;
    sum.knee |= contacts.knee;
}

#[cfg(test)]
mod tests {
    use super::*;

    fn config(sets: &[&str]) -> Config {
        let sets: Vec<String> = sets.iter().map(|set| (*set).to_owned()).collect();
        Config::load(None, &sets).expect("valid")
    }

    fn trot() -> (Config, Trace) {
        let config = config(&["task.kind=constant", "task.episode_secs=0.9"]);
        let trace = record(&config, Seed::from_number(1), &mut |_| Vec::new());
        (config, trace)
    }

    #[test]
    fn a_trace_is_the_whole_episode() {
        let (config, trace) = trot();
        let plain = crate::rollout::run_constant(&config, &config.task.constant, Seed::from_number(1)).0;
        assert_eq!((trace.ticks.len(), trace.outcome), (450, plain));
        assert_eq!(trace.ticks[449].0, 5);
        let moved = trace.ticks[449].1.after.position[0] - trace.start.position[0];
        assert!((moved - plain.distance_m).abs() < 1e-12);
    }

    #[test]
    fn a_replay_at_the_same_step_begins_as_the_episode_did() {
        let (config, trace) = trot();
        let from = 300;
        let torques: Vec<_> = trace.ticks[from..from + 50].iter().map(|(_, record)| record.torques).collect();
        let again = replay(&config, &trace.ticks[from - 1].1.after, &torques, 1);
        assert_eq!(again.len(), 50);
        for (found, (_, expected)) in again.iter().zip(&trace.ticks[from..]) {
            assert_eq!(found.torques, expected.torques);
            let apart = found.after.joints.iter().zip(&expected.after.joints).map(|(a, b)| (a - b).abs());
            // Not to the bit: the impulses that rapier's solver starts from are in no snapshot. What they make is 3e-4 rad
            // after 50 ticks as after the first.
            assert!(apart.fold(0.0, f64::max) < 2e-3);
        }
    }

    #[test]
    fn a_torque_is_held_over_finer_ticks() {
        let (_, trace) = trot();
        let fine = config(&["sim.tick_secs=0.0005"]);
        let torques: Vec<_> = trace.ticks[..25].iter().map(|(_, record)| record.torques).collect();
        let again = replay(&fine, &trace.start, &torques, 4);
        let (found, expected) = (again[24].after, trace.ticks[24].1.after);
        assert!((found.position[2] - expected.position[2]).abs() < 2e-3);
        let feet = found.contacts().feet;
        assert!(feet.into_iter().filter(|on_ground| *on_ground).count() >= 2, "a pair at least bears it: {feet:?}");
        let apart = found.joints.iter().zip(&expected.joints).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(apart > 0.0 && apart < 0.05, "{apart}");
    }
}
