//! Stand-ins for tests: a robot without physics, and the orders, policies and outcomes that go with it.

mod learner;

pub(crate) use learner::{Learner, Script};

use crate::worker::{Emit, Factory, Robot};
use herd_common::config::Config;
use herd_common::episode::{Counts, Ending, Outcome, Reward};
use herd_common::policy::{Layer, Policy, Provenance};
use herd_common::seed::Seed;
use herd_common::spaces::{OBSERVATION_DIM, Task};
use herd_common::transition::{Batch, Transition};
use herd_common::work::{Order, Work};
use std::ops::ControlFlow;
use std::sync::Arc;

/// A robot that does nothing, at once.
pub(crate) struct Puppet;

impl Puppet {
    /// Transitions of its episodes.
    pub(crate) const LENGTH: u64 = 70;
    /// The episode in which it panics.
    pub(crate) const PANICS: u64 = 1000;
    /// The episode that only ends when it is cancelled.
    pub(crate) const ENDLESS: u64 = 2000;

    pub(crate) fn factory() -> Factory {
        Arc::new(|_, _, _| Box::new(Self))
    }
}

impl Robot for Puppet {
    fn run(&mut self, order: &Order, policy: Option<&Policy>, emit: &mut Emit<'_>) -> Option<Outcome> {
        assert_ne!(order.work, Work::Episode(Self::PANICS), "stumbled");
        while order.work == Work::Episode(Self::ENDLESS) {
            if emit(Batch::new(Task::Gait.dims())).is_break() {
                return None;
            }
            std::thread::yield_now();
        }
        let action = policy.map_or(0.0, |policy| policy.act(&[0.0; OBSERVATION_DIM])[0]);
        let mut left = Self::LENGTH;
        while left > 0 {
            let mut piece = Batch::new(Task::Gait.dims());
            for _ in 0..left.min(crate::worker::PIECE as u64) {
                let observation = [0.0; OBSERVATION_DIM];
                piece.push(Transition {
                    observation: &observation,
                    action: &[action; 4],
                    reward: 1.0,
                    discount: 1.0,
                    next_observation: &observation,
                });
            }
            left -= piece.len() as u64;
            if let ControlFlow::Break(()) = emit(piece) {
                return None;
            }
        }
        Some(outcome(Self::LENGTH))
    }
}

/// A lease of this episode with random actions.
pub(crate) fn order(episode: u64) -> Order {
    let work = Work::Episode(episode);
    Order { work, attempt: 1, seed: work.seed(Seed::from_number(1)), policy_version: 0, sigma: 0.1, random: true }
}

/// A small policy for this task whose actions depend on what it sees.
pub(crate) fn policy(config: &Config, version: u64) -> Policy {
    let (inputs, outputs) = (config.task.kind.observation_dim(), config.task.kind.action_dim());
    let weights = (0..inputs * outputs).map(|i| (i % 7) as f32 / 7.0 - 0.4).collect();
    let layer = Layer { inputs, outputs, weights, biases: vec![0.1; outputs] };
    let provenance = Provenance { version, run: "run".into(), task_hash: config.task_hash() };
    Policy::new(provenance, vec![layer]).expect("well formed")
}

/// The summary of an uneventful episode.
pub(crate) fn outcome(decisions: u64) -> Outcome {
    Outcome {
        ending: Ending::TimedOut,
        decisions,
        seconds: 10.0,
        reward: Reward::default(),
        distance_m: 1.0,
        roll_variance: 0.0,
        pitch_variance: 0.0,
        counts: Counts::default(),
    }
}
