//! One robot on its ground, advanced tick by tick under joint torques.
//!
//! World frame: z up, level ground at z = 0. Torques act between the two links of a joint along its axis, which is exactly
//! a generalised force on that joint. Forces persist in rapier until reset, so each tick resets them. Velocities come
//! from the multibody's generalised ones: those of the bodies lag by a solver step.
//!
//! A solver step of length h first changes the velocities, then moves the pose by h times the new ones (symplectic
//! Euler), which alone is of first order. The same numbers are those of position Verlet, once the pose is read half a step
//! earlier: move by h/2, change the velocities there, move by h/2. That is exact in a free fall and of second order for
//! forces that depend on the pose; rapier's Coriolis and damping terms stay of first order. So rapier's pose leads ours by
//! `lead_secs`, and whoever changes velocities between two ticks has to move it along.

use super::build::{self, Handles, ROOT_DOFS};
use super::contact::{self, Before, Contacts};
use super::convert::{rotation_from_sim, vector_from_sim, vector_to_sim};
use super::ground::Ground;
use crate::robot::{Leg, Model};
use herd_common::config::sim;
use nalgebra::{UnitQuaternion, Vector3};
use rapier3d::prelude::*;

/// What the robot meets in its world.
#[derive(Clone, Debug, PartialEq)]
pub struct Site {
    /// The shape of the ground.
    pub ground: Ground,
    /// Factor on the configured friction of the ground.
    pub friction_factor: f64,
    /// Mass of a box on the trunk, kg.
    pub payload_kg: f64,
}

impl Default for Site {
    /// Level ground as configured, and no payload.
    fn default() -> Self {
        Self { ground: Ground::level(), friction_factor: 1.0, payload_kg: 0.0 }
    }
}

/// Where a robot starts.
#[derive(Clone, Debug)]
pub struct Start {
    /// Trunk origin, world, m.
    pub position: Vector3<f64>,
    /// World from body.
    pub rotation: UnitQuaternion<f64>,
    /// Joint angles, rad.
    pub joints: [Vector3<f64>; 4],
}

/// What can be measured of a robot.
#[derive(Clone, Debug, PartialEq)]
pub struct RobotState {
    /// Trunk origin, world, m.
    pub position: Vector3<f64>,
    /// World from body.
    pub rotation: UnitQuaternion<f64>,
    /// Velocity of the trunk origin, world, m/s.
    pub velocity: Vector3<f64>,
    /// Angular velocity of the trunk, world, rad/s.
    pub angular_velocity: Vector3<f64>,
    /// Joint angles, rad.
    pub joints: [Vector3<f64>; 4],
    /// Joint speeds, rad/s.
    pub joint_speeds: [Vector3<f64>; 4],
}

/// A robot in its world.
pub struct World {
    physics: PhysicsWorld,
    handles: Handles,
    dofs: [[usize; 3]; 4],
    push: Option<(Vector, u32)>,
    before: Before,
    contacts: Contacts,
}

impl RobotState {
    /// Roll, pitch and yaw, rad.
    pub fn angles(&self) -> Vector3<f64> {
        let (roll, pitch, yaw) = self.rotation.euler_angles();
        Vector3::new(roll, pitch, yaw)
    }

    /// Pose and joint angles as these velocities lead on for so long, s; the velocities stay.
    fn moved(mut self, secs: f64) -> Self {
        self.position += self.velocity * secs;
        self.rotation = UnitQuaternion::from_scaled_axis(self.angular_velocity * secs) * self.rotation;
        for (angles, speeds) in self.joints.iter_mut().zip(&self.joint_speeds) {
            *angles += speeds * secs;
        }
        self
    }

    /// True when every number is finite.
    pub fn is_finite(&self) -> bool {
        let vectors = [&self.position, &self.velocity, &self.angular_velocity];
        let all = vectors.into_iter().chain(&self.joints).chain(&self.joint_speeds);
        all.flat_map(|v| v.iter()).chain(self.rotation.coords.iter()).all(|x| f64::is_finite(*x))
    }
}

impl World {
    /// A fresh world of level ground with the robot at rest in its starting pose.
    pub fn new(model: &Model, config: &sim::Config, start: &Start) -> Self {
        Self::at(model, config, &Site::default(), start)
    }

    /// A fresh world of this site with the robot at rest in its starting pose.
    pub fn at(model: &Model, config: &sim::Config, site: &Site, start: &Start) -> Self {
        let mut physics = build::world(config, site);
        let handles = build::robot(&mut physics, model, config, site, start);
        let dofs = handles.joints.map(|leg| leg.map(|joint| build::dof(&physics, joint)));
        Self { physics, handles, dofs, push: None, before: Before::default(), contacts: Contacts::default() }
    }

    /// Advances by one tick under these joint torques, N·m.
    pub fn tick(&mut self, torques: &[Vector3<f64>; 4]) {
        self.clear_forces();
        for leg in Leg::ALL {
            self.add_torques(leg, &torques[leg.index()]);
        }
        if let Some((force, ticks)) = self.push.take() {
            self.body(self.handles.trunk).add_force(force, true);
            self.push = (ticks > 1).then_some((force, ticks - 1));
        }
        self.before.speeds = self.multibody().generalized_velocity().into_owned();
        self.physics.step();
        self.contacts = contact::read(&self.physics, &self.handles, &mut self.before);
    }

