//! The matrix product, in place on candle tensors: C ← A B.
//!
//! | symbol | name | shape |
//! |---|---|---|
//! | A | left factor, any strides | `[m, k]` |
//! | B | right factor, any strides | `[k, n]` |
//! | C | result, contiguous | `[m, n]` |
//!
//! candle's own product asks the operating system for the number of processors each time and fills fresh memory; on
//! networks of this size the two cost as much as the arithmetic. Here every number of C is one chain of fused
//! multiply-adds in the order of k, on the calling thread: the bits depend neither on the width of the registers nor on
//! the size of the caches.

use super::kernels::{slice, slice_mut};
use candle_core::{CpuStorage, InplaceOp3, Layout, Result, Tensor, bail};
use pulp::{Simd, WithSimd};

/// `c ← a · b`.
pub(super) fn product(c: &Tensor, a: &Tensor, b: &Tensor) -> Result<()> {
    c.inplace_op3(a, b, &Product)
}

struct Product;

impl InplaceOp3 for Product {
    fn name(&self) -> &'static str {
        "product"
    }

    fn cpu_fwd(
        &self,
        c: &mut CpuStorage,
        c_at: &Layout,
        a: &CpuStorage,
        a_at: &Layout,
        b: &CpuStorage,
        b_at: &Layout,
    ) -> Result<()> {
        let (a, b) = (Matrix::new(a, a_at)?, Matrix::new(b, b_at)?);
        let (m, n) = c_at.shape().dims2()?;
        if a.rows != m || b.columns != n || a.columns != b.rows {
            bail!("product of {:?} and {:?} into {:?}", a_at.shape(), b_at.shape(), c_at.shape());
        }
        let c = slice_mut(c, c_at)?;
        let transposed;
        let b = if b.column_stride == 1 {
            b
        } else {
            transposed = b.row_major();
            Matrix { numbers: &transposed, row_stride: n, column_stride: 1, ..b }
        };
        pulp::Arch::new().dispatch(Multiply { c, a, b });
        Ok(())
    }
}

/// A strided view of numbers.
#[derive(Clone, Copy)]
struct Matrix<'a> {
    numbers: &'a [f32],
    rows: usize,
    columns: usize,
    row_stride: usize,
    column_stride: usize,
}

impl<'a> Matrix<'a> {
    fn new(storage: &'a CpuStorage, layout: &Layout) -> Result<Self> {
        let CpuStorage::F32(numbers) = storage else { bail!("a factor that is not f32") };
        let (rows, columns) = layout.shape().dims2()?;
        let &[row_stride, column_stride] = layout.stride() else { bail!("a factor that is not a matrix") };
        Ok(Self { numbers: &numbers[layout.start_offset()..], rows, columns, row_stride, column_stride })
    }

    /// A copy with adjacent columns, made in blocks whose lines of cache are used whole on both sides.
    fn row_major(&self) -> Vec<f32> {
        let mut copy = vec![0.0; self.rows * self.columns];
        for (i, rows) in copy.chunks_mut(BLOCK * self.columns).enumerate() {
            for first in (0..self.columns).step_by(BLOCK) {
                let block = self.block(i * BLOCK, first);
                for (r, row) in rows.chunks_mut(self.columns).enumerate() {
                    row[first..].iter_mut().zip(&block).for_each(|(x, column)| *x = column[r]);
                }
            }
        }
        copy
    }

    /// The block that starts at (`row`, `column`), column by column, zero beyond the edges.
    fn block(&self, row: usize, column: usize) -> [[f32; BLOCK]; BLOCK] {
        let mut block = [[0.0_f32; BLOCK]; BLOCK];
        let rows = BLOCK.min(self.rows - row);
        for (c, numbers) in block[..BLOCK.min(self.columns - column)].iter_mut().enumerate() {
            let from = &self.numbers[row * self.row_stride + (column + c) * self.column_stride..];
            if self.row_stride == 1 && rows == BLOCK {
                numbers.copy_from_slice(&from[..BLOCK]);
            } else {
                numbers[..rows].iter_mut().zip(from.iter().step_by(self.row_stride)).for_each(|(x, y)| *x = *y);
            }
        }
        block
    }

