//! Runs a robot through an episode, decision by decision.
//!
//! Time is counted in ticks. A decision of the gait task is one swing; of the torque task a fixed time; the last one of
//! an episode is cut at the time limit, which truncates: the value goes on. Every reset builds a fresh world, so an
//! episode is a function of configuration, seed and actions, whatever was run before.

mod figures;

use super::command::{Commands, Follower, seen_from};
use super::observation::{Observation, Sense, observe};
use super::reward::Payer;
use super::scenario::{Push, Scenario};
use super::sensor::Sensor;
use super::summary::Summary;
use super::{ending, settle};
use crate::control::{Body, Controller, Timer, Watcher};
use crate::gait::Pair;
use crate::robot::Model;
use crate::sim::{self, Contacts, Plant, RobotState, Spawn};
use herd_common::config::Config;
use herd_common::config::command::Command;
use herd_common::episode::{Ending, Reward};
use herd_common::seed::Seed;
use herd_common::spaces::Task;
use nalgebra::{Vector3, Vector4};
use std::collections::VecDeque;

/// Ticks over which foot forces are averaged for the observation: contact impulses of one tick are spiky.
const FORCE_TICKS: usize = 5;

/// What a decision led to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// What the policy sees next.
    pub observation: Observation,
    /// Eq 10 summed over the decision.
    pub reward: f32,
    /// Factor on the next value: 0 after a fall, never 0 after the time limit.
    pub discount: f32,
    /// The terms of eq 10 at the decision's end, by the command that it followed, whether or not a sample is due.
    pub moment: Reward,
    /// Set when the episode is over; after `Diverged` the other fields mean nothing and the decision is dropped.
    pub ending: Option<Ending>,
}

/// Sees the robot, its ground contact and its joint torques (N·m) after every tick of an episode.
pub type Observer = Box<dyn FnMut(&RobotState, &Contacts, &[Vector3<f64>; 4]) + Send>;

/// One robot and its task.
pub struct Env {
    config: Config,
    model: Model,
    controller: Controller,
    payer: Payer,
    commands: Commands,
    /// What the robot is told in this decision; nothing but in the command task.
    command: Option<Command>,
    follower: Follower,
    scenario: Scenario,
    sensor: Sensor,
    world: Box<dyn Plant>,
    spawn: Spawn,
    state: RobotState,
    /// The state as the robot measures it.
    sensed: RobotState,
    contacts: Contacts,
    /// Torques (N·m) that have yet to act, oldest first.
    late: VecDeque<[Vector3<f64>; 4]>,
    /// Foot forces of the last ticks, normal and friction, N.
    forces: [(Vector4<f64>, Vector4<f64>); FORCE_TICKS],
    torques: [Vector3<f64>; 4],
    ticks: u64,
    limit_ticks: u64,
    summary: Summary,
    ending: Option<Ending>,
    observer: Option<Observer>,
}

impl Env {
    /// An environment for this configuration, reset with a seed of its own; call `reset` before an episode.
    pub fn new(config: &Config) -> Self {
        let model = Model::new(&config.robot);
        let seed = Seed::from_number(config.seed);
        let scenario = Scenario::draw(config, seed);
        let mut spawn = sim::rapier();
        let (world, _) = settle::world(&model, config, &scenario.site, seed, &mut spawn);
        let state = world.state();
        Self {
            controller: Controller::new(config, &model),
            payer: Payer::new(&config.task, model.torque_max, config.sim.tick_secs),
            contacts: world.contacts(),
            forces: [(Vector4::zeros(), Vector4::zeros()); FORCE_TICKS],
            torques: [Vector3::zeros(); 4],
            ticks: 0,
            limit_ticks: (config.task.episode_secs / config.sim.tick_secs).round() as u64,
            summary: Summary::default(),
            commands: Commands::new(config, seed),
            command: None,
            follower: Follower::default(),
            ending: None,
            observer: None,
            sensor: Sensor::new(scenario.noise, seed),
            late: VecDeque::new(),
            config: config.clone(),
            model,
            scenario,
            world,
            spawn,
            sensed: state.clone(),
            state,
        }
    }

