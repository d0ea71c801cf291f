//! Reads ground contact out of a stepped world: forces on the feet, and whether trunk or knees touch.
//!
//! A force here is the impulse over one tick divided by its length, so a touchdown peaks the higher the shorter the
//! tick is: consumers average.
//!
//! Rapier looks ahead: it slows a foot that is d above the ground and would be there within a solver step of length h to
//! d/h, so that it arrives at the end of that step. Poses lead by half a step, so a foot of speed v arrives d/v after
//! the middle of the step that slows it: before the step's end if it has lost more than half of its speed, else in the
//! tick to come. Were every slowed foot held to be on the ground, a long step would tell earlier than four short ones.

use super::build::Handles;
use super::convert::vector_from_sim;
use crate::robot::Leg;
use nalgebra::Vector3;
use rapier3d::prelude::*;

/// Ground contact over one tick.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Contacts {
    /// Normal force on each foot, N.
    pub normal: [f64; 4],
    /// Magnitude of the friction force on each foot, N.
    pub friction: [f64; 4],
    /// Each foot that is on the ground at the tick's end.
    pub feet: [bool; 4],
    /// The trunk touches the ground.
    pub trunk: bool,
    /// A knee touches the ground.
    pub knee: bool,
}

/// Velocities of the feet, world, m/s.
pub(super) type Velocities = [Vector3<f64>; 4];

/// Contact over the tick after `last`, which took the feet from the one velocities to the other.
pub(super) fn read(world: &PhysicsWorld, handles: &Handles, last: &Contacts, feet: [&Velocities; 2]) -> Contacts {
    let forces = handles.feet.map(|foot| force(world, foot));
    let normal = forces.map(|(normal, _)| normal);
    let on_ground = |leg: Leg| {
        let i = leg.index();
        let was_slowed = last.normal[i] > 0.0;
        normal[i] > 0.0 && (was_slowed || has_arrived(&upwards(world, handles.feet[i]), feet.map(|of| &of[i])))
    };
    Contacts {
        normal,
        friction: forces.map(|(_, friction)| friction),
        feet: Leg::ALL.map(on_ground),
        trunk: touches(world, handles.trunk_box),
        knee: handles.knees.iter().any(|knee| touches(world, *knee)),
    }
}

/// Velocities of the feet in rapier's pose.
pub(super) fn velocities(world: &PhysicsWorld, handles: &Handles) -> Velocities {
    Leg::ALL.map(|leg| {
        let i = leg.index();
        let (multibody, calf) = world.multibody_joints.get(handles.joints[i][2]).expect("the robot stays in the world");
        let calf_velocity = multibody.body_jacobian(calf) * multibody.generalized_velocity();
        let [linear, angular] = [0, 3].map(|row| Vector3::from_fn(|i, _| f64::from(calf_velocity[row + i])));
        let arm = world.colliders[handles.feet[i]].translation() - world.bodies[handles.links[i][2]].center_of_mass();
        linear + angular.cross(&vector_from_sim(arm))
    })
}

/// Whether a foot that rapier has slowed from the first velocity to the second is on the ground by now.
fn has_arrived(up: &Vector3<f64>, velocities: [&Vector3<f64>; 2]) -> bool {
    let [before, after] = velocities.map(|velocity| -velocity.dot(up));
    after <= before.max(0.0) / 2.0
}

/// The ground's normal where a collider touches it.
fn upwards(world: &PhysicsWorld, collider: ColliderHandle) -> Vector3<f64> {
    let mut manifolds = world.narrow_phase.contact_pairs_with(collider).flat_map(ContactPair::solver_manifolds);
    let normal = manifolds.find(|manifold| !manifold.points.is_empty()).map_or(Vector::Z, |m| m.data.normal);
    // Which of the two bodies it points away from is the pair's affair; the ground is always below.
    vector_from_sim(normal * normal.z.signum())
}

/// Normal force and friction magnitude on a collider, N.
fn force(world: &PhysicsWorld, collider: ColliderHandle) -> (f64, f64) {
    let mut normal = 0.0;
    let mut friction = 0.0;
    for manifold in world.narrow_phase.contact_pairs_with(collider).flat_map(ContactPair::solver_manifolds) {
        normal += manifold.points.iter().map(|point| f64::from(point.data.impulse)).sum::<f64>();
        // Only within one manifold do tangents share their directions.
        friction +=
            manifold.points.iter().map(|point| point.data.tangent_impulse.cast::<f64>()).sum::<Vector2>().norm();
    }
    let dt = f64::from(world.integration_parameters.dt);
    (normal / dt, friction / dt)
}

type Vector2 = rapier3d::na::Vector2<f64>;

fn touches(world: &PhysicsWorld, collider: ColliderHandle) -> bool {
    force(world, collider).0 > 0.0
}
