//! Writes the numbers that the policy sees: the blocks of `herd_common::spaces`, scaled and clipped to [−1, 1].
//!
//! Mirrored, the observation is that of the same robot seen in a mirror along its xz plane: left and right legs change
//! places and every sideways quantity (y, roll, yaw, hip roll) its sign. Shown so whenever FR + RL swing next, the pair
//! about to swing is always FL + RR, and the gait's phase needs no number of its own. A command is mirrored likewise.

use crate::robot::{Leg, Model};
use crate::sim::RobotState;
use herd_common::config::command::Command;
use herd_common::spaces::{self, Block, OBSERVATION_DIM, OBSERVATION_DIM_MAX};
use nalgebra::Vector3;
use std::ops::Deref;

/// What a policy sees: as many numbers as its task shows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observation {
    numbers: [f32; OBSERVATION_DIM_MAX],
    len: usize,
}

impl Observation {
    /// Zeros.
    pub(super) fn zeros(len: usize) -> Self {
        assert!(len <= OBSERVATION_DIM_MAX, "an observation has {len} numbers, at most {OBSERVATION_DIM_MAX} fit");
        Self { numbers: [0.0; OBSERVATION_DIM_MAX], len }
    }
}

impl Deref for Observation {
    type Target = [f32];

    fn deref(&self) -> &[f32] {
        &self.numbers[..self.len]
    }
}

/// What is measured for one observation.
pub struct Sense<'a> {
    /// The robot.
    pub state: &'a RobotState,
    /// Torques of the last tick, N·m.
    pub torques: &'a [Vector3<f64>; 4],
    /// Normal force on each foot, N.
    pub normal: [f64; 4],
    /// Friction force on each foot, N.
    pub friction: [f64; 4],
    /// Height of the ground below the trunk, as the feet feel it where a controller drives them, world, m.
    pub ground: f64,
    /// What is asked of the robot, in the command task.
    pub command: Option<Command>,
}

/// The observation, mirrored if asked.
pub fn observe(model: &Model, sense: &Sense<'_>, mirrored: bool) -> Observation {
    let state = sense.state;
    let sign = if mirrored { -1.0 } else { 1.0 };
    let angles = state.angles();
    let q = state.rotation.quaternion();
    // A rotation and its negative quaternion are the same: show the one with w ≥ 0.
    let half = if q.w < 0.0 { -1.0 } else { 1.0 };
    let commanded = sense.command.map_or(0, |_| spaces::COMMAND.len);
    let mut out = Observation::zeros(OBSERVATION_DIM + commanded);
    put(&mut out, spaces::VELOCITY, [state.velocity.x, sign * state.velocity.y, state.velocity.z]);
    put(&mut out, spaces::QUATERNION, [q.w, sign * q.i, q.j, sign * q.k].map(|x| half * x));
    put(&mut out, spaces::ANGLES, [sign * angles.x, angles.y, sign * angles.z]);
    put(&mut out, spaces::POSITION_Y, [sign * state.position.y]);
    put(&mut out, spaces::POSITION_Z, [state.position.z - sense.ground - model.standing_height()]);
    let shown = Leg::ALL.map(|leg| if mirrored { leg.mirrored() } else { leg });
    let joints = |of: &dyn Fn(Leg) -> Vector3<f64>| {
        shown
            .into_iter()
            .flat_map(move |leg| {
                let v = of(leg);
                [sign * v.x, v.y, v.z]
            })
            .collect::<Vec<_>>()
    };
    put(&mut out, spaces::TORQUE, joints(&|leg| sense.torques[leg.index()]));
    put(&mut out, spaces::JOINT_ANGLE, joints(&|leg| state.joints[leg.index()] - model.nominal(leg)));
    put(&mut out, spaces::JOINT_VELOCITY, joints(&|leg| state.joint_speeds[leg.index()]));
    put(&mut out, spaces::NORMAL_FORCE, shown.map(|leg| sense.normal[leg.index()]));
    put(&mut out, spaces::FRICTION_FORCE, shown.map(|leg| sense.friction[leg.index()]));
    if let Some(Command { forward_mps, lateral_mps, yaw_radps }) = sense.command {
        put(&mut out, spaces::COMMAND, [forward_mps, sign * lateral_mps, sign * yaw_radps]);
    }
    out
}

/// Scales, clips and stores one block.
fn put(out: &mut Observation, block: Block, values: impl IntoIterator<Item = f64>) {
    let target = &mut out.numbers[block.start..block.start + block.len];
    let mut values = values.into_iter();
    for (slot, value) in target.iter_mut().zip(&mut values) {
        *slot = (value as f32 / block.scale).clamp(-1.0, 1.0);
    }
    debug_assert!(values.next().is_none(), "{}: more values than the block has room for", block.meaning);
}

#[cfg(test)]
mod tests {
    use super::*;
    use herd_common::config::Config;
    use nalgebra::UnitQuaternion;

