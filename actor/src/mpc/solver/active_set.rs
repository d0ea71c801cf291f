//! Dual active-set method for the controller's programme: exact after a few steps when few rows bind.
//!
//! | symbol | name                                                  | unit |
//! |--------|-------------------------------------------------------|------|
//! | y      | U u, with H = UᵀU                                     | –    |
//! | a, s   | the row most violated, and by how much                | N    |
//! | v, z   | U⁻ᵀ a, and what of it is orthogonal to the rows held  | –    |
//! | λ      | multipliers                                           | –    |
//!
//! It starts at the minimiser without rows and takes in one violated row at a time: u moves along −H⁻¹(a − rows held)
//! until the row is met or a multiplier becomes zero, whose row is then let go. Every whole step raises the dual
//! cost, so no set of rows comes back. Source: Goldfarb & Idnani 1983, with the working set kept as V and the Cholesky
//! factor of VᵀV instead of an orthonormal basis of the whole space: a programme of 60 forces with 10 rows binding
//! then costs a factorisation, and two triangular solves per row.

use super::super::qp::{GaveUp, LANES, Qp, QpSolver, check_finite};
use super::triangular::{Cholesky, Lane, add_scaled, dot};
use super::working_set::{Split, WorkingSet};
use herd_common::caps;

/// A row is met when it is violated by less than this share of the largest force allowed.
const TOLERANCE: f64 = 1e-12;
/// A row depends on those held when less than this share of its squared v is orthogonal to them.
const DEPENDENT: f64 = 1e-12;

/// See the module; keeps its buffers, and nothing of one programme for the next.
#[derive(Debug, Default)]
pub struct ActiveSet {
    cholesky: Cholesky,
    working: WorkingSet,
    split: Split,
    y: Vec<Lane>,
    u: Vec<Lane>,
    v: Vec<Lane>,
}

/// The row that is taken in next.
#[derive(Clone, Copy)]
struct Candidate {
    row: usize,
    violation: f64,
}

impl QpSolver for ActiveSet {
    fn solve(&mut self, qp: &Qp, forces: &mut [f64]) -> Result<u32, GaveUp> {
        assert_eq!(forces.len(), qp.variables(), "one force per variable");
        self.cholesky
            .factor(&qp.hessian, qp.variables(), qp.stride())
            .map_err(|(index, pivot)| GaveUp::NotConvex { index, pivot })?;
        self.working.reset(self.cholesky.width(), qp.rows());
        self.start(qp);
        let mut iterations = 0;
        while let Some(candidate) = self.most_violated(qp) {
            self.take_in(qp, candidate, &mut iterations)?;
        }
        forces.copy_from_slice(&self.u.as_flattened()[..forces.len()]);
        check_finite(forces)?;
        Ok(iterations)
    }
}

impl ActiveSet {
    /// Puts y and u at the minimiser without rows.
    fn start(&mut self, qp: &Qp) {
        self.y.clear();
        let (gradient, _) = qp.gradient.as_chunks::<LANES>();
        self.y.extend(gradient.iter().map(|lane| lane.map(|value| -value)));
        self.cholesky.solve_transposed(&mut self.y, 0);
        self.recover();
    }

    /// u from y.
    fn recover(&mut self) {
        self.u.clone_from(&self.y);
        self.cholesky.solve(&mut self.u);
    }

    /// The row not held that is violated most, if any is by more than rounding.
    fn most_violated(&self, qp: &Qp) -> Option<Candidate> {
        let forces = &self.u.as_flattened()[..qp.variables()];
        let mut limit = TOLERANCE * qp.force_max_n;
        let mut worst = None;
        for (foot, force) in forces.as_chunks::<3>().0.iter().enumerate() {
            // Most feet are inside: look at rows one by one only where one of them can win.
            if qp.worst_violation(force) > limit {
                for row in foot * Qp::ROWS_PER_FOOT..(foot + 1) * Qp::ROWS_PER_FOOT {
                    let violation = qp.row(row).violation(forces);
                    if violation > limit && !self.working.holds(row) {
                        limit = violation;
                        worst = Some(Candidate { row, violation });
                    }
                }
            }
        }
        worst
    }

