//! Settings of the low-level controller: MPC, footholds, swing.

use super::{Error, check, check_span};
use serde::{Deserialize, Serialize};

/// The low-level controller (paper §3.3).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Legs in stance.
    pub mpc: Mpc,
    /// Where feet go.
    pub gait: Gait,
    /// Legs in swing.
    pub swing: Swing,
}

/// Which solver the MPC asks first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Solver {
    /// Dense dual active set (Goldfarb–Idnani) on the condensed programme.
    ActiveSet,
    /// Interior point.
    Clarabel,
}

/// Convex MPC, eqs 11–14.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Mpc {
    /// See [`Solver`].
    pub solver: Solver,
    /// Time between two solves, s.
    pub period_secs: f64,
    /// Steps of the prediction.
    pub horizon: usize,
    /// Length of one, s.
    pub step_secs: f64,
    /// Q of roll, pitch, yaw, 1/rad².
    pub weight_angles: [f64; 3],
    /// Q of x, y, z, 1/m².
    pub weight_position: [f64; 3],
    /// Q of world angular velocity, s²/rad².
    pub weight_angular_velocity: [f64; 3],
    /// Q of world velocity, s²/m².
    pub weight_velocity: [f64; 3],
    /// R, 1/N².
    pub weight_force: f64,
    /// μ of the friction pyramid.
    pub friction: f64,
    /// Largest normal force of one foot, N.
    pub force_max_n: f64,
}

/// Footholds and reference.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Gait {
    /// κ: share of the shift that would undo a velocity error within one stance.
    pub foothold_gain: f64,
    /// Largest distance of a foothold from below the hip, m.
    pub foothold_clamp_m: f64,
    /// Depth below the ground that a swing aims at, m.
    pub touchdown_depth_m: f64,
    /// Largest shift of the foothold by a stride that does not fit the speed, m.
    pub stride_trim_m: f64,
    /// Longest stride a leg can make: bounds Δt at a given speed, m.
    pub stride_max_m: f64,
    /// Largest distance of the integrated position reference from the robot, m.
    pub position_clamp_m: f64,
    /// Speed asked for on top per distance to that reference, 1/s.
    pub position_gain: f64,
    /// Fastest speeds that are aimed at, backwards and forwards, m/s.
    pub speed_mps: [f64; 2],
    /// Least apex of a swing per speed, s.
    pub lift_per_speed_secs: f64,
    /// Largest change of the speed that is aimed at when another is asked for, m/s².
    pub pace_mps2: f64,
    /// Largest difference between that speed and the robot's, m/s.
    pub pace_lead_mps: f64,
    /// Largest acceleration of the speed reference along an axis, m/s².
    pub acceleration_mps2: f64,
    /// Below this speed a robot that is asked to stand still stops stepping, m/s.
    pub halt_mps: f64,
}

/// Swing control, eqs 15–16.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Swing {
    /// Share of the swing after which the foothold stays.
    pub aim_share: f64,
    /// Share of the swing at its end in which the foot only sinks, per squared speed, s²/m².
    pub sink_share: f64,
    /// K_p, N/m.
    pub stiffness_npm: f64,
    /// K_d, N·s/m.
    pub damping_nspm: f64,
    /// What holds a standing foot in its place, N·s/m.
    pub grip_nspm: f64,
    /// Normal force that counts as touchdown, N.
    pub early_contact_n: f64,
    /// Share of the swing before which contact does not count.
    pub early_contact_phase: f64,
    /// Speed at which a foot that found no ground at the end of its swing reaches down, m/s.
    pub reach_down_mps: f64,
}

impl Config {
    pub(super) fn validate(&self) -> Result<(), Error> {
        let mpc = &self.mpc;
        check("control.mpc.period_secs", mpc.period_secs, 0.002..=0.5)?;
        check("control.mpc.horizon", mpc.horizon, 1..=40)?;
        check("control.mpc.step_secs", mpc.step_secs, 0.002..=0.2)?;
        for (key, weights) in [
            ("control.mpc.weight_angles", mpc.weight_angles),
            ("control.mpc.weight_position", mpc.weight_position),
            ("control.mpc.weight_angular_velocity", mpc.weight_angular_velocity),
            ("control.mpc.weight_velocity", mpc.weight_velocity),
        ] {
            for weight in weights {
                check(key, weight, 0.0..=1e6)?;
            }
        }
        check("control.mpc.weight_force", mpc.weight_force, 1e-9..=1e3)?;
        check("control.mpc.friction", mpc.friction, 0.01..=5.0)?;
        check("control.mpc.force_max_n", mpc.force_max_n, 1.0..=1e5)?;
        check("control.gait.foothold_gain", self.gait.foothold_gain, 0.0..=2.0)?;
        check("control.gait.foothold_clamp_m", self.gait.foothold_clamp_m, 0.0..=0.25)?;
        check("control.gait.touchdown_depth_m", self.gait.touchdown_depth_m, 0.0..=0.05)?;
        check("control.gait.stride_trim_m", self.gait.stride_trim_m, 0.0..=0.25)?;
        check("control.gait.stride_max_m", self.gait.stride_max_m, 0.05..=1.0)?;
        check("control.gait.position_clamp_m", self.gait.position_clamp_m, 0.0..=1.0)?;
        check("control.gait.position_gain", self.gait.position_gain, 0.0..=50.0)?;
        check_span("control.gait.speed_mps", self.gait.speed_mps, -5.0..=5.0)?;
        check("control.gait.lift_per_speed_secs", self.gait.lift_per_speed_secs, 0.0..=0.1)?;
        check("control.gait.pace_mps2", self.gait.pace_mps2, 0.01..=100.0)?;
        check("control.gait.pace_lead_mps", self.gait.pace_lead_mps, 0.01..=100.0)?;
        check("control.gait.acceleration_mps2", self.gait.acceleration_mps2, 0.01..=100.0)?;
        check("control.swing.sink_share", self.swing.sink_share, 0.0..=1.0)?;
        check("control.swing.aim_share", self.swing.aim_share, 0.0..=1.0)?;
        check("control.gait.halt_mps", self.gait.halt_mps, 0.0..=5.0)?;
        check("control.swing.stiffness_npm", self.swing.stiffness_npm, 0.0..=1e5)?;
        check("control.swing.damping_nspm", self.swing.damping_nspm, 0.0..=1e4)?;
        check("control.swing.grip_nspm", self.swing.grip_nspm, 0.0..=1e4)?;
        check("control.swing.early_contact_n", self.swing.early_contact_n, 0.0..=1e4)?;
        check("control.swing.early_contact_phase", self.swing.early_contact_phase, 0.0..=1.0)?;
        check("control.swing.reach_down_mps", self.swing.reach_down_mps, 0.0..=5.0)
    }
}
