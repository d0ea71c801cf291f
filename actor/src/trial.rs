//! A hard but reproducible trial: a robot under an erratic policy that is pushed about. Benches, examples and tests ask
//! the MPC what the controller asked it there.
//!
//! The policy's weights are random and large, so that it answers differently to every observation and uses the whole box
//! of gaits. Pushes come before one decision in four, from any side. An episode ends with a fall or its time limit.

use crate::env::Env;
use crate::mpc::{State, Step};
use herd_common::config::Config;
use herd_common::policy::{Layer, Policy, Provenance};
use herd_common::seed::Seed;
use nalgebra::Vector3;
use rand::{Rng, RngExt};
use std::f64::consts::TAU;
use std::sync::{Arc, Mutex, PoisonError};

/// Force of a push, N: from hardly felt to half the robot's weight.
const PUSH_N: std::ops::Range<f64> = 10.0..70.0;
/// Length of a push, s.
const PUSH_SECS: f64 = 0.1;
/// Share of decisions that begin with a push.
const PUSHED: f64 = 0.25;

/// What the controller asked the MPC.
#[derive(Clone, Debug, PartialEq)]
pub struct Question {
    /// The robot.
    pub state: State,
    /// What it expects.
    pub horizon: Vec<Step>,
}

/// A small policy for the gait task with random weights.
pub fn erratic_policy(config: &Config, seed: Seed) -> Policy {
    let mut rng = seed.child("policy", 0).rng();
    let mut layer = |inputs: usize, outputs: usize| {
        let bound = 3.0 / (inputs as f32).sqrt();
        let mut numbers = |count: usize| (0..count).map(|_| rng.random_range(-bound..=bound)).collect();
        Layer { inputs, outputs, weights: numbers(inputs * outputs), biases: numbers(outputs) }
    };
    let layers = vec![layer(config.task.kind.observation_dim(), 64), layer(64, config.task.kind.action_dim())];
    let provenance = Provenance { version: 0, run: "trial".into(), task_hash: config.task_hash() };
    Policy::new(provenance, layers).expect("the shapes fit")
}

/// Every `stride`-th of the questions that come up under this policy, until there are `count`.
pub fn questions(config: &Config, policy: &Policy, count: usize, stride: usize) -> Vec<Question> {
    let seen = Arc::new(Mutex::new((0, Vec::new())));
    let sink = Arc::clone(&seen);
    let watcher = move |state: &State, horizon: &[Step]| {
        let mut seen = sink.lock().unwrap_or_else(PoisonError::into_inner);
        if seen.0 % stride.max(1) == 0 {
            seen.1.push(Question { state: *state, horizon: horizon.to_vec() });
        }
        seen.0 += 1;
    };
    let mut env = Env::new(config).with_watcher(Box::new(watcher));
    let done = || seen.lock().unwrap_or_else(PoisonError::into_inner).1.len() >= count;
    for episode in 0.. {
        run(&mut env, policy, Seed::from_number(episode), &done);
        if done() {
            break;
        }
    }
    let mut questions = std::mem::take(&mut seen.lock().unwrap_or_else(PoisonError::into_inner).1);
    questions.truncate(count);
    questions
}

/// Runs the pushed episode of this seed until `done`.
fn run(env: &mut Env, policy: &Policy, seed: Seed, done: &dyn Fn() -> bool) {
    let mut rng = seed.child("push", 0).rng();
    let mut observation = env.reset(seed);
    loop {
        if let Some(force) = push(&mut rng) {
            env.push(&force, PUSH_SECS);
        }
        let step = env.step(&policy.act(&observation));
        if step.ending.is_some() || done() {
            return;
        }
        observation = step.observation;
    }
}

/// The push before this decision, if it gets one, world, N.
fn push(rng: &mut impl Rng) -> Option<Vector3<f64>> {
    let (chosen, force, side) = (rng.random_bool(PUSHED), rng.random_range(PUSH_N), rng.random_range(0.0..TAU));
    chosen.then(|| Vector3::new(side.cos(), side.sin(), 0.0) * force)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_questions_are_many_sided_and_repeat() {
        let config = Config::default();
        let policy = erratic_policy(&config, Seed::from_number(1));
        let asked = questions(&config, &policy, 150, 3);
        assert_eq!(asked.len(), 150);
        assert_eq!(asked, questions(&config, &policy, 150, 3));
        let stances: std::collections::BTreeSet<usize> =
            asked.iter().map(|question| question.horizon[0].stance()).collect();
        assert!(stances.len() > 1, "{stances:?}");
    }
}
