//! The arithmetic of the matrix product: a tile of C stays in registers from its first term to what follows the sum.
//!
//! | symbol | name | shape |
//! |---|---|---|
//! | R, V | rows of a tile, registers of each of them | – |
//! | left | A, or a matrix whose transposed is A | `[m, k]` or `[k, m]` |
//! | b, c | a strip of B, the strip of C that comes of it | `[k, WIDTH]`, `[m, WIDTH]` |

#![expect(clippy::inline_always, reason = "vector code must be inlined into the function that has the features")]
#![expect(clippy::needless_range_loop, reason = "iterators are not inlined where there is much code around them")]

use super::kernels::Activation;
use super::strips::{Matrix, Piece, WIDTH};
use pulp::Simd;
use std::ops::Range;

/// What follows a sum z once it is complete.
#[derive(Debug)]
pub(super) enum Finish<'a> {
    /// Nothing; z² is added to the number of its column, as that stands in its strip.
    Squares(&'a mut Piece),
    /// `f(z + b)`; b holds a number for each row of C.
    Bias(&'a [Piece], Activation),
    /// `z · f′` where f is ReLU and its value y is what C held before.
    Slope,
}

/// The left factor A, read where it stands.
pub(super) trait Left: Copy {
    /// m and k.
    fn shape(&self) -> (usize, usize);

    /// Rows of A from `row` on that a tile may hold together.
    fn together(&self, row: usize) -> usize;

    /// Of R rows from `row` on the columns in `range`, which begins where a strip does and is no longer than one: a
    /// function of the column, counted from there, and of the row.
    fn part<const R: usize>(&self, row: usize, range: Range<usize>) -> impl Fn(usize, usize) -> f32;
}

/// A is this matrix.
#[derive(Clone, Copy)]
pub(super) struct Plain<'a>(pub(super) Matrix<'a>);

impl Left for Plain<'_> {
    #[inline(always)]
    fn shape(&self) -> (usize, usize) {
        (self.0.rows, self.0.columns)
    }

    #[inline(always)]
    fn together(&self, row: usize) -> usize {
        self.0.rows - row
    }

    #[inline(always)]
    fn part<const R: usize>(&self, row: usize, range: Range<usize>) -> impl Fn(usize, usize) -> f32 {
        let rows: &[Piece; R] =
            self.0.pieces[range.start / WIDTH * self.0.rows + row..].first_chunk().expect("R rows are together");
        |k, r| rows[r].0[k]
    }
}

/// Rows of a matrix that is turned over stand side by side; those of a tile are of one half of a line of cache.
const BESIDE: usize = 8;

/// A is this matrix turned over, its first rows left out.
#[derive(Clone, Copy)]
pub(super) struct Turned<'a> {
    pub(super) matrix: Matrix<'a>,
    /// Rows of A that are left out.
    pub(super) skipped: usize,
}

impl Left for Turned<'_> {
    #[inline(always)]
    fn shape(&self) -> (usize, usize) {
        (self.matrix.columns - self.skipped, self.matrix.rows)
    }

    #[inline(always)]
    fn together(&self, row: usize) -> usize {
        let column = self.skipped + row;
        (self.matrix.columns - column).min(BESIDE - column % BESIDE)
    }

    #[inline(always)]
    fn part<const R: usize>(&self, row: usize, range: Range<usize>) -> impl Fn(usize, usize) -> f32 {
        let column = self.skipped + row;
        let pieces = &self.matrix.pieces[column / WIDTH * self.matrix.rows..][range];
        let first = column % WIDTH;
        move |k, r| {
            let numbers: &[f32; R] = pieces[k].0[first..].first_chunk().expect("R rows are together");
            numbers[r]
        }
    }
}

/// Some terms of the sums: these rows of a strip of B. The first is the first of a strip of A, too.
#[derive(Clone, Copy)]
pub(super) struct Terms<'a> {
    pub(super) b: &'a [Piece],
    pub(super) first: usize,
    pub(super) end: usize,
}

/// One tile: rows `row` to `row + R` of the strip c. The terms are added to those before them, whose sums stand in c;
/// what follows a sum is done after the last.
#[inline(always)]
pub(super) fn place<S: Simd, const R: usize, const V: usize>(
    simd: S,
    left: impl Left,
    row: usize,
    terms: Terms<'_>,
    c: &mut [Piece],
    finish: &mut Finish<'_>,
) {
    let is_last = terms.end == terms.b.len();
    let c: &mut [Piece; R] = c[row..].first_chunk_mut().expect("rows of the tile");
    for column in (0..WIDTH).step_by(V * S::F32_LANES) {
        let mut sums = [[simd.splat_f32s(0.0); V]; R];
        if terms.first > 0 {
            for r in 0..R {
                sums[r] = registers::<S, V>(&c[r], column);
            }
        }
        add_terms(simd, &mut sums, left, row, terms, column);
        match finish {
            _ if !is_last => (),
            Finish::Squares(squares) => add_squares(simd, registers_mut::<S, V>(squares, column), &sums),
            Finish::Bias(bias, f) => add_bias(simd, &mut sums, bias, row, *f),
            Finish::Slope => slope(simd, &mut sums, c, column),
        }
        for r in 0..R {
            *registers_mut::<S, V>(&mut c[r], column) = sums[r];
        }
    }
    if let (Finish::Bias(_, Activation::Tanh | Activation::OpenTanh), true) = (finish, is_last) {
        for number in c.iter_mut().flat_map(|piece| &mut piece.0) {
            *number = number.tanh();
        }
    }
}

