//! Cholesky factor of a dense matrix and the two triangular solves, in loops that compilers turn into vector code.
//!
//! | symbol | name                          | shape                            |
//! |--------|-------------------------------|----------------------------------|
//! | H      | symmetric, positive definite  | [n, n]                           |
//! | U      | upper triangular, H = UᵀU     | n padded to whole lanes, with an identity in the padding |
//!
//! Rows are cut into lanes of four numbers and worked on four at a time, so that no loop has a remainder. Every sum has
//! one order, whatever the width of the machine's vectors, and no products are fused: the bits are the same everywhere.

use super::super::qp::LANES;

/// Four neighbouring numbers of a row.
pub(super) type Lane = [f64; LANES];

/// The inner product, summed lane-wise with one order of additions.
pub(super) fn dot(a: &[Lane], b: &[Lane]) -> f64 {
    let mut sums = [0.0; LANES];
    for (a, b) in a.iter().zip(b) {
        for l in 0..LANES {
            sums[l] += a[l] * b[l];
        }
    }
    (sums[0] + sums[1]) + (sums[2] + sums[3])
}

/// `y += scale · x`.
pub(super) fn add_scaled(y: &mut [Lane], scale: f64, x: &[Lane]) {
    for (y, x) in y.iter_mut().zip(x) {
        for l in 0..LANES {
            y[l] += scale * x[l];
        }
    }
}

/// U, with room for the largest matrix seen.
#[derive(Debug, Default)]
pub(super) struct Cholesky {
    /// Lanes of one row, which is also the number of blocks of four rows.
    width: usize,
    rows: Vec<Lane>,
    /// 1 / U[i, i].
    inverse_diagonal: Vec<Lane>,
}

impl Cholesky {
    /// Lanes of one vector.
    pub(super) fn width(&self) -> usize {
        self.width
    }

    /// Factors the matrix of order `n` whose rows, `stride` apart and padded to whole lanes, are valid from the diagonal
    /// on. On failure gives the pivot that is not positive.
    pub(super) fn factor(&mut self, matrix: &[f64], n: usize, stride: usize) -> Result<(), (usize, f64)> {
        self.load(matrix, n, stride);
        for block in 0..self.width {
            let (panel, trailing) = self.rows[block * LANES * self.width..].split_at_mut(LANES * self.width);
            let pivots = factor_panel(panel, block, self.width).map_err(|(row, pivot)| (block * LANES + row, pivot))?;
            self.inverse_diagonal[block] = pivots;
            for (below, rows) in trailing.chunks_exact_mut(LANES * self.width).enumerate() {
                subtract_outer(rows, panel, block + 1 + below, self.width);
            }
        }
        Ok(())
    }

    /// Copies the upper triangle and clears the rest of its lanes.
    fn load(&mut self, matrix: &[f64], n: usize, stride: usize) {
        self.width = stride / LANES;
        self.rows.resize(stride * self.width, [0.0; LANES]);
        self.inverse_diagonal.resize(self.width, [0.0; LANES]);
        for i in 0..stride {
            let row = &mut self.rows[i * self.width..][..self.width];
            let block = i / LANES;
            if i < n {
                let (source, _) = matrix[i * stride..][..stride].as_chunks::<LANES>();
                row[block..].copy_from_slice(&source[block..]);
            } else {
                row[block..].fill([0.0; LANES]);
                row[block][i % LANES] = 1.0;
            }
        }
    }

    /// Solves Uᵀ v = b in place; lanes of b before `first` are zero and stay so.
    pub(super) fn solve_transposed(&self, b: &mut [Lane], first: usize) {
        for block in first..self.width {
            let rows = self.block(block);
            let (head, rest) = b.split_at_mut(block + 1);
            let v = &mut head[block];
            let inverse = &self.inverse_diagonal[block];
            for p in 0..LANES {
                for q in 0..p {
                    v[p] -= rows[q][block][p] * v[q];
                }
                v[p] *= inverse[p];
            }
            let tails = rows.map(|row| &row[block + 1..]);
            for (j, y) in rest.iter_mut().enumerate() {
                for l in 0..LANES {
                    y[l] -= (v[0] * tails[0][j][l] + v[1] * tails[1][j][l])
                        + (v[2] * tails[2][j][l] + v[3] * tails[3][j][l]);
                }
            }
        }
    }

    /// Solves U x = b in place.
    pub(super) fn solve(&self, b: &mut [Lane]) {
        for block in (0..self.width).rev() {
            let rows = self.block(block);
            let (head, rest) = b.split_at_mut(block + 1);
            let x = &mut head[block];
            let mut sums = [[0.0; LANES]; LANES];
            let tails = rows.map(|row| &row[block + 1..]);
            for (j, known) in rest.iter().enumerate() {
                for p in 0..LANES {
                    for l in 0..LANES {
                        sums[p][l] += tails[p][j][l] * known[l];
                    }
                }
            }
            let inverse = &self.inverse_diagonal[block];
            for p in (0..LANES).rev() {
                x[p] -= (sums[p][0] + sums[p][1]) + (sums[p][2] + sums[p][3]);
                for q in p + 1..LANES {
                    x[p] -= rows[p][block][q] * x[q];
                }
                x[p] *= inverse[p];
            }
        }
    }

    /// The four rows of a block.
    fn block(&self, block: usize) -> [&[Lane]; LANES] {
        let rows = &self.rows[block * LANES * self.width..][..LANES * self.width];
        std::array::from_fn(|p| &rows[p * self.width..][..self.width])
    }
}

