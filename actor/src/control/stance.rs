//! What the MPC is asked: the horizon of references and standing feet, from schedule, reference and footholds.
//!
//! The feet of a future stance are predicted: those of legs in the air at the place they aim at, later ones relative to
//! where the hips will be by then. The first step always has the legs that stand now.
//!
//! The reference starts at the robot and reaches the speed asked for with bounded acceleration. The model takes the arms
//! of its moments from the reference, so one that ran ahead of the robot would shift the feet of the prediction by as
//! much and tip the trunk over (an ideal rigid body falls within 2 s). What is to be caught up enters as speed instead.

use super::contact::Duty;
use super::leg::Body;
use super::terrain::Terrain;
use crate::gait::{Motion, Planner, Schedule};
use crate::mpc::{State, Step};
use crate::robot::Leg;
use herd_common::config::control;
use nalgebra::{Rotation2, Vector2, Vector3};
use std::f64::consts::TAU;

/// What the robot expects of the time ahead.
pub(super) struct Outlook<'a> {
    pub(super) body: &'a Body<'a>,
    pub(super) duties: &'a [Duty; 4],
    pub(super) schedule: &'a Schedule,
    pub(super) planner: &'a Planner,
    /// How the robot moves now and is meant to.
    pub(super) motion: Motion,
    /// S, m.
    pub(super) stride: f64,
    /// The speed asked for and what is to be caught up, world, m/s.
    pub(super) target: Vector2<f64>,
    /// Largest acceleration of the reference along an axis, m/s².
    pub(super) acceleration: f64,
    /// Where the robot is meant to head, full turns included, rad.
    pub(super) heading: f64,
    /// Height of the centre of mass over the ground, m.
    pub(super) height: f64,
    /// The ground as the feet feel it.
    pub(super) terrain: &'a Terrain,
}

impl Outlook<'_> {
    /// The robot as the MPC sees it.
    pub(super) fn state(&self) -> State {
        State {
            angles: self.body.state.angles(),
            position: self.body.centre(),
            angular_velocity: self.body.state.angular_velocity,
            velocity: self.body.centre_velocity(),
        }
    }

    /// The steps of the prediction.
    pub(super) fn horizon(&self, config: &control::Mpc) -> Vec<Step> {
        (0..config.horizon)
            .map(|k| {
                let begin = k as f64 * config.step_secs;
                let middle = if k == 0 { 0.0 } else { begin + config.step_secs / 2.0 };
                Step {
                    reference: self.reference(begin + config.step_secs),
                    feet: Leg::ALL.map(|leg| self.foot(leg, middle)),
                }
            })
            .collect()
    }

    fn reference(&self, ahead: f64) -> State {
        let mut place = self.motion.position;
        let mut velocity = self.motion.velocity;
        // A robot that turns has its velocity turn with it.
        let target = Rotation2::new(self.motion.turn * ahead) * self.target;
        for axis in 0..2 {
            let now = velocity[axis];
            let missing = target[axis] - now;
            let ramp_secs = (missing.abs() / self.acceleration).min(ahead);
            velocity[axis] = now + missing.signum() * self.acceleration * ramp_secs;
            place[axis] += f64::midpoint(now, velocity[axis]) * ramp_secs + velocity[axis] * (ahead - ramp_secs);
        }
        let tilt = self.terrain.tilt(self.motion.yaw);
        State {
            angles: Vector3::new(tilt.x, tilt.y, near(self.heading, self.motion.yaw) + self.motion.turn * ahead),
            position: Vector3::new(place.x, place.y, self.terrain.height(&place) + self.height),
            angular_velocity: Vector3::new(0.0, 0.0, self.motion.turn),
            velocity: Vector3::new(velocity.x, velocity.y, self.terrain.climb(&velocity)),
        }
    }

    /// Where a leg will press on the ground `ahead` seconds from now, world, m.
    fn foot(&self, leg: Leg, ahead: f64) -> Option<Vector3<f64>> {
        let duty = &self.duties[leg.index()];
        let touchdown = self.schedule.touchdown_before(ahead);
        // A leg that touched down early stands until the end of its next stance.
        let planned = self.schedule.stands_at(leg, ahead) || (touchdown.is_none() && duty.stands());
        // A late leg bears nothing before it has found the ground.
        let stands = if ahead == 0.0 { duty.stands() } else { planned };
        if !stands {
            return None;
        }
        let first_stance = touchdown.is_none_or(|when| when <= self.schedule.remaining_secs());
        let place = match duty {
            Duty::Stands if first_stance => return Some(self.body.contact_point(leg)),
            Duty::Flies { target, .. } if first_stance => *target,
            _ => {
                let when = touchdown.unwrap_or_default();
                self.planner.foothold(leg, &self.motion, self.stride, self.schedule.duration_secs(), when)
            }
        };
        Some(Vector3::new(place.x, place.y, self.terrain.height(&place.xy())))
    }
}

/// The heading less the full turns that lie between it and the yaw, which is measured within half a turn of zero, rad.
fn near(heading: f64, yaw: f64) -> f64 {
    heading - TAU * ((heading - yaw) / TAU).round()
}
