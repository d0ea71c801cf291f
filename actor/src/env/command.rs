//! What the robot is told, drawn from the episode's seed, and how well it follows.

use super::reward::velocity;
use crate::sim::RobotState;
use herd_common::config::Config;
use herd_common::config::command::{self, Command};
use herd_common::seed::Seed;
use nalgebra::{UnitQuaternion, Vector2, Vector3};
use rand::RngExt;
use serde::Serialize;

/// Start-up that following does not count, s.
const START_SECS: f64 = 1.0;

/// The commands of one episode: a new one every so often, each a branch of the seed tree to itself.
pub(super) struct Commands {
    config: command::Config,
    every_ticks: u64,
    seed: Seed,
}

impl Commands {
    pub(super) fn new(config: &Config, seed: Seed) -> Self {
        let every_ticks = (config.task.command.every_secs / config.sim.tick_secs).round() as u64;
        Self { config: config.task.command.clone(), every_ticks: every_ticks.max(1), seed }
    }

    /// The command after this many ticks.
    pub(super) fn at(&self, ticks: u64) -> Command {
        let mut rng = self.seed.child("command", ticks / self.every_ticks).rng();
        let stands = rng.random::<f64>() < self.config.standing;
        let mut draw = |[lowest, highest]: [f64; 2]| lowest + (highest - lowest) * rng.random::<f64>();
        let command = Command {
            forward_mps: draw(self.config.forward_mps),
            lateral_mps: draw(self.config.lateral_mps),
            yaw_radps: draw(self.config.yaw_radps),
        };
        if stands { Command::default() } else { command }
    }
}

/// The robot as seen from its course: a place (world, m) and a heading (rad) become the origin and the x axis.
pub(super) fn seen_from(state: &RobotState, place: &Vector2<f64>, heading: f64) -> RobotState {
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -heading);
    RobotState {
        position: turn * (state.position - Vector3::new(place.x, place.y, 0.0)),
        rotation: turn * state.rotation,
        velocity: turn * state.velocity,
        angular_velocity: turn * state.angular_velocity,
        ..state.clone()
    }
}

/// How well a robot followed its commands; the first second is left out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Following {
    /// Mean of the commands.
    pub asked: Command,
    /// Mean of what the robot did, in the frame of its heading.
    pub found: Command,
    /// Root mean square of the difference in planar velocity, m/s; the trunk's sway in each stride is part of it.
    pub velocity_error: f64,
    /// Root mean square of the difference in yaw rate, rad/s.
    pub turn_error: f64,
}

/// Gathers it, tick by tick.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Follower {
    count: f64,
    asked: Vector3<f64>,
    found: Vector3<f64>,
    squares: [f64; 2],
}

impl Follower {
    pub(super) fn tick(&mut self, secs: f64, state: &RobotState, command: &Command) {
        if secs < START_SECS {
            return;
        }
        let vector = |c: &Command| Vector3::new(c.forward_mps, c.lateral_mps, c.yaw_radps);
        let (asked, found) = (vector(command), vector(&velocity(state)));
        let off = found - asked;
        self.count += 1.0;
        self.asked += asked;
        self.found += found;
        self.squares[0] += off.xy().norm_squared();
        self.squares[1] += off.z.powi(2);
    }

    /// The figures so far; none before the start-up is over.
    pub(super) fn following(&self) -> Option<Following> {
        let command = |sum: Vector3<f64>| {
            let [forward_mps, lateral_mps, yaw_radps] = (sum / self.count).into();
            Command { forward_mps, lateral_mps, yaw_radps }
        };
        (self.count > 0.0).then(|| Following {
            asked: command(self.asked),
            found: command(self.found),
            velocity_error: (self.squares[0] / self.count).sqrt(),
            turn_error: (self.squares[1] / self.count).sqrt(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn commands(sets: &[&str], seed: u64) -> Commands {
        let sets: Vec<String> = sets.iter().map(|set| (*set).to_owned()).collect();
        Commands::new(&Config::load(None, &sets).expect("valid"), Seed::from_number(seed))
    }

    #[test]
    fn a_command_holds_until_the_next_draw_and_stays_in_its_range() {
        let commands = commands(&["task.command.standing=0"], 1);
        assert_eq!(commands.at(0), commands.at(1499));
        assert_ne!(commands.at(0), commands.at(1500));
        let drawn: Vec<Command> = (0..500).map(|n| commands.at(1500 * n)).collect();
        let within = |c: &Command| {
            (-0.3..=0.8).contains(&c.forward_mps) && c.lateral_mps.abs() <= 0.2 && c.yaw_radps.abs() <= 0.5
        };
        assert!(drawn.iter().all(within));
        let mean = drawn.iter().map(|c| c.forward_mps).sum::<f64>() / 500.0;
        assert!((mean - 0.25).abs() < 0.06, "{mean} m/s: uniform, σ of the mean 0.014 m/s");
        assert!(!drawn.iter().any(Command::is_standing));
    }

    #[test]
    fn some_draws_ask_to_stand() {
        let commands = commands(&["task.command.standing=0.3"], 2);
        let standing = (0..1000).filter(|n| commands.at(1500 * n).is_standing()).count();
        assert!((240..360).contains(&standing), "{standing} of 1000");
    }

    #[test]
    fn seen_from_its_course_a_robot_on_it_is_at_the_origin_and_heads_along_x() {
        let state = RobotState {
            position: Vector3::new(2.0, 3.0, 0.2),
            rotation: UnitQuaternion::from_euler_angles(0.1, -0.05, 2.5),
            velocity: UnitQuaternion::from_euler_angles(0.0, 0.0, 2.5) * Vector3::new(0.5, 0.1, 0.0),
            angular_velocity: Vector3::z(),
            joints: [Vector3::zeros(); 4],
            joint_speeds: [Vector3::zeros(); 4],
        };
        let seen = seen_from(&state, &Vector2::new(2.0, 3.0), 2.5);
        assert!((seen.position - Vector3::new(0.0, 0.0, 0.2)).norm() < 1e-12, "{seen:?}");
        assert!((seen.angles() - Vector3::new(0.1, -0.05, 0.0)).norm() < 1e-12, "{seen:?}");
        assert!((seen.velocity - Vector3::new(0.5, 0.1, 0.0)).norm() < 1e-12, "{seen:?}");
    }

    #[test]
    fn following_is_the_mean_of_what_was_asked_and_done_after_the_start() {
        let mut follower = Follower::default();
        let command = Command { forward_mps: 0.4, lateral_mps: 0.0, yaw_radps: 0.5 };
        let state = |speed: f64, turn: f64| RobotState {
            position: Vector3::zeros(),
            rotation: UnitQuaternion::identity(),
            velocity: Vector3::new(speed, 0.0, 0.0),
            angular_velocity: Vector3::z() * turn,
            joints: [Vector3::zeros(); 4],
            joint_speeds: [Vector3::zeros(); 4],
        };
        follower.tick(0.5, &state(9.0, 9.0), &command);
        assert_eq!(follower.following(), None);
        follower.tick(1.0, &state(0.3, 0.5), &command);
        follower.tick(1.5, &state(0.5, 0.3), &command);
        let found = follower.following().expect("two samples");
        assert!((found.found.forward_mps - 0.4).abs() < 1e-12 && (found.found.yaw_radps - 0.4).abs() < 1e-12);
        assert!((found.velocity_error - 0.1).abs() < 1e-12 && (found.turn_error - 0.02_f64.sqrt()).abs() < 1e-12);
    }
}