    /// The same, with the solver's times measured by this timer (ns since any fixed moment).
    pub fn with_timer(mut self, timer: Timer) -> Self {
        self.controller.set_timer(timer);
        self
    }

    /// The same, with every question to the MPC shown to this watcher.
    pub fn with_watcher(mut self, watcher: Watcher) -> Self {
        self.controller.set_watcher(watcher);
        self
    }

    /// The same, with the worlds of episodes to come made by `spawn`: those of another simulator.
    pub fn with_plant(mut self, spawn: Spawn) -> Self {
        self.spawn = spawn;
        self
    }

    /// Shows every tick from now on to this observer, or to nobody; what it does changes nothing in the episode.
    pub fn set_observer(&mut self, observer: Option<Observer>) {
        self.observer = observer;
    }

    /// Starts the episode of this seed.
    pub fn reset(&mut self, seed: Seed) -> Observation {
        self.scenario = Scenario::draw(&self.config, seed);
        let (world, held) = settle::world(&self.model, &self.config, &self.scenario.site, seed, &mut self.spawn);
        self.world = world;
        self.late = VecDeque::from(vec![held; self.scenario.delay_ticks]);
        self.sensor = Sensor::new(self.scenario.noise, seed);
        self.state = self.world.state();
        self.sensed = self.sensor.measure(&self.state);
        self.contacts = self.world.contacts();
        self.controller.reset();
        self.forces = [(Vector4::zeros(), Vector4::zeros()); FORCE_TICKS];
        self.forces.fill((Vector4::from(self.contacts.normal), Vector4::from(self.contacts.friction)));
        self.torques = [Vector3::zeros(); 4];
        self.ticks = 0;
        self.summary = Summary::new(self.state.position.x);
        self.commands = Commands::new(&self.config, seed);
        self.command = self.command_now();
        self.follower = Follower::default();
        self.ending = None;
        self.observation()
    }

    /// Takes one decision: an action of [−1, 1]ⁿ; the constant task ignores it.
    ///
    /// # Panics
    /// When the episode is over, or the action has another length than the task's.
    pub fn step(&mut self, action: &[f32]) -> Step {
        assert!(self.ending.is_none(), "the episode ended with {:?}: reset first", self.ending);
        let first_tick = self.ticks;
        let before = self.summary.reward();
        match self.config.task.kind {
            Task::Torque => self.step_torque(action),
            Task::Gait => {
                let gait = self.config.task.gait.from_action(checked(action, Task::Gait));
                self.step_gait(&gait);
            }
            Task::Constant => self.step_gait(&self.config.task.constant.clone()),
            Task::Command => self.step_command(action),
        }
        let moment = self.reward_now();
        self.command = self.command_now();
        if self.ending.is_none() && self.ticks >= self.limit_ticks {
            self.ending = Some(Ending::TimedOut);
        }
        let secs = (self.ticks - first_tick) as f64 * self.config.sim.tick_secs;
        self.summary.end_decision(self.ending);
        let discount = match self.ending {
            Some(Ending::Fell(_) | Ending::Diverged) => 0.0,
            Some(Ending::TimedOut) | None => self.config.task.discount.of(secs),
        };
        let reward = self.summary.reward().total() - before.total();
        Step {
            observation: self.observation(),
            reward: reward as f32,
            discount: discount as f32,
            moment,
            ending: self.ending,
        }
    }

    /// The terms of eq 10 at this moment.
    fn reward_now(&self) -> Reward {
        match &self.command {
            Some(command) => self.payer.sample_following(&self.state, &self.torques, command),
            None => self.payer.sample(&self.state, &self.torques),
        }
    }

    /// Pushes the trunk with a world force (N) for this many seconds from now on.
    pub fn push(&mut self, force: &Vector3<f64>, secs: f64) {
        self.world.push(force, (secs / self.config.sim.tick_secs).round() as u32);
    }

