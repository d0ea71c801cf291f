//! The one loop that runs an episode: training, evaluation and reports differ in who acts and who listens.

use crate::env::{Env, Figures, Observation};
use crate::explore::{Exploration, explorer};
use herd_common::config::{Config, task};
use herd_common::episode::{Ending, Outcome};
use herd_common::policy::Policy;
use herd_common::seed::Seed;
use herd_common::spaces::Task;
use herd_common::transition::Transition;
use std::ops::ControlFlow;

/// Runs the episode of `seed`: `act` chooses, `sink` receives every transition as it happens.
///
/// The decision in which the simulation diverged is not a transition.
pub fn run_episode(
    env: &mut Env,
    seed: Seed,
    act: &mut dyn FnMut(&Observation) -> Vec<f32>,
    sink: &mut dyn FnMut(Transition<'_>),
) -> Outcome {
    let mut sink = |transition: Transition<'_>| {
        sink(transition);
        ControlFlow::Continue(())
    };
    run_until(env, seed, act, &mut sink).expect("this sink never breaks the episode off")
}

/// Runs an episode that `sink` may break off, which leaves no outcome.
pub fn run_until(
    env: &mut Env,
    seed: Seed,
    act: &mut dyn FnMut(&Observation) -> Vec<f32>,
    sink: &mut dyn FnMut(Transition<'_>) -> ControlFlow<()>,
) -> Option<Outcome> {
    let observation = env.reset(seed);
    finish(env, observation, act, sink)
}

/// Runs the rest of an episode that has been reset, from what the policy sees now.
pub fn finish(
    env: &mut Env,
    mut observation: Observation,
    act: &mut dyn FnMut(&Observation) -> Vec<f32>,
    sink: &mut dyn FnMut(Transition<'_>) -> ControlFlow<()>,
) -> Option<Outcome> {
    loop {
        let action = act(&observation);
        let step = env.step(&action);
        if step.ending != Some(Ending::Diverged) {
            let transition = Transition {
                observation: &observation,
                action: &action,
                reward: step.reward,
                discount: step.discount,
                next_observation: &step.observation,
            };
            if sink(transition).is_break() {
                return None;
            }
        }
        if step.ending.is_some() {
            return Some(env.outcome());
        }
        observation = step.observation;
    }
}

/// Runs the episode of `seed` under a policy with this exploration.
pub fn run_policy(
    env: &mut Env,
    seed: Seed,
    policy: &Policy,
    exploration: Exploration,
    sink: &mut dyn FnMut(Transition<'_>),
) -> Outcome {
    let mut explorer = explorer(exploration, seed);
    let mut act = |observation: &Observation| {
        let mut action = policy.act(observation);
        explorer.apply(&mut action);
        action
    };
    run_episode(env, seed, &mut act, sink)
}

/// Runs the constant task of this configuration with another gait: what a gait is worth without learning.
pub fn run_constant(config: &Config, gait: &task::Constant, seed: Seed) -> (Outcome, Figures) {
    let task = task::Config { kind: Task::Constant, constant: *gait, ..config.task.clone() };
    let mut env = Env::new(&Config { task, ..config.clone() });
    let outcome = run_episode(&mut env, seed, &mut |_| Vec::new(), &mut |_| {});
    (outcome, env.figures(gait.velocity_mps))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::env::Following;
    use rand::RngExt;

    /// A gait whose stride fits its speed.
    fn gait(velocity_mps: f64) -> task::Constant {
        task::Constant { velocity_mps, stride_m: velocity_mps * 0.15, lift_m: 0.03, step_secs: 0.15 }
    }

    #[test]
    fn the_robot_walks_ten_seconds_at_the_speed_asked_for() {
        for velocity in [0.2, 0.6, 1.0] {
            let (outcome, figures) = run_constant(&Config::default(), &gait(velocity), Seed::from_number(1));
            assert_eq!(outcome.ending, Ending::TimedOut, "{velocity} m/s: {outcome:?}");
            let speed = outcome.mean_speed();
            assert!((speed / velocity - 1.0).abs() < 0.05, "{speed} m/s for {velocity} m/s");
            assert!((figures.mean_speed - speed).abs() < 0.01, "{figures:?}");
            // The paper's Group_1 has 8.9e-4 and 2.1e-3 rad².
            assert!(outcome.roll_variance < 2e-4 && outcome.pitch_variance < 1e-3, "{outcome:?}");
            assert!(outcome.counts.qp_failures == 0 && outcome.counts.saturated_torques == 0, "{:?}", outcome.counts);
        }
    }

    /// The episode of a robot that is told this by a policy that corrects nothing, and how well it followed.
    fn told(command: [f64; 3], sets: &[&str]) -> (Outcome, Following) {
        let [forward, lateral, yaw] = command;
        let mut all = vec![
            "task.kind=command".to_owned(),
            format!("task.command.forward_mps=[{forward:?}, {forward:?}]"),
            format!("task.command.lateral_mps=[{lateral:?}, {lateral:?}]"),
            format!("task.command.yaw_radps=[{yaw:?}, {yaw:?}]"),
            "task.command.standing=0".to_owned(),
        ];
        all.extend(sets.iter().map(|set| (*set).to_owned()));
        let mut env = Env::new(&Config::load(None, &all).expect("valid"));
        let outcome = run_episode(&mut env, Seed::from_number(1), &mut |_| vec![0.0; 4], &mut |_| {});
        (outcome, env.following().expect("it ran for more than a second"))
    }

    #[test]
    fn the_controller_follows_commands_for_ten_seconds() {
        let commands = [
            [0.4, 0.1, 0.3],
            [0.4, -0.1, -0.3],
            [-0.3, 0.1, 0.3],
            [0.0, 0.2, 0.0],
            [0.0, -0.2, 0.0],
            [0.0, 0.0, 0.5],
            [0.0, 0.0, -0.5],
            [0.8, 0.0, 0.5],
        ];
        for command in commands {
            let (outcome, Following { found, .. }) = told(command, &[]);
            assert_eq!(outcome.ending, Ending::TimedOut, "{command:?}: {outcome:?}");
            let found = [found.forward_mps, found.lateral_mps, found.yaw_radps];
            let off = (0..3).map(|i| (found[i] - command[i]).abs()).fold(0.0, f64::max);
            assert!(off < 0.03, "told {command:?}, did {found:?}: m/s, rad/s");
        }
    }

    #[test]
    fn a_robot_told_to_stand_stands() {
        let (outcome, followed) = told([0.0; 3], &["task.episode_secs=4"]);
        assert_eq!(outcome.ending, Ending::TimedOut);
        assert!(followed.velocity_error < 5e-3 && followed.turn_error < 5e-3, "{followed:?}");
        assert_eq!((outcome.counts.early_contacts, outcome.counts.late_contacts), (0, 0), "it took no step");
        let pushed = ["task.episode_secs=6", "scenario.push_ns=[5, 5]", "scenario.push_every_secs=[2, 2]"];
        let (outcome, followed) = told([0.0; 3], &pushed);
        assert_eq!(outcome.ending, Ending::TimedOut, "{outcome:?}");
        assert!(outcome.counts.early_contacts > 0, "it steps to stay up");
        assert!(followed.found.forward_mps.abs() < 0.1, "{followed:?}");
    }

    #[test]
    fn the_robot_walks_up_a_slope_and_over_steps_that_it_cannot_see() {
        for site in ["scenario.slope_deg=[10, 10]", "scenario.step_m=[0.02, 0.02]", "scenario.bump_m=[0.02, 0.02]"] {
            let config = Config::load(None, &[site.to_owned()]).expect("valid");
            let (outcome, _) = run_constant(&config, &gait(0.4), Seed::from_number(1));
            assert_eq!(outcome.ending, Ending::TimedOut, "{site}: {outcome:?}");
            let speed = outcome.mean_speed();
            assert!((speed / 0.4 - 1.0).abs() < 0.05, "{site}: {speed} m/s");
        }
    }

    #[test]
    fn random_actions_do_not_trip_the_robot() {
        let mut env = Env::new(&Config::default());
        for number in 0..2 {
            let seed = Seed::from_number(number);
            let mut random = explorer(Exploration::Uniform, seed);
            let mut act = |_: &Observation| {
                let mut action = vec![0.0; 4];
                random.apply(&mut action);
                action
            };
            let outcome = run_episode(&mut env, seed, &mut act, &mut |_| {});
            assert_eq!(outcome.ending, Ending::TimedOut, "seed {number}: {outcome:?}");
        }
    }

    #[test]
    fn jumps_between_the_corners_of_the_box_do_not_trip_the_robot() {
        let mut env = Env::new(&Config::default());
        // Seeds that fell, most while braking, before speed asked for and standing feet were kept near the robot.
        for number in [4, 5, 11, 49] {
            let seed = Seed::from_number(number);
            let mut rng = seed.child("trial", 0).rng();
            let mut act = |_: &Observation| (0..4).map(|_| if rng.random_bool(0.5) { 1.0 } else { -1.0 }).collect();
            let outcome = run_episode(&mut env, seed, &mut act, &mut |_| {});
            assert_eq!(outcome.ending, Ending::TimedOut, "seed {number}: {outcome:?}");
        }
    }

    #[test]
    fn transitions_are_whole_and_chained() {
        let config = Config::load(None, &["task.episode_secs=2".to_owned()]).expect("valid");
        let mut env = Env::new(&config);
        let mut batch = herd_common::transition::Batch::new(Task::Gait.dims());
        let outcome = run_episode(&mut env, Seed::from_number(2), &mut |o| vec![o[0], -1.0, 0.5, 2.0], &mut |t| {
            batch.push(Transition { action: &t.action.iter().map(|x| x.clamp(-1.0, 1.0)).collect::<Vec<_>>(), ..t });
        });
        assert_eq!(batch.validate(), Ok(()));
        assert_eq!(batch.len() as u64, outcome.decisions);
        for i in 1..batch.len() {
            assert_eq!(batch.get(i).observation, batch.get(i - 1).next_observation);
        }
        let sum: f64 = batch.rewards.iter().map(|r| f64::from(*r)).sum();
        assert!((sum - outcome.reward.total()).abs() < 1e-3);
    }
}
