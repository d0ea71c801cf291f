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
#[inline]
pub(super) fn dot(a: &[Lane], b: &[Lane]) -> f64 {
    let mut sums = [0.0; LANES];
    for (a, b) in a.iter().zip(b) {
        for l in 0..LANES {
            sums[l] += a[l] * b[l];
        }
    }
    sum(sums)
}

/// `y += scale · x`.
#[inline]
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

    /// Factors the matrix of order `n` whose rows, `stride` apart and padded to whole lanes, are valid from the
    /// diagonal on. On failure gives the pivot that is not positive.
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
            let [r0, r1, r2, r3] = quad(&self.rows[block * LANES * self.width..], self.width, block);
            let inverse = &self.inverse_diagonal[block];
            let (head, rest) = b.split_at_mut(block + 1);
            let v = &mut head[block];
            v[0] *= inverse[0];
            v[1] = (v[1] - r0[0][1] * v[0]) * inverse[1];
            v[2] = (v[2] - r0[0][2] * v[0] - r1[0][2] * v[1]) * inverse[2];
            v[3] = (v[3] - r0[0][3] * v[0] - r1[0][3] * v[1] - r2[0][3] * v[2]) * inverse[3];
            subtract_rows(rest, *v, [&r0[1..], &r1[1..], &r2[1..], &r3[1..]]);
        }
    }

    /// Solves U x = b in place.
    pub(super) fn solve(&self, b: &mut [Lane]) {
        for block in (0..self.width).rev() {
            let [r0, r1, r2, r3] = quad(&self.rows[block * LANES * self.width..], self.width, block);
            let inverse = &self.inverse_diagonal[block];
            let (head, rest) = b.split_at_mut(block + 1);
            let [s0, s1, s2, s3] = dot_rows(rest, [&r0[1..], &r1[1..], &r2[1..], &r3[1..]]);
            let x = &mut head[block];
            x[3] = (x[3] - s3) * inverse[3];
            x[2] = (x[2] - s2 - r2[0][3] * x[3]) * inverse[2];
            x[1] = (x[1] - s1 - r1[0][3] * x[3] - r1[0][2] * x[2]) * inverse[1];
            x[0] = (x[0] - s0 - r0[0][3] * x[3] - r0[0][2] * x[2] - r0[0][1] * x[1]) * inverse[0];
        }
    }
}

/// The first four rows, `width` lanes each, from lane `from` on.
#[inline]
fn quad(rows: &[Lane], width: usize, from: usize) -> [&[Lane]; 4] {
    let (r0, rows) = rows.split_at(width);
    let (r1, rows) = rows.split_at(width);
    let (r2, rows) = rows.split_at(width);
    [&r0[from..], &r1[from..], &r2[from..], &rows[from..width]]
}

/// `y −= Σ scale · row` over four rows as long as y.
#[inline]
fn subtract_rows(y: &mut [Lane], scale: Lane, rows: [&[Lane]; 4]) {
    let n = y.len();
    let (r0, r1, r2, r3) = (&rows[0][..n], &rows[1][..n], &rows[2][..n], &rows[3][..n]);
    for j in 0..n {
        for l in 0..LANES {
            y[j][l] -= (scale[0] * r0[j][l] + scale[1] * r1[j][l]) + (scale[2] * r2[j][l] + scale[3] * r3[j][l]);
        }
    }
}

/// The inner products of x with four rows as long as x.
#[inline]
fn dot_rows(x: &[Lane], rows: [&[Lane]; 4]) -> Lane {
    let n = x.len();
    let (r0, r1, r2, r3) = (&rows[0][..n], &rows[1][..n], &rows[2][..n], &rows[3][..n]);
    let (mut s0, mut s1, mut s2, mut s3) = ([0.0; LANES], [0.0; LANES], [0.0; LANES], [0.0; LANES]);
    for j in 0..n {
        for l in 0..LANES {
            s0[l] += r0[j][l] * x[j][l];
            s1[l] += r1[j][l] * x[j][l];
            s2[l] += r2[j][l] * x[j][l];
            s3[l] += r3[j][l] * x[j][l];
        }
    }
    [sum(s0), sum(s1), sum(s2), sum(s3)]
}

#[inline]
fn sum(lane: Lane) -> f64 {
    (lane[0] + lane[1]) + (lane[2] + lane[3])
}

/// Factors four rows that nothing is left to be subtracted from; gives the inverse pivots.
fn factor_panel(panel: &mut [Lane], block: usize, width: usize) -> Result<Lane, (usize, f64)> {
    let (r0, rest) = panel.split_at_mut(width);
    let (r1, rest) = rest.split_at_mut(width);
    let (r2, r3) = rest.split_at_mut(width);
    let (r0, r1, r2, r3) = (&mut r0[block..], &mut r1[block..], &mut r2[block..], &mut r3[block..]);
    let mut corner = [r0[0], r1[0], r2[0], r3[0]];
    let inverse = factor_corner(&mut corner)?;
    let [u0, u1, u2, u3] = corner;
    (r0[0], r1[0], r2[0], r3[0]) = (u0, u1, u2, u3);
    let n = r0.len();
    let (r1, r2, r3) = (&mut r1[..n], &mut r2[..n], &mut r3[..n]);
    for j in 1..n {
        for l in 0..LANES {
            r0[j][l] *= inverse[0];
            r1[j][l] = (r1[j][l] - u0[1] * r0[j][l]) * inverse[1];
            r2[j][l] = (r2[j][l] - u0[2] * r0[j][l] - u1[2] * r1[j][l]) * inverse[2];
            r3[j][l] = (r3[j][l] - u0[3] * r0[j][l] - u1[3] * r1[j][l] - u2[3] * r2[j][l]) * inverse[3];
        }
    }
    Ok(inverse)
}

/// Factors a matrix of order four in place, with zeros below the diagonal; gives the inverse pivots.
#[inline]
fn factor_corner(corner: &mut [Lane; LANES]) -> Result<Lane, (usize, f64)> {
    let mut inverse = [0.0; LANES];
    for p in 0..LANES {
        let (above, rows) = corner.split_at_mut(p);
        let row = &mut rows[0];
        for done in above {
            let scale = done[p];
            for (value, done) in row[p..].iter_mut().zip(&done[p..]) {
                *value -= scale * done;
            }
        }
        let pivot = row[p];
        // The negation also catches NaN; the upper bound an overflow.
        if !(pivot > 0.0 && pivot < f64::MAX) {
            return Err((p, pivot));
        }
        let root = pivot.sqrt();
        inverse[p] = 1.0 / root;
        row[..p].fill(0.0);
        row[p] = root;
        for value in &mut row[p + 1..] {
            *value *= inverse[p];
        }
    }
    Ok(inverse)
}

/// Subtracts what the four rows of `panel` contribute to the four rows of block `at`.
fn subtract_outer(rows: &mut [Lane], panel: &[Lane], at: usize, width: usize) {
    let [p0, p1, p2, p3] = quad(panel, width, at);
    for (r, row) in rows.chunks_exact_mut(width).enumerate() {
        subtract_rows(&mut row[at..], [p0[0][r], p1[0][r], p2[0][r], p3[0][r]], [p0, p1, p2, p3]);
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
