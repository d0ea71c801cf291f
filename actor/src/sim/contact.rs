//! Reads ground contact out of a stepped world: forces on the feet, and whether trunk or knees touch.
//!
//! A force here is the impulse over one tick divided by its length, so a touchdown peaks the higher the shorter the
//! tick is: consumers average.

use super::build::Handles;
use rapier3d::prelude::*;

/// Ground contact over one tick.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Contacts {
    /// Normal force on each foot, N.
    pub normal: [f64; 4],
    /// Magnitude of the friction force on each foot, N.
    pub friction: [f64; 4],
    /// The trunk touches the ground.
    pub trunk: bool,
    /// A knee touches the ground.
    pub knee: bool,
}

pub(super) fn read(world: &PhysicsWorld, handles: &Handles) -> Contacts {
    let forces = handles.feet.map(|foot| force(world, foot));
    Contacts {
        normal: forces.map(|(normal, _)| normal),
        friction: forces.map(|(_, friction)| friction),
        trunk: touches(world, handles.trunk_box),
        knee: handles.knees.iter().any(|knee| touches(world, *knee)),
    }
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