/// Adds z² to the squares, row by row: so their bits do not depend on the tiles.
#[inline(always)]
fn add_squares<S: Simd, const R: usize, const V: usize>(simd: S, squares: &mut [S::f32s; V], sums: &[[S::f32s; V]; R]) {
    for r in 0..R {
        for v in 0..V {
            squares[v] = simd.mul_add_f32s(sums[r][v], sums[r][v], squares[v]);
        }
    }
}

/// z + b, and what is left of it if f is ReLU. NaN is not below 0: a poisoned weight cannot hide there.
#[inline(always)]
fn add_bias<S: Simd, const R: usize, const V: usize>(
    simd: S,
    sums: &mut [[S::f32s; V]; R],
    bias: &[Piece],
    row: usize,
    f: Activation,
) {
    let zero = simd.splat_f32s(0.0);
    for r in 0..R {
        let b = simd.splat_f32s(bias[(row + r) / WIDTH].0[(row + r) % WIDTH]);
        for v in 0..V {
            sums[r][v] = simd.add_f32s(sums[r][v], b);
        }
    }
    if f == Activation::Relu {
        for r in 0..R {
            for v in 0..V {
                sums[r][v] = simd.select_f32s(simd.less_than_f32s(sums[r][v], zero), zero, sums[r][v]);
            }
        }
    }
}

/// z where ReLU's value y, which stands in c, is more than 0.
#[inline(always)]
fn slope<S: Simd, const R: usize, const V: usize>(
    simd: S,
    sums: &mut [[S::f32s; V]; R],
    c: &[Piece; R],
    column: usize,
) {
    let zero = simd.splat_f32s(0.0);
    for r in 0..R {
        let y = registers::<S, V>(&c[r], column);
        for v in 0..V {
            sums[r][v] = simd.select_f32s(simd.greater_than_f32s(y[v], zero), sums[r][v], zero);
        }
    }
}

/// Columns of A that are written out one after the other.
const ROUND: usize = 8;

/// Adds these terms of R rows of A times V registers of b from this column on, one fused multiply-add after the other.
#[inline(always)]
fn add_terms<S: Simd, const R: usize, const V: usize>(
    simd: S,
    sums: &mut [[S::f32s; V]; R],
    left: impl Left,
    row: usize,
    terms: Terms<'_>,
    column: usize,
) {
    let (blocks, rest) = terms.b[terms.first..terms.end].as_chunks::<WIDTH>();
    for (i, block) in blocks.iter().enumerate() {
        let first = terms.first + i * WIDTH;
        let left = left.part::<R>(row, first..first + WIDTH);
        for first in (0..WIDTH).step_by(ROUND) {
            for k in first..first + ROUND {
                add_term(simd, sums, &left, k, &block[k], column);
            }
        }
    }
    if !rest.is_empty() {
        let left = left.part::<R>(row, terms.end - rest.len()..terms.end);
        for k in 0..rest.len() {
            add_term(simd, sums, &left, k, &rest[k], column);
        }
    }
}

/// Adds `left(k, r) · b` to the sums of each row r.
#[inline(always)]
fn add_term<S: Simd, const R: usize, const V: usize>(
    simd: S,
    sums: &mut [[S::f32s; V]; R],
    left: &impl Fn(usize, usize) -> f32,
    k: usize,
    b: &Piece,
    column: usize,
) {
    let b = registers::<S, V>(b, column);
    for r in 0..R {
        let x = simd.splat_f32s(left(k, r));
        for v in 0..V {
            sums[r][v] = simd.mul_add_f32s(x, b[v], sums[r][v]);
        }
    }
}

#[inline(always)]
fn registers<S: Simd, const V: usize>(piece: &Piece, column: usize) -> [S::f32s; V] {
    let (numbers, _) = S::as_simd_f32s(&piece.0[column..]);
    *numbers.first_chunk().expect("a piece holds V registers")
}

#[inline(always)]
fn registers_mut<S: Simd, const V: usize>(piece: &mut Piece, column: usize) -> &mut [S::f32s; V] {
    let (numbers, _) = S::as_mut_simd_f32s(&mut piece.0[column..]);
    numbers.first_chunk_mut().expect("a piece holds V registers")
}