    /// The same, but `delay_secs` from now, in the middle of a decision too; call it after `reset`.
    pub fn push_after(&mut self, delay_secs: f64, force: &Vector3<f64>, secs: f64) {
        let ticks = |secs: f64| (secs / self.config.sim.tick_secs).round();
        let push = Push { force: *force, ticks: ticks(secs) as u32 };
        self.scenario.pushes.insert(self.ticks + ticks(delay_secs) as u64, push);
    }

    fn step_gait(&mut self, gait: &herd_common::config::task::Constant) {
        let ticks = self.controller.begin(gait, &Body::new(&self.model, &self.sensed));
        for _ in 0..ticks {
            let torques = self.controller.torques(&Body::new(&self.model, &self.sensed), &self.contacts);
            self.tick(torques);
            if self.is_over() {
                return;
            }
        }
    }

    fn step_command(&mut self, action: &[f32]) {
        let command = self.command.unwrap_or_default();
        let task = &self.config.task;
        let gait = task.command.gait(checked(action, Task::Command), &command, &task.gait);
        self.controller.steer(command.lateral_mps, command.yaw_radps);
        self.step_gait(&gait);
    }

    /// What the robot is told from now on.
    fn command_now(&self) -> Option<Command> {
        (self.config.task.kind == Task::Command).then(|| self.commands.at(self.ticks))
    }

    fn step_torque(&mut self, action: &[f32]) {
        let action = checked(action, Task::Torque);
        let torque = self.config.task.torque.limit_nm.min(self.model.torque_max);
        let torques = std::array::from_fn(|leg| {
            Vector3::from_fn(|joint, _| f64::from(action[3 * leg + joint].clamp(-1.0, 1.0)) * torque)
        });
        // Decisions end on the ticks nearest to multiples of their duration, so none drifts.
        let (duration, tick) = (self.config.task.torque.decision_secs, self.config.sim.tick_secs);
        let decision = (self.ticks as f64 * tick / duration + 0.5).floor() + 1.0;
        let last_tick = ((decision * duration / tick).round() as u64).max(self.ticks + 1);
        while self.ticks < last_tick {
            self.tick(torques);
            if self.is_over() {
                return;
            }
        }
    }

    fn tick(&mut self, torques: [Vector3<f64>; 4]) {
        if let Some(push) = self.scenario.pushes.remove(&self.ticks) {
            self.world.push(&push.force, push.ticks);
        }
        self.late.push_back(torques);
        self.torques = self.late.pop_front().unwrap_or(torques);
        self.world.tick(&self.torques);
        let before = std::mem::replace(&mut self.state, self.world.state());
        self.sensed = self.sensor.measure(&self.state);
        self.contacts = self.world.contacts();
        self.ticks += 1;
        self.forces[self.ticks as usize % FORCE_TICKS] =
            (Vector4::from(self.contacts.normal), Vector4::from(self.contacts.friction));
        self.ending = if self.world.has_diverged() {
            Some(Ending::Diverged)
        } else {
            ending::of(&self.state, &self.contacts, self.ground(), self.controller.heading(), &self.config.task.ending)
        };
        if self.ending == Some(Ending::Diverged) {
            return;
        }
        self.summary.tick([&before, &self.state], &self.contacts, &self.torques, self.config.sim.tick_secs);
        if self.payer.is_due(self.ticks) {
            self.summary.sample(&self.state, self.reward_now());
        }
        if let Some(command) = &self.command {
            self.follower.tick(self.ticks as f64 * self.config.sim.tick_secs, &self.state, command);
        }
        if let Some(observer) = &mut self.observer {
            observer(&self.state, &self.contacts, &self.torques);
        }
    }

    fn is_over(&self) -> bool {
        self.ending.is_some() || self.ticks >= self.limit_ticks
    }

