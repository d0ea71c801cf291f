//! Joint torques of one leg: for a force on the ground, or for a path through the air (eqs 16 and 17).
//!
//! | symbol | name                                                 | unit    | shape  |
//! |--------|------------------------------------------------------|---------|--------|
//! | τ      | joint torques                                        | N·m     | [3]    |
//! | u      | force of the ground on the foot, world               | N       | [3]    |
//! | R      | world from body                                      | 1       | [3, 3] |
//! | J, J_c | Jacobian of the foot's centre, of its contact point  | m       | [3, 3] |
//! | M, h   | inertia of the leg with its rotors; Coriolis, gravity and friction | kg m², N·m | [3, 3], [3] |
//!
//! Stance: `τ = −J_cᵀ Rᵀ u + g(q) + d q̇`, where g carries the leg's own weight. Swing:
//! `τ = Jᵀ F + M q̈ + h`, `F = Kp (p* − p) + Kd (ṗ* − ṗ)`, `q̈ = J⁻¹ (p̈* − J̇ q̇)`. The trunk counts as unaccelerated.

use crate::gait::Point;
use crate::robot::{GRAVITY, Leg, Model, Posture};
use crate::sim::RobotState;
use herd_common::config::control;
use nalgebra::{Matrix3, Rotation3, Vector3};

/// Smallest |det J| (m³) that is inverted: below, the knee is nearly straight and the acceleration is not fed forward.
const DETERMINANT_MIN: f64 = 2e-4;

/// The robot at one tick, with everything derived that more than one consumer needs.
pub struct Body<'a> {
    /// Masses and lengths.
    pub model: &'a Model,
    /// What was measured.
    pub state: &'a RobotState,
    /// World from body.
    pub rotation: Rotation3<f64>,
    /// The legs with their trigonometry done.
    pub legs: [Posture; 4],
}

impl<'a> Body<'a> {
    /// The robot in this state.
    pub fn new(model: &'a Model, state: &'a RobotState) -> Self {
        Self {
            model,
            state,
            rotation: state.rotation.to_rotation_matrix(),
            legs: Leg::ALL.map(|leg| model.geometry.posture(leg, &state.joints[leg.index()])),
        }
    }

    /// Centre of mass of the whole robot, world, m.
    pub fn centre(&self) -> Vector3<f64> {
        self.state.position + self.rotation * self.model.centre(&self.legs)
    }

    /// Velocity of that centre, world, m/s.
    pub fn centre_velocity(&self) -> Vector3<f64> {
        let arm = self.rotation * self.model.centre(&self.legs);
        let inside = self.model.centre_velocity(&self.legs, &self.state.joint_speeds);
        self.state.velocity + self.state.angular_velocity.cross(&arm) + self.rotation * inside
    }

    /// Centre of a foot, world, m.
    pub fn foot(&self, leg: Leg) -> Vector3<f64> {
        self.state.position + self.rotation * self.foot_in_body(leg)
    }

    /// The point of a foot that touches level ground, world, m.
    pub fn contact_point(&self, leg: Leg) -> Vector3<f64> {
        self.foot(leg) - Vector3::z() * self.model.foot_radius
    }

    /// Torques (N·m) that make the ground push a standing foot with `force` (world, N).
    pub fn stance_torques(&self, leg: Leg, force: &Vector3<f64>) -> Vector3<f64> {
        let down = self.rotation.inverse() * Vector3::new(0.0, 0.0, -self.model.foot_radius);
        let jacobian = self.posture(leg).jacobian_with_offset(self.model.geometry.foot(), &down);
        let in_body = self.rotation.inverse() * force;
        -(jacobian.transpose() * in_body) + self.own_weight(leg) + self.friction(leg)
    }

    /// Torques (N·m) that bring the contact point of a standing foot, should it move otherwise, to this velocity (world, m/s).
    pub fn grip_torques(&self, leg: Leg, velocity: &Vector3<f64>, damping_nspm: f64) -> Vector3<f64> {
        let down = self.rotation.inverse() * Vector3::new(0.0, 0.0, -self.model.foot_radius);
        let posture = self.posture(leg);
        let jacobian = posture.jacobian_with_offset(self.model.geometry.foot(), &down);
        let arm = self.contact_point(leg) - self.state.position;
        let carried = self.state.velocity + self.state.angular_velocity.cross(&arm);
        let wanted = self.rotation.inverse() * (velocity - carried);
        jacobian.transpose() * (wanted - jacobian * self.state.joint_speeds[leg.index()]) * damping_nspm
    }

