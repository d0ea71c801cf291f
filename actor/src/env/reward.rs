//! Eq 10, `r = 3 v_x + 30 T_s/T_f − 10 θ² − 0.01 Σ τ²`, sampled every T_s and summed.
//!
//! θ is the yaw angle, τ the torques of the last tick: over the torque limit as in the original of eq 10, or in N·m.
//! Samples are counted from the start of the episode, so a decision holds as many as fall into it.

use crate::sim::RobotState;
use herd_common::config::task;
use herd_common::episode::Reward;
use nalgebra::Vector3;

/// Pays by eq 10.
pub(super) struct Payer {
    config: task::Reward,
    episode_secs: f64,
    torque_unit_nm: f64,
    tick_secs: f64,
}

impl Payer {
    pub(super) fn new(task: &task::Config, torque_max: f64, tick_secs: f64) -> Self {
        let torque_unit_nm = match task.reward.torque_unit {
            task::TorqueUnit::Normalised => torque_max,
            task::TorqueUnit::NewtonMetre => 1.0,
        };
        Self { config: task.reward.clone(), episode_secs: task.episode_secs, torque_unit_nm, tick_secs }
    }

    /// True when a sample falls into the tick that ends after `ticks` ticks.
    pub(super) fn is_due(&self, ticks: u64) -> bool {
        self.samples_until(ticks) > self.samples_until(ticks - 1)
    }

    /// Samples due by the end of this many ticks.
    fn samples_until(&self, ticks: u64) -> u64 {
        // The sum of ticks that makes up a sample may miss it by a rounding error.
        (ticks as f64 * self.tick_secs / self.config.sample_secs + 1e-9) as u64
    }

    /// The terms of one sample.
    pub(super) fn sample(&self, state: &RobotState, torques: &[Vector3<f64>; 4]) -> Reward {
        let effort: f64 = torques.iter().map(|leg| (leg / self.torque_unit_nm).norm_squared()).sum();
        Reward {
            velocity: self.config.velocity * state.velocity.x,
            survival: self.config.survival * self.config.sample_secs / self.episode_secs,
            heading: -self.config.heading * state.angles().z.powi(2),
            effort: -self.config.effort * effort,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use herd_common::config::Config;
    use nalgebra::UnitQuaternion;

    fn payer(sets: &[&str]) -> Payer {
        let sets: Vec<String> = sets.iter().map(|set| (*set).to_owned()).collect();
        let config = Config::load(None, &sets).expect("valid");
        Payer::new(&config.task, config.robot.torque_max_nm, config.sim.tick_secs)
    }

    fn state() -> RobotState {
        RobotState {
            position: Vector3::zeros(),
            rotation: UnitQuaternion::from_euler_angles(0.0, 0.0, 0.1),
            velocity: Vector3::new(0.5, 9.0, 9.0),
            angular_velocity: Vector3::zeros(),
            joints: [Vector3::zeros(); 4],
            joint_speeds: [Vector3::zeros(); 4],
        }
    }

    #[test]
    fn terms_are_those_of_equation_10() {
        let torques = [Vector3::new(3.0, -6.0, 0.0), Vector3::zeros(), Vector3::zeros(), Vector3::new(0.0, 0.0, 6.0)];
        let reward = payer(&[]).sample(&state(), &torques);
        assert!((reward.velocity - 1.5).abs() < 1e-12);
        assert!((reward.survival - 0.075).abs() < 1e-12);
        assert!((reward.heading + 0.1).abs() < 1e-12);
        assert!((reward.effort + 0.01 * 0.09).abs() < 1e-12);
        let raw = payer(&["task.reward.torque_unit=newton_metre"]).sample(&state(), &torques);
        assert!((raw.effort + 0.81).abs() < 1e-12);
    }

    #[test]
    fn a_whole_episode_has_its_samples_and_survival_adds_up_to_its_weight() {
        let payer = payer(&[]);
        let due: Vec<u64> = (1..=5000).filter(|ticks| payer.is_due(*ticks)).collect();
        assert_eq!(due.len(), 400);
        // 12.5 ticks a sample: never early, late by less than a tick.
        assert!(due.iter().zip(1_u64..).all(|(ticks, n)| *ticks == (25 * n).div_ceil(2)));
        let survival: f64 = due.iter().map(|_| payer.sample(&state(), &[Vector3::zeros(); 4]).survival).sum();
        assert!((survival - 30.0).abs() < 1e-9);
    }
}
