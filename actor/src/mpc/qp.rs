//! The quadratic programme of the controller: minimise ½ uᵀHu + gᵀu over friction pyramids, and who may solve it.
//!
//! | symbol | name                               | unit | shape                                     |
//! |--------|------------------------------------|------|-------------------------------------------|
//! | u      | stance forces, world               | N    | [3 · feet]: x, y, z of one foot after the other |
//! | H      | Hessian, positive definite         | 1/N² | [3 · feet, 3 · feet]                      |
//! | g      | gradient at u = 0                  | 1/N  | [3 · feet]                                |
//! | μ      | friction of the pyramid            | –    | scalar                                    |
//!
//! Every foot has the same five rows: ±u_x − μ u_z ≤ 0, ±u_y − μ u_z ≤ 0 and u_z ≤ limit; u_z ≥ 0 follows from them.
//! So u = 0 is always feasible and no row has more than two coefficients.

/// Numbers that H's rows are padded to a multiple of, for loops without a remainder.
pub(super) const LANES: usize = 4;

/// One inequality: Σ coefficient · u ≤ bound over the variables that `terms` names.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Row {
    /// Indices into u and their coefficients; a second coefficient of zero means one variable only.
    pub terms: [(usize, f64); 2],
    /// Right-hand side, N.
    pub bound: f64,
}

impl Row {
    /// How far u is beyond the bound, N; negative inside.
    pub fn violation(&self, forces: &[f64]) -> f64 {
        let [(a, ca), (b, cb)] = self.terms;
        ca * forces[a] + cb * forces[b] - self.bound
    }
}

/// One programme; its buffers are reused from solve to solve.
#[derive(Clone, Debug, Default)]
pub struct Qp {
    feet: usize,
    stride: usize,
    /// Rows of H, `stride` apart. Entries in the diagonal block of a foot and right of it are valid, those left of
    /// it are not.
    pub(super) hessian: Vec<f64>,
    /// g, padded with zeros to `stride`.
    pub(super) gradient: Vec<f64>,
    /// μ.
    pub(super) friction: f64,
    /// Largest u_z, N.
    pub(super) force_max_n: f64,
}

impl Qp {
    /// Rows of one foot.
    pub const ROWS_PER_FOOT: usize = 5;

    /// Makes room for `feet` feet; all entries are zero when the size changes and stale otherwise.
    pub(super) fn resize(&mut self, feet: usize) {
        if feet == self.feet && !self.hessian.is_empty() {
            return;
        }
        self.feet = feet;
        self.stride = (3 * feet).next_multiple_of(LANES);
        self.hessian.clear();
        self.hessian.resize(3 * feet * self.stride, 0.0);
        self.gradient.clear();
        self.gradient.resize(self.stride, 0.0);
    }

    /// Feet in stance, summed over the horizon.
    pub fn feet(&self) -> usize {
        self.feet
    }

    /// Numbers in u.
    pub fn variables(&self) -> usize {
        3 * self.feet
    }

    /// Numbers from one row of H to the next.
    pub fn stride(&self) -> usize {
        self.stride
    }

    /// H[i, j].
    pub fn hessian(&self, i: usize, j: usize) -> f64 {
        self.hessian[i.min(j) * self.stride + i.max(j)]
    }

    /// g.
    pub fn gradient(&self) -> &[f64] {
        &self.gradient[..self.variables()]
    }

    /// Number of inequalities.
    pub fn rows(&self) -> usize {
        Self::ROWS_PER_FOOT * self.feet
    }

    /// The inequality `index` below `rows()`.
    pub fn row(&self, index: usize) -> Row {
        let x = index / Self::ROWS_PER_FOOT * 3;
        let z = x + 2;
        match index % Self::ROWS_PER_FOOT {
            0 => Row { terms: [(x, 1.0), (z, -self.friction)], bound: 0.0 },
            1 => Row { terms: [(x, -1.0), (z, -self.friction)], bound: 0.0 },
            2 => Row { terms: [(x + 1, 1.0), (z, -self.friction)], bound: 0.0 },
            3 => Row { terms: [(x + 1, -1.0), (z, -self.friction)], bound: 0.0 },
            _ => Row { terms: [(z, 1.0), (z, 0.0)], bound: self.force_max_n },
        }
    }

    /// The largest violation among the rows of one foot with this force, N.
    #[inline]
    pub(super) fn worst_violation(&self, force: &[f64; 3]) -> f64 {
        let [x, y, z] = *force;
        (x.abs().max(y.abs()) - self.friction * z).max(z - self.force_max_n)
    }

    /// ½ uᵀHu + gᵀu.
    pub fn cost(&self, forces: &[f64]) -> f64 {
        (0..self.variables())
            .map(|i| {
                let row: f64 = (0..self.variables()).map(|j| self.hessian(i, j) * forces[j]).sum();
                forces[i] * (row / 2.0 + self.gradient[i])
            })
            .sum()
    }
}

/// Why a solver has no answer.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum GaveUp {
    /// H has a direction without curvature, or is not finite.
    #[error("Hessian: pivot {index} is {pivot:e}, expected a positive number")]
    NotConvex {
        /// Which pivot of the Cholesky factor.
        index: usize,
        /// Its square.
        pivot: f64,
    },
    /// A row contradicts the others as far as rounding can tell.
    #[error("row {row} cannot be met together with the {working} rows held")]
    Inconsistent {
        /// Which row.
        row: usize,
        /// Rows in the working set.
        working: usize,
    },
    /// The bound on iterations was reached.
    #[error("not solved after {iterations} iterations")]
    Iterations {
        /// How many were allowed.
        iterations: usize,
    },
    /// Numbers overflowed on the way.
    #[error("force {index} of the answer is not finite")]
    NotFinite {
        /// The first such force.
        index: usize,
    },
    /// The interior-point solver ended in another way.
    #[error("interior-point solver ended as {status}, expected Solved")]
    InteriorPoint {
        /// Its own word.
        status: &'static str,
    },
}

/// Refuses an answer with numbers that are not finite.
pub(super) fn check_finite(forces: &[f64]) -> Result<(), GaveUp> {
    match forces.iter().position(|force| !force.is_finite()) {
        Some(index) => Err(GaveUp::NotFinite { index }),
        None => Ok(()),
    }
}

/// Anything that solves a `Qp`: a pure function of the programme, bounded by iterations and never by a clock.
pub trait QpSolver {
    /// Writes the minimiser, finite, to `forces` (length `qp.variables()`) and returns the iterations taken.
    fn solve(&mut self, qp: &Qp, forces: &mut [f64]) -> Result<u32, GaveUp>;
}
