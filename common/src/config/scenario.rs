//! What the robot meets: ground, payload, pushes, sensors and actuators, drawn anew for every episode.
//!
//! Each quantity is a range `[lowest, highest]`; the episode's seed draws from it, evenly. Equal ends draw nothing.

use super::{Error, check_span};
use serde::{Deserialize, Serialize};

/// Ranges of everything that may differ from one episode to the next.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Factor on `sim.ground_friction`.
    pub friction_factor: [f64; 2],
    /// Mass of a box on the trunk that the controller does not know of, kg.
    pub payload_kg: [f64; 2],
    /// Slope of the ground, uphill along world x, degrees.
    pub slope_deg: [f64; 2],
    /// Height of random bumps, m.
    pub bump_m: [f64; 2],
    /// Height of steps up and down, m.
    pub step_m: [f64; 2],
    /// Impulse of one push on the trunk, N·s.
    pub push_ns: [f64; 2],
    /// Time between two pushes, s.
    pub push_every_secs: [f64; 2],
    /// Factor on the standard deviations of what is measured.
    pub noise: [f64; 2],
    /// Ticks by which torques are late.
    pub delay_ticks: [u32; 2],
}

impl Config {
    /// The ranges with nothing in them: level ground as `sim` has it, no payload, no push, exact sensors, no delay.
    pub fn plain() -> Self {
        Self {
            friction_factor: [1.0; 2],
            payload_kg: [0.0; 2],
            slope_deg: [0.0; 2],
            bump_m: [0.0; 2],
            step_m: [0.0; 2],
            push_ns: [0.0; 2],
            push_every_secs: [3.0; 2],
            noise: [0.0; 2],
            delay_ticks: [0; 2],
        }
    }

    pub(super) fn validate(&self) -> Result<(), Error> {
        check_span("scenario.friction_factor", self.friction_factor, 0.0..=10.0)?;
        check_span("scenario.payload_kg", self.payload_kg, 0.0..=50.0)?;
        check_span("scenario.slope_deg", self.slope_deg, -45.0..=45.0)?;
        check_span("scenario.bump_m", self.bump_m, 0.0..=0.1)?;
        check_span("scenario.step_m", self.step_m, 0.0..=0.1)?;
        check_span("scenario.push_ns", self.push_ns, 0.0..=1000.0)?;
        check_span("scenario.push_every_secs", self.push_every_secs, 0.1..=1000.0)?;
        check_span("scenario.noise", self.noise, 0.0..=100.0)?;
        check_span("scenario.delay_ticks", self.delay_ticks, 0..=crate::caps::DELAY_TICKS)
    }
}

#[cfg(test)]
mod tests {
    use super::super::Config;

    #[test]
    fn the_default_is_plain() {
        assert_eq!(Config::default().scenario, super::Config::plain());
    }

    #[test]
    fn the_scenario_is_part_of_the_task() {
        let base = Config::default();
        let windy = base.overridden(&["scenario.push_ns=[0, 5]".into()]).expect("valid");
        assert_ne!((windy.task_hash(), windy.run_name()), (base.task_hash(), base.run_name()));
    }

    #[test]
    fn ranges_are_checked() {
        for set in ["scenario.delay_ticks=[2, 1]", "scenario.bump_m=[0, 2]", "scenario.noise=[-1, 0]"] {
            let error = Config::load(None, &[set.to_owned()]).expect_err("refused").to_string();
            let key = set.split('=').next().expect("has a key");
            assert!(error.contains(key) && error.contains("[lowest, highest]"), "{error}");
        }
    }
}
