//! Robots, gaits and disturbances that the tests of the controller share.

use super::{Body, Condenser, Qp, State, Step};
use herd_common::config::{Config, control};
use herd_common::seed::Seed;
use nalgebra::{Matrix3, Rotation3, Vector3};
use rand::RngExt;

/// Length of the default horizon.
pub(super) const HORIZON: usize = 10;
/// The feet of all legs.
pub(super) const ALL: [bool; 4] = [true; 4];

pub(super) fn config() -> control::Mpc {
    Config::default().control.mpc
}

pub(super) fn body() -> Body {
    Body { mass_kg: 13.6, inertia: Matrix3::from_diagonal(&Vector3::new(0.040, 0.082, 0.088)) }
}

pub(super) fn inertia_inverse() -> Matrix3<f64> {
    body().inertia.try_inverse().expect("diagonal with positive entries")
}

/// I⁻¹ in the middle of a step, world, from the product of three rotations.
pub(super) fn inertia_inverse_at(start: &State, end: &State) -> Matrix3<f64> {
    let angles = (start.angles + end.angles) / 2.0;
    let about = |axis: Vector3<f64>, angle: f64| *Rotation3::from_scaled_axis(axis * angle).matrix();
    let rotation = about(Vector3::z(), angles.z) * about(Vector3::y(), angles.y) * about(Vector3::x(), angles.x);
    let inertia = rotation * body().inertia * rotation.transpose();
    inertia.try_inverse().expect("similar to a diagonal with positive entries")
}

/// A vector with entries in ±`scale`.
fn vector(rng: &mut impl RngExt, scale: f64) -> Vector3<f64> {
    Vector3::from_fn(|_, _| rng.random_range(-scale..=scale))
}

/// Some state after a push, different for each `seed`.
pub(super) fn disturbed(seed: u64) -> State {
    let mut rng = Seed::from_number(seed).rng();
    State {
        angles: vector(&mut rng, 0.25),
        position: vector(&mut rng, 0.03) + Vector3::new(0.0, 0.0, 0.17),
        angular_velocity: vector(&mut rng, 1.5),
        velocity: vector(&mut rng, 0.6),
    }
}

/// Legs FL, FR, RL, RR in stance for five steps, then the others of a trot.
pub(super) fn trot() -> Vec<[bool; 4]> {
    let pairs = [[true, false, false, true], [false, true, true, false]];
    (0..HORIZON).map(|step| pairs[step / 5 % 2]).collect()
}

/// A walk forwards at `speed`, m/s, with some scatter of the feet.
pub(super) fn horizon(stance: &[[bool; 4]], speed: f64, seed: u64) -> Vec<Step> {
    let mut rng = Seed::from_number(seed).child("feet", 0).rng();
    let dt = config().step_secs;
    let yaw_rate = rng.random_range(-0.5..=0.5);
    let scatter: [Vector3<f64>; 4] = std::array::from_fn(|_| vector(&mut rng, 0.04));
    let corners = [(0.07, 0.09), (0.07, -0.09), (-0.07, 0.09), (-0.07, -0.09)];
    let step = |k: usize| {
        let time = (k + 1) as f64 * dt;
        let reference = State {
            angles: Vector3::new(0.0, 0.0, yaw_rate * time),
            position: Vector3::new(speed * time, 0.0, 0.17),
            angular_velocity: Vector3::new(0.0, 0.0, yaw_rate),
            velocity: Vector3::new(speed, 0.0, 0.0),
        };
        let feet = std::array::from_fn(|leg| {
            let (x, y) = corners[leg];
            let landed = speed * dt * (k / 5 * 5) as f64;
            let foot = Vector3::new(x + landed, y, 0.0) + scatter[leg].component_mul(&Vector3::new(1.0, 1.0, 0.1));
            stance[k][leg].then_some(foot)
        });
        Step { reference, feet }
    };
    (0..stance.len()).map(step).collect()
}

/// The programme of the default configuration.
pub(super) fn programme(state: &State, horizon: &[Step]) -> Qp {
    let mut qp = Qp::default();
    Condenser::new(&config(), &body()).build(state, horizon, &mut qp);
    qp
}

/// H u + g.
fn slope(qp: &Qp, forces: &[f64]) -> Vec<f64> {
    let n = qp.variables();
    (0..n).map(|i| qp.gradient()[i] + (0..n).map(|j| qp.hessian(i, j) * forces[j]).sum::<f64>()).collect()
}

/// Optimality without multipliers: every foot's pyramid is the hull of five corners, and going towards none of them may
/// lower the cost.
#[track_caller]
pub(super) fn check_optimal(qp: &Qp, forces: &[f64]) {
    for row in 0..qp.rows() {
        let violation = qp.row(row).violation(forces);
        assert!(violation < 1e-8, "row {row} is violated by {violation} N");
    }
    let slope = slope(qp, forces);
    let (top, side) = (qp.force_max_n, qp.force_max_n * qp.friction);
    for foot in 0..qp.feet() {
        let (here, slope) = (&forces[3 * foot..][..3], &slope[3 * foot..][..3]);
        let signs = [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)];
        let corners = signs.map(|(x, y)| [x * side, y * side, top]);
        for corner in corners.iter().chain([&[0.0; 3]]) {
            let change: f64 = (0..3).map(|axis| slope[axis] * (corner[axis] - here[axis])).sum();
            // A slope in rounding error, 1e-11, over 200 N.
            assert!(change > -1e-8, "foot {foot}: cost falls by {change} towards {corner:?}");
        }
    }
}

/// How far, N, `forces` can be from the minimiser: the part of the downhill slope that no row met resists, over the
/// least curvature. Rows within 1e-8 N of their bounds count as met.
pub(super) fn error_bound(qp: &Qp, forces: &[f64]) -> f64 {
    let slope = slope(qp, forces);
    let mut squares = 0.0;
    for foot in 0..qp.feet() {
        let downhill = -Vector3::from_column_slice(&slope[3 * foot..3 * foot + 3]);
        let met: Vec<Vector3<f64>> = (foot * Qp::ROWS_PER_FOOT..(foot + 1) * Qp::ROWS_PER_FOOT)
            .map(|row| qp.row(row))
            .filter(|row| row.violation(forces) > -1e-8)
            .map(|row| {
                let mut normal = Vector3::zeros();
                for (variable, coefficient) in row.terms {
                    normal[variable - 3 * foot] += coefficient;
                }
                normal
            })
            .collect();
        squares += unresisted(&downhill, &met).norm_squared();
    }
    squares.sqrt() / config().weight_force
}

/// The projection of a direction onto {d : normal · d ≤ 0 for all normals}, by trying every face of that cone.
fn unresisted(direction: &Vector3<f64>, normals: &[Vector3<f64>]) -> Vector3<f64> {
    let mut best = Vector3::zeros();
    for face in 0..1_u32 << normals.len() {
        let mut rest = *direction;
        let mut basis: Vec<Vector3<f64>> = Vec::new();
        for (_, normal) in normals.iter().enumerate().filter(|(index, _)| face >> index & 1 == 1) {
            let new = basis.iter().fold(*normal, |new, known| new - known * known.dot(&new));
            if new.norm() > 1e-9 {
                basis.push(new.normalize());
                rest -= basis[basis.len() - 1] * basis[basis.len() - 1].dot(&rest);
            }
        }
        let feasible = normals.iter().all(|normal| normal.dot(&rest) <= 1e-9 * direction.norm());
        if feasible && rest.norm() > best.norm() {
            best = rest;
        }
    }
    best
}
