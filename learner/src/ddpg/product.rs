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
//! the size of the caches. Both factors are copied into the order in which they are read, strips of B no deeper than fit
//! the nearest cache; a tile of C stays in registers while a strip lasts.

#![expect(clippy::inline_always, reason = "vector code must be inlined into the function that has the features")]

use super::kernels::slice_mut;
use candle_core::{CpuStorage, InplaceOp3, Layout, Result, Tensor, bail};
use pulp::{Simd, WithSimd};
use std::cell::RefCell;
use std::ops::Range;

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
        SCRATCH.with_borrow_mut(|scratch| pulp::Arch::new().dispatch(Multiply { c, a, b, scratch }));
        Ok(())
    }
}

/// Copies of both factors in the order in which they are read; nothing in it outlives a product.
#[derive(Default)]
struct Scratch {
    panels: Vec<f32>,
    strip: Vec<f32>,
}

thread_local! {
    static SCRATCH: RefCell<Scratch> = RefCell::default();
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

    /// Copies rows `rows` of the columns from `column` on into `strip`, row by row, with zeros beyond the last column.
    #[inline(always)]
    fn copy_strip<const W: usize>(&self, rows: Range<usize>, column: usize, strip: &mut [[f32; W]]) {
        let width = W.min(self.columns - column);
        if self.column_stride == 1 {
            for (k, row) in rows.zip(strip) {
                let numbers = &self.numbers[k * self.row_stride + column..];
                if width == W {
                    *row = *numbers.first_chunk().expect("a whole row of the strip");
                } else {
                    row[..width].copy_from_slice(&numbers[..width]);
                    row[width..].fill(0.0);
                }
            }
            return;
        }
        for (i, strip) in strip.chunks_mut(BLOCK).enumerate() {
            self.turn_block(rows.start + i * BLOCK, column, width, strip);
        }
    }

    /// The rows of one block: read along the columns, which lie adjacent here, so that each line of cache is fetched once.
    #[inline(always)]
    fn turn_block<const W: usize>(&self, row: usize, column: usize, width: usize, strip: &mut [[f32; W]]) {
        let column_at = |c: usize| &self.numbers[row * self.row_stride + (column + c) * self.column_stride..];
        if let (Some(strip), true) =
            (strip.first_chunk_mut::<BLOCK>(), width == W && W >= GROUP && self.row_stride == 1)
        {
            for c in (0..W).step_by(GROUP) {
                let columns: [&[f32; BLOCK]; GROUP] =
                    std::array::from_fn(|i| column_at(c + i).first_chunk().expect("a block of rows"));
                for k in 0..BLOCK {
                    for i in 0..GROUP {
                        strip[k][c + i] = columns[i][k];
                    }
                }
            }
            return;
        }
        if width < W {
            strip.as_flattened_mut().fill(0.0);
        }
        for c in 0..width {
            for (to, from) in strip.iter_mut().zip(column_at(c).iter().step_by(self.row_stride)) {
                to[c] = *from;
            }
        }
    }
}

/// Columns that are turned over together.
const GROUP: usize = 4;
/// Numbers in a line of cache, by which a matrix is turned over.
const BLOCK: usize = 16;
/// Terms of the sums that are added before the next column strip: a strip of B then stays in the nearest cache.
const DEPTH: usize = 256;

struct Multiply<'a> {
    c: &'a mut [f32],
    a: Matrix<'a>,
    b: Matrix<'a>,
    scratch: &'a mut Scratch,
}

impl WithSimd for Multiply<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        // Tiles that leave registers to spare: 32 of them where a register holds 16 numbers, else 16.
        match S::F32_LANES {
            16 => self.tiled::<S, 8, 2, 32>(simd),
            8 => self.tiled::<S, 4, 2, 16>(simd),
            4 => self.tiled::<S, 4, 2, 8>(simd),
            _ => self.tiled::<S, 4, 1, 1>(simd),
        }
    }
}

