//! The figures of an episode as it goes: return by terms, distance, variances, work.

use crate::sim::{Contacts, RobotState};
use herd_common::episode::{Counts, Ending, Outcome, Reward};
use nalgebra::Vector3;

/// Heat of the motors per squared torque, W/(N·m)²; the value that gait papers use for motors of this size.
const HEAT: f64 = 0.3;

/// How well and how cheaply a robot walked.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Figures {
    /// Mean of the trunk's velocity along world x, m/s.
    pub mean_speed: f64,
    /// Root mean square of its difference from the speed asked for, start-up and strides included, m/s.
    pub speed_error: f64,
    /// `Σ max(τ q̇ + 0.3 τ², 0) dt / (m g d)`: work of the motors, none recovered, per weight and distance; q̇ is the mean
    /// of a tick's first and last speed.
    pub cost_of_transport: f64,
    /// Mean vertical force of the ground on all feet, per weight.
    pub load: f64,
}

/// Mean and variance of a stream of numbers (Welford).
#[derive(Clone, Copy, Debug, Default)]
struct Spread {
    count: f64,
    mean: f64,
    squares: f64,
}

/// What is gathered while an episode runs.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Summary {
    decisions: u64,
    reward: Reward,
    start_x: f64,
    end_x: f64,
    roll: Spread,
    pitch: Spread,
    speed: Spread,
    load: Spread,
    work_j: f64,
}

impl Spread {
    fn add(&mut self, value: f64) {
        self.count += 1.0;
        let step = value - self.mean;
        self.mean += step / self.count;
        self.squares += step * (value - self.mean);
    }

    fn variance(&self) -> f64 {
        if self.count > 0.0 { self.squares / self.count } else { 0.0 }
    }
}

impl Summary {
    /// An empty summary of a robot that starts at this x, m.
    pub(super) fn new(start_x: f64) -> Self {
        Self { start_x, end_x: start_x, ..Self::default() }
    }

    pub(super) fn reward(&self) -> Reward {
        self.reward
    }

    /// Adds a tick from one state to the next, with the contacts and torques (N·m) that were in between.
    pub(super) fn tick(
        &mut self,
        [before, after]: [&RobotState; 2],
        contacts: &Contacts,
        torques: &[Vector3<f64>; 4],
        secs: f64,
    ) {
        self.end_x = after.position.x;
        self.speed.add(after.velocity.x);
        self.load.add(contacts.normal.iter().sum());
        for (leg, torques) in torques.iter().enumerate() {
            let speeds = (before.joint_speeds[leg] + after.joint_speeds[leg]) / 2.0;
            let power = torques.zip_map(&speeds, |torque, speed| (torque * speed + HEAT * torque * torque).max(0.0));
            self.work_j += power.sum() * secs;
        }
    }

    /// The figures so far for a robot of this weight (N) that was asked to walk at `wanted` m/s.
    pub(super) fn figures(&self, wanted: f64, weight: f64) -> Figures {
        let distance = (self.end_x - self.start_x).abs().max(1e-3);
        Figures {
            mean_speed: self.speed.mean,
            speed_error: (self.speed.variance() + (self.speed.mean - wanted).powi(2)).sqrt(),
            cost_of_transport: self.work_j / (weight * distance),
            load: self.load.mean / weight,
        }
    }

    pub(super) fn sample(&mut self, state: &RobotState, reward: Reward) {
        let angles = state.angles();
        self.roll.add(angles.x);
        self.pitch.add(angles.y);
        self.reward += reward;
    }

    /// Counts a decision, unless it is dropped.
    pub(super) fn end_decision(&mut self, ending: Option<Ending>) {
        self.decisions += u64::from(ending != Some(Ending::Diverged));
    }

    pub(super) fn outcome(&self, ending: Ending, seconds: f64, counts: Counts) -> Outcome {
        Outcome {
            ending,
            decisions: self.decisions,
            seconds,
            reward: self.reward,
            distance_m: self.end_x - self.start_x,
            roll_variance: self.roll.variance(),
            pitch_variance: self.pitch.variance(),
            counts,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::UnitQuaternion;

    #[test]
    fn work_is_that_of_the_mean_speed_of_a_tick_and_none_is_recovered() {
        let at = |speed: f64| RobotState {
            position: Vector3::zeros(),
            rotation: UnitQuaternion::identity(),
            velocity: Vector3::zeros(),
            angular_velocity: Vector3::zeros(),
            joints: [Vector3::zeros(); 4],
            joint_speeds: [Vector3::new(speed, -speed, 0.0); 4],
        };
        let torques = [Vector3::new(2.0, 2.0, 1.0); 4];
        let mut summary = Summary::new(0.0);
        summary.tick([&at(1.0), &at(3.0)], &Contacts::default(), &torques, 0.5);
        // A leg's joints: 2 N m at 2 rad/s and heat; braking, with less heat than it takes in; heat alone.
        let leg = (2.0 * 2.0 + HEAT * 4.0) + 0.0 + HEAT;
        assert!((summary.work_j - 4.0 * leg * 0.5).abs() < 1e-12, "{} J", summary.work_j);
    }

    #[test]
    fn variance_is_that_of_the_definition() {
        let values = [0.1, -0.3, 0.25, 7.0, 0.1];
        let mut spread = Spread::default();
        for value in values {
            spread.add(value);
        }
        let mean = values.iter().sum::<f64>() / 5.0;
        let expected = values.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / 5.0;
        assert!((spread.variance() - expected).abs() < 1e-12);
        assert_eq!(Spread::default().variance(), 0.0);
    }
}
