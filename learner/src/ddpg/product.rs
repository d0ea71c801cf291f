//! The matrix product, in place on candle tensors: C ← f(A B).
//!
//! | symbol | name | shape |
//! |---|---|---|
//! | A | left factor, any strides | `[m, k]` |
//! | B | right factor, any strides | `[k, n]` |
//! | C | result, contiguous | `[m, n]` |
//! | f | what follows a sum: nothing, a bias and an activation, the slope of one | – |
//!
//! candle's own product asks the operating system for the number of processors each time and fills fresh memory; on
//! networks of this size the two cost as much as the arithmetic. Here every number of A B is one chain of fused
//! multiply-adds in the order of k, on the calling thread, and f is taken of it alone: the bits depend neither on the
//! width of the registers nor on the size of the caches. Both factors are copied into the order in which they are read,
//! strips of B no deeper than fit the nearest cache; `tile` does the arithmetic.

#![expect(clippy::inline_always, reason = "vector code must be inlined into the function that has the features")]
#![expect(clippy::needless_range_loop, reason = "iterators are not inlined where there is much code around them")]

use super::kernels::{numbers, slice_mut};
use super::tile::{At, Finish, Panel, Rows, place};
use candle_core::{CpuStorage, InplaceOp3, Layout, Result, Tensor, bail};
use pulp::{Simd, WithSimd};
use std::cell::RefCell;
use std::ops::Range;

/// `c ← f(a · b)`; the tensor in `finish` must not share memory with c.
pub(super) fn product(c: &Tensor, a: &Tensor, b: &Tensor, finish: Finish<&Tensor>) -> Result<()> {
    c.inplace_op3(a, b, &Product(finish))
}

struct Product<'a>(Finish<&'a Tensor>);

impl InplaceOp3 for Product<'_> {
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
        let held = self.0.operand().map(Tensor::storage_and_layout);
        let finish = match &held {
            None => Finish::Nothing,
            Some((storage, layout)) => self.0.with(numbers(storage, layout)?),
        };
        if finish.len(m, n) != finish.operand().map(<[f32]>::len) {
            bail!("a product of shape {:?} does not go with {:?}", c_at.shape(), self.0);
        }
        SCRATCH.with_borrow_mut(|scratch| pulp::Arch::new().dispatch(Multiply { c, a, b, finish, scratch }));
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

    /// The numbers `reach` of R rows from row `first` on, counted from the beginning of each.
    #[inline(always)]
    fn rows<const R: usize>(&self, first: usize, reach: Range<usize>) -> [&'a [f32]; R] {
        let mut rows: [&[f32]; R] = [&[]; R];
        for r in 0..R {
            rows[r] = &self.numbers[(first + r) * self.row_stride..][reach.clone()];
        }
        rows
    }

    /// Copies rows `rows` of the columns from `column` on into `strip`, row by row, with zeros beyond the last column.
    #[inline(always)]
    fn copy_strip<const W: usize>(&self, rows: Range<usize>, column: usize, strip: &mut [[f32; W]]) {
        let width = W.min(self.columns - column);
        if self.column_stride == 1 {
            for k in 0..rows.len() {
                let numbers = &self.numbers[(rows.start + k) * self.row_stride + column..];
                if width == W {
                    strip[k] = *numbers.first_chunk().expect("a whole row of the strip");
                } else {
                    strip[k][..width].copy_from_slice(&numbers[..width]);
                    strip[k][width..].fill(0.0);
                }
            }
            return;
        }
        for (i, strip) in strip.chunks_mut(LINE).enumerate() {
            self.turn_block(rows.start + i * LINE, column, width, strip);
        }
    }

    /// The rows of one block: read along the columns, which lie adjacent here, so that each line of cache is fetched once.
    #[inline(always)]
    fn turn_block<const W: usize>(&self, row: usize, column: usize, width: usize, strip: &mut [[f32; W]]) {
        let column_at = |c: usize| &self.numbers[row * self.row_stride + (column + c) * self.column_stride..];
        if let (Some(strip), true) = (strip.first_chunk_mut::<LINE>(), width == W && W >= GROUP && self.row_stride == 1)
        {
            for c in (0..W).step_by(GROUP) {
                let mut columns = [&[0.0; LINE]; GROUP];
                for i in 0..GROUP {
                    columns[i] = column_at(c + i).first_chunk().expect("a block of rows");
                }
                for k in 0..LINE {
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
const LINE: usize = 16;
/// Terms of the sums that are added before the next column strip: a strip of B then stays in the nearest cache.
const DEPTH: usize = 256;

struct Multiply<'a> {
    c: &'a mut [f32],
    a: Matrix<'a>,
    b: Matrix<'a>,
    finish: Finish<&'a [f32]>,
    scratch: &'a mut Scratch,
}

impl WithSimd for Multiply<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        // Tiles that leave registers to spare: 32 of them where a register holds 16 numbers, else 16.
        match S::F32_LANES {
            16 => self.tiled::<S, 8, 2, 32, 16>(simd),
            8 => self.tiled::<S, 4, 2, 16, 8>(simd),
            4 => self.tiled::<S, 4, 2, 8, 4>(simd),
            _ => self.tiled::<S, 4, 1, 1, 1>(simd),
        }
    }
}

impl Multiply<'_> {
    /// Works through C in strips of W columns, which are V registers; a last strip that fits into one register, of N
    /// numbers, is of that width. So a layer of few outputs costs half.
    ///
    /// Columns outside, rows inside: a strip of B is fetched from far once and then met again in a near cache.
    #[inline(always)]
    fn tiled<S: Simd, const R: usize, const V: usize, const W: usize, const N: usize>(self, simd: S) {
        let Self { c, a, b, finish, scratch } = self;
        // Rows that lie in one piece are read where they are.
        let whole = if a.column_stride == 1 { a.rows / R } else { 0 };
        let panels = blocks::<R>(&mut scratch.panels, a.columns * (a.rows.div_ceil(R) - whole));
        for (i, panels) in panels.chunks_mut(LINE / R * a.columns).enumerate() {
            pack_line(panels, &a, whole * R + i * LINE);
        }
        let (left, room) = (&Packed { a, whole, panels }, &mut scratch.strip);
        for column in (0..b.columns).step_by(W) {
            if b.columns - column > N {
                simd.vectorize(Strip::<R, V, W> { c, left, b, column, finish, room });
            } else {
                simd.vectorize(Strip::<R, 1, N> { c, left, b, column, finish, room });
            }
        }
    }
}

