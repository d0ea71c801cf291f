//! Reads ground contact out of a stepped world: forces on the feet, which of them are on the ground, and whether trunk or
//! knees touch it.
//!
//! A force here is the impulse over one tick divided by its length, so a touchdown peaks the higher the shorter the
//! tick is: consumers average.
//!
//! Rapier looks ahead: it slows a foot that is d above the ground and would be there within a solver step of length h to
//! d/h, so that it arrives at the end of that step. Poses lead by half a step, so a foot that would have had the speed v
//! arrives d/v after the middle of the step that slows it: before the step's end if it has lost more than half of that
//! speed, else in the tick to come. Were every slowed foot held to be on the ground, a long step would tell earlier than
//! four short ones. Trunk and knees, whose touch ends an episode, are told as soon as they are slowed. A foot stands as long
//! as any step of the tick presses on it: with several steps a tick some press and some do not.

use super::build::Handles;
use super::convert::vector_from_sim;
use super::world::ROBOT;
use crate::robot::Leg;
use nalgebra::{DVector, Vector3};
use rapier3d::prelude::*;

/// A slowed foot that sinks no faster than this is on the ground, whatever it had before, m/s.
const STILL: f64 = 1e-3;

/// Ground contact over one tick.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Contacts {
    /// Normal force on each foot, N.
    pub normal: [f64; 4],
    /// Magnitude of the friction force on each foot, N.
    pub friction: [f64; 4],
    /// Each foot that has arrived on the ground by the tick's end and was pressed on in the tick.
    pub feet: [bool; 4],
    /// The trunk touches the ground.
    pub trunk: bool,
    /// A knee touches the ground.
    pub knee: bool,
}

/// What has to be known of the time before a tick.
#[derive(Default)]
pub(super) struct Before {
    /// Generalised velocities.
    pub(super) speeds: DVector<f32>,
    /// Feet that the tick before it pressed on.
    pressed: [bool; 4],
}

/// What a collider met in a tick.
#[derive(Default)]
struct Touch {
    /// Impulses along the normals and across, N·s.
    normal: f64,
    friction: f64,
    /// The mean normal, away from the ground, of any length.
    up: Vector3<f64>,
}

/// Contact over the tick that has been stepped; `before` then belongs to the next.
pub(super) fn read(world: &PhysicsWorld, handles: &Handles, before: &mut Before) -> Contacts {
    let touches = handles.feet.map(|foot| touch(world, foot));
    let secs = f64::from(world.integration_parameters.dt);
    let feet = Leg::ALL.map(|leg| {
        let (i, touch) = (leg.index(), &touches[leg.index()]);
        touch.normal > 0.0 && (before.pressed[i] || has_arrived(world, handles, leg, &touch.up, &before.speeds))
    });
    before.pressed = touches.each_ref().map(|touch| touch.normal > 0.0);
    Contacts {
        normal: touches.each_ref().map(|touch| touch.normal / secs),
        friction: touches.each_ref().map(|touch| touch.friction / secs),
        feet,
        trunk: touch(world, handles.trunk_box).normal > 0.0,
        knee: handles.knees.iter().any(|knee| touch(world, *knee).normal > 0.0),
    }
}

fn touch(world: &PhysicsWorld, collider: ColliderHandle) -> Touch {
    let mut touch = Touch::default();
    for pair in world.narrow_phase.contact_pairs_with(collider) {
        // Normals point from the first collider to the second.
        let away = if pair.collider1 == collider { -1.0 } else { 1.0 };
        for manifold in pair.solver_manifolds() {
            let points = || manifold.points.iter().map(|point| &point.data);
            let impulse: f64 = points().map(|point| f64::from(point.impulse)).sum();
            touch.normal += impulse;
            touch.up += vector_from_sim(manifold.data.normal) * (away * impulse);
            // Only within one manifold do tangents share their directions.
            touch.friction += points().map(|point| point.tangent_impulse.cast::<f64>()).sum::<Vector2>().norm();
        }
    }
    touch
}

type Vector2 = rapier3d::na::Vector2<f64>;

/// Whether a foot that is being slowed for the first time is on the ground by now.
fn has_arrived(world: &PhysicsWorld, handles: &Handles, leg: Leg, up: &Vector3<f64>, before: &DVector<f32>) -> bool {
    let (multibody, _) = world.multibody_joints.get(handles.joints[leg.index()][2]).expect(ROBOT);
    let free = before + multibody.generalized_acceleration() * world.integration_parameters.dt;
    let now = multibody.generalized_velocity().into_owned();
    let sinking = |speeds| -foot_velocity(world, handles, leg, speeds).dot(up) / up.norm();
    sinking(&now) <= (sinking(&free) / 2.0).max(STILL)
}

/// Velocity of a foot in rapier's pose at these generalised velocities, world, m/s.
pub(super) fn foot_velocity(world: &PhysicsWorld, handles: &Handles, leg: Leg, speeds: &DVector<f32>) -> Vector3<f64> {
    let [_, _, calf] = handles.links[leg.index()];
    let (multibody, link) = world.multibody_joints.get(handles.joints[leg.index()][2]).expect(ROBOT);
    let velocity = multibody.body_jacobian(link) * speeds;
    let [linear, angular] = [0, 3].map(|row| Vector3::from_fn(|axis, _| f64::from(velocity[row + axis])));
    let (body, foot) = (&world.bodies[calf], &world.colliders[handles.feet[leg.index()]]);
    let in_calf = foot.position_wrt_parent().map_or(Vector::ZERO, |pose| pose.translation);
    let arm = *body.rotation() * (in_calf - body.local_center_of_mass());
    linear + angular.cross(&vector_from_sim(arm))
}
