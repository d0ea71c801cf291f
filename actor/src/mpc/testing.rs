//! Robots, gaits and disturbances that the tests of the controller share.

use super::{Body, Condenser, Qp, QpSolver, State, Step};
use herd_common::config::{Config, control};
use herd_common::seed::Seed;
use nalgebra::{DMatrix, DVector, Matrix3, Rotation3, Vector3};
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

/// The answer of `solver` made exact: rows whose multiplier exceeds their slack are met as equations.
pub(super) fn polished(qp: &Qp, solver: &mut impl QpSolver) -> Vec<f64> {
    let n = qp.variables();
    let mut forces = vec![0.0; n];
    solver.solve(qp, &mut forces).expect("the reference solves");
    let met: Vec<usize> = (0..qp.rows()).filter(|row| qp.row(*row).violation(&forces) > -1e-3).collect();
    let scale = 1.0 / config().weight_force;
    let mut system = DMatrix::zeros(n + met.len(), n + met.len());
    let mut right = DVector::zeros(n + met.len());
    for i in 0..n {
        right[i] = -scale * qp.gradient()[i];
        for j in 0..n {
            system[(i, j)] = scale * qp.hessian(i, j);
        }
    }
    for (k, row) in met.iter().enumerate() {
        let row = qp.row(*row);
        right[n + k] = row.bound;
        for (variable, coefficient) in row.terms {
            system[(n + k, variable)] += coefficient;
            system[(variable, n + k)] += coefficient;
        }
    }
    let exact = system.svd(true, true).solve(&right, 1e-10).expect("both factors were asked for");
    exact.as_slice()[..n].to_vec()
}
