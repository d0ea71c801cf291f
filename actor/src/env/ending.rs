//! When an episode is over: the limits whose breach is a fall, and numbers that are none.
//!
//! Height counts from the ground below the trunk. On a slope a trunk stands upright anywhere between level and parallel
//! to the ground, whichever way it looks; its roll and pitch count from there. Yaw counts from the heading that the robot was told to take.

use crate::sim::{Contacts, Ground, RobotState};
use herd_common::config::task;
use herd_common::episode::{Ending, Fall};
use std::f64::consts::TAU;

/// The ending that this state calls for, if any; the time limit is not a matter of state.
pub(super) fn of(
    state: &RobotState,
    contacts: &Contacts,
    ground: &Ground,
    heading: f64,
    limits: &task::Ending,
) -> Option<Ending> {
    if !state.is_finite() {
        return Some(Ending::Diverged);
    }
    let angles = state.angles();
    // Seen from the trunk, the slope rises ahead and to the left by this much: parallel to it, the nose is up (a negative
    // pitch) and the left side is up (a positive roll).
    let (sin, cos) = angles.z.sin_cos();
    let rise = ground.slope_rad().tan();
    let roll = beyond(angles.x, (-rise * sin).atan());
    let pitch = beyond(angles.y, -(rise * cos).atan());
    let height = state.position.z - ground.height(state.position.x, state.position.y);
    [
        (roll.abs() > limits.roll_rad, Fall::Roll),
        (pitch.abs() > limits.pitch_rad, Fall::Pitch),
        (wrapped(angles.z - heading).abs() > limits.yaw_rad, Fall::Yaw),
        (height < limits.height_m, Fall::Height),
        (contacts.trunk, Fall::TrunkContact),
        (contacts.knee, Fall::KneeContact),
    ]
    .into_iter()
    .find_map(|(broken, fall)| broken.then_some(Ending::Fell(fall)))
}

/// What of an angle lies outside level … parallel, rad.
fn beyond(angle: f64, parallel: f64) -> f64 {
    angle - angle.clamp(parallel.min(0.0), parallel.max(0.0))
}

/// The angle within half a turn of zero, rad.
fn wrapped(angle: f64) -> f64 {
    angle - TAU * (angle / TAU).round()
}

#[cfg(test)]
mod tests {
    use super::*;
    use herd_common::config::Config;
    use herd_common::seed::Seed;
    use nalgebra::{UnitQuaternion, Vector3};

    #[track_caller]
    fn check(angles: [f64; 3], height: f64, contacts: Contacts, expected: Option<Ending>) {
        check_on(&Ground::level(), angles, Vector3::new(0.0, 0.0, height), contacts, expected);
    }

    #[track_caller]
    fn check_on(
        ground: &Ground,
        angles: [f64; 3],
        position: Vector3<f64>,
        contacts: Contacts,
        expected: Option<Ending>,
    ) {
        let state = RobotState {
            position,
            rotation: UnitQuaternion::from_euler_angles(angles[0], angles[1], angles[2]),
            velocity: Vector3::zeros(),
            angular_velocity: Vector3::zeros(),
            joints: [Vector3::zeros(); 4],
            joint_speeds: [Vector3::zeros(); 4],
        };
        assert_eq!(of(&state, &contacts, ground, 0.0, &Config::default().task.ending), expected);
    }

    #[test]
    fn each_limit_has_its_name() {
        let clear = Contacts::default();
        check([0.34, -0.34, 0.34], 0.12, clear, None);
        check([0.36, 0.0, 0.0], 0.18, clear, Some(Ending::Fell(Fall::Roll)));
        check([0.0, -0.36, 0.0], 0.18, clear, Some(Ending::Fell(Fall::Pitch)));
        check([0.0, 0.0, 0.36], 0.18, clear, Some(Ending::Fell(Fall::Yaw)));
        check([0.0; 3], 0.11, clear, Some(Ending::Fell(Fall::Height)));
        check([0.0; 3], 0.18, Contacts { trunk: true, ..clear }, Some(Ending::Fell(Fall::TrunkContact)));
        check([0.0; 3], 0.18, Contacts { knee: true, ..clear }, Some(Ending::Fell(Fall::KneeContact)));
        check([0.0; 3], f64::NAN, clear, Some(Ending::Diverged));
    }

    #[test]
    fn yaw_counts_from_the_heading_over_any_number_of_turns() {
        let at = |yaw: f64, heading: f64| {
            let state = RobotState {
                position: Vector3::new(0.0, 0.0, 0.18),
                rotation: UnitQuaternion::from_euler_angles(0.0, 0.0, yaw),
                velocity: Vector3::zeros(),
                angular_velocity: Vector3::zeros(),
                joints: [Vector3::zeros(); 4],
                joint_speeds: [Vector3::zeros(); 4],
            };
            of(&state, &Contacts::default(), &Ground::level(), heading, &Config::default().task.ending)
        };
        assert_eq!(at(2.0 * TAU + 2.9, 2.0 * TAU + 3.2), None);
        assert_eq!(at(2.8, 3.2), Some(Ending::Fell(Fall::Yaw)));
        assert_eq!(at(0.0, 0.4), Some(Ending::Fell(Fall::Yaw)));
    }

    #[test]
    fn limits_count_from_the_ground() {
        let slope = 15.0_f64.to_radians();
        let ground = Ground::new(slope, 0.0, 0.0, Seed::from_number(1));
        let place = |height: f64| Vector3::new(2.0, 1.0, 2.0 * slope.tan() + height);
        let check = |pitch: f64, height: f64, expected| {
            check_on(&ground, [0.0, pitch, 0.0], place(height), Contacts::default(), expected);
        };
        check(-slope, 0.18, None);
        check(-slope - 0.34, 0.12, None);
        check(0.34, 0.12, None);
        check(-slope - 0.36, 0.18, Some(Ending::Fell(Fall::Pitch)));
        check(0.36, 0.18, Some(Ending::Fell(Fall::Pitch)));
        check(0.0, 0.11, Some(Ending::Fell(Fall::Height)));
    }

    #[test]
    fn a_trunk_parallel_to_the_slope_stands_whichever_way_it_looks() {
        let slope = 20.5_f64.to_radians();
        let ground = Ground::new(slope, 0.0, 0.0, Seed::from_number(1));
        let limits = Config::default().task.ending;
        for quarter in -2..=2 {
            let yaw = f64::from(quarter) * TAU / 4.0;
            let rotation = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), -slope)
                * UnitQuaternion::from_euler_angles(0.0, 0.0, yaw);
            let state = |rotation: UnitQuaternion<f64>| RobotState {
                position: Vector3::new(0.0, 0.0, 0.18),
                rotation,
                velocity: Vector3::zeros(),
                angular_velocity: Vector3::zeros(),
                joints: [Vector3::zeros(); 4],
                joint_speeds: [Vector3::zeros(); 4],
            };
            let of = |state: &RobotState| of(state, &Contacts::default(), &ground, yaw, &limits);
            assert_eq!(of(&state(rotation)), None, "{quarter} quarter turns");
            // Leaning as much beyond the slope as a limit allows is too much with what the slope has already.
            let leaning = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), -slope - 0.36);
            let fallen = of(&state(leaning * UnitQuaternion::from_euler_angles(0.0, 0.0, yaw)));
            assert!(
                matches!(fallen, Some(Ending::Fell(Fall::Roll | Fall::Pitch))),
                "{quarter} quarter turns: {fallen:?}"
            );
        }
    }
}
