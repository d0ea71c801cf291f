//! Settings of the simulator.

use super::{Error, check};
use serde::{Deserialize, Serialize};

/// Rapier's settings as far as they matter here.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Period of physics and torque loop, s.
    pub tick_secs: f64,
    /// Solver steps within a tick.
    pub substeps: usize,
    /// μ between foot and ground.
    pub ground_friction: f64,
    /// Natural frequency of the contact spring, Hz.
    pub contact_hz: f64,
    /// Its damping ratio.
    pub contact_damping_ratio: f64,
}

impl Config {
    pub(super) fn validate(&self) -> Result<(), Error> {
        check("sim.tick_secs", self.tick_secs, 1e-4..=0.02)?;
        check("sim.substeps", self.substeps, 1..=64)?;
        check("sim.ground_friction", self.ground_friction, 0.0..=5.0)?;
        check("sim.contact_hz", self.contact_hz, 1.0..=1000.0)?;
        check("sim.contact_damping_ratio", self.contact_damping_ratio, 0.01..=100.0)
    }
}