    /// Moves until `candidate` is met, letting rows go on the way.
    fn take_in(&mut self, qp: &Qp, candidate: Candidate, iterations: &mut u32) -> Result<(), GaveUp> {
        let Candidate { row, mut violation } = candidate;
        let first = self.aim(qp, row);
        let length_squared = dot(&self.v, &self.v);
        let mut multiplier = 0.0;
        loop {
            if *iterations as usize >= caps::QP_ITERATIONS {
                return Err(GaveUp::Iterations { iterations: caps::QP_ITERATIONS });
            }
            *iterations += 1;
            self.working.project(&self.v, first, &mut self.split);
            let rest_squared = dot(&self.split.rest, &self.split.rest);
            let free = rest_squared > DEPENDENT * length_squared;
            let whole = if free { violation / rest_squared } else { f64::INFINITY };
            let blocking = self.working.blocking(&self.split.reply);
            let step = blocking.as_ref().map_or(whole, |blocking| blocking.step.min(whole));
            if !step.is_finite() {
                return Err(GaveUp::Inconsistent { row, working: self.working.len() });
            }
            multiplier += step;
            self.working.advance(step, &self.split.reply);
            if free {
                add_scaled(&mut self.y, -step, &self.split.rest);
                violation -= step * rest_squared;
            }
            match blocking {
                Some(blocking) if blocking.step < whole => self.working.drop_at(blocking.index),
                _ => {
                    let (v, half) = ((self.v.as_slice(), first), self.split.half.as_slice());
                    self.working.add(row, multiplier, v, half, rest_squared.sqrt());
                    self.recover();
                    return Ok(());
                }
            }
        }
    }

    /// Puts v = U⁻ᵀ a of a row; returns its first lane that may differ from zero.
    fn aim(&mut self, qp: &Qp, row: usize) -> usize {
        self.v.clear();
        self.v.resize(self.cholesky.width(), [0.0; LANES]);
        let flat = self.v.as_flattened_mut();
        let terms = qp.row(row).terms;
        for (variable, coefficient) in terms {
            flat[variable] += coefficient;
        }
        let first = terms[0].0.min(terms[1].0) / LANES;
        self.cholesky.solve_transposed(&mut self.v, first);
        first
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::testing::{self, ALL};
    use super::super::InteriorPoint;
    use super::*;

    #[test]
    fn a_matrix_without_curvature_is_refused() {
        let mut qp = testing::programme(&testing::disturbed(1), &testing::horizon(&testing::trot(), 0.3, 1));
        qp.hessian.fill(0.0);
        let mut forces = vec![0.0; qp.variables()];
        let given_up = ActiveSet::default().solve(&qp, &mut forces).unwrap_err();
        assert_eq!(given_up, GaveUp::NotConvex { index: 0, pivot: 0.0 });
        assert!(matches!(InteriorPoint.solve(&qp, &mut forces), Err(GaveUp::NotConvex { .. })));
        qp.hessian.fill(f64::NAN);
        assert!(matches!(ActiveSet::default().solve(&qp, &mut forces), Err(GaveUp::NotConvex { .. })));
    }

    #[test]
    fn an_overflow_is_refused() {
        let mut qp = testing::programme(&testing::disturbed(1), &testing::horizon(&testing::trot(), 0.3, 1));
        qp.gradient.fill(1e308);
        let mut forces = vec![0.0; qp.variables()];
        assert!(ActiveSet::default().solve(&qp, &mut forces).is_err());
    }

    #[test]
    fn nothing_is_kept_from_one_programme_to_the_next() {
        let programmes: Vec<Qp> = (0..6)
            .map(|seed| {
                let stance = if seed % 2 == 0 { testing::trot() } else { vec![ALL; 4] };
                testing::programme(&testing::disturbed(seed), &testing::horizon(&stance, 0.5, seed))
            })
            .collect();
        let mut used = ActiveSet::default();
        for qp in &programmes {
            let (mut again, mut fresh) = (vec![0.0; qp.variables()], vec![0.0; qp.variables()]);
            let iterations = used.solve(qp, &mut again).unwrap();
            assert_eq!(ActiveSet::default().solve(qp, &mut fresh).unwrap(), iterations);
            assert_eq!(again, fresh);
        }
    }
}
