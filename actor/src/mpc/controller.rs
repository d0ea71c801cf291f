//! From a state and a horizon to the forces of the first step, with a second solver behind the first.
//!
//! A solve is a pure function of its arguments: nothing but buffers is kept from one to the next, so episodes can share
//! a controller and still give the same bits.

use super::condense::{Condenser, Step};
use super::model::{Body, GRAVITY, State};
use super::qp::{Qp, QpSolver};
use super::solver::{ActiveSet, InteriorPoint};
use herd_common::config::control;
use nalgebra::Vector3;
use std::f64::consts::TAU;

/// Who answered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Status {
    /// The solver that the configuration names.
    Solved,
    /// It gave up; the interior point answered.
    Fallback,
    /// Nobody: the weight is shared evenly by the feet in stance.
    Failed,
}

/// Forces for the time until the next solve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Solution {
    /// Ground on robot, world, N, per leg; zero for legs in swing. Always inside the friction pyramid.
    pub forces: [Vector3<f64>; 4],
    /// See [`Status`].
    pub status: Status,
    /// Iterations of the solver that answered.
    pub iterations: u32,
}

/// The controller.
pub struct Mpc {
    condenser: Condenser,
    primary: Box<dyn QpSolver + Send>,
    /// None when the primary is the interior point already.
    fallback: Option<InteriorPoint>,
    mass_kg: f64,
    friction: f64,
    force_max_n: f64,
    qp: Qp,
    minimiser: Vec<f64>,
}

impl Mpc {
    /// For a body whose mass and inertia are positive.
    pub fn new(config: &control::Mpc, body: Body) -> Self {
        let (primary, fallback): (Box<dyn QpSolver + Send>, _) = match config.solver {
            control::Solver::ActiveSet => (Box::new(ActiveSet::default()), Some(InteriorPoint)),
            control::Solver::Clarabel => (Box::new(InteriorPoint), None),
        };
        Self {
            condenser: Condenser::new(config, &body),
            primary,
            fallback,
            mass_kg: body.mass_kg,
            friction: config.friction,
            force_max_n: config.force_max_n,
            qp: Qp::default(),
            minimiser: Vec::new(),
        }
    }

    /// The forces of the first step of `horizon`, whose yaw may differ from that of `state` by full turns.
    ///
    /// The horizon may have any length; an empty one fails, and one whose first step has no foot in stance is solved
    /// with no force. Numbers that are not finite fail.
    pub fn solve(&mut self, state: &State, horizon: &[Step]) -> Solution {
        let Some(first) = horizon.first() else {
            return Solution { forces: [Vector3::zeros(); 4], status: Status::Failed, iterations: 0 };
        };
        if !is_finite(state, horizon) {
            return self.share_weight(first);
        }
        if first.stance() == 0 {
            return Solution { forces: [Vector3::zeros(); 4], status: Status::Solved, iterations: 0 };
        }
        let mut state = *state;
        state.angles.z += TAU * ((first.reference.angles.z - state.angles.z) / TAU).round();
        self.condenser.build(&state, horizon, &mut self.qp);
        self.minimiser.resize(self.qp.variables(), 0.0);
        if let Ok(iterations) = self.primary.solve(&self.qp, &mut self.minimiser) {
            return self.first_forces(Status::Solved, iterations);
        }
        match self.fallback.as_mut().map(|fallback| fallback.solve(&self.qp, &mut self.minimiser)) {
            Some(Ok(iterations)) => self.first_forces(Status::Fallback, iterations),
            Some(Err(_)) | None => self.share_weight(first),
        }
    }

    /// The first step's part of the minimiser, with what tolerances left outside the pyramid cut off.
    fn first_forces(&self, status: Status, iterations: u32) -> Solution {
        let forces = std::array::from_fn(|leg| {
            self.condenser.first_step_force(leg).map_or_else(Vector3::zeros, |at| {
                let z = self.minimiser[at + 2].clamp(0.0, self.force_max_n);
                let side = self.friction * z;
                Vector3::new(self.minimiser[at].clamp(-side, side), self.minimiser[at + 1].clamp(-side, side), z)
            })
        });
        Solution { forces, status, iterations }
    }

