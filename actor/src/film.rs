//! An episode as a film: the robot's pose every so often, and what its decisions were worth if each is paid once.
//!
//! The pictures are what views from the side and from behind need: outlines of the trunk, four points of each leg.
//! Everything is a function of configuration, seed and who acts; filming an episode does not change it.

use crate::env::{Env, Observation};
use crate::robot::{Leg, LegPoint, Model};
use crate::sim::{Contacts, RobotState};
use herd_common::episode::{Ending, Outcome, Reward};
use herd_common::seed::Seed;
use serde::{Deserialize, Serialize};
use std::sync::mpsc;

/// A point of the world: x forward, y left, z up, m.
pub type Point = [f64; 3];

/// One picture.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Frame {
    /// Time since the episode began, s.
    pub secs: f64,
    /// Centre of mass of the whole robot.
    pub centre: Point,
    /// Roll, pitch, yaw of the trunk, rad.
    pub angles: [f64; 3],
    /// The trunk's outline in its own xz plane: front top, front bottom, rear bottom, rear top.
    pub trunk: [Point; 4],
    /// The same in its yz plane: left top, left bottom, right bottom, right top.
    pub across: [Point; 4],
    /// Hip, top of the thigh, knee and foot of each leg, in leg order.
    pub legs: [[Point; 4]; 4],
    /// True for a foot that the ground carries.
    pub down: [bool; 4],
}

/// A filmed episode.
#[derive(Clone, Debug, PartialEq)]
pub struct Film {
    /// Its summary, the return summed as the configuration says.
    pub outcome: Outcome,
    /// Eq 10 taken once at the end of each decision, and summed.
    pub per_decision: Reward,
    /// Pictures in order; none if none were asked for.
    pub frames: Vec<Frame>,
}

/// Runs the episode of `seed` and takes a picture every `every_ticks` ticks, the first of them at the start; 0 for none.
pub fn film(env: &mut Env, seed: Seed, every_ticks: u64, act: &mut dyn FnMut(&Observation) -> Vec<f32>) -> Film {
    let observation = env.reset(seed);
    finish(env, observation, every_ticks, act)
}

/// The same for an episode that has been reset, from what the policy sees now.
///
/// The decision in which the simulation diverged is not paid.
pub fn finish(
    env: &mut Env,
    mut observation: Observation,
    every_ticks: u64,
    act: &mut dyn FnMut(&Observation) -> Vec<f32>,
) -> Film {
    let (camera, frames) = mpsc::channel();
    if every_ticks > 0 {
        let (model, tick_secs) = (env.model().clone(), env.tick_secs());
        // Nobody has looked at the ground yet: the robot was set down on all four feet.
        let _ = camera.send(Frame::new(&model, 0.0, env.state(), [true; 4]));
        let mut ticks = 0;
        env.set_observer(Some(Box::new(move |state: &RobotState, contacts: &Contacts, _: &_| {
            ticks += 1;
            if ticks % every_ticks == 0 {
                // The film is over when nobody takes its frames any more.
                let _ = camera.send(Frame::new(&model, ticks as f64 * tick_secs, state, contacts.feet));
            }
        })));
    }
    let mut per_decision = Reward::default();
    loop {
        let step = env.step(&act(&observation));
        if step.ending != Some(Ending::Diverged) {
            per_decision += step.moment;
        }
        observation = step.observation;
        if step.ending.is_some() {
            break;
        }
    }
    env.set_observer(None);
    Film { outcome: env.outcome(), per_decision, frames: frames.try_iter().collect() }
}