    /// Torques (N·m) that take a foot in the air along its path.
    pub fn swing_torques(&self, leg: Leg, path: &Point, gains: &control::Swing) -> Vector3<f64> {
        let posture = self.posture(leg);
        let foot = self.model.geometry.foot();
        let speeds = &self.state.joint_speeds[leg.index()];
        let jacobian = posture.jacobian(foot);
        let body_from_world = self.rotation.inverse();
        let wanted = body_from_world * (path.position - self.state.position);
        let carried = self.state.velocity + self.state.angular_velocity.cross(&(path.position - self.state.position));
        let wanted_velocity = body_from_world * (path.velocity - carried);
        let force = (wanted - posture.position(foot)) * gains.stiffness_npm
            + (wanted_velocity - jacobian * speeds) * gains.damping_nspm;
        let feedback = jacobian.transpose() * force;
        let bias = posture.bias_acceleration(foot, speeds);
        let acceleration = if jacobian.determinant().abs() > DETERMINANT_MIN {
            jacobian.try_inverse().map_or_else(Vector3::zeros, |j| j * (body_from_world * path.acceleration - bias))
        } else {
            Vector3::zeros()
        };
        feedback + self.inverse_dynamics(leg, &acceleration) + self.friction(leg)
    }

    /// Torques (N·m) for these joint accelerations (rad/s²), links taken as point masses: M q̈ + Coriolis + weight.
    fn inverse_dynamics(&self, leg: Leg, acceleration: &Vector3<f64>) -> Vector3<f64> {
        let posture = self.posture(leg);
        let speeds = &self.state.joint_speeds[leg.index()];
        let moving: Vector3<f64> = self
            .model
            .links
            .iter()
            .map(|link| {
                let jacobian = posture.jacobian(link.centre);
                let linear = jacobian * acceleration + posture.bias_acceleration(link.centre, speeds);
                jacobian.transpose() * linear * link.mass
            })
            .sum();
        moving + acceleration * self.model.joint_armature + self.own_weight(leg)
    }

    /// Torques that hold the leg's own links against gravity, N·m.
    fn own_weight(&self, leg: Leg) -> Vector3<f64> {
        let up = self.rotation.inverse() * Vector3::new(0.0, 0.0, GRAVITY);
        let jacobian: Matrix3<f64> =
            self.model.links.iter().map(|link| self.posture(leg).jacobian(link.centre) * link.mass).sum();
        jacobian.transpose() * up
    }

    /// Torques that overcome the joints' viscous friction, N·m.
    fn friction(&self, leg: Leg) -> Vector3<f64> {
        self.state.joint_speeds[leg.index()] * self.model.joint_damping
    }

    fn posture(&self, leg: Leg) -> &Posture {
        &self.legs[leg.index()]
    }