    /// A copy of the columns from `first` on, each row filled up with zeros to `width`.
    fn padded(&self, first: usize, width: usize) -> Vec<f32> {
        let mut copy = vec![0.0; self.rows * width];
        for (k, row) in copy.chunks_mut(width).enumerate() {
            let numbers = &self.numbers[k * self.row_stride..][first..self.columns];
            row[..numbers.len()].copy_from_slice(numbers);
        }
        copy
    }
}

/// Numbers in a line of cache, by which a matrix is turned over.
const BLOCK: usize = 16;

struct Multiply<'a> {
    c: &'a mut [f32],
    a: Matrix<'a>,
    b: Matrix<'a>,
}

impl WithSimd for Multiply<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        // Tiles that leave registers to spare: 32 of them where a register holds 16 numbers, else 16.
        if S::F32_LANES >= 16 { self.tiled::<S, 8, 2>(simd) } else { self.tiled::<S, 4, 2>(simd) }
    }
}

impl Multiply<'_> {
    /// Works through C in tiles of R rows and V registers. Rows and columns beyond C are zeros that are not stored.
    #[inline(always)]
    fn tiled<S: Simd, const R: usize, const V: usize>(self, simd: S) {
        let Self { c, a, b } = self;
        let (n, wide) = (b.columns, V * S::F32_LANES);
        let full = n / wide * wide;
        let rest = (n - full).next_multiple_of(S::F32_LANES);
        let padded = if rest > 0 { b.padded(full, rest) } else { Vec::new() };
        let padded = Matrix { numbers: &padded, row_stride: rest, ..b };
        let mut panel = vec![[0.0_f32; R]; a.columns];
        for (i, c) in c.chunks_mut(R * n).enumerate() {
            pack(&mut panel, &a, i * R);
            for j in (0..full).step_by(wide) {
                let sums = tile::<S, R, V>(simd, &panel, &b, j);
                for (c, sums) in c.chunks_mut(n).zip(&sums) {
                    S::as_mut_simd_f32s(&mut c[j..j + wide]).0.copy_from_slice(sums);
                }
            }
            for j in (0..rest).step_by(S::F32_LANES) {
                let columns = full + j..n.min(full + j + S::F32_LANES);
                let sums = tile::<S, R, 1>(simd, &panel, &padded, j);
                for (c, [sum]) in c.chunks_mut(n).zip(sums) {
                    simd.partial_store_f32s(&mut c[columns.clone()], sum);
                }
            }
        }
    }
}

/// Rows `first .. first + R` of A, column by column.
#[inline(always)]
fn pack<const R: usize>(panel: &mut [[f32; R]], a: &Matrix<'_>, first: usize) {
    let rows = R.min(a.rows - first);
    if a.row_stride == 1 && rows == R {
        for (k, column) in panel.iter_mut().enumerate() {
            column.copy_from_slice(&a.numbers[k * a.column_stride + first..][..R]);
        }
        return;
    }
    for r in 0..R {
        if r < rows {
            let row = a.numbers[(first + r) * a.row_stride..].iter().step_by(a.column_stride);
            panel.iter_mut().zip(row).for_each(|(column, x)| column[r] = *x);
        } else {
            panel.iter_mut().for_each(|column| column[r] = 0.0);
        }
    }
}