    fn share_weight(&self, first: &Step) -> Solution {
        let share = -GRAVITY * self.mass_kg / first.stance().max(1) as f64;
        let forces = first.feet.map(|foot| foot.map_or_else(Vector3::zeros, |_| share));
        Solution { forces, status: Status::Failed, iterations: 0 }
    }
}

fn is_finite(state: &State, horizon: &[Step]) -> bool {
    let foot_is_finite = |foot: &Vector3<f64>| foot.iter().all(|value| value.is_finite());
    state.is_finite()
        && horizon.iter().all(|step| step.reference.is_finite() && step.feet.iter().flatten().all(foot_is_finite))
}

#[cfg(test)]
mod tests {
    use super::super::testing::{self, ALL};
    use super::*;
    use proptest::prelude::*;

    fn solve(solver: control::Solver, state: &State, horizon: &[Step]) -> Solution {
        let config = control::Mpc { solver, ..testing::config() };
        Mpc::new(&config, testing::body()).solve(state, horizon)
    }

    #[track_caller]
    fn check(state: &State, stance: &[[bool; 4]], seed: u64) {
        let horizon = testing::horizon(stance, 0.5, seed);
        let solution = solve(control::Solver::ActiveSet, state, &horizon);
        assert_eq!(solution.status, Status::Solved);
        for (leg, force) in solution.forces.iter().enumerate() {
            if stance[0][leg] {
                let side = testing::config().friction * force.z;
                assert!(force.z >= 0.0 && force.z <= testing::config().force_max_n, "{force}");
                assert!(force.x.abs() <= side && force.y.abs() <= side, "{force}");
            } else {
                assert_eq!(*force, Vector3::zeros());
            }
        }
        let again = solve(control::Solver::ActiveSet, state, &horizon);
        assert_eq!(bits(&solution), bits(&again));
    }

    /// A body at rest and a horizon that wants it to stay.
    fn standstill(stance: &[[bool; 4]]) -> (State, Vec<Step>) {
        let rest = State { position: Vector3::new(0.0, 0.0, 0.17), ..State::zero() };
        let horizon = testing::horizon(stance, 0.0, 1);
        (rest, horizon.into_iter().map(|step| Step { reference: rest, ..step }).collect())
    }

    fn bits(solution: &Solution) -> Vec<u64> {
        solution.forces.iter().flat_map(|force| force.iter().map(|value| value.to_bits())).collect()
    }

    proptest! {
        #[test]
        fn forces_stay_in_their_pyramid_and_repeat(
            seed in 0_u64..1_000_000,
            stance in prop::collection::vec(prop::array::uniform4(any::<bool>()), 1..11),
        ) {
            check(&testing::disturbed(seed), &stance, seed);
        }

        #[test]
        fn no_finite_state_makes_it_panic(scale in prop::array::uniform4(-300.0..300.0_f64), seed in 0_u64..100) {
            let mut state = testing::disturbed(seed);
            state.angles *= 10.0_f64.powf(scale[0]);
            state.position *= 10.0_f64.powf(scale[1]);
            state.velocity *= 10.0_f64.powf(scale[2]);
            state.angular_velocity *= 10.0_f64.powf(scale[3]);
            let horizon = testing::horizon(&testing::trot()[..4], 0.5, seed);
            let solution = solve(control::Solver::ActiveSet, &state, &horizon);
            prop_assert!(solution.forces.iter().all(|force| force.iter().all(|value| value.is_finite())));
        }
    }

    #[test]
    fn both_solvers_give_the_same_forces() {
        for seed in 0..4 {
            let (state, horizon) = (testing::disturbed(seed), testing::horizon(&testing::trot(), 0.5, seed));
            let active_set = solve(control::Solver::ActiveSet, &state, &horizon);
            let clarabel = solve(control::Solver::Clarabel, &state, &horizon);
            assert_eq!((active_set.status, clarabel.status), (Status::Solved, Status::Solved));
            for leg in 0..4 {
                let error = (active_set.forces[leg] - clarabel.forces[leg]).norm();
                assert!(error < 1e-3, "leg {leg} differs by {error} N");
            }
        }
    }

