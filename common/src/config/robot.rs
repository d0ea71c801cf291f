//! The robot: lengths, masses, limits.

use super::{Error, check};
use serde::{Deserialize, Serialize};

/// The robot, with sources in `robot.toml`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// L_x: front to rear hip roll joints, m.
    pub hip_distance_x_m: f64,
    /// L_y: left to right hip roll joints, m.
    pub hip_distance_y_m: f64,
    /// L_1: hip roll axis to thigh plane, m.
    pub hip_link_m: f64,
    /// L_2: hip pitch to knee, m.
    pub thigh_m: f64,
    /// L_3: knee to foot centre, m.
    pub calf_m: f64,
    /// Radius of the foot sphere, m.
    pub foot_radius_m: f64,
    /// Trunk, kg.
    pub trunk_mass_kg: f64,
    /// Trunk box along x, y, z, m.
    pub trunk_size_m: [f64; 3],
    /// One hip link, kg.
    pub hip_mass_kg: f64,
    /// One thigh, kg.
    pub thigh_mass_kg: f64,
    /// One calf with its foot, kg.
    pub calf_mass_kg: f64,
    /// Limit of every joint, N·m.
    pub torque_max_nm: f64,
    /// Viscous friction of every joint, N·m·s/rad.
    pub joint_damping: f64,
    /// Reflected rotor inertia of every joint, kg·m².
    pub joint_armature: f64,
    /// Hip roll, hip pitch, knee of the nominal stance, rad.
    pub nominal_joint_rad: [f64; 3],
}

impl Config {
    /// Mass of the whole robot, kg.
    pub fn mass_kg(&self) -> f64 {
        self.trunk_mass_kg + 4.0 * (self.hip_mass_kg + self.thigh_mass_kg + self.calf_mass_kg)
    }

    pub(super) fn validate(&self) -> Result<(), Error> {
        for (key, metres) in [
            ("robot.hip_distance_x_m", self.hip_distance_x_m),
            ("robot.hip_distance_y_m", self.hip_distance_y_m),
            ("robot.hip_link_m", self.hip_link_m),
            ("robot.thigh_m", self.thigh_m),
            ("robot.calf_m", self.calf_m),
            ("robot.foot_radius_m", self.foot_radius_m),
            ("robot.trunk_size_m", self.trunk_size_m.iter().copied().fold(f64::INFINITY, f64::min)),
        ] {
            check(key, metres, 1e-3..=10.0)?;
        }
        for (key, kilograms) in [
            ("robot.trunk_mass_kg", self.trunk_mass_kg),
            ("robot.hip_mass_kg", self.hip_mass_kg),
            ("robot.thigh_mass_kg", self.thigh_mass_kg),
            ("robot.calf_mass_kg", self.calf_mass_kg),
        ] {
            check(key, kilograms, 1e-3..=1000.0)?;
        }
        check("robot.torque_max_nm", self.torque_max_nm, 0.0..=1e4)?;
        check("robot.joint_damping", self.joint_damping, 0.0..=100.0)?;
        check("robot.joint_armature", self.joint_armature, 0.0..=100.0)?;
        for angle in self.nominal_joint_rad {
            check("robot.nominal_joint_rad", angle, -3.2..=3.2)?;
        }
        Ok(())
    }
}