/// A, ready to be read R rows at a time.
struct Packed<'a, const R: usize> {
    a: Matrix<'a>,
    /// Groups of R rows that are read where they are.
    whole: usize,
    /// The other rows, R at a time, with zeros beyond the last.
    panels: &'a [[f32; R]],
}

/// The strip of C that begins in `column`, in tiles of R rows and V registers, W columns. Rows and columns beyond C are
/// zeros that are not stored. It is a function of its own because a larger one is not inlined to the end.
struct Strip<'a, const R: usize, const V: usize, const W: usize> {
    c: &'a mut [f32],
    left: &'a Packed<'a, R>,
    b: Matrix<'a>,
    column: usize,
    finish: Finish<&'a [f32]>,
    /// For the strip of B.
    room: &'a mut Vec<f32>,
}

impl<const R: usize, const V: usize, const W: usize> WithSimd for Strip<'_, R, V, W> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { c, left: Packed { a, whole, panels }, b, column, finish, room } = self;
        let (n, depth, width) = (b.columns, a.columns, W.min(b.columns - column));
        let strip = blocks::<W>(room, depth.min(DEPTH));
        for k in (0..depth).step_by(DEPTH) {
            let terms = k..depth.min(k + DEPTH);
            let strip = &mut strip[..terms.len()];
            b.copy_strip(terms.clone(), column, strip);
            let finish = if terms.end == depth { finish } else { Finish::Nothing };
            for first in (0..a.rows).step_by(R) {
                let start = first * n + column;
                let at = At { start, stride: n, column, rows: R.min(a.rows - first), width, adds: k > 0 };
                if first / R < *whole {
                    place::<S, R, V, W>(simd, &Rows::<R>(a.rows(first, terms.clone())), strip, c, at, finish);
                } else {
                    let panel = &panels[(first / R - whole) * depth..][terms.clone()];
                    place::<S, R, V, W>(simd, &Panel(panel), strip, c, at, finish);
                }
            }
        }
    }
}

