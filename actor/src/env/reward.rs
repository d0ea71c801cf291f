//! Eq 10, `r = 3 v_x + 30 T_s/T_f − 10 θ² − 0.01 Σ τ²`, sampled every T_s and summed.
//!
//! θ is the yaw angle, τ the torques of the last tick: over the torque limit as in the original of eq 10, or in N·m.
//! Samples are counted from the start of the episode, so a decision holds as many as fall into it.
//!
//! The command task is paid for following instead: `w exp(−|v − v*|² / σ²)` for the planar velocity in the heading frame in
//! place of 3 v_x, the same for the yaw rate in place of −10 θ²; the form is that of Rudin et al. 2022 (legged_gym).

use crate::sim::RobotState;
use herd_common::config::command::{self, Command};
use herd_common::config::task;
use herd_common::episode::Reward;
use nalgebra::{Rotation2, Vector2, Vector3};

/// Pays by eq 10.
pub(super) struct Payer {
    config: task::Reward,
    command: command::Config,
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
        let (config, command) = (task.reward.clone(), task.command.clone());
        Self { config, command, episode_secs: task.episode_secs, torque_unit_nm, tick_secs }
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

    /// The terms of one sample of a robot that is told how to move.
    pub(super) fn sample_following(
        &self,
        state: &RobotState,
        torques: &[Vector3<f64>; 4],
        command: &Command,
    ) -> Reward {
        let found = velocity(state);
        let off = Vector2::new(found.forward_mps - command.forward_mps, found.lateral_mps - command.lateral_mps);
        let turned = found.yaw_radps - command.yaw_radps;
        Reward {
            velocity: self.command.velocity * (-off.norm_squared() / self.command.velocity_width_mps.powi(2)).exp(),
            heading: self.command.turn * (-(turned / self.command.turn_width_radps).powi(2)).exp(),
            ..self.sample(state, torques)
        }
    }
}

/// How the robot moves, in the terms of a command.
pub(super) fn velocity(state: &RobotState) -> Command {
    let planar = Rotation2::new(-state.angles().z) * state.velocity.xy();
    Command { forward_mps: planar.x, lateral_mps: planar.y, yaw_radps: state.angular_velocity.z }
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
    fn following_is_paid_by_its_error_in_the_heading_frame() {
        // At yaw 90° world y is forwards and world −x to the left.
        let state = RobotState {
            rotation: UnitQuaternion::from_euler_angles(0.0, 0.0, std::f64::consts::FRAC_PI_2),
            velocity: Vector3::new(-0.1, 0.5, 0.3),
            angular_velocity: Vector3::new(1.0, 1.0, 0.25),
            ..state()
        };
        let payer = payer(&[]);
        let pay = |forward_mps: f64, lateral_mps: f64, yaw_radps: f64| {
            payer.sample_following(&state, &[Vector3::zeros(); 4], &Command { forward_mps, lateral_mps, yaw_radps })
        };
        let best = pay(0.5, 0.1, 0.25);
        assert!((best.velocity - 2.0).abs() < 1e-12 && (best.heading - 1.0).abs() < 1e-12, "{best:?}");
        let off = pay(0.5 - 0.06, 0.1 + 0.08, 0.25 - 0.1);
        assert!((off.velocity - 2.0 / 1_f64.exp()).abs() < 1e-12, "one width off: {off:?}");
        assert!((off.heading - 1.0 / 1_f64.exp()).abs() < 1e-12, "{off:?}");
        assert!((best.survival - 0.075).abs() < 1e-12);
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