    fn observation(&self) -> Observation {
        if self.ending == Some(Ending::Diverged) {
            return Observation::zeros(self.config.task.kind.observation_dim());
        }
        let mirrored = self.config.task.kind != Task::Torque
            && self.config.task.gait.mirror
            && self.controller.next_pair() == Pair::FrontRightRearLeft;
        let mean = |sum: Vector4<f64>| (sum / FORCE_TICKS as f64).into();
        let on_course = self.command.map(|_| {
            let place = self.controller.place().unwrap_or(self.sensed.position.xy());
            seen_from(&self.sensed, &place, self.controller.heading())
        });
        let place = self.state.position.xy();
        let sense = Sense {
            state: on_course.as_ref().unwrap_or(&self.sensed),
            torques: &self.torques,
            ground: self.controller.ground_below(&place).unwrap_or_else(|| self.ground().height(place.x, place.y)),
            normal: mean(self.forces.iter().map(|(normal, _)| normal).sum()),
            friction: mean(self.forces.iter().map(|(_, friction)| friction).sum()),
            command: self.command,
        };
        observe(&self.model, &sense, mirrored)
    }
}

/// The action, if it has the length of the task's.
fn checked(action: &[f32], task: Task) -> &[f32] {
    assert_eq!(action.len(), task.action_dim(), "length of an action of the {} task", task.name());
    action
}

#[cfg(test)]
mod tests {
    use super::*;
    use herd_common::spaces;
    use std::sync::{Arc, Mutex};

    fn env(sets: &[&str]) -> Env {
        let sets: Vec<String> = sets.iter().map(|set| (*set).to_owned()).collect();
        Env::new(&Config::load(None, &sets).expect("valid"))
    }

    /// Everything that a policy could notice of an episode, as bits.
    fn trace(env: &mut Env, seed: u64, action: &[f32]) -> Vec<u32> {
        let mut bits: Vec<u32> = env.reset(Seed::from_number(seed)).iter().map(|x| x.to_bits()).collect();
        loop {
            let step = env.step(action);
            bits.extend(step.observation.iter().chain([&step.reward, &step.discount]).map(|x| x.to_bits()));
            if step.ending.is_some() {
                return bits;
            }
        }
    }

    #[test]
    fn an_episode_depends_on_its_seed_alone() {
        let short = ["task.episode_secs=1"];
        let mut used = env(&short);
        let action = [0.3, -0.2, 0.0, -0.5];
        let first = trace(&mut used, 5, &action);
        trace(&mut used, 6, &[1.0, 1.0, 1.0, 1.0]);
        assert_eq!(trace(&mut used, 5, &action), first, "after another episode");
        assert_eq!(trace(&mut env(&short), 5, &action), first, "in a new environment");
        assert_ne!(trace(&mut used, 7, &action), first);
    }

    #[test]
    fn the_time_limit_truncates_and_cuts_the_last_decision() {
        let mut env = env(&["task.kind=constant", "task.episode_secs=1", "task.constant.step_secs=0.15"]);
        env.reset(Seed::from_number(1));
        let mut steps = Vec::new();
        while steps.last().is_none_or(|step: &Step| step.ending.is_none()) {
            steps.push(env.step(&[]));
        }
        let (first, last) = (&steps[0], &steps[steps.len() - 1]);
        assert_eq!((steps.len(), last.ending), (7, Some(Ending::TimedOut)));
        assert!((f64::from(first.discount) - 0.95).abs() < 1e-6);
        assert!((f64::from(last.discount) - 0.95_f64.powf(0.1 / 0.15)).abs() < 1e-6);
        let outcome = env.outcome();
        let total: f64 = steps.iter().map(|step| f64::from(step.reward)).sum();
        assert!((outcome.reward.total() - total).abs() < 1e-4);
        assert_eq!((outcome.decisions, outcome.seconds), (7, 1.0));
        assert!((outcome.reward.survival - 30.0).abs() < 1e-9);
        assert_eq!(outcome.first_invalid(), None);
    }

    #[test]
    fn heights_are_those_over_the_ground_that_the_feet_feel() {
        let mut env = env(&["task.kind=constant", "scenario.bump_m=[0.02, 0.02]"]);
        env.reset(Seed::from_number(1));
        let steps: Vec<Step> = (0..10).map(|_| env.step(&[])).collect();
        let place = env.state().position.xy();
        let over = |ground: f64| (env.state().position.z - ground - env.model().standing_height()) as f32;
        let shown = steps[9].observation[spaces::POSITION_Z.start] * spaces::POSITION_Z.scale;
        let felt = env.controller.ground_below(&place).expect("it has walked");
        assert!((shown - over(felt)).abs() < 1e-6, "{shown}, expected {}", over(felt));
        assert!(
            (shown - over(env.ground().height(place.x, place.y))).abs() > 1e-4,
            "bumps that no foot stands on show"
        );
    }

