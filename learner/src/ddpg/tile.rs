//! The arithmetic of the matrix product: a tile of C that stays in registers while a strip of B lasts.
//!
//! | symbol | name | shape |
//! |---|---|---|
//! | R, V, W | rows of a tile, registers and numbers in one of them | – |
//! | left | R rows of A | `[R, k]` |
//! | strip | W columns of B | `[k, W]` |
//!
//! What follows a sum is done tile by tile, while the tile is in the nearest cache.

#![expect(clippy::inline_always, reason = "vector code must be inlined into the function that has the features")]
#![expect(clippy::needless_range_loop, reason = "iterators are not inlined where there is much code around them")]

use super::kernels::Activation;
use pulp::Simd;

/// What follows a sum z once it is complete.
#[derive(Clone, Copy, Debug)]
pub(super) enum Finish<T> {
    /// Nothing.
    Nothing,
    /// `f(z + b)`; b is `[columns of C]`.
    Bias(T, Activation),
    /// `z · f′`, with f′ told from f's value y, which is shaped like C.
    Slope(T, Activation),
}

impl<T: Copy> Finish<T> {
    /// b or y.
    pub(super) fn operand(self) -> Option<T> {
        match self {
            Self::Nothing => None,
            Self::Bias(operand, _) | Self::Slope(operand, _) => Some(operand),
        }
    }

    /// The same with another form of b or y.
    pub(super) fn with<U>(self, operand: U) -> Finish<U> {
        match self {
            Self::Nothing => Finish::Nothing,
            Self::Bias(_, f) => Finish::Bias(operand, f),
            Self::Slope(_, f) => Finish::Slope(operand, f),
        }
    }

    /// Numbers that b or y has where C is `[m, n]`.
    pub(super) fn len(self, m: usize, n: usize) -> Option<usize> {
        match self {
            Self::Nothing => None,
            Self::Bias(..) => Some(n),
            Self::Slope(..) => Some(m * n),
        }
    }
}

impl Finish<&[f32]> {
    /// Finishes a piece of a row of C that begins with C's number `start`, in its column `column`.
    #[inline(always)]
    fn on(self, sums: &mut [f32], start: usize, column: usize) {
        match self {
            Self::Nothing => (),
            Self::Bias(b, f) => f.add_bias(sums, &b[column..][..sums.len()]),
            Self::Slope(y, f) => f.slope(sums, &y[start..][..sums.len()]),
        }
    }
}

/// R rows of A, wherever they stand.
pub(super) trait Left {
    /// The number in row `r` and column `k`.
    fn at(&self, k: usize, r: usize) -> f32;

    /// The numbers of `ROUND` columns from `first` on, as a function of column and row.
    fn round(&self, first: usize) -> impl Fn(usize, usize) -> f32;
}

/// Rows that are read where they are.
pub(super) struct Rows<'a, const R: usize>(pub(super) [&'a [f32]; R]);

impl<const R: usize> Left for Rows<'_, R> {
    #[inline(always)]
    fn at(&self, k: usize, r: usize) -> f32 {
        self.0[r][k]
    }

    #[inline(always)]
    fn round(&self, first: usize) -> impl Fn(usize, usize) -> f32 {
        let mut rows = [&[0.0; ROUND]; R];
        for r in 0..R {
            rows[r] = self.0[r][first..].first_chunk().expect("a round");
        }
        move |k, r| rows[r][k]
    }
}

/// Rows that were packed column by column.
pub(super) struct Panel<'a, const R: usize>(pub(super) &'a [[f32; R]]);

impl<const R: usize> Left for Panel<'_, R> {
    #[inline(always)]
    fn at(&self, k: usize, r: usize) -> f32 {
        self.0[k][r]
    }

    #[inline(always)]
    fn round(&self, first: usize) -> impl Fn(usize, usize) -> f32 {
        let columns: &[[f32; R]; ROUND] = self.0[first..].first_chunk().expect("a round");
        |k, r| columns[k][r]
    }
}

/// Where a tile stands in C.
#[derive(Clone, Copy)]
pub(super) struct At {
    /// Its first number.
    pub(super) start: usize,
    /// From row to row.
    pub(super) stride: usize,
    /// Its first column.
    pub(super) column: usize,
    /// Rows that are not beyond C.
    pub(super) rows: usize,
    /// Columns that are not beyond C.
    pub(super) width: usize,
    /// True when the sums go on that stand there.
    pub(super) adds: bool,
}

/// One tile into C. At the edges it is worked out aside.
#[inline(always)]
pub(super) fn place<S: Simd, const R: usize, const V: usize, const W: usize>(
    simd: S,
    left: &impl Left,
    strip: &[[f32; W]],
    c: &mut [f32],
    at: At,
    finish: Finish<&[f32]>,
) {
    if at.width == W && at.rows == R {
        tile::<S, R, V, W>(simd, left, strip, &mut c[at.start..], at);
        for r in 0..R {
            let start = at.start + r * at.stride;
            finish.on(c[start..].first_chunk_mut::<W>().expect("a row of the tile"), start, at.column);
        }
        return;
    }
    let mut aside = [[0.0_f32; W]; R];
    for r in 0..at.rows {
        aside[r][..at.width].copy_from_slice(&c[at.start + r * at.stride..][..at.width]);
    }
    tile::<S, R, V, W>(simd, left, strip, aside.as_flattened_mut(), At { stride: W, ..at });
    for r in 0..at.rows {
        let start = at.start + r * at.stride;
        let row = &mut c[start..][..at.width];
        row.copy_from_slice(&aside[r][..at.width]);
        finish.on(row, start, at.column);
    }
}

/// Terms of a sum that are written out one after the other: what it takes to find the numbers is then shared by them.
const ROUND: usize = 8;

/// A strip's part of R rows of W numbers of C, held in V registers each while it lasts.
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
    let (rounds, rest) = strip.as_chunks::<ROUND>();
    for (i, round) in rounds.iter().enumerate() {
        add_terms(simd, &mut sums, left.round(i * ROUND), round);
    }
    let done = rounds.len() * ROUND;
    add_terms(simd, &mut sums, |k, r| left.at(done + k, r), rest);
    for r in 0..R {
        let (to, _) = S::as_mut_simd_f32s(&mut c[r * at.stride..][..W]);
        *to.first_chunk_mut().expect("W numbers are V registers") = sums[r];
    }
}

/// Adds `left(k, r) · strip[k]` to the sums of row r, k by k.
#[inline(always)]
fn add_terms<S: Simd, const R: usize, const V: usize, const W: usize>(
    simd: S,
    sums: &mut [[S::f32s; V]; R],
    left: impl Fn(usize, usize) -> f32,
    strip: &[[f32; W]],
) {
    for k in 0..strip.len() {
        let row = registers::<S, V, W>(&strip[k]);
        for r in 0..R {
            let x = simd.splat_f32s(left(k, r));
            for v in 0..V {
                sums[r][v] = simd.mul_add_f32s(x, row[v], sums[r][v]);
            }
        }
    }
}

#[inline(always)]
fn registers<S: Simd, const V: usize, const W: usize>(numbers: &[f32; W]) -> [S::f32s; V] {
    let (numbers, _) = S::as_simd_f32s(numbers);
    *numbers.first_chunk().expect("W numbers are V registers")
}
