//! The active set against the interior point and against optimality itself, over every kind of programme. Tests only.
//!
//! The interior point leaves up to a hundredth of a newton in directions of little curvature, so its forces are compared
//! loosely and its cost tightly; what a force may be off by is bounded from the programme alone (`error_bound`).

use super::super::qp::{Qp, QpSolver};
use super::super::testing::{self, ALL, check_optimal};
use super::super::{Condenser, State};
use super::{ActiveSet, InteriorPoint};
use crate::trial::{Question, erratic_policy, questions};
use herd_common::config::Config;
use herd_common::seed::Seed;
use nalgebra::Vector3;
use proptest::prelude::*;

/// What the interior point leaves in weakly curved directions, N.
const REFERENCE_ERROR_N: f64 = 1e-2;
/// How far our forces may be from the minimiser, N.
const ERROR_N: f64 = 1e-6;
/// By how much the costs of both may differ, relative to Σ |gᵢ| max(|uᵢ|, 1 N).
const COST_ERROR: f64 = 1e-9;

/// Solves with the active set and holds the answer against everything known of the minimiser.
#[track_caller]
fn check(qp: &Qp) {
    let mut forces = vec![0.0; qp.variables()];
    ActiveSet::default().solve(qp, &mut forces).unwrap();
    check_optimal(qp, &forces);
    let error = testing::error_bound(qp, &forces);
    assert!(error < ERROR_N, "{error} N from the minimiser");
    let mut reference = vec![0.0; qp.variables()];
    InteriorPoint.solve(qp, &mut reference).unwrap();
    for (index, (got, expected)) in forces.iter().zip(&reference).enumerate() {
        assert!((got - expected).abs() < REFERENCE_ERROR_N, "force {index} is {got}, expected {expected}");
    }
    let (got, expected) = (qp.cost(&forces), qp.cost(&reference));
    // Of the terms, not of their sum, which may cancel; and at least that of a newton, where no force is best.
    let terms = qp.gradient().iter().zip(&forces).map(|(slope, force)| slope.abs() * force.abs().max(1.0));
    let size: f64 = terms.sum();
    assert!((got - expected).abs() < COST_ERROR * size, "cost {got}, expected {expected}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn in_a_trot(seed in 0_u64..1_000_000, speed in -1.0..2.0_f64) {
        check(&testing::programme(&testing::disturbed(seed), &testing::horizon(&testing::trot(), speed, seed)));
    }

    #[test]
    fn after_a_push(seed in 0_u64..1_000_000, side in 0.0..std::f64::consts::TAU, speed in 0.5..3.0_f64) {
        let mut state = testing::disturbed(seed);
        state.velocity += Vector3::new(side.cos(), side.sin(), 0.0) * speed;
        state.angular_velocity += Vector3::new(-side.sin(), side.cos(), 0.0) * (2.0 * speed);
        check(&testing::programme(&state, &testing::horizon(&testing::trot(), 0.5, seed)));
    }

    #[test]
    fn for_any_stance(
        seed in 0_u64..1_000_000,
        stance in prop::collection::vec(prop::array::uniform4(any::<bool>()), 1..7),
    ) {
        let qp = testing::programme(&testing::disturbed(seed), &testing::horizon(&stance, 0.3, seed));
        if qp.feet() > 0 {
            check(&qp);
        }
    }

    #[test]
    fn for_a_reference_that_no_force_reaches(seed in 0_u64..1_000_000, up in -0.3..0.3_f64, ahead in 3.0..8.0_f64) {
        let mut horizon = testing::horizon(&testing::trot(), 1.0, seed);
        for step in &mut horizon {
            step.reference.position += Vector3::new(0.0, -0.3, up);
            step.reference.velocity.x = ahead;
        }
        check(&testing::programme(&testing::disturbed(seed), &horizon));
    }
}

#[test]
fn on_four_feet() {
    for seed in 0..6 {
        check(&testing::programme(&testing::disturbed(seed), &testing::horizon(&[ALL; 10], 0.0, seed)));
    }
}

#[test]
fn far_off_the_reference() {
    for seed in 0..8 {
        let far = testing::disturbed(seed);
        let state = State {
            position: far.position - Vector3::new(0.0, 0.0, 1.5),
            velocity: far.velocity + Vector3::new(0.0, 8.0, 0.0),
            angles: far.angles + Vector3::new(1.2, 0.0, 0.0),
            ..far
        };
        check(&testing::programme(&state, &testing::horizon(&testing::trot(), 1.0, seed)));
    }
}

#[test]
fn under_random_policies_and_pushes() {
    let config = Config::default();
    for seed in 0..3 {
        let policy = erratic_policy(&config, Seed::from_number(seed));
        let mut condenser = Condenser::new(&config.control.mpc, &testing::body());
        let mut qp = Qp::default();
        for Question { state, horizon } in questions(&config, &policy, 25, 11) {
            condenser.build(&state, &horizon, &mut qp);
            check(&qp);
        }
    }
}
