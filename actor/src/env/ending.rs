//! When an episode is over: the limits whose breach is a fall, and numbers that are none.

use crate::sim::{Contacts, RobotState};
use herd_common::config::task;
use herd_common::episode::{Ending, Fall};

/// The ending that this state calls for, if any; the time limit is not a matter of state.
pub(super) fn of(state: &RobotState, contacts: &Contacts, limits: &task::Ending) -> Option<Ending> {
    if !state.is_finite() {
        return Some(Ending::Diverged);
    }
    let angles = state.angles();
    [
        (angles.x.abs() > limits.roll_rad, Fall::Roll),
        (angles.y.abs() > limits.pitch_rad, Fall::Pitch),
        (angles.z.abs() > limits.yaw_rad, Fall::Yaw),
        (state.position.z < limits.height_m, Fall::Height),
        (contacts.trunk, Fall::TrunkContact),
        (contacts.knee, Fall::KneeContact),
    ]
    .into_iter()
    .find_map(|(broken, fall)| broken.then_some(Ending::Fell(fall)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use herd_common::config::Config;
    use nalgebra::{UnitQuaternion, Vector3};

    #[track_caller]
    fn check(angles: [f64; 3], height: f64, contacts: Contacts, expected: Option<Ending>) {
        let state = RobotState {
            position: Vector3::new(0.0, 0.0, height),
            rotation: UnitQuaternion::from_euler_angles(angles[0], angles[1], angles[2]),
            velocity: Vector3::zeros(),
            angular_velocity: Vector3::zeros(),
            joints: [Vector3::zeros(); 4],
            joint_speeds: [Vector3::zeros(); 4],
        };
        assert_eq!(of(&state, &contacts, &Config::default().task.ending), expected);
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
}
