//! State and ground contact as flat rows of numbers: what traces hold and other programs send.

use super::{Contacts, RobotState};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

/// A robot at one moment. Joints come as FL, FR, RL, RR, each hip roll, hip pitch, knee.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Snapshot {
    /// Trunk origin, world, m.
    pub position: [f64; 3],
    /// World from body: w, x, y, z.
    pub quaternion: [f64; 4],
    /// Velocity of the trunk origin, world, m/s.
    pub velocity: [f64; 3],
    /// Angular velocity of the trunk, world, rad/s.
    pub angular_velocity: [f64; 3],
    /// Joint angles, rad.
    pub joints: [f64; 12],
    /// Joint speeds, rad/s.
    pub joint_speeds: [f64; 12],
    /// Normal force on each foot, mean over the last tick, N.
    pub normal: [f64; 4],
    /// Magnitude of the friction force on each foot, mean over the last tick, N.
    pub friction: [f64; 4],
    /// Each foot that is on the ground; unless told, one that has a normal force.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub feet: Option<[bool; 4]>,
    /// The trunk touches the ground.
    #[serde(default)]
    pub trunk: bool,
    /// A knee touches the ground.
    #[serde(default)]
    pub knee: bool,
}

impl Snapshot {
    /// This state with this contact.
    pub fn new(state: &RobotState, contacts: &Contacts) -> Self {
        let q = state.rotation.quaternion();
        Self {
            position: state.position.into(),
            quaternion: [q.w, q.i, q.j, q.k],
            velocity: state.velocity.into(),
            angular_velocity: state.angular_velocity.into(),
            joints: flat(&state.joints),
            joint_speeds: flat(&state.joint_speeds),
            normal: contacts.normal,
            friction: contacts.friction,
            feet: Some(contacts.feet),
            trunk: contacts.trunk,
            knee: contacts.knee,
        }
    }

    /// The state; the quaternion is made a unit one.
    pub fn state(&self) -> RobotState {
        let [w, x, y, z] = self.quaternion;
        RobotState {
            position: self.position.into(),
            rotation: UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z)),
            velocity: self.velocity.into(),
            angular_velocity: self.angular_velocity.into(),
            joints: legs(&self.joints),
            joint_speeds: legs(&self.joint_speeds),
        }
    }

    /// The ground contact.
    pub fn contacts(&self) -> Contacts {
        let feet = self.feet.unwrap_or(self.normal.map(|force| force > 0.0));
        Contacts { normal: self.normal, friction: self.friction, feet, trunk: self.trunk, knee: self.knee }
    }
}

/// Twelve numbers in a row.
pub fn flat(legs: &[Vector3<f64>; 4]) -> [f64; 12] {
    std::array::from_fn(|i| legs[i / 3][i % 3])
}

/// Twelve numbers as four legs.
pub fn legs(numbers: &[f64; 12]) -> [Vector3<f64>; 4] {
    std::array::from_fn(|leg| Vector3::from_fn(|joint, _| numbers[3 * leg + joint]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_state_comes_back() {
        let state = RobotState {
            position: Vector3::new(1.0, 2.0, 3.0),
            rotation: UnitQuaternion::from_euler_angles(0.1, -0.2, 0.3),
            velocity: Vector3::new(4.0, 5.0, 6.0),
            angular_velocity: Vector3::new(7.0, 8.0, 9.0),
            joints: std::array::from_fn(|i| Vector3::new(0.1, 0.2, i as f64)),
            joint_speeds: std::array::from_fn(|i| Vector3::new(i as f64, -0.1, -0.2)),
        };
        let feet = [true, false, true, true];
        let contacts = Contacts { normal: [1.0, 2.0, 3.0, 0.0], friction: [0.5; 4], feet, trunk: false, knee: true };
        let snapshot = Snapshot::new(&state, &contacts);
        assert_eq!(snapshot.joints[3..6], [0.1, 0.2, 1.0]);
        let back = snapshot.state();
        assert!(back.rotation.angle_to(&state.rotation) < 1e-12);
        assert_eq!((RobotState { rotation: state.rotation, ..back }, snapshot.contacts()), (state, contacts));
        let untold = Snapshot { feet: None, ..snapshot };
        assert_eq!(untold.contacts().feet, [true, true, true, false]);
    }
}
