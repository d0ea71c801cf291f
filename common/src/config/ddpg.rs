//! Settings of the learner: networks, replay, optimiser, and what tames DDPG's overestimation.

use super::{Error, check};
use serde::{Deserialize, Serialize};

/// Where updates are computed. Their bits differ from one to the other.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Device {
    /// The thread that trains.
    Cpu,
    /// The first GPU that CUDA shows to the process.
    Cuda,
}

/// DDPG (paper eqs 6–9) and the parts of TD3 that may be added to it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// What computes the updates.
    pub device: Device,
    /// Widths of the hidden layers of actor and critic.
    pub hidden: Vec<usize>,
    /// Transitions of one update.
    pub batch_size: usize,
    /// Transitions that the replay memory holds.
    pub replay_capacity: usize,
    /// Committed transitions before the first update.
    pub warmup_transitions: u64,
    /// Updates that a committed transition triggers.
    pub updates_per_transition: f64,
    /// Adam's step for the actor.
    pub actor_rate: f64,
    /// Adam's step for the critic.
    pub critic_rate: f64,
    /// Decoupled weight decay of the critics, as AdamW has it: each step takes `critic_rate` · this of every weight.
    pub critic_decay: f64,
    /// Polyak factor γ of eqs 8–9.
    pub target_rate: f64,
    /// Largest global gradient norm; 0 turns clipping off.
    pub gradient_clip: f64,
    /// Factor on rewards.
    pub reward_scale: f64,
    /// Last layers start uniform within ± this.
    pub output_init: f64,
    /// Learn two critics and trust the lower.
    pub twin_critic: bool,
    /// Critic updates per actor and target update.
    pub actor_every: u64,
    /// Let the actor come back from the ends of its box at full speed.
    pub open_box: bool,
    /// Decisions folded into one transition.
    pub n_step: usize,
    /// α of prioritised replay; 0 draws uniformly.
    pub priority_alpha: f64,
    /// β of prioritised replay.
    pub priority_beta: f64,
    /// Standard deviation of the noise on target actions.
    pub smoothing_sigma: f64,
    /// Bound of that noise.
    pub smoothing_clip: f64,
}

impl Config {
    pub(super) fn validate(&self) -> Result<(), Error> {
        check("ddpg.hidden (number of layers)", self.hidden.len(), 1..=8)?;
        for &width in &self.hidden {
            check("ddpg.hidden", width, 1..=8192)?;
        }
        check("ddpg.batch_size", self.batch_size, 1..=65_536)?;
        check("ddpg.replay_capacity", self.replay_capacity, self.batch_size..=100_000_000)?;
        check("ddpg.warmup_transitions", self.warmup_transitions, 1..=100_000_000)?;
        check("ddpg.updates_per_transition", self.updates_per_transition, 0.0..=1000.0)?;
        check("ddpg.actor_rate", self.actor_rate, 0.0..=1.0)?;
        check("ddpg.critic_rate", self.critic_rate, 0.0..=1.0)?;
        check("ddpg.critic_decay", self.critic_decay, 0.0..=10.0)?;
        check("ddpg.target_rate", self.target_rate, 1e-9..=1.0)?;
        check("ddpg.gradient_clip", self.gradient_clip, 0.0..=1e9)?;
        check("ddpg.reward_scale", self.reward_scale, 1e-9..=1e9)?;
        check("ddpg.output_init", self.output_init, 0.0..=1.0)?;
        check("ddpg.actor_every", self.actor_every, 1..=1000)?;
        check("ddpg.n_step", self.n_step, 1..=crate::caps::FOLDED_DECISIONS)?;
        check("ddpg.priority_alpha", self.priority_alpha, 0.0..=2.0)?;
        check("ddpg.priority_beta", self.priority_beta, 0.0..=1.0)?;
        check("ddpg.smoothing_sigma", self.smoothing_sigma, 0.0..=2.0)?;
        check("ddpg.smoothing_clip", self.smoothing_clip, 0.0..=2.0)
    }
}