impl Multiply<'_> {
    /// Works through C in tiles of R rows and V registers, W columns. Rows and columns beyond C are zeros that are not stored.
    ///
    /// Columns outside, rows inside: a strip of B is fetched from far once and then met again in a near cache.
    #[inline(always)]
    fn tiled<S: Simd, const R: usize, const V: usize, const W: usize>(self, simd: S) {
        let Self { c, a, b, scratch } = self;
        let (n, depth) = (b.columns, a.columns);
        // Rows that lie in one piece are read where they are.
        let whole = if a.column_stride == 1 { a.rows / R } else { 0 };
        let panels = blocks::<R>(&mut scratch.panels, depth * (a.rows.div_ceil(R) - whole));
        for (i, panel) in panels.chunks_exact_mut(depth).enumerate() {
            pack(panel, &a, (whole + i) * R);
        }
        let strip = blocks::<W>(&mut scratch.strip, depth.min(DEPTH));
        for j in (0..n).step_by(W) {
            let width = W.min(n - j);
            for k in (0..depth).step_by(DEPTH) {
                let rows = k..depth.min(k + DEPTH);
                let strip = &mut strip[..rows.len()];
                b.copy_strip(rows.clone(), j, strip);
                for first in (0..a.rows).step_by(R) {
                    let at = At { start: first * n + j, stride: n, width, adds: k > 0 };
                    if first / R < whole {
                        let row = |r| &a.numbers[(first + r) * a.row_stride..][rows.clone()];
                        place::<S, R, V, W>(simd, &Rows::<R>(std::array::from_fn(row)), strip, c, at);
                    } else {
                        let panel = &panels[(first / R - whole) * depth..][rows.clone()];
                        place::<S, R, V, W>(simd, &Panel(panel), strip, c, at);
                    }
                }
            }
        }
    }
}

/// R rows of A, wherever they stand.
trait Left {
    /// The number in row `r` and column `k`.
    fn at(&self, k: usize, r: usize) -> f32;
}

/// Rows that are read where they are.
struct Rows<'a, const R: usize>([&'a [f32]; R]);

impl<const R: usize> Left for Rows<'_, R> {
    #[inline(always)]
    fn at(&self, k: usize, r: usize) -> f32 {
        self.0[r][k]
    }
}

/// Rows that were packed column by column.
struct Panel<'a, const R: usize>(&'a [[f32; R]]);

impl<const R: usize> Left for Panel<'_, R> {
    #[inline(always)]
    fn at(&self, k: usize, r: usize) -> f32 {
        self.0[k][r]
    }
}

/// Where a tile stands in C.
#[derive(Clone, Copy)]
struct At {
    start: usize,
    stride: usize,
    /// Columns that are not beyond C.
    width: usize,
    /// True when the sums go on that stand there.
    adds: bool,
}

/// One tile into C. At the edges it is worked out aside.
#[inline(always)]
fn place<S: Simd, const R: usize, const V: usize, const W: usize>(
    simd: S,
    left: &impl Left,
    strip: &[[f32; W]],
    c: &mut [f32],
    at: At,
) {
    let starts = (at.start..c.len()).step_by(at.stride).take(R);
    if at.width == W && starts.len() == R {
        tile::<S, R, V, W>(simd, left, strip, &mut c[at.start..], at);
        return;
    }
    let mut aside = [[0.0_f32; W]; R];
    for (r, start) in starts.clone().enumerate() {
        aside[r][..at.width].copy_from_slice(&c[start..][..at.width]);
    }
    tile::<S, R, V, W>(simd, left, strip, aside.as_flattened_mut(), At { stride: W, ..at });
    for (r, start) in starts.enumerate() {
        c[start..][..at.width].copy_from_slice(&aside[r][..at.width]);
    }
}