/// R rows by V registers of C, from column `j` on.
#[inline(always)]
fn tile<S: Simd, const R: usize, const V: usize>(
    simd: S,
    panel: &[[f32; R]],
    b: &Matrix<'_>,
    j: usize,
) -> [[S::f32s; V]; R] {
    let mut sums = [[simd.splat_f32s(0.0); V]; R];
    for (k, column) in panel.iter().enumerate() {
        let (row, _) = S::as_simd_f32s(&b.numbers[k * b.row_stride + j..][..V * S::F32_LANES]);
        let row: [S::f32s; V] = *row.first_chunk().expect("V registers of numbers");
        for (sums, x) in sums.iter_mut().zip(column) {
            let x = simd.splat_f32s(*x);
            for (sum, y) in sums.iter_mut().zip(row) {
                *sum = simd.mul_add_f32s(x, y, *sum);
            }
        }
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::super::networks::tests::random;
    use super::*;
    use candle_core::{DType, Device};
    use proptest::prelude::*;

    fn check(m: usize, k: usize, n: usize, flips: (bool, bool)) {
        let factor = |rows, columns, flip: bool, seed| {
            if flip { random((columns, rows), seed).t().unwrap() } else { random((rows, columns), seed) }
        };
        let (a, b) = (factor(m, k, flips.0, 1), factor(k, n, flips.1, 2));
        let c = Tensor::full(f32::NAN, (m, n), &Device::Cpu).unwrap();
        product(&c, &a, &b).unwrap();
        let exact = |t: &Tensor| t.to_dtype(DType::F64).unwrap();
        let expected = exact(&a).matmul(&exact(&b)).unwrap();
        let error = (exact(&c) - expected).unwrap().abs().unwrap().max_all().unwrap().to_scalar::<f64>().unwrap();
        assert!(error < 1e-6 * (1.0 + k as f64), "{m} × {k} × {n} {flips:?}: {error}");
    }

    proptest! {
        #[test]
        fn any_shape_matches_candle(
            m in 1_usize..40, k in 1_usize..70, n in 1_usize..80, flip_a in any::<bool>(), flip_b in any::<bool>(),
        ) {
            check(m, k, n, (flip_a, flip_b));
        }
    }

    #[test]
    fn views_into_larger_tensors() {
        let (a, b) = (random((9, 20), 3), random((30, 12), 4));
        let (a, b) = (a.narrow(0, 2, 5).unwrap().narrow(1, 3, 7).unwrap(), b.narrow(0, 11, 7).unwrap());
        let whole = Tensor::zeros((8, 12), DType::F32, &Device::Cpu).unwrap();
        product(&whole.narrow(0, 2, 5).unwrap(), &a, &b).unwrap();
        let copy = |t: &Tensor| t.contiguous().unwrap();
        let expected = copy(&a).matmul(&copy(&b)).unwrap();
        super::super::networks::tests::assert_close("view", &whole.narrow(0, 2, 5).unwrap(), &expected);
        assert_eq!(whole.narrow(0, 7, 1).unwrap().abs().unwrap().max_all().unwrap().to_scalar::<f32>().unwrap(), 0.0);
    }

    #[test]
    fn registers_do_not_show_in_the_bits() {
        let (a, b) = (random((13, 50), 5), random((50, 37), 6));
        let numbers = |t: &Tensor| t.flatten_all().unwrap().to_vec1::<f32>().unwrap();
        let c = Tensor::zeros((13, 37), DType::F32, &Device::Cpu).unwrap();
        product(&c, &a, &b).unwrap();
        let (a, b) = (numbers(&a), numbers(&b));
        for (at, found) in numbers(&c).iter().enumerate() {
            let (i, j) = (at / 37, at % 37);
            assert_eq!(*found, (0..50).fold(0.0_f32, |sum, k| a[i * 50 + k].mul_add(b[k * 37 + j], sum)));
        }
    }

    #[test]
    fn factors_that_do_not_fit_are_refused() {
        let c = Tensor::zeros((2, 3), DType::F32, &Device::Cpu).unwrap();
        assert!(product(&c, &random((2, 4), 1), &random((5, 3), 2)).is_err());
    }
}