    fn state() -> RobotState {
        RobotState {
            position: Vector3::new(3.0, 0.2, 0.17),
            rotation: UnitQuaternion::from_euler_angles(0.1, -0.05, 0.2),
            velocity: Vector3::new(0.5, -0.25, 0.125),
            angular_velocity: Vector3::zeros(),
            joints: std::array::from_fn(|i| Vector3::new(0.1 * (i as f64 + 1.0), 0.8, -1.6)),
            joint_speeds: std::array::from_fn(|i| Vector3::new(i as f64, 1.0, 2.0)),
        }
    }

    fn seen(state: &RobotState, mirrored: bool) -> Observation {
        let model = Model::new(&Config::default().robot);
        let torques = std::array::from_fn(|i| Vector3::new(1.0, 2.0, i as f64));
        let (normal, friction) = ([10.0, 20.0, 30.0, 500.0], [1.0, 2.0, 3.0, 4.0]);
        let sense = Sense { state, torques: &torques, normal, friction, ground: 0.01, command: None };
        observe(&model, &sense, mirrored)
    }

    #[test]
    fn a_command_stands_behind_the_papers_numbers_and_is_mirrored() {
        let model = Model::new(&Config::default().robot);
        let (state, torques) = (state(), [Vector3::zeros(); 4]);
        let plain = Sense {
            state: &state,
            torques: &torques,
            normal: [0.0; 4],
            friction: [0.0; 4],
            ground: 0.0,
            command: None,
        };
        let command = Command { forward_mps: 0.6, lateral_mps: 0.15, yaw_radps: -0.3 };
        let told = Sense { command: Some(command), ..plain };
        for (mirrored, expected) in [(false, [0.4, 0.1, -0.2]), (true, [0.4, -0.1, 0.2])] {
            let observation = observe(&model, &told, mirrored);
            assert_eq!(observation.len(), 59);
            assert_eq!(observation[..56], *observe(&model, &plain, mirrored));
            let close = observation[56..].iter().zip(expected).all(|(found, expected)| (found - expected).abs() < 1e-6);
            assert!(close, "{:?}, expected {expected:?}", &observation[56..]);
        }
    }

    /// The robot's image in the mirror.
    fn image(state: &RobotState) -> RobotState {
        let (roll, pitch, yaw) = state.rotation.euler_angles();
        let flip = |v: &Vector3<f64>| Vector3::new(-v.x, v.y, v.z);
        RobotState {
            position: Vector3::new(state.position.x, -state.position.y, state.position.z),
            rotation: UnitQuaternion::from_euler_angles(-roll, pitch, -yaw),
            velocity: Vector3::new(state.velocity.x, -state.velocity.y, state.velocity.z),
            angular_velocity: Vector3::zeros(),
            joints: Leg::ALL.map(|leg| flip(&state.joints[leg.mirrored().index()])),
            joint_speeds: Leg::ALL.map(|leg| flip(&state.joint_speeds[leg.mirrored().index()])),
        }
    }

    #[test]
    fn blocks_hold_scaled_and_clipped_values() {
        let observation = seen(&state(), false);
        let expect = |block: Block, offset: usize, value: f32| {
            assert!((observation[block.start + offset] - value).abs() < 1e-6, "{} {offset}", block.meaning);
        };
        expect(spaces::VELOCITY, 0, 0.2);
        expect(spaces::ANGLES, 2, 0.2 / 0.35);
        expect(spaces::TORQUE, 11, 0.1);
        expect(spaces::POSITION_Y, 0, 0.2);
        let standing = Model::new(&Config::default().robot).standing_height() as f32;
        expect(spaces::POSITION_Z, 0, (0.16 - standing) / 0.1);
        expect(spaces::JOINT_ANGLE, 9, 0.4);
        expect(spaces::JOINT_VELOCITY, 5, 0.08);
        expect(spaces::NORMAL_FORCE, 3, 1.0);
        expect(spaces::FRICTION_FORCE, 1, 0.02);
    }

    #[test]
    fn mirrored_is_what_the_mirror_image_would_see() {
        let state = state();
        let (mirrored, image) = (seen(&state, true), seen(&image(&state), false));
        for block in [spaces::VELOCITY, spaces::QUATERNION, spaces::ANGLES, spaces::POSITION_Y, spaces::POSITION_Z] {
            for i in block.start..block.start + block.len {
                assert!((mirrored[i] - image[i]).abs() < 1e-6, "{} {i}", block.meaning);
            }
        }
        for block in [spaces::JOINT_ANGLE, spaces::JOINT_VELOCITY] {
            for i in block.start..block.start + block.len {
                assert!((mirrored[i] - image[i]).abs() < 1e-6, "{} {i}", block.meaning);
            }
        }
        assert_eq!(mirrored[spaces::NORMAL_FORCE.start], 0.1);
        assert_eq!(mirrored[spaces::TORQUE.start], -1.0 / 30.0);
    }
}