    #[test]
    fn no_torque_is_beyond_the_limit_and_cut_ones_are_counted() {
        let mut env = env(&["task.kind=constant", "robot.torque_max_nm=6", "task.episode_secs=1"]);
        let largest = Arc::new(Mutex::new(0.0_f64));
        let seen = Arc::clone(&largest);
        env.set_observer(Some(Box::new(move |_, _, torques| {
            let most = torques.iter().map(Vector3::amax).fold(0.0, f64::max);
            let mut largest = seen.lock().expect("nobody panics");
            *largest = largest.max(most);
        })));
        env.reset(Seed::from_number(1));
        while env.step(&[]).ending.is_none() {}
        assert_eq!(*largest.lock().expect("nobody panics"), env.model().torque_max);
        assert!(env.outcome().counts.saturated_torques > 0);
    }

    #[test]
    fn the_mpc_is_asked_every_period_and_looks_as_far_ahead_as_it_is_told() {
        let config = Config::load(None, &["task.kind=constant".to_owned(), "task.episode_secs=3".to_owned()]);
        let config = config.expect("valid");
        let (gait, mpc) = (&config.task.constant, &config.control.mpc);
        let ahead = Arc::new(Mutex::new(Vec::new()));
        let asked = Arc::clone(&ahead);
        let mut env = Env::new(&config).with_watcher(Box::new(move |state, horizon| {
            let last = horizon.last().expect("not empty");
            asked.lock().expect("nobody panics").push(last.reference.position.x - state.position.x);
        }));
        env.reset(Seed::from_number(1));
        while env.step(&[]).ending.is_none() {}
        let ahead = ahead.lock().expect("nobody panics");
        let (periods, swings) = (3.0 / mpc.period_secs, 3.0 / gait.step_secs);
        // Beside the period: at the start of each swing, and when each of its two feet touches down.
        let count = ahead.len() as f64;
        assert!(count > periods && count <= periods + 3.0 * swings, "{count} questions in 3 s");
        let far = ahead[ahead.len() - 1] / gait.velocity_mps;
        let horizon_secs = mpc.horizon as f64 * mpc.step_secs;
        assert!(
            (far / horizon_secs - 1.0).abs() < 0.2,
            "{far} s ahead at the end of the walk, expected {horizon_secs}"
        );
    }

    #[test]
    fn a_robot_without_torque_falls_and_that_is_terminal() {
        let mut env = env(&["task.kind=torque"]);
        env.reset(Seed::from_number(1));
        for decisions in 1..400 {
            let step = env.step(&[0.0; 12]);
            if let Some(ending) = step.ending {
                assert!(ending.is_fall(), "{ending:?}");
                assert_eq!((step.discount, env.outcome().decisions), (0.0, decisions));
                return;
            }
        }
        panic!("it never fell");
    }

    #[test]
    fn torque_decisions_last_25_ms_on_average() {
        let mut env = env(&["task.kind=torque", "task.ending.height_m=0", "task.episode_secs=0.25"]);
        env.reset(Seed::from_number(1));
        let stand = [0.0, 0.0, 0.1].repeat(4);
        let mut decisions = 1;
        while env.step(&stand).ending.is_none() {
            decisions += 1;
        }
        assert_eq!(decisions, 10);
    }

