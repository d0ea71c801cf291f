//! What can be asked of an episode without changing it.

use super::super::command::Following;
use super::super::summary::Figures;
use super::Env;
use crate::control::Latency;
use crate::robot::{GRAVITY, Model};
use crate::sim::{Contacts, Ground, RobotState};
use herd_common::episode::{Ending, Outcome, Reward};
use nalgebra::Vector3;

impl Env {
    /// The episode so far; one that is not over counts as timed out.
    pub fn outcome(&self) -> Outcome {
        let seconds = self.ticks as f64 * self.config.sim.tick_secs;
        let ending = self.ending.unwrap_or(Ending::TimedOut);
        self.summary.outcome(ending, seconds, self.controller.counts())
    }

    /// How well the robot walked so far, if it was asked for `wanted` m/s.
    pub fn figures(&self, wanted: f64) -> Figures {
        self.summary.figures(wanted, (self.model.mass() + self.scenario.site.payload_kg) * GRAVITY)
    }

    /// How well the robot followed its commands so far, in the command task.
    pub fn following(&self) -> Option<Following> {
        self.follower.following()
    }

    /// How long the MPC's solver took, over all episodes; empty without a timer.
    pub fn qp_latency(&self) -> &Latency {
        self.controller.latency()
    }

    /// The ground of this episode.
    pub fn ground(&self) -> &Ground {
        &self.scenario.site.ground
    }

    /// The robot's true state, for reports and recordings.
    pub fn state(&self) -> &RobotState {
        &self.state
    }

    /// Ground contact over the last tick.
    pub fn contacts(&self) -> &Contacts {
        &self.contacts
    }

    /// Joint torques of the last tick, N·m.
    pub fn torques(&self) -> &[Vector3<f64>; 4] {
        &self.torques
    }

    /// The robot's body.
    pub fn model(&self) -> &Model {
        &self.model
    }

    /// Length of a tick, s.
    pub fn tick_secs(&self) -> f64 {
        self.config.sim.tick_secs
    }

    /// The reward of the episode so far.
    pub fn reward(&self) -> Reward {
        self.summary.reward()
    }
}
