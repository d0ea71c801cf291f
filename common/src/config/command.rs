//! Settings of the command task: what is asked of the robot, what its policy may correct, what it is paid for.

use super::task::{Constant, Gait};
use super::{Error, check, check_span};
use crate::spaces;
use serde::{Deserialize, Serialize};

/// A velocity asked for, in the frame of the robot's heading.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Command {
    /// Forwards, m/s.
    pub forward_mps: f64,
    /// To the left, m/s.
    pub lateral_mps: f64,
    /// Turning left, rad/s.
    pub yaw_radps: f64,
}

/// The command task.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Range `[lowest, highest]` of the forward velocity, m/s.
    pub forward_mps: [f64; 2],
    /// Range of the velocity to the left, m/s.
    pub lateral_mps: [f64; 2],
    /// Range of the yaw rate, rad/s.
    pub yaw_radps: [f64; 2],
    /// Time between two draws, s.
    pub every_secs: f64,
    /// Share of draws that ask the robot to stand.
    pub standing: f64,
    /// Forward speed that the whole half width of the action adds to the command, m/s.
    pub correction_mps: f64,
    /// Length that it adds to the stride that fits the speed, m.
    pub correction_m: f64,
    /// Weight of the planar velocity's term, per sample.
    pub velocity: f64,
    /// Its width σ, m/s.
    pub velocity_width_mps: f64,
    /// Weight of the yaw rate's term, per sample.
    pub turn: f64,
    /// Its width σ, rad/s.
    pub turn_width_radps: f64,
}

impl Command {
    /// True when the robot is to stay where it is.
    pub fn is_standing(&self) -> bool {
        *self == Self::default()
    }
}

impl Config {
    /// The gait that an action in [−1, 1]⁴ stands for: speed and stride around those of the command, H and Δt as in
    /// the gait task. A robot that is to stand is not corrected.
    pub fn gait(&self, action: &[f32], command: &Command, ranges: &Gait) -> Constant {
        let plain = ranges.from_action(action);
        let at = |i: usize, half: f64| f64::from(action[i]).clamp(-1.0, 1.0) * half;
        if command.is_standing() {
            return Constant { velocity_mps: 0.0, stride_m: 0.0, ..plain };
        }
        Constant {
            velocity_mps: command.forward_mps + at(0, self.correction_mps),
            stride_m: command.forward_mps * plain.step_secs + at(1, self.correction_m),
            ..plain
        }
    }

    pub(super) fn validate(&self) -> Result<(), Error> {
        // What is asked for must fit the observation.
        let most = f64::from(spaces::COMMAND.scale);
        check_span("task.command.forward_mps", self.forward_mps, -most..=most)?;
        check_span("task.command.lateral_mps", self.lateral_mps, -most..=most)?;
        check_span("task.command.yaw_radps", self.yaw_radps, -most..=most)?;
        check("task.command.every_secs", self.every_secs, 0.1..=1000.0)?;
        check("task.command.standing", self.standing, 0.0..=1.0)?;
        check("task.command.correction_mps", self.correction_mps, 0.0..=2.0)?;
        check("task.command.correction_m", self.correction_m, 0.0..=0.5)?;
        check("task.command.velocity", self.velocity, 0.0..=1000.0)?;
        check("task.command.velocity_width_mps", self.velocity_width_mps, 0.01..=10.0)?;
        check("task.command.turn", self.turn, 0.0..=1000.0)?;
        check("task.command.turn_width_radps", self.turn_width_radps, 0.01..=10.0)
    }
}

#[cfg(test)]
mod tests {
    use super::super::Config;
    use super::Command;

    #[test]
    fn an_action_corrects_the_command_and_not_a_standing_robot() {
        let task = Config::default().task;
        let command = Command { forward_mps: 0.5, lateral_mps: 0.1, yaw_radps: 0.2 };
        let gait = |action: [f32; 4], command: &Command| task.command.gait(&action, command, &task.gait);
        let middle = gait([0.0; 4], &command);
        assert_eq!((middle.velocity_mps, middle.stride_m), (0.5, 0.5 * middle.step_secs));
        let most = gait([1.0; 4], &command);
        assert_eq!((most.velocity_mps, most.lift_m), (0.5 + task.command.correction_mps, task.gait.lift_m[1]));
        assert_eq!(most.stride_m, 0.5 * task.gait.step_secs[1] + task.command.correction_m);
        let standing = gait([1.0; 4], &Command::default());
        assert_eq!((standing.velocity_mps, standing.stride_m), (0.0, 0.0));
    }

    #[test]
    fn ranges_that_the_observation_cannot_show_are_refused() {
        let error = Config::load(None, &["task.command.forward_mps=[0, 1.6]".into()]).expect_err("refused");
        assert!(error.to_string().contains("`task.command.forward_mps` is [0.0, 1.6]"), "{error}");
    }

    #[test]
    fn commands_are_part_of_the_command_task_alone() {
        let base = Config::default();
        let wide = |config: &Config| config.overridden(&["task.command.standing=0.5".into()]).expect("valid");
        assert_eq!(wide(&base).task_hash(), base.task_hash());
        let command = base.overridden(&["task.kind=command".into()]).expect("valid");
        assert_ne!(wide(&command).task_hash(), command.task_hash());
    }
}