    #[test]
    fn the_pair_about_to_swing_is_shown_as_front_left_and_rear_right() {
        // In a steady trot every decision begins alike, so the shown load of the pair that comes down is alike too.
        let sets = ["task.kind=constant", "task.episode_secs=3"];
        let sideways = |mirror: &str| {
            let mut env = env(&[sets[0], sets[1], mirror]);
            env.reset(Seed::from_number(3));
            let mut seen = Vec::new();
            while seen.len() < 19 {
                seen.push(env.step(&[]).observation);
            }
            let at = herd_common::spaces::JOINT_ANGLE.start + 1;
            (f64::from(seen[16][at]) - f64::from(seen[17][at])).abs()
        };
        let (mirrored, plain) = (sideways("task.gait.mirror=true"), sideways("task.gait.mirror=false"));
        assert!(mirrored < 0.2 * plain, "{mirrored} {plain}");
    }

    #[test]
    fn a_strong_push_knocks_the_robot_over() {
        let mut env = env(&["task.kind=constant"]);
        env.reset(Seed::from_number(1));
        env.step(&[]);
        env.push(&Vector3::new(0.0, 2000.0, 0.0), 0.1);
        let ending = (0..10).find_map(|_| env.step(&[]).ending);
        assert!(ending.is_some_and(Ending::is_fall), "{ending:?}");
    }

    /// Everything at once.
    const HARD: [&str; 9] = [
        "task.episode_secs=1",
        "scenario.friction_factor=[0.5, 1.2]",
        "scenario.payload_kg=[0, 3]",
        "scenario.slope_deg=[0, 5]",
        "scenario.bump_m=[0.005, 0.01]",
        "scenario.step_m=[0.005, 0.01]",
        "scenario.push_ns=[1, 3]",
        "scenario.noise=[0.5, 1]",
        "scenario.delay_ticks=[0, 1]",
    ];

    #[test]
    fn a_scenario_depends_on_its_seed_alone() {
        let mut used = env(&HARD);
        let action = [0.2, 0.1, 0.0, -0.5];
        let first = trace(&mut used, 5, &action);
        let other = trace(&mut used, 6, &action);
        assert_eq!(trace(&mut used, 5, &action), first, "after another episode");
        assert_eq!(trace(&mut env(&HARD), 6, &action), other, "in a new environment");
        assert_ne!(first, other);
    }

    #[test]
    fn torques_act_as_late_as_the_scenario_says() {
        let at = |delay: &str, decisions: usize| {
            let mut env = env(&["task.kind=torque", "task.torque.decision_secs=0.002", delay]);
            env.reset(Seed::from_number(1));
            (0..decisions).for_each(|n| assert_eq!(env.step(&[0.01 * n as f32; 12]).ending, None));
            *env.torques()
        };
        let (now, late) = ("scenario.delay_ticks=[0, 0]", "scenario.delay_ticks=[2, 2]");
        assert_eq!(at(late, 5), at(now, 3));
        assert!(at(late, 2)[0].norm() > 0.5, "the torques that settled the robot go on: {:?}", at(late, 2));
    }

    #[test]
    fn a_later_push_comes_on_its_tick() {
        let begins = |delay_secs: f64| {
            let run = |push: f64| {
                let mut env = env(&["task.kind=torque", "task.torque.decision_secs=0.002"]);
                env.reset(Seed::from_number(1));
                env.push_after(delay_secs, &Vector3::new(0.0, push, 0.0), 0.01);
                (0..20).map(|_| (env.step(&[0.0; 12]), env.state().velocity.y).1).collect::<Vec<_>>()
            };
            let (still, pushed) = (run(0.0), run(50.0));
            still.iter().zip(&pushed).position(|(a, b)| a != b)
        };
        assert_eq!((begins(0.0), begins(0.02)), (Some(0), Some(10)));
    }

    #[test]
    fn policy_and_controller_see_noise_and_the_reward_does_not() {
        let seen = |noise: &str| {
            let mut env = env(&[noise]);
            let observation = env.reset(Seed::from_number(2));
            (observation, env.state().clone())
        };
        let ((exact, state), (noisy, same)) = (seen("scenario.noise=[0, 0]"), seen("scenario.noise=[1, 1]"));
        assert_eq!(state, same);
        let speed = herd_common::spaces::JOINT_VELOCITY;
        let differs = (speed.start..speed.start + speed.len).filter(|i| exact[*i] != noisy[*i]).count();
        assert_eq!(differs, 12);
    }
}