/// `count` blocks of N numbers, of any value, out of a buffer that only grows.
fn blocks<const N: usize>(buffer: &mut Vec<f32>, count: usize) -> &mut [[f32; N]] {
    if buffer.len() < N * count {
        buffer.resize(N * count, 0.0);
    }
    &mut buffer.as_chunks_mut().0[..count]
}

/// Rows `first .. first + R` of A, column by column, with zeros beyond the last row.
#[inline(always)]
fn pack<const R: usize>(panel: &mut [[f32; R]], a: &Matrix<'_>, first: usize) {
    let rows = R.min(a.rows - first);
    if rows < R {
        panel.as_flattened_mut().fill(0.0);
        for r in 0..rows {
            let row = a.numbers[(first + r) * a.row_stride..].iter().step_by(a.column_stride);
            panel.iter_mut().zip(row).for_each(|(column, x)| column[r] = *x);
        }
    } else if a.row_stride == 1 {
        for (k, column) in panel.iter_mut().enumerate() {
            *column = *a.numbers[k * a.column_stride + first..].first_chunk().expect("R rows");
        }
    } else {
        let reach = (panel.len() - 1) * a.column_stride + 1;
        let rows: [&[f32]; R] = std::array::from_fn(|r| &a.numbers[(first + r) * a.row_stride..][..reach]);
        for k in 0..panel.len() {
            for r in 0..R {
                panel[k][r] = rows[r][k * a.column_stride];
            }
        }
    }
}

/// A strip's part of R rows of W numbers of C, held in V registers each while it lasts.
#[expect(clippy::needless_range_loop, reason = "iterators are not unrolled, and then the sums are kept in memory")]
#[inline(always)]
fn tile<S: Simd, const R: usize, const V: usize, const W: usize>(
    simd: S,
    left: &impl Left,
    strip: &[[f32; W]],
    c: &mut [f32],
    at: At,
) {
    let mut sums = [[simd.splat_f32s(0.0); V]; R];
    if at.adds {
        for r in 0..R {
            sums[r] = registers::<S, V, W>(c[r * at.stride..].first_chunk().expect("a row of the tile"));
        }
    }
    for k in 0..strip.len() {
        let row = registers::<S, V, W>(&strip[k]);
        for r in 0..R {
            let x = simd.splat_f32s(left.at(k, r));
            for v in 0..V {
                sums[r][v] = simd.mul_add_f32s(x, row[v], sums[r][v]);
            }
        }
    }
    for r in 0..R {
        let (to, _) = S::as_mut_simd_f32s(&mut c[r * at.stride..][..W]);
        *to.first_chunk_mut().expect("W numbers are V registers") = sums[r];
    }
}

#[inline(always)]
fn registers<S: Simd, const V: usize, const W: usize>(numbers: &[f32; W]) -> [S::f32s; V] {
    let (numbers, _) = S::as_simd_f32s(numbers);
    *numbers.first_chunk().expect("W numbers are V registers")
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
        // Deeper than two strips, with rows and columns left over.
        const K: usize = 2 * DEPTH + 50;
        let (a, b) = (random((13, K), 5), random((K, 37), 6));
        let numbers = |t: &Tensor| t.flatten_all().unwrap().to_vec1::<f32>().unwrap();
        let c = Tensor::zeros((13, 37), DType::F32, &Device::Cpu).unwrap();
        product(&c, &a, &b).unwrap();
        let (a, b) = (numbers(&a), numbers(&b));
        for (at, found) in numbers(&c).iter().enumerate() {
            let (i, j) = (at / 37, at % 37);
            assert_eq!(*found, (0..K).fold(0.0_f32, |sum, k| a[i * K + k].mul_add(b[k * 37 + j], sum)));
        }
    }

    #[test]
    fn factors_that_do_not_fit_are_refused() {
        let c = Tensor::zeros((2, 3), DType::F32, &Device::Cpu).unwrap();
        assert!(product(&c, &random((2, 4), 1), &random((5, 3), 2)).is_err());
    }
}