    #[test]
    fn standing_carries_the_weight() {
        let (rest, horizon) = standstill(&[ALL; 10]);
        let solution = solve(control::Solver::ActiveSet, &rest, &horizon);
        let total: Vector3<f64> = solution.forces.iter().sum();
        // Not to the newton's last digit: the feet of this stance are not quite below the hips, and a plan turns the body.
        assert!((total + GRAVITY * testing::body().mass_kg).norm() < 1.0, "{total}");
    }

    #[test]
    fn a_robot_pushed_left_is_pushed_right() {
        let (rest, horizon) = standstill(&testing::trot());
        let pushed = State { velocity: Vector3::new(0.0, 0.5, 0.0), ..rest };
        let side = |state: &State| -> f64 {
            solve(control::Solver::ActiveSet, state, &horizon).forces.iter().map(|force| force.y).sum()
        };
        assert!(side(&pushed) < side(&rest) - 1.0);
    }

    #[test]
    fn full_turns_of_yaw_change_nothing() {
        let horizon = testing::horizon(&testing::trot(), 0.5, 2);
        let state = testing::disturbed(2);
        let mut turned = state;
        turned.angles.z += 3.0 * TAU;
        let (straight, turned) =
            (solve(control::Solver::ActiveSet, &state, &horizon), solve(control::Solver::ActiveSet, &turned, &horizon));
        for leg in 0..4 {
            assert!((straight.forces[leg] - turned.forces[leg]).norm() < 1e-9);
        }
    }

    #[test]
    fn without_feet_there_is_no_force() {
        let state = testing::disturbed(1);
        for stance in [vec![[false; 4]; 10], vec![[false; 4], ALL, ALL]] {
            let solution = solve(control::Solver::ActiveSet, &state, &testing::horizon(&stance, 0.5, 1));
            assert_eq!(solution, Solution { forces: [Vector3::zeros(); 4], status: Status::Solved, iterations: 0 });
        }
        assert_eq!(solve(control::Solver::ActiveSet, &state, &[]).status, Status::Failed);
    }

    #[test]
    fn what_is_not_finite_fails_with_the_weight_shared() {
        let good = testing::disturbed(1);
        let horizon = testing::horizon(&testing::trot(), 0.5, 1);
        let share = -GRAVITY * (testing::body().mass_kg / 2.0);
        let check = |state: &State, horizon: &[Step]| {
            let solution = solve(control::Solver::ActiveSet, state, horizon);
            assert_eq!(solution.status, Status::Failed);
            assert_eq!(solution.forces, [share, Vector3::zeros(), Vector3::zeros(), share]);
        };
        for value in [f64::NAN, f64::INFINITY] {
            check(&State { angles: Vector3::new(0.0, value, 0.0), ..good }, &horizon);
            check(&State { velocity: Vector3::new(0.0, value, 0.0), ..good }, &horizon);
            let mut broken = horizon.clone();
            broken[7].reference.position.x = value;
            check(&good, &broken);
            let mut broken = horizon.clone();
            broken[2].feet[0] = Some(Vector3::new(value, 0.0, 0.0));
            check(&good, &broken);
        }
    }

    #[test]
    fn the_fallback_answers_when_the_primary_gives_up() {
        struct Never;
        impl QpSolver for Never {
            fn solve(&mut self, _: &Qp, _: &mut [f64]) -> Result<u32, super::super::GaveUp> {
                Err(super::super::GaveUp::Iterations { iterations: 0 })
            }
        }
        let (state, horizon) = (testing::disturbed(1), testing::horizon(&testing::trot(), 0.5, 1));
        let mut mpc = Mpc::new(&testing::config(), testing::body());
        let expected = mpc.solve(&state, &horizon);
        mpc.primary = Box::new(Never);
        let got = mpc.solve(&state, &horizon);
        assert_eq!(got.status, Status::Fallback);
        assert!((got.forces[0] - expected.forces[0]).norm() < 1e-3);
        mpc.fallback = None;
        assert_eq!(mpc.solve(&state, &horizon).status, Status::Failed);
    }
}
