//! The one loop that runs an episode: training, evaluation and reports differ in who acts and who listens.

use crate::env::{Env, Observation};
use crate::explore::{Exploration, explorer};
use herd_common::episode::{Ending, Outcome};
use herd_common::policy::Policy;
use herd_common::seed::Seed;
use herd_common::transition::Transition;
use std::ops::ControlFlow;

/// Runs the episode of `seed`: `act` chooses, `sink` receives every transition as it happens.
///
/// The decision in which the simulation diverged is not a transition.
pub fn run_episode(
    env: &mut Env,
    seed: Seed,
    act: &mut dyn FnMut(&Observation) -> Vec<f32>,
    sink: &mut dyn FnMut(Transition<'_>),
) -> Outcome {
    let mut sink = |transition: Transition<'_>| {
        sink(transition);
        ControlFlow::Continue(())
    };
    run_until(env, seed, act, &mut sink).expect("this sink never breaks the episode off")
}

/// Runs an episode that `sink` may break off, which leaves no outcome.
pub fn run_until(
    env: &mut Env,
    seed: Seed,
    act: &mut dyn FnMut(&Observation) -> Vec<f32>,
    sink: &mut dyn FnMut(Transition<'_>) -> ControlFlow<()>,
) -> Option<Outcome> {
    let mut observation = env.reset(seed);
    loop {
        let action = act(&observation);
        let step = env.step(&action);
        if step.ending != Some(Ending::Diverged) {
            let transition = Transition {
                observation: &observation,
                action: &action,
                reward: step.reward,
                discount: step.discount,
                next_observation: &step.observation,
            };
            if sink(transition).is_break() {
                return None;
            }
        }
        if step.ending.is_some() {
            return Some(env.outcome());
        }
        observation = step.observation;
    }
}

/// Runs the episode of `seed` under a policy with this exploration.
pub fn run_policy(
    env: &mut Env,
    seed: Seed,
    policy: &Policy,
    exploration: Exploration,
    sink: &mut dyn FnMut(Transition<'_>),
) -> Outcome {
    let mut explorer = explorer(exploration, seed);
    let mut act = |observation: &Observation| {
        let mut action = policy.act(observation);
        explorer.apply(&mut action);
        action
    };
    run_episode(env, seed, &mut act, sink)
}
