//! What is left of an episode when it is over: why it ended and what it was worth.
//!
//! An `Outcome` is a function of seed, policy and configuration alone, so it may be journaled and hashed. Measured
//! times (how fast the solver ran) are not: they travel as telemetry, see `status`.

use serde::{Deserialize, Serialize};

/// Which limit a fallen robot broke.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Fall {
    /// Roll beyond its limit.
    Roll,
    /// Pitch beyond its limit.
    Pitch,
    /// Yaw beyond its limit.
    Yaw,
    /// Trunk too low.
    Height,
    /// Trunk touched the ground.
    TrunkContact,
    /// A hip or knee touched the ground.
    KneeContact,
}

/// Why an episode ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Ending {
    /// It reached its time limit: truncation, the value goes on.
    TimedOut,
    /// The robot broke a limit: termination, the value is zero from here.
    Fell(Fall),
    /// The simulation left the realm of finite numbers: the last decision is dropped, the rest is kept.
    Diverged,
}

impl Ending {
    /// Every ending with its name on the wire, in status and in metrics.
    pub const ALL: [(Self, &'static str); 8] = [
        (Self::TimedOut, "timed_out"),
        (Self::Fell(Fall::Roll), "fell_roll"),
        (Self::Fell(Fall::Pitch), "fell_pitch"),
        (Self::Fell(Fall::Yaw), "fell_yaw"),
        (Self::Fell(Fall::Height), "fell_height"),
        (Self::Fell(Fall::TrunkContact), "fell_trunk_contact"),
        (Self::Fell(Fall::KneeContact), "fell_knee_contact"),
        (Self::Diverged, "diverged"),
    ];

    /// The name of this ending.
    pub fn name(self) -> &'static str {
        Self::ALL.iter().find(|(ending, _)| *ending == self).map_or("unknown", |(_, name)| name)
    }

    /// The ending of this name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.iter().find(|(_, known)| *known == name).map(|(ending, _)| *ending)
    }

    /// True for every ending that is the robot's fault.
    pub fn is_fall(self) -> bool {
        matches!(self, Self::Fell(_))
    }
}

/// The four terms of eq 10, each summed over the samples of an episode or a decision, signs included.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Reward {
    /// `3 v_x`
    pub velocity: f64,
    /// `30 T_s / T_f`
    pub survival: f64,
    /// `−10 θ²`, θ = yaw
    pub heading: f64,
    /// `−0.01 Σ τ²`
    pub effort: f64,
}

impl Reward {
    /// The sum that eq 10 calls r.
    pub fn total(&self) -> f64 {
        self.velocity + self.survival + self.heading + self.effort
    }
}

impl std::ops::AddAssign for Reward {
    fn add_assign(&mut self, other: Self) {
        self.velocity += other.velocity;
        self.survival += other.survival;
        self.heading += other.heading;
        self.effort += other.effort;
    }
}

/// What the low-level controller met on the way.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Counts {
    /// Quadratic programmes solved.
    pub qp_solves: u64,
    /// Of those, programmes that the primary solver gave up on.
    pub qp_failures: u64,
    /// Legs that touched down before the schedule said so.
    pub early_contacts: u64,
    /// Legs still in the air when the schedule put weight on them.
    pub late_contacts: u64,
    /// Joint torques cut at their limit, counted per joint and tick.
    pub saturated_torques: u64,
}

impl std::ops::AddAssign for Counts {
    fn add_assign(&mut self, other: Self) {
        self.qp_solves += other.qp_solves;
        self.qp_failures += other.qp_failures;
        self.early_contacts += other.early_contacts;
        self.late_contacts += other.late_contacts;
        self.saturated_torques += other.saturated_torques;
    }
}

/// The summary of one finished episode.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Outcome {
    /// Why it ended.
    pub ending: Ending,
    /// Decisions taken, the number of its transitions.
    pub decisions: u64,
    /// Simulated time, s.
    pub seconds: f64,
    /// Return by terms.
    pub reward: Reward,
    /// Distance along world x, m.
    pub distance_m: f64,
    /// Variance of the roll angle over the episode's samples, rad².
    pub roll_variance: f64,
    /// Variance of the pitch angle over the episode's samples, rad².
    pub pitch_variance: f64,
    /// What the controller counted.
    pub counts: Counts,
}

impl Outcome {
    /// Mean forward speed, m/s.
    pub fn mean_speed(&self) -> f64 {
        if self.seconds > 0.0 { self.distance_m / self.seconds } else { 0.0 }
    }

    /// The first field that no real episode can have, with its value.
    pub fn first_invalid(&self) -> Option<(&'static str, f64)> {
        [
            ("seconds", self.seconds, 0.0, 1e4),
            ("reward.velocity", self.reward.velocity, -1e9, 1e9),
            ("reward.survival", self.reward.survival, -1e9, 1e9),
            ("reward.heading", self.reward.heading, -1e9, 1e9),
            ("reward.effort", self.reward.effort, -1e9, 1e9),
            ("distance_m", self.distance_m, -1e6, 1e6),
            ("roll_variance", self.roll_variance, 0.0, 100.0),
            ("pitch_variance", self.pitch_variance, 0.0, 100.0),
        ]
        .into_iter()
        .find(|(_, value, lowest, highest)| !(*lowest..=*highest).contains(value))
        .map(|(name, value, ..)| (name, value))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_unique_and_come_back() {
        for (ending, name) in Ending::ALL {
            assert_eq!(ending.name(), name);
            assert_eq!(Ending::from_name(name), Some(ending));
        }
        assert_eq!(Ending::from_name("tripped"), None);
    }
}
