//! The steps of the networks that go number by number, in the widest registers of the machine.
//!
//! Each result is of fixed numbers in a fixed order, and no multiplication is fused with an addition, so the width of the
//! registers does not show in the bits.

#![expect(clippy::inline_always, reason = "vector code must be inlined into the function that has the features")]

use super::strips::{Matrix, Piece, WIDTH};
use pulp::{Simd, WithSimd};

/// What follows a layer's sum. `repr(u32)`: a GPU's kernels read it as a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub(super) enum Activation {
    /// Nothing.
    Linear,
    /// max(0, y)
    Relu,
    /// tanh y
    Tanh,
    /// tanh y, whose slope counts as 1 where the gradient points away from the nearer end, see [`Activation::slope`].
    OpenTanh,
}

impl Activation {
    /// `d · f′`, with f′ told from f's value y.
    ///
    /// At an end of tanh f′ vanishes, and what has run into it never comes back, whatever is found elsewhere. The open one
    /// keeps f′ where a step along −d would go further out, so that it does not run away, and takes 1 where it would come
    /// back (after the inverted gradients of Hausknecht and Stone 2016).
    pub(super) fn slope(self, d: f32, y: f32) -> f32 {
        match self {
            Self::Linear => d,
            Self::Relu if y > 0.0 => d,
            Self::Relu => 0.0,
            Self::OpenTanh if d * y > 0.0 => d,
            Self::Tanh | Self::OpenTanh => d * (1.0 - y * y),
        }
    }
}

/// Pieces that are added up side by side: an addition takes longer than the next one waits.
const ABREAST: usize = 4;

/// `sums ← Σ columns of d`, a number for each row of d `[rows, n]`.
pub(super) fn sum_columns(sums: &mut [Piece], d: Matrix<'_>) {
    pulp::Arch::new().dispatch(SumColumns { sums, d });
}

struct SumColumns<'a> {
    sums: &'a mut [Piece],
    d: Matrix<'a>,
}

impl WithSimd for SumColumns<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { sums, d } = self;
        for first in (0..d.rows).step_by(ABREAST) {
            let mut lanes = [Piece::ZERO; ABREAST];
            for (strip, left) in d.pieces.chunks_exact(d.rows).zip((1..=d.columns).rev().step_by(WIDTH)) {
                for (lanes, piece) in lanes.iter_mut().zip(&strip[first..]) {
                    if left < WIDTH {
                        (0..left).for_each(|i| lanes.0[i] += piece.0[i]);
                    } else {
                        (0..WIDTH).for_each(|i| lanes.0[i] += piece.0[i]);
                    }
                }
            }
            for (row, lanes) in (first..d.rows).zip(lanes) {
                sums[row / WIDTH].0[row % WIDTH] = sum(lanes);
            }
        }
    }
}

/// Adds x² to the number of its column.
pub(super) fn add_squares(squares: &mut Piece, x: &[Piece]) {
    for (square, x) in x.iter().flat_map(|x| (0..WIDTH).map(move |i| (i, x.0[i]))) {
        squares.0[square] += x * x;
    }
}

/// The sum of a piece: halves are added until one number is left.
#[inline(always)]
pub(super) fn sum(mut piece: Piece) -> f32 {
    let mut half = WIDTH / 2;
    while half > 0 {
        for i in 0..half {
            piece.0[i] += piece.0[i + half];
        }
        half /= 2;
    }
    piece.0[0]
}

#[cfg(test)]
mod tests {
    use super::super::strips::Strips;
    use super::*;

    #[test]
    fn slopes() {
        let y = [0.0, 0.5, 2.0, 0.0];
        for (activation, expected) in [
            (Activation::Linear, [1.0, 2.0, 3.0, 4.0]),
            (Activation::Relu, [0.0, 2.0, 3.0, 0.0]),
            (Activation::Tanh, [1.0, 1.5, -9.0, 4.0]),
            (Activation::OpenTanh, [1.0, 2.0, 3.0, 4.0]),
        ] {
            let found: Vec<f32> = [1.0, 2.0, 3.0, 4.0].iter().zip(y).map(|(d, y)| activation.slope(*d, y)).collect();
            assert_eq!(found, expected, "{activation:?}");
        }
    }

    #[test]
    fn the_open_slope_holds_back_only_what_runs_out_of_the_box() {
        // A step goes along −d: the first two come back from the upper and the lower end, the others go further out.
        for (d, y, expected) in [(2.0, 1.0, 2.0), (-3.0, -1.0, -3.0), (-2.0, 1.0, 0.0), (4.0, -0.5, 3.0)] {
            assert_eq!(Activation::OpenTanh.slope(d, y), expected);
        }
    }

    #[test]
    fn sums_of_columns() {
        for n in [1, 31, 32, 33, 100] {
            let mut d = Strips::new(35, n);
            d.pieces_mut().fill(Piece([1e9; WIDTH]));
            for row in 0..35 {
                d.set_row(row, &(0..n).map(|i| (row + i) as f32).collect::<Vec<_>>());
            }
            let mut sums = [Piece::ZERO; 2];
            sum_columns(&mut sums, d.view());
            for row in 0..35 {
                assert_eq!(sums[row / WIDTH].0[row % WIDTH], (n * row + n * (n - 1) / 2) as f32, "row {row} of {n}");
            }
        }
    }

    #[test]
    fn squares_and_what_is_not_finite() {
        let mut squares = Piece::ZERO;
        add_squares(&mut squares, &[Piece(std::array::from_fn(|i| i as f32)), Piece([2.0; WIDTH])]);
        assert_eq!(squares.0, std::array::from_fn(|i| (i * i + 4) as f32));
        assert_eq!(sum(squares), (31 * 32 * 63 / 6 + 4 * 32) as f32);
        for bad in [f32::NAN, f32::INFINITY] {
            let mut x = Piece::ZERO;
            x.0[5] = bad;
            let mut squares = Piece::ZERO;
            add_squares(&mut squares, &[x]);
            assert!(!sum(squares).is_finite());
        }
    }
}