    fn foot_in_body(&self, leg: Leg) -> Vector3<f64> {
        self.posture(leg).position(self.model.geometry.foot())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use herd_common::config::Config;
    use nalgebra::UnitQuaternion;

    /// Where the point of the calf that touches the ground now is when the leg has come to `joints`, from the trunk, world.
    fn carried_point(model: &Model, state: &RobotState, leg: Leg, joints: &Vector3<f64>) -> Vector3<f64> {
        let calf = |q: &Vector3<f64>| {
            UnitQuaternion::from_axis_angle(&Vector3::x_axis(), q.x)
                * UnitQuaternion::from_axis_angle(&Vector3::y_axis(), q.y + q.z)
        };
        let touching = state.joints[leg.index()];
        let below = Vector3::new(0.0, 0.0, -model.foot_radius);
        let in_calf = (state.rotation * calf(&touching)).inverse() * below;
        state.rotation * (model.geometry.foot_in_body(leg, joints) + calf(joints) * in_calf)
    }

    #[test]
    fn a_standing_foot_that_skids_is_braked_and_one_that_stays_is_left_alone() {
        const STEP: f64 = 1e-6;
        let model = Model::new(&Config::default().robot);
        let mut state = RobotState {
            position: Vector3::new(1.0, -2.0, 0.17),
            rotation: UnitQuaternion::from_euler_angles(0.1, -0.1, 0.5),
            velocity: Vector3::new(0.9, 0.1, -0.05),
            angular_velocity: Vector3::new(0.2, -0.3, 0.4),
            joints: Leg::ALL.map(|leg| model.nominal(leg)),
            joint_speeds: [Vector3::zeros(); 4],
        };
        let leg = Leg::RearLeft;
        let gripping = |state: &RobotState| Body::new(&model, state).grip_torques(leg, &Vector3::zeros(), 20.0);
        // How the touching point of the calf moves, with the trunk and with each joint, by small displacements.
        let touching = state.joints[leg.index()];
        let arm = carried_point(&model, &state, leg, &touching);
        let ridden = |secs: f64| state.velocity * secs + Rotation3::new(state.angular_velocity * secs) * arm;
        let rides = (ridden(STEP) - ridden(-STEP)) / (2.0 * STEP);
        let columns = [Vector3::x(), Vector3::y(), Vector3::z()].map(|joint| {
            let moved = |angle: f64| carried_point(&model, &state, leg, &(touching + joint * angle));
            (moved(STEP) - moved(-STEP)) / (2.0 * STEP)
        });
        let inverse = Matrix3::from_columns(&columns).try_inverse().expect("the knee is bent");
        // The foot rides along with the trunk: what is felt at the foot is 20 N·s/m against its velocity.
        let felt = inverse.transpose() * gripping(&state);
        assert!((felt + rides * 20.0).norm() < 1e-6, "{felt}");
        // Now its joints move so that it stays where it is.
        state.joint_speeds[leg.index()] = -(inverse * rides);
        assert!(gripping(&state).norm() < 1e-6);
    }

    /// x, ẋ and ẍ at t = 0 of a path, by differences.
    fn at_once(path: impl Fn(f64) -> Vector3<f64>) -> Point {
        const STEP: f64 = 1e-4;
        let (before, now, after) = (path(-STEP), path(0.0), path(STEP));
        let acceleration = (after - 2.0 * now + before) / (STEP * STEP);
        Point { position: now, velocity: (after - before) / (2.0 * STEP), acceleration }
    }

    #[test]
    fn a_foot_on_its_path_is_given_what_the_masses_of_its_leg_ask_for() {
        let config = Config::default();
        let model = Model::new(&config.robot);
        let speeds = Vector3::new(1.5, -4.0, 6.0);
        let accelerations = Vector3::new(-20.0, 70.0, -50.0);
        for leg in Leg::ALL {
            let mut state = RobotState {
                position: Vector3::new(1.0, -2.0, 0.17),
                rotation: UnitQuaternion::from_euler_angles(0.2, -0.2, 1.0),
                velocity: Vector3::zeros(),
                angular_velocity: Vector3::zeros(),
                joints: Leg::ALL.map(|leg| model.nominal(leg)),
                joint_speeds: [Vector3::zeros(); 4],
            };
            let joints = state.joints[leg.index()];
            state.joint_speeds[leg.index()] = speeds;
            let moving = |t: f64| joints + speeds * t + accelerations * (t * t / 2.0);
            let world = |point, q: &Vector3<f64>| {
                state.position + state.rotation * model.geometry.posture(leg, q).position(point)
            };
            // d'Alembert: τ = Σ m (p̈ + g)ᵀ ∂p/∂q over the links, and the rotors; nothing of it takes a Jacobian of ours.
            let mut expected = accelerations * model.joint_armature + speeds * model.joint_damping;
            for link in &model.links {
                let push =
                    (at_once(|t| world(link.centre, &moving(t))).acceleration + Vector3::z() * GRAVITY) * link.mass;
                for joint in 0..3 {
                    let along = at_once(|t| world(link.centre, &(joints + Vector3::ith(joint, t)))).velocity;
                    expected[joint] += push.dot(&along);
                }
            }
            let path = at_once(|t| world(model.geometry.foot(), &moving(t)));
            let found = Body::new(&model, &state).swing_torques(leg, &path, &config.control.swing);
            assert!((found - expected).amax() < 1e-4 * expected.amax(), "{leg:?}: {found}, expected {expected}");
        }
    }

    #[test]
    fn swing_torques_stay_bounded_as_the_knee_straightens() {
        let config = Config::default();
        let model = Model::new(&config.robot);
        let leg = Leg::FrontRight;
        let largest = |knee: f64| {
            let mut state = RobotState {
                position: Vector3::new(0.0, 0.0, 0.2),
                rotation: UnitQuaternion::identity(),
                velocity: Vector3::zeros(),
                angular_velocity: Vector3::zeros(),
                joints: Leg::ALL.map(|leg| model.nominal(leg)),
                joint_speeds: [Vector3::zeros(); 4],
            };
            state.joints[leg.index()].z = knee;
            let body = Body::new(&model, &state);
            let path = Point {
                position: body.foot(leg),
                velocity: Vector3::zeros(),
                acceleration: Vector3::new(30.0, 0.0, 30.0),
            };
            body.swing_torques(leg, &path, &config.control.swing).amax()
        };
        for knee in [-1.0, -0.3, -0.1, -0.05, -0.01, -1e-3, -1e-9, 0.0] {
            assert!(largest(knee) < 1.5 * model.torque_max, "knee at {knee} rad: {} N·m", largest(knee));
        }
    }

    #[test]
    fn a_stance_torque_does_the_work_of_its_force_whichever_way_the_trunk_leans() {
        let model = Model::new(&Config::default().robot);
        let state = RobotState {
            position: Vector3::new(1.0, -2.0, 0.17),
            rotation: UnitQuaternion::from_euler_angles(0.2, -0.2, 1.0),
            velocity: Vector3::zeros(),
            angular_velocity: Vector3::zeros(),
            joints: Leg::ALL.map(|leg| model.nominal(leg) + Vector3::new(0.1, -0.2, 0.15) * leg.side()),
            joint_speeds: [Vector3::zeros(); 4],
        };
        let body = Body::new(&model, &state);
        let force = Vector3::new(20.0, -15.0, 60.0);
        for leg in Leg::ALL {
            // What carries the leg's own weight does no work for the force.
            let torques = body.stance_torques(leg, &force) - body.stance_torques(leg, &Vector3::zeros());
            for joint in 0..3 {
                const STEP: f64 = 1e-6;
                let moved = |step: f64| {
                    let mut joints = state.joints[leg.index()];
                    joints[joint] += step;
                    carried_point(&model, &state, leg, &joints)
                };
                let velocity = (moved(STEP) - moved(-STEP)) / (2.0 * STEP);
                let (work, expected) = (-torques[joint], force.dot(&velocity));
                assert!((work - expected).abs() < 1e-6, "{leg:?} joint {joint}: {work}, expected {expected}");
            }
        }
    }
}