/// Factors four rows that nothing is left to be subtracted from; gives the inverse pivots.
fn factor_panel(panel: &mut [Lane], block: usize, width: usize) -> Result<Lane, (usize, f64)> {
    let mut inverse = [0.0; LANES];
    let mut corner: [Lane; LANES] = std::array::from_fn(|p| panel[p * width + block]);
    for p in 0..LANES {
        let (above, row) = corner.split_at_mut(p);
        for q in above {
            let scale = q[p];
            for l in p..LANES {
                row[0][l] -= scale * q[l];
            }
        }
        let pivot = row[0][p];
        // The negation also catches NaN; the upper bound an overflow.
        if !(pivot > 0.0 && pivot < f64::MAX) {
            return Err((p, pivot));
        }
        let root = pivot.sqrt();
        inverse[p] = 1.0 / root;
        row[0][p] = root;
        for value in &mut row[0][p + 1..] {
            *value *= inverse[p];
        }
    }
    for (p, row) in corner.iter_mut().enumerate() {
        row[..p].fill(0.0);
        panel[p * width + block] = *row;
    }
    let (r0, rest) = panel.split_at_mut(width);
    let (r1, rest) = rest.split_at_mut(width);
    let (r2, r3) = rest.split_at_mut(width);
    let tails =
        r0[block + 1..].iter_mut().zip(&mut r1[block + 1..]).zip(&mut r2[block + 1..]).zip(&mut r3[block + 1..]);
    for (((x0, x1), x2), x3) in tails {
        for l in 0..LANES {
            x0[l] *= inverse[0];
            x1[l] = (x1[l] - corner[0][1] * x0[l]) * inverse[1];
            x2[l] = (x2[l] - corner[0][2] * x0[l] - corner[1][2] * x1[l]) * inverse[2];
            x3[l] = (x3[l] - corner[0][3] * x0[l] - corner[1][3] * x1[l] - corner[2][3] * x2[l]) * inverse[3];
        }
    }
    Ok(inverse)
}

/// Subtracts what the four rows of `panel` contribute to the four rows of block `at`.
fn subtract_outer(rows: &mut [Lane], panel: &[Lane], at: usize, width: usize) {
    let panel: [&[Lane]; LANES] = std::array::from_fn(|p| &panel[p * width + at..][..width - at]);
    for (r, row) in rows.chunks_exact_mut(width).enumerate() {
        let scales = panel.map(|row| row[0][r]);
        for (j, y) in row[at..].iter_mut().enumerate() {
            for l in 0..LANES {
                y[l] -= (scales[0] * panel[0][j][l] + scales[1] * panel[1][j][l])
                    + (scales[2] * panel[2][j][l] + scales[3] * panel[3][j][l]);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{DMatrix, DVector};
    use proptest::prelude::*;

    fn lanes(values: &[f64]) -> Vec<Lane> {
        let mut padded = values.to_vec();
        padded.resize(values.len().next_multiple_of(LANES), 0.0);
        padded.as_chunks::<LANES>().0.to_vec()
    }

    proptest! {
        #[test]
        fn solves_agree_with_nalgebra(n in 1_usize..40, entries in prop::collection::vec(-1.0..1.0_f64, 41 * 40)) {
            let root = DMatrix::from_fn(n, n, |i, j| entries[i * 40 + j]);
            let matrix = root.transpose() * root + DMatrix::identity(n, n) * 0.1;
            let stride = n.next_multiple_of(LANES);
            let mut flat = vec![0.0; n * stride];
            for i in 0..n {
                for j in 0..n {
                    // What lies below the diagonal must not matter.
                    flat[i * stride + j] = if j < i { f64::NAN } else { matrix[(i, j)] };
                }
            }
            let right = DVector::from_fn(n, |i, _| entries[1600 + i]);
            let mut cholesky = Cholesky::default();
            cholesky.factor(&flat, n, stride).unwrap();
            let mut x = lanes(right.as_slice());
            cholesky.solve_transposed(&mut x, 0);
            let upper = matrix.clone().cholesky().unwrap().l().transpose();
            let half = upper.transpose().solve_lower_triangular(&right).unwrap();
            prop_assert!((DVector::from_row_slice(&x.as_flattened()[..n]) - &half).norm() < 1e-9 * (1.0 + half.norm()));
            cholesky.solve(&mut x);
            let solution = DVector::from_row_slice(&x.as_flattened()[..n]);
            prop_assert!((&matrix * solution - right).norm() < 1e-10);
        }
    }

    #[test]
    fn a_matrix_without_curvature_is_named() {
        let mut cholesky = Cholesky::default();
        let flat = [1.0, 2.0, 0.0, 0.0, f64::NAN, 4.0, 0.0, 0.0];
        assert_eq!(cholesky.factor(&flat, 2, 4), Err((1, 0.0)));
        let (index, pivot) = cholesky.factor(&[f64::NAN, 0.0, 0.0, 0.0], 1, 4).unwrap_err();
        assert!(index == 0 && pivot.is_nan());
    }

    #[test]
    fn vectors_are_summed_over_all_lanes() {
        let (a, b) = (lanes(&[1.0, 2.0, 3.0, 4.0, 5.0]), lanes(&[1.0, -1.0, 1.0, -1.0, 2.0]));
        assert_eq!(dot(&a, &b), 8.0);
        let mut y = a.clone();
        add_scaled(&mut y, 2.0, &b);
        assert_eq!(y.as_flattened()[..5], [3.0, 0.0, 5.0, 2.0, 9.0]);
    }
}