/// `count` blocks of N numbers, of any value, out of a buffer that only grows. They begin with a line of cache: a
/// register that is read across two lines costs two reads.
fn blocks<const N: usize>(buffer: &mut Vec<f32>, count: usize) -> &mut [[f32; N]] {
    if buffer.len() < N * count + LINE {
        buffer.resize(N * count + LINE, 0.0);
    }
    let first = buffer.as_ptr().align_offset(LINE * size_of::<f32>());
    &mut buffer[first..].as_chunks_mut().0[..count]
}

/// The panels of as many rows as a line of cache has numbers, from row `first` on. Rows that lie side by side are read
/// by the line, so that each is fetched once.
#[inline(always)]
fn pack_line<const R: usize>(panels: &mut [[f32; R]], a: &Matrix<'_>, first: usize) {
    if a.row_stride == 1 && first + LINE <= a.rows {
        for k in 0..a.columns {
            let line: &[f32; LINE] = a.numbers[k * a.column_stride + first..].first_chunk().expect("a line of rows");
            for (i, rows) in line.as_chunks().0.iter().enumerate() {
                panels[i * a.columns + k] = *rows;
            }
        }
    } else {
        for (i, panel) in panels.chunks_exact_mut(a.columns).enumerate() {
            pack(panel, a, first + i * R);
        }
    }
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
        let rows = a.rows::<R>(first, 0..(panel.len() - 1) * a.column_stride + 1);
        for k in 0..panel.len() {
            for r in 0..R {
                panel[k][r] = rows[r][k * a.column_stride];
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::kernels::Activation;
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
        product(&c, &a, &b, Finish::Nothing).unwrap();
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
        product(&whole.narrow(0, 2, 5).unwrap(), &a, &b, Finish::Nothing).unwrap();
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
        product(&c, &a, &b, Finish::Nothing).unwrap();
        let (a, b) = (numbers(&a), numbers(&b));
        for (at, found) in numbers(&c).iter().enumerate() {
            let (i, j) = (at / 37, at % 37);
            assert_eq!(*found, (0..K).fold(0.0_f32, |sum, k| a[i * K + k].mul_add(b[k * 37 + j], sum)));
        }
    }

    #[test]
    fn what_follows_a_sum_is_done_once_to_every_number() {
        // Deeper than one strip; whole tiles, rows and columns left over, and strips that fit into one register.
        for (m, n) in [(16, 64), (13, 37), (9, 3), (5, 1)] {
            let (a, b) = (random((m, DEPTH + 9), 7), random((DEPTH + 9, n), 8));
            let (bias, y) = (random((1, n), 9).flatten_all().unwrap(), random((m, n), 10));
            let numbers = |t: &Tensor| t.flatten_all().unwrap().to_vec1::<f32>().unwrap();
            let with = |finish: Finish<&Tensor>| {
                let c = Tensor::full(f32::NAN, (m, n), &Device::Cpu).unwrap();
                product(&c, &a, &b, finish).unwrap();
                numbers(&c)
            };
            let (sums, bias_at, y_at) = (with(Finish::Nothing), numbers(&bias), numbers(&y));
            for f in [Activation::Linear, Activation::Relu, Activation::Tanh] {
                let mut expected = sums.clone();
                expected.chunks_exact_mut(n).for_each(|row| f.add_bias(row, &bias_at));
                assert_eq!(with(Finish::Bias(&bias, f)), expected, "bias, {f:?}, {m} × {n}");
                let mut expected = sums.clone();
                f.slope(&mut expected, &y_at);
                assert_eq!(with(Finish::Slope(&y, f)), expected, "slope, {f:?}, {m} × {n}");
            }
        }
    }

    #[test]
    fn factors_that_do_not_fit_are_refused() {
        let c = Tensor::zeros((2, 3), DType::F32, &Device::Cpu).unwrap();
        let (a, b) = (random((2, 4), 1), random((4, 3), 2));
        assert!(product(&c, &a, &b, Finish::Bias(&random((1, 2), 3), Activation::Relu)).is_err());
        assert!(product(&c, &a, &b, Finish::Slope(&random((3, 3), 3), Activation::Relu)).is_err());
        assert!(product(&c, &random((2, 4), 1), &random((5, 3), 2), Finish::Nothing).is_err());
    }
}
