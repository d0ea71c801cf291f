//! Clarabel's interior point on the controller's programme: slow, but it needs no luck with degenerate rows.
//!
//! The cost is divided by the least curvature that any force has, so that the solver's absolute gap is in N²: the
//! controller's own units make differences of whole newtons look small. Builds a solver per programme, because sizes
//! change with the gait and this path is for reference and for what the active set gives up.

use super::super::qp::{GaveUp, Qp, QpSolver, check_finite};
use ::clarabel::algebra::CscMatrix;
use ::clarabel::solver::{
    DefaultSettings, DefaultSettingsBuilder, DefaultSolver, IPSolver, SolverStatus, SupportedConeT,
};
use herd_common::caps;

/// Gap, N², and feasibility, N, relative to the programme's size, at which clarabel may stop.
const TOLERANCE: f64 = 1e-11;
/// What is still accepted when rounding stops it before that.
const TOLERANCE_REDUCED: f64 = 1e-7;

/// See the module.
#[derive(Debug, Default)]
pub struct InteriorPoint;

impl QpSolver for InteriorPoint {
    fn solve(&mut self, qp: &Qp, forces: &mut [f64]) -> Result<u32, GaveUp> {
        assert_eq!(forces.len(), qp.variables(), "one force per variable");
        let n = qp.variables();
        let scale = scale(qp)?;
        let gradient: Vec<f64> = qp.gradient().iter().map(|value| value * scale).collect();
        let bounds: Vec<f64> = (0..qp.rows()).map(|row| qp.row(row).bound).collect();
        let cones = [SupportedConeT::NonnegativeConeT(qp.rows())];
        let refused = |_| GaveUp::InteriorPoint { status: "refused" };
        let mut solver =
            DefaultSolver::new(&upper_hessian(qp, scale), &gradient, &rows(qp), &bounds, &cones, settings())
                .map_err(refused)?;
        solver.solve();
        match solver.solution.status {
            SolverStatus::Solved | SolverStatus::AlmostSolved => {}
            status => return Err(GaveUp::InteriorPoint { status: name(status) }),
        }
        forces.copy_from_slice(&solver.solution.x[..n]);
        check_finite(forces)?;
        Ok(solver.solution.iterations)
    }
}

fn settings() -> DefaultSettings<f64> {
    DefaultSettingsBuilder::default()
        .verbose(false)
        .max_iter(caps::QP_ITERATIONS as u32)
        .max_threads(1)
        .direct_solve_method("qdldl".to_string())
        .tol_gap_abs(TOLERANCE)
        .tol_gap_rel(TOLERANCE)
        .tol_feas(TOLERANCE)
        .reduced_tol_gap_abs(TOLERANCE_REDUCED)
        .reduced_tol_gap_rel(TOLERANCE_REDUCED)
        .reduced_tol_feas(TOLERANCE_REDUCED)
        .presolve_enable(false)
        .build()
        .expect("every setting is inside its range")
}

/// One over the least curvature on the diagonal.
fn scale(qp: &Qp) -> Result<f64, GaveUp> {
    let mut least = f64::INFINITY;
    for index in 0..qp.variables() {
        let pivot = qp.hessian(index, index);
        if !(pivot > 0.0 && pivot < f64::MAX) {
            return Err(GaveUp::NotConvex { index, pivot });
        }
        least = least.min(pivot);
    }
    Ok(1.0 / least)
}

/// Upper triangle by columns.
fn upper_hessian(qp: &Qp, scale: f64) -> CscMatrix<f64> {
    let n = qp.variables();
    let mut starts = vec![0];
    let (mut indices, mut values) = (Vec::new(), Vec::new());
    for column in 0..n {
        for row in 0..=column {
            indices.push(row);
            values.push(scale * qp.hessian(row, column));
        }
        starts.push(indices.len());
    }
    CscMatrix::new(n, n, starts, indices, values)
}

/// The inequalities by columns: those of one foot touch its three forces only.
fn rows(qp: &Qp) -> CscMatrix<f64> {
    let mut starts = vec![0];
    let (mut indices, mut values) = (Vec::new(), Vec::new());
    for variable in 0..qp.variables() {
        let foot = variable / 3;
        for row in foot * Qp::ROWS_PER_FOOT..(foot + 1) * Qp::ROWS_PER_FOOT {
            let terms = qp.row(row).terms;
            let coefficient: f64 = terms.iter().filter(|(at, _)| *at == variable).map(|(_, value)| value).sum();
            if coefficient != 0.0 {
                indices.push(row);
                values.push(coefficient);
            }
        }
        starts.push(indices.len());
    }
    CscMatrix::new(qp.rows(), qp.variables(), starts, indices, values)
}

fn name(status: SolverStatus) -> &'static str {
    match status {
        SolverStatus::MaxIterations => "MaxIterations",
        SolverStatus::NumericalError => "NumericalError",
        SolverStatus::InsufficientProgress => "InsufficientProgress",
        SolverStatus::PrimalInfeasible | SolverStatus::AlmostPrimalInfeasible => "PrimalInfeasible",
        SolverStatus::DualInfeasible | SolverStatus::AlmostDualInfeasible => "DualInfeasible",
        _ => "Unsolved",
    }
}
