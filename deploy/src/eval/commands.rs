//! Commands given on the command line: a case each, and a table of what was asked and what the robot did.

use super::cases::Case;
use super::figures::Result;
use crate::exit::Failure;
use crate::table::{columns, percent};
use herd_actor::env::Following;
use herd_common::config::command::Command;
use herd_common::config::{self, Config};
use herd_common::policy::Policy;
use herd_common::spaces::Task;
use std::sync::Arc;

/// Reads `FORWARD,LEFT,TURN`.
pub(crate) fn parse(text: &str) -> std::result::Result<Command, String> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|number| number.trim().parse().ok()).collect();
    match numbers.as_deref() {
        Some(&[forward_mps, lateral_mps, yaw_radps]) => Ok(Command { forward_mps, lateral_mps, yaw_radps }),
        _ => Err("expected three numbers: forward m/s, left m/s, yaw rad/s".to_owned()),
    }
}

/// Refuses commands for a task that takes none.
pub(crate) fn check(task: Task) -> anyhow::Result<()> {
    match task {
        Task::Command | Task::Constant => Ok(()),
        Task::Gait | Task::Torque => {
            let text = format!("--command is for --task command and --task constant, not for {}", task.name());
            Err(Failure::usage(text).into())
        }
    }
}

/// The configuration in which the robot is told this from beginning to end. The constant task becomes the command task
/// with the lift and step of its gait, which nobody corrects.
fn told(config: &Config, command: &Command) -> std::result::Result<Config, config::Error> {
    let span = |key: &str, value: f64| format!("task.{key}=[{value:?}, {value:?}]");
    let standing = f64::from(u8::from(command.is_standing()));
    let mut sets = vec![
        span("command.forward_mps", command.forward_mps),
        span("command.lateral_mps", command.lateral_mps),
        span("command.yaw_radps", command.yaw_radps),
        format!("task.command.standing={standing:?}"),
    ];
    if config.task.kind == Task::Constant {
        let gait = &config.task.constant;
        sets.extend([span("gait.lift_m", gait.lift_m), span("gait.step_secs", gait.step_secs)]);
        sets.push("task.kind=command".to_owned());
    }
    config.overridden(&sets)
}

/// A case for each of these commands; without a policy the controller follows them alone.
pub(crate) fn cases(
    config: &Config,
    commands: &[Command],
    policy: Option<&Arc<Policy>>,
) -> std::result::Result<Vec<Case>, config::Error> {
    let case = |command: &Command| {
        let Command { forward_mps, lateral_mps, yaw_radps } = command;
        let label = format!("{forward_mps:.2} m/s, {lateral_mps:.2} m/s, {yaw_radps:.2} rad/s");
        Ok(Case { label, config: told(config, command)?, policy: policy.cloned() })
    };
    commands.iter().map(case).collect()
}

/// The mean over episodes; none if none of them followed anything.
pub(crate) fn mean(all: &[Following]) -> Option<Following> {
    let n = all.len() as f64;
    let mean = |figure: &dyn Fn(&Following) -> f64| all.iter().map(figure).sum::<f64>() / n;
    let command = |of: &dyn Fn(&Following) -> Command| Command {
        forward_mps: mean(&|f| of(f).forward_mps),
        lateral_mps: mean(&|f| of(f).lateral_mps),
        yaw_radps: mean(&|f| of(f).yaw_radps),
    };
    (!all.is_empty()).then(|| Following {
        asked: command(&|f| f.asked),
        found: command(&|f| f.found),
        velocity_error: mean(&|f| f.velocity_error),
        turn_error: mean(&|f| f.turn_error),
    })
}

/// One row a command: asked, and done in the mean.
pub(crate) fn table(results: &[Result]) -> String {
    let head = "forward m/s|did|left m/s|did|yaw rad/s|did|rms m/s|rms rad/s|return|falls";
    let rows = results.iter().map(|result| {
        let falls = percent(result.mean.fall_rate);
        let value = format!("{:.1}", result.mean.value);
        let Some(Following { asked, found, velocity_error, turn_error }) = result.mean.following else {
            return [vec![result.label.clone()], vec!["–".to_owned(); 7], vec![value, falls]].concat();
        };
        let numbers = [
            (asked.forward_mps, found.forward_mps),
            (asked.lateral_mps, found.lateral_mps),
            (asked.yaw_radps, found.yaw_radps),
        ];
        let pairs = numbers.into_iter().flat_map(|(asked, found)| [format!("{asked:.2}"), format!("{found:.3}")]);
        pairs.chain([format!("{velocity_error:.3}"), format!("{turn_error:.3}"), value, falls]).collect()
    });
    let head = head.split('|').map(str::to_owned).collect();
    columns(&std::iter::once(head).chain(rows).collect::<Vec<_>>())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_command_is_three_numbers() {
        let command = Command { forward_mps: 0.5, lateral_mps: -0.1, yaw_radps: 0.3 };
        assert_eq!(parse("0.5, -0.1,0.3"), Ok(command));
        for bad in ["0.5", "0.5,0.1", "0.5,0.1,fast", "1,2,3,4"] {
            assert!(parse(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn the_constant_gait_keeps_its_lift_and_step_when_told() {
        let config = Config::load(None, &["task.kind=constant".into()]).expect("valid");
        let command = Command { forward_mps: 0.5, lateral_mps: 0.1, yaw_radps: 0.3 };
        let task = told(&config, &command).expect("valid").task;
        assert_eq!(task.kind, Task::Command);
        let gait = task.command.gait(&[0.0; 4], &command, &task.gait);
        assert_eq!((gait.lift_m, gait.step_secs), (task.constant.lift_m, task.constant.step_secs));
        assert_eq!(gait.velocity_mps, 0.5);
        let error = told(&config, &Command { forward_mps: 9.0, ..command }).expect_err("refused").to_string();
        assert!(error.contains("`task.command.forward_mps` is [9.0, 9.0]"), "{error}");
    }

    #[test]
    fn the_mean_is_that_of_the_episodes() {
        let one = |forward_mps: f64, velocity_error: f64| Following {
            found: Command { forward_mps, ..Command::default() },
            velocity_error,
            ..Following::default()
        };
        let mean = mean(&[one(0.4, 0.1), one(0.6, 0.3)]).expect("two");
        assert!((mean.found.forward_mps - 0.5).abs() < 1e-12 && (mean.velocity_error - 0.2).abs() < 1e-12);
        assert_eq!(super::mean(&[]), None);
    }
}
