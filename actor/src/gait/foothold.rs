//! Where a swinging foot is to land.
//!
//! | symbol | name                                                   | unit |
//! |--------|--------------------------------------------------------|------|
//! | v, v*  | velocity measured, and asked for                       | m/s  |
//! | S      | stride in the hip frame, from +S/2 to −S/2             | m    |
//! | Δt     | duration of a stance                                   | s    |
//! | κ      | balance gain                                           | 1    |
//! | ω      | √(g / h_c), h_c the height of the centre of mass       | 1/s  |
//! | ω*     | yaw rate asked for                                     | rad/s |
//! | h      | hip from the centre of mass                            | m    |
//!
//! Seen from below the hip at touchdown, in the frame of the heading: `v Δt/2 + κ (v − v*) / (ω sinh ωΔt) + trim`. The
//! first term is the neutral point of a running machine (Raibert 1986): the centre of mass passes over the foot at half
//! stance. The second, with κ = 1, is what a point mass on a massless pole needs to have v* after this one stance; less is
//! gentler, and the MPC does its part. S enters as the trim, `½ (S − v* Δt)` within bounds, with the Δt that the step really
//! takes: a stride that fits the speed has none; a longer one puts the feet ahead and brakes, a shorter one lets the trunk
//! run ahead of its feet. Hips are taken as placed about the centre of mass, which is what the feet have to carry, not about
//! the trunk's origin. The bounds keep a stride that contradicts the speed from tripping the robot. A robot that turns moves
//! its hips by `ω* × h` on top, so that term is `(v + ω* × h) Δt/2`. Offsets from the hip are limited to what a leg can
//! reach.

use crate::robot::{GRAVITY, Geometry, Leg};
use herd_common::config::control;
use nalgebra::{Rotation2, Vector2, Vector3};

/// How the robot moves now and is meant to move.
#[derive(Clone, Copy, Debug)]
pub struct Motion {
    /// Centre of mass over the ground, world, m.
    pub position: Vector2<f64>,
    /// World, m/s.
    pub velocity: Vector2<f64>,
    /// v*, world, m/s.
    pub wanted: Vector2<f64>,
    /// rad
    pub yaw: f64,
    /// rad/s
    pub yaw_rate: f64,
    /// ω*, rad/s.
    pub turn: f64,
}

/// Plans footholds for one robot.
#[derive(Clone, Debug)]
pub struct Planner {
    geometry: Geometry,
    foot_radius: f64,
    /// ω, 1/s.
    pole_rate: f64,
    config: control::Gait,
}

impl Planner {
    /// A planner for legs of this geometry, with feet of this radius (m), that carry a centre of mass at `height` (m).
    pub fn new(geometry: Geometry, foot_radius: f64, height: f64, config: &control::Gait) -> Self {
        Self { geometry, foot_radius, pole_rate: (GRAVITY / height).sqrt(), config: config.clone() }
    }

    /// Centre of the foot of `leg` (world, m) when it lands `ahead` seconds from now for a stance of `stance_secs`.
    pub fn foothold(&self, leg: Leg, motion: &Motion, stride: f64, stance_secs: f64, ahead: f64) -> Vector3<f64> {
        let place = self.below_hip(leg, motion, ahead) + self.offset(leg, motion, stride, stance_secs);
        Vector3::new(place.x, place.y, self.foot_radius)
    }

    /// The point below the hip's thigh plane `ahead` seconds from now, world, m.
    fn below_hip(&self, leg: Leg, motion: &Motion, ahead: f64) -> Vector2<f64> {
        let hip = self.hip(leg);
        let heading = Rotation2::new(motion.yaw + motion.yaw_rate * ahead);
        motion.position + motion.velocity * ahead + heading * hip
    }

    /// h of the leg's thigh plane, heading frame, m.
    fn hip(&self, leg: Leg) -> Vector2<f64> {
        self.geometry.hip(leg).xy() + Vector2::y() * (leg.side() * self.geometry.hip_link)
    }

