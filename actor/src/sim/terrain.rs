//! Puts the ground into a rapier world: a plane, a height field for bumps, a solid for each raised tread.
//!
//! Slopes are ground that is tilted, under gravity that is not: heights, speeds and angles of a report are then those of
//! the world. The solids overlap, so the highest one carries, which is what `Ground` says.

use super::convert::vector_to_sim;
use super::ground::{CELL, COLUMNS, Ground, REACH_X, REACH_Y, ROWS};
use nalgebra::Vector3;
use rapier3d::prelude::*;

/// Half the edge of the plane, m: far beyond any episode.
const PLANE_HALF: f32 = 500.0;
/// Depth of a tread below its lower edge, m; only its top and walls are ever touched.
const TREAD_DEPTH: f64 = 0.5;

/// The colliders of this ground.
pub(super) fn colliders(ground: &Ground) -> Vec<ColliderBuilder> {
    let treads = ground.steps().into_iter().flat_map(|steps| {
        let both = |(from, to): (f64, f64)| [(from, to), (-to, -from)];
        steps.raised().flat_map(both).map(move |span| tread(span, steps.height, ground))
    });
    std::iter::once(plane(ground)).chain(ground.bumps().map(|heights| bumps(heights, ground))).chain(treads).collect()
}

/// Turns z up about y, so that +x points uphill.
fn tilt(ground: &Ground) -> Rotation {
    Rotation::from_rotation_y(-ground.slope_rad() as f32)
}

fn plane(ground: &Ground) -> ColliderBuilder {
    let tilt = tilt(ground);
    let centre = tilt * Vector::new(0.0, 0.0, -1.0);
    ColliderBuilder::cuboid(PLANE_HALF, PLANE_HALF, 1.0).position(Pose::from_parts(centre, tilt))
}

/// rapier's height fields have y up, columns along x and rows along z: turned by a right angle, rows go towards −y.
fn bumps(heights: &[f32], ground: &Ground) -> ColliderBuilder {
    let rise = |column: usize| (column as f64 * CELL - REACH_X) * ground.slope_rad().tan();
    let heights = heights.iter().enumerate().map(|(n, height)| height + rise(n / ROWS) as f32).collect();
    let size = Vector::new(2.0 * REACH_X as f32, 1.0, 2.0 * REACH_Y as f32);
    let field = Array2::new(ROWS, COLUMNS, heights);
    ColliderBuilder::heightfield_with_flags(field, size, HeightFieldFlags::FIX_INTERNAL_EDGES)
        .rotation(Vector::X * std::f32::consts::FRAC_PI_2)
}

/// A solid whose top follows the slope and whose walls are upright.
fn tread((from, to): (f64, f64), height: f64, ground: &Ground) -> ColliderBuilder {
    let rise = |x: f64| x * ground.slope_rad().tan();
    let corners: Vec<Vector> = [from, to]
        .into_iter()
        .flat_map(|x| [-REACH_Y, REACH_Y].map(|y| (x, y)))
        .flat_map(|(x, y)| [-TREAD_DEPTH, height].map(|z| Vector3::new(x, y, rise(x) + z)))
        .map(|corner| vector_to_sim(&corner))
        .collect();
    ColliderBuilder::convex_hull(&corners).expect("eight corners span a solid")
}
