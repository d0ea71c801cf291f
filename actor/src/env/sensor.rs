//! What the robot measures of itself: its state with Gaussian noise on it, fresh at every tick.
//!
//! The position of the trunk is left exact. Heights over the ground come from the legs where a controller drives them, see
//! `terrain`; policies of torques, and the first look of an episode, get the true one.

use crate::sim::RobotState;
use herd_common::seed::Seed;
use nalgebra::{UnitQuaternion, Vector3};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

// Standard deviations at a factor of 1; guesses after the data sheets of magnetic encoders (12 to 14 bits, speeds by
// difference) and of small inertial units with their filters, and after leg odometry.
const JOINT_RAD: f64 = 0.003;
const JOINT_RADPS: f64 = 0.2;
const ATTITUDE_RAD: f64 = 0.01;
const TURN_RADPS: f64 = 0.05;
const VELOCITY_MPS: f64 = 0.05;

/// Sensors with a random stream of their own.
pub(super) struct Sensor {
    rng: ChaCha8Rng,
    factor: f64,
}

impl Sensor {
    /// Sensors whose standard deviations are multiplied by `factor`; 0 makes them exact.
    pub(super) fn new(factor: f64, seed: Seed) -> Self {
        Self { rng: seed.child("noise", 0).rng(), factor }
    }

    /// One measurement of this state.
    pub(super) fn measure(&mut self, state: &RobotState) -> RobotState {
        if self.factor == 0.0 {
            return state.clone();
        }
        RobotState {
            position: state.position,
            rotation: state.rotation * UnitQuaternion::from_scaled_axis(self.noise(ATTITUDE_RAD)),
            velocity: state.velocity + self.noise(VELOCITY_MPS),
            angular_velocity: state.angular_velocity + self.noise(TURN_RADPS),
            joints: state.joints.map(|leg| leg + self.noise(JOINT_RAD)),
            joint_speeds: state.joint_speeds.map(|leg| leg + self.noise(JOINT_RADPS)),
        }
    }

    fn noise(&mut self, deviation: f64) -> Vector3<f64> {
        Vector3::from_fn(|_, _| {
            let normal: f64 = StandardNormal.sample(&mut self.rng);
            normal * deviation * self.factor
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn state() -> RobotState {
        RobotState {
            position: Vector3::new(1.0, 2.0, 3.0),
            rotation: UnitQuaternion::from_euler_angles(0.1, -0.2, 0.3),
            velocity: Vector3::new(0.4, 0.5, 0.6),
            angular_velocity: Vector3::new(0.7, 0.8, 0.9),
            joints: [Vector3::new(0.1, 0.2, 0.3); 4],
            joint_speeds: [Vector3::new(1.0, 2.0, 3.0); 4],
        }
    }

    #[test]
    fn exact_sensors_change_nothing() {
        assert_eq!(Sensor::new(0.0, Seed::from_number(1)).measure(&state()), state());
    }

    #[test]
    fn noise_has_its_deviation_and_no_bias() {
        const COUNT: f64 = 4000.0;
        let (mut sensor, state) = (Sensor::new(2.0, Seed::from_number(1)), state());
        let quantities = |seen: &RobotState| {
            [
                (seen.joints[3] - state.joints[3], JOINT_RAD),
                (seen.joint_speeds[0] - state.joint_speeds[0], JOINT_RADPS),
                ((state.rotation.inverse() * seen.rotation).scaled_axis(), ATTITUDE_RAD),
                (seen.angular_velocity - state.angular_velocity, TURN_RADPS),
                (seen.velocity - state.velocity, VELOCITY_MPS),
            ]
        };
        let seen: Vec<_> = (0..COUNT as usize).map(|_| quantities(&sensor.measure(&state))).collect();
        for (i, (_, deviation)) in quantities(&state).into_iter().enumerate() {
            let wanted = 2.0 * deviation;
            let mean = seen.iter().map(|one| one[i].0).sum::<Vector3<f64>>() / COUNT;
            let square = seen.iter().map(|one| one[i].0.component_mul(&one[i].0)).sum::<Vector3<f64>>() / COUNT;
            assert!(mean.amax() < 5.0 * wanted / COUNT.sqrt(), "{i}: mean {mean}");
            assert!(square.map(|s| (s.sqrt() / wanted - 1.0).abs()).amax() < 0.06, "{i}: {square}");
        }
    }
}
