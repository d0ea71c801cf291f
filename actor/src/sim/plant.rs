//! What an episode needs of a simulator.

use super::{Contacts, RobotState, Site, Start, World};
use crate::robot::Model;
use herd_common::config::sim;
use nalgebra::Vector3;

/// One robot in a world that is advanced tick by tick.
pub trait Plant: Send {
    /// Advances by one tick under these joint torques, N·m.
    fn tick(&mut self, torques: &[Vector3<f64>; 4]);
    /// Pushes the trunk's origin with a world force (N) for this many ticks from the next one on.
    fn push(&mut self, force: &Vector3<f64>, ticks: u32);
    /// Adds to the velocity of the trunk and everything attached to it, world, m/s; pose and joint angles stay.
    fn add_velocity(&mut self, change: &Vector3<f64>);
    /// The robot's state after the last tick.
    fn state(&self) -> RobotState;
    /// Ground contact over the last tick.
    fn contacts(&self) -> Contacts;
    /// True when the simulation can go no further.
    fn has_diverged(&self) -> bool;
}

/// Makes a world of this site with the robot at rest in its starting pose.
pub type Spawn = Box<dyn FnMut(&Model, &sim::Config, &Site, &Start) -> Box<dyn Plant> + Send>;

/// Makes rapier's worlds.
pub fn rapier() -> Spawn {
    Box::new(|model, config, site, start| Box::new(World::at(model, config, site, start)))
}

impl Plant for World {
    fn tick(&mut self, torques: &[Vector3<f64>; 4]) {
        World::tick(self, torques);
    }

    fn push(&mut self, force: &Vector3<f64>, ticks: u32) {
        World::push(self, force, ticks);
    }

    fn add_velocity(&mut self, change: &Vector3<f64>) {
        World::add_velocity(self, change);
    }

    fn state(&self) -> RobotState {
        World::state(self)
    }

    fn contacts(&self) -> Contacts {
        World::contacts(self)
    }

    fn has_diverged(&self) -> bool {
        World::has_diverged(self)
    }
}