    /// Pushes the trunk's origin with a world force (N) for this many ticks from the next one on.
    pub fn push(&mut self, force: &Vector3<f64>, ticks: u32) {
        self.push = (ticks > 0).then_some((vector_to_sim(force), ticks));
    }

    /// Adds to the velocity of the trunk and everything attached to it, world, m/s; pose and joint angles stay.
    pub fn add_velocity(&mut self, change: &Vector3<f64>) {
        let mut changes = vec![0.0; self.multibody().ndofs()];
        for axis in 0..3 {
            changes[axis] = change[axis] as f32;
        }
        self.change_speeds(changes);
    }

    /// Gives a robot at rest the velocities of `state`; its pose and joint angles stay.
    pub fn set_speeds(&mut self, state: &RobotState) {
        let mut speeds = vec![0.0; self.multibody().ndofs()];
        for axis in 0..3 {
            speeds[axis] = state.velocity[axis] as f32;
            speeds[3 + axis] = state.angular_velocity[axis] as f32;
        }
        for (dof, speed) in self.dofs.iter().flatten().zip(state.joint_speeds.iter().flatten()) {
            speeds[*dof] = *speed as f32;
        }
        self.change_speeds(speeds);
    }

    /// The robot's state after the last tick.
    pub fn state(&self) -> RobotState {
        self.ahead().moved(-self.lead_secs())
    }

    /// The robot as rapier has it: its pose leads by `lead_secs`.
    pub(super) fn ahead(&self) -> RobotState {
        let trunk = &self.physics.bodies[self.handles.trunk];
        let speeds = self.multibody().generalized_velocity();
        let speed = |dof: usize| f64::from(speeds[dof]);
        let angle = |joint: MultibodyJointHandle| {
            let (multibody, id) = self.physics.multibody_joints.get(joint).expect(ROBOT);
            f64::from(multibody.link(id).expect(ROBOT).joint().coords()[REVOLUTE])
        };
        RobotState {
            position: vector_from_sim(trunk.translation()),
            rotation: rotation_from_sim(trunk.rotation()),
            velocity: Vector3::new(speed(0), speed(1), speed(2)),
            angular_velocity: Vector3::new(speed(3), speed(4), speed(ROOT_DOFS - 1)),
            joints: self.handles.joints.map(|leg| Vector3::from(leg.map(angle))),
            joint_speeds: self.dofs.map(|leg| Vector3::from(leg.map(speed))),
        }
    }

    /// Ground contact over the last tick; none before the first.
    pub fn contacts(&self) -> Contacts {
        self.contacts
    }

    /// True when rapier had to take bodies out of the simulation because their numbers were not finite.
    pub fn has_diverged(&self) -> bool {
        !self.physics.quarantine().is_empty()
    }

    /// Velocities of the feet in rapier's pose, world, m/s.
    #[cfg(test)]
    pub(super) fn foot_velocities(&self) -> [Vector3<f64>; 4] {
        let speeds = self.multibody().generalized_velocity().into_owned();
        Leg::ALL.map(|leg| contact::foot_velocity(&self.physics, &self.handles, leg, &speeds))
    }

    /// Half a solver step, s.
    fn lead_secs(&self) -> f64 {
        let parameters = &self.physics.integration_parameters;
        f64::from(parameters.dt) / (2 * parameters.num_solver_iterations) as f64
    }

    /// Adds to the generalised velocities without moving what `state` tells.
    fn change_speeds(&mut self, mut changes: Vec<f32>) {
        let lead = self.lead_secs() as f32;
        let (multibody, _) = self.physics.multibody_joints.get_mut(self.handles.joints[0][0]).expect(ROBOT);
        for (speed, change) in multibody.generalized_velocity_mut().iter_mut().zip(&mut changes) {
            *speed += *change;
            *change *= lead;
        }
        multibody.apply_displacements(&changes);
        multibody.forward_kinematics(&self.physics.bodies, false);
        multibody.update_rigid_bodies(&mut self.physics.bodies, true);
    }

    fn multibody(&self) -> &Multibody {
        self.physics.multibody_joints.get(self.handles.joints[0][0]).expect(ROBOT).0
    }

    fn clear_forces(&mut self) {
        for handle in self.handles.links.into_iter().flatten().chain([self.handles.trunk]) {
            let body = self.body(handle);
            body.reset_forces(false);
            body.reset_torques(false);
        }
    }

    fn add_torques(&mut self, leg: Leg, torques: &Vector3<f64>) {
        let [hip, thigh, calf] = self.handles.links[leg.index()];
        let roll_axis = *self.physics.bodies[self.handles.trunk].rotation() * Vector::X;
        let pitch_axis = *self.physics.bodies[hip].rotation() * Vector::Y;
        let chain = [(self.handles.trunk, hip, roll_axis), (hip, thigh, pitch_axis), (thigh, calf, pitch_axis)];
        for ((parent, child, axis), torque) in chain.into_iter().zip(torques.iter()) {
            let torque = axis * (*torque as f32);
            self.body(child).add_torque(torque, true);
            self.body(parent).add_torque(-torque, true);
        }
    }

    fn body(&mut self, handle: RigidBodyHandle) -> &mut RigidBody {
        &mut self.physics.bodies[handle]
    }
}

pub(super) const ROBOT: &str = "the robot stays in the world";
/// Index of a revolute joint's angle in rapier's six joint coordinates.
const REVOLUTE: usize = 3;