    /// The foothold seen from below the hip, world, m.
    fn offset(&self, leg: Leg, motion: &Motion, stride: f64, stance_secs: f64) -> Vector2<f64> {
        let heading = Rotation2::new(motion.yaw);
        let velocity = heading.inverse() * motion.velocity;
        let wanted = heading.inverse() * motion.wanted;
        let bound = self.config.stride_trim_m;
        let trim = ((stride - wanted.x * stance_secs) / 2.0).clamp(-bound, bound);
        let gain = self.config.foothold_gain / (self.pole_rate * (self.pole_rate * stance_secs).sinh());
        let offset = velocity * (stance_secs / 2.0) + (velocity - wanted) * gain + Vector2::new(trim, 0.0);
        let hip = self.hip(leg);
        let turned = offset + Vector2::new(-hip.y, hip.x) * (motion.turn * stance_secs / 2.0);
        let reach = self.config.foothold_clamp_m;
        heading * turned.map(|x| x.clamp(-reach, reach))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::Model;
    use herd_common::config::Config;

    fn planner() -> Planner {
        let config = Config::default();
        let model = Model::new(&config.robot);
        Planner::new(model.geometry, model.foot_radius, model.standing_height(), &config.control.gait)
    }

    fn walking(velocity: f64, wanted: f64) -> Motion {
        Motion {
            position: Vector2::new(2.0, -1.0),
            velocity: Vector2::new(velocity, 0.0),
            wanted: Vector2::new(wanted, 0.0),
            yaw: 0.0,
            yaw_rate: 0.0,
            turn: 0.0,
        }
    }

    #[test]
    fn a_steady_walk_lands_half_a_stride_ahead_of_the_hip() {
        let foot = planner().foothold(Leg::FrontLeft, &walking(0.4, 0.4), 0.06, 0.15, 0.05);
        let expected = Vector3::new(2.0 + 0.4 * 0.05 + 0.0705 + 0.03, -1.0 + 0.039 + 0.049, 0.01);
        assert!((foot - expected).norm() < 1e-12, "{foot}");
    }

    #[test]
    fn too_fast_and_a_longer_stride_both_land_further_ahead() {
        let land = |motion: &Motion, stride| planner().foothold(Leg::RearRight, motion, stride, 0.15, 0.0).x;
        let steady = land(&walking(0.4, 0.4), 0.06);
        assert!(land(&walking(0.5, 0.4), 0.06) > steady + 0.1 * 0.15 / 2.0);
        assert!(land(&walking(0.4, 0.4), 0.07) > steady);
        let bound = Config::default().control.gait.stride_trim_m;
        assert!((land(&walking(0.4, 0.4), 0.5) - steady - bound).abs() < 1e-12);
    }

    #[test]
    fn the_heading_turns_everything() {
        let turned = Motion {
            yaw: std::f64::consts::FRAC_PI_2,
            velocity: Vector2::new(0.0, 0.4),
            wanted: Vector2::new(0.0, 0.4),
            ..walking(0.0, 0.0)
        };
        let foot = planner().foothold(Leg::FrontLeft, &turned, 0.06, 0.15, 0.0);
        assert!((foot.xy() - Vector2::new(2.0 - 0.088, -1.0 + 0.0705 + 0.03)).norm() < 1e-12, "{foot}");
    }

    #[test]
    fn a_turning_robot_steps_around_its_centre() {
        let offset = |leg: Leg| {
            let still = walking(0.0, 0.0);
            let turning = Motion { turn: 1.0, ..still };
            let land = |motion: &Motion| planner().foothold(leg, motion, 0.0, 0.2, 0.0).xy();
            (land(&turning) - land(&still), land(&still) - still.position)
        };
        for leg in Leg::ALL {
            let (offset, hip) = offset(leg);
            assert!(offset.dot(&hip).abs() < 1e-12, "{leg:?}: across the line to its hip");
            assert!((hip.perp(&offset) - 0.1 * hip.norm_squared()).abs() < 1e-12, "{leg:?}: counterclockwise, ω Δt/2");
        }
    }

    #[test]
    fn no_foothold_leaves_the_reach() {
        let reach = Config::default().control.gait.foothold_clamp_m;
        let foot = planner().foothold(Leg::FrontLeft, &walking(9.0, 0.0), 0.2, 0.2, 0.0);
        assert!(foot.x <= 2.0 + 0.0705 + reach + 1e-12);
    }
}