impl Frame {
    fn new(model: &Model, secs: f64, state: &RobotState, down: [bool; 4]) -> Self {
        let world = |body: nalgebra::Vector3<f64>| Point::from(state.position + state.rotation * body);
        let legs = Leg::ALL.map(|leg| model.geometry.posture(leg, &state.joints[leg.index()]));
        let half = model.trunk_size / 2.0;
        let corner = |x: f64, y: f64, z: f64| world(nalgebra::Vector3::new(x * half.x, y * half.y, z * half.z));
        let outline = |of: &dyn Fn(f64, f64) -> Point| [of(1.0, 1.0), of(1.0, -1.0), of(-1.0, -1.0), of(-1.0, 1.0)];
        let geometry = &model.geometry;
        let thigh_top = LegPoint { outwards: geometry.hip_link, thigh: 0.0, calf: 0.0 };
        let knee = LegPoint { thigh: geometry.thigh, ..thigh_top };
        let points = |leg: Leg| {
            let posture = &legs[leg.index()];
            let of = |point| world(posture.position(point));
            [world(geometry.hip(leg)), of(thigh_top), of(knee), of(geometry.foot())]
        };
        Self {
            secs,
            centre: world(model.centre(&legs)),
            angles: state.angles().into(),
            trunk: outline(&|x, z| corner(x, 0.0, z)),
            across: outline(&|y, z| corner(0.0, y, z)),
            legs: Leg::ALL.map(points),
            down,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rollout::run_episode;
    use herd_common::config::Config;

    fn env(sets: &[&str]) -> Env {
        let sets: Vec<String> = sets.iter().map(|set| (*set).to_owned()).collect();
        Env::new(&Config::load(None, &sets).expect("valid"))
    }

    #[test]
    fn filming_changes_nothing_and_shows_the_whole_robot() {
        let mut env = env(&["task.kind=constant", "task.episode_secs=1", "task.constant.velocity_mps=0.6"]);
        let seed = Seed::from_number(3);
        let plain = run_episode(&mut env, seed, &mut |_| Vec::new(), &mut |_| {});
        let film = film(&mut env, seed, 10, &mut |_| Vec::new());
        assert_eq!(film.outcome, plain);
        assert_eq!(film.frames.len(), 51, "one at the start, then every 20 ms of a second");
        let times: Vec<f64> = film.frames.iter().map(|frame| frame.secs).collect();
        assert!((times[50] - 1.0).abs() < 1e-9 && times.is_sorted(), "{times:?}");
        let (first, last) = (&film.frames[0], &film.frames[50]);
        // The centre of mass and the trunk's middle go the same way; feet are on the ground, knees above it.
        assert!((last.centre[0] - first.centre[0] - plain.distance_m).abs() < 0.03, "{last:?}");
        for frame in &film.frames {
            let [hip, top, knee, foot] = frame.legs[1];
            let length = |a: Point, b: Point| (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt();
            assert!((length(top, knee) - 0.1256).abs() < 1e-9 && (length(knee, foot) - 0.136).abs() < 1e-9);
            assert!((length(hip, top) - 0.049).abs() < 1e-9);
            assert!(foot[2] > 0.0 && foot[2] < 0.06 && knee[2] > foot[2] && foot[1] < 0.0, "{frame:?}");
            assert!((length(frame.trunk[0], frame.trunk[3]) - 0.238).abs() < 1e-9);
            assert!(frame.across[0][1] > 0.0 && frame.across[3][1] < 0.0 && frame.across[0][2] > frame.across[1][2]);
        }
        let stances = film.frames.iter().filter(|frame| frame.down.iter().filter(|down| **down).count() == 2).count();
        assert!(stances > 25, "a trot stands on two feet most of the time: {stances}");
    }

    #[test]
    fn what_a_decision_pays_once_is_its_last_sample() {
        // A torque decision holds one sample, at its end; so both ways of paying agree there.
        let mut torque = env(&["task.kind=torque", "task.episode_secs=0.2", "task.ending.height_m=0"]);
        let sample = film(&mut torque, Seed::from_number(1), 0, &mut |_| vec![0.1; 12]);
        assert!(sample.frames.is_empty());
        let (once, summed) = (sample.per_decision, sample.outcome.reward);
        assert!((once.total() - summed.total()).abs() < 1e-9, "{once:?} {summed:?}");
        // A gait decision of 0.15 s holds six, so a second has 40 samples and 7 decisions.
        let mut gait = env(&["task.kind=constant", "task.episode_secs=1"]);
        let sample = film(&mut gait, Seed::from_number(1), 0, &mut |_| Vec::new());
        assert_eq!(sample.outcome.decisions, 7);
        let ratio = sample.per_decision.survival / sample.outcome.reward.survival;
        assert!((ratio - 7.0 / 40.0).abs() < 1e-9, "{ratio}");
    }

    #[test]
    fn a_decision_is_paid_for_the_command_that_it_followed() {
        // A sample and a new command at the end of every decision: both ways of paying agree, if both go by the same command.
        let rhythm =
            ["task.gait.step_secs=[0.15, 0.15]", "task.reward.sample_secs=0.15", "task.command.every_secs=0.15"];
        let mut env = env(&[&["task.kind=command", "task.episode_secs=0.9"], &rhythm[..]].concat());
        let film = film(&mut env, Seed::from_number(2), 0, &mut |_| vec![0.0; 4]);
        let (once, summed) = (film.per_decision, film.outcome.reward);
        assert!(film.outcome.decisions == 6 && (once.total() - summed.total()).abs() < 1e-9, "{once:?} {summed:?}");
    }
}
