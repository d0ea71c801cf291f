//! The matrix product: C ← f(A B), strip by strip.
//!
//! | symbol | name | shape |
//! |---|---|---|
//! | A | left factor, a matrix or one that is read turned over | `[m, k]` |
//! | B | right factor; rows after the k-th are not read | `[k, n]` |
//! | C | result | `[m, n]` |
//! | f | what follows a sum: a bias and an activation, the slope of one, or nothing | – |
//!
//! Every number of A B is one chain of fused multiply-adds in the order of k, on the calling thread, and f is taken of
//! it alone: the bits depend neither on the width of the registers nor on the size of the caches. All matrices stand in
//! strips, so that none is copied; `tile` does the arithmetic.

#![expect(clippy::inline_always, reason = "vector code must be inlined into the function that has the features")]

use super::strips::{Matrix, Piece, pieces};
use super::tile::{Finish, Left, Terms, place};
use pulp::{Simd, WithSimd};

/// `c ← f(a · b)`, where c holds the pieces of `[m, n]`.
pub(super) fn product(c: &mut [Piece], a: impl Left, b: Matrix<'_>, mut finish: Finish<'_>) {
    let (m, k) = a.shape();
    assert!(k <= b.rows, "a product of [{m}, {k}] and [{}, {}]", b.rows, b.columns);
    assert_eq!(c.len(), pieces(m, b.columns), "pieces of a product [{m}, {}]", b.columns);
    if let Finish::Bias(bias, _) = &finish {
        assert_eq!(bias.len(), pieces(1, m), "pieces of a bias [{m}]");
    }
    pulp::Arch::new().dispatch(Multiply { c, a, b, finish: &mut finish });
}

/// Terms that are added to all of a strip of C before the next: so much of a strip of B stays in the nearest cache.
const DEPTH: usize = 256;

struct Multiply<'a, 'f, A> {
    c: &'a mut [Piece],
    a: A,
    b: Matrix<'a>,
    finish: &'a mut Finish<'f>,
}

impl<A: Left> WithSimd for Multiply<'_, '_, A> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        // Tiles that leave registers to spare: 32 of them where a register holds 16 numbers, else 16. Taller ones were not
        // faster.
        match S::F32_LANES {
            16 => self.tiled::<S, 8, 4, 2>(simd),
            4 | 8 => self.tiled::<S, 4, 2, 2>(simd),
            _ => self.tiled::<S, 4, 2, 1>(simd),
        }
    }
}

impl<A: Left> Multiply<'_, '_, A> {
    /// Works through C in tiles of R rows, of H where fewer are left, and of one.
    ///
    /// Columns outside, rows inside: a strip of B is fetched from far once and then met again in a near cache.
    #[inline(always)]
    fn tiled<S: Simd, const R: usize, const H: usize, const V: usize>(self, simd: S) {
        let Self { c, a, b, finish } = self;
        let (m, k) = a.shape();
        for (c, b) in c.chunks_exact_mut(m).zip(b.pieces.chunks_exact(b.rows)) {
            simd.vectorize(Strip::<A, R, H, V> { c, a, b: &b[..k], finish: &mut *finish });
        }
    }
}

/// One strip of C. It is a function of its own because a larger one is not inlined to the end.
struct Strip<'a, 'f, A, const R: usize, const H: usize, const V: usize> {
    c: &'a mut [Piece],
    a: A,
    b: &'a [Piece],
    finish: &'a mut Finish<'f>,
}

impl<A: Left, const R: usize, const H: usize, const V: usize> WithSimd for Strip<'_, '_, A, R, H, V> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { c, a, b, finish } = self;
        // ReLU's value stands where the sums of the first terms would.
        let depth = if matches!(finish, Finish::Slope) { b.len() } else { DEPTH };
        for first in (0..b.len()).step_by(depth) {
            let terms = Terms { b, first, end: b.len().min(first + depth) };
            let mut row = 0;
            while row < c.len() {
                let together = a.together(row);
                row += if together >= R {
                    place::<S, R, V>(simd, a, row, terms, c, finish);
                    R
                } else if together >= H {
                    place::<S, H, V>(simd, a, row, terms, c, finish);
                    H
                } else {
                    place::<S, 1, V>(simd, a, row, terms, c, finish);
                    1
                };
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::kernels::Activation;
    use super::super::networks::tests::random;
    use super::super::strips::{Strips, WIDTH, turn};
    use super::super::tile::{Plain, Turned};
    use super::*;
    use proptest::prelude::*;

    /// Against sums written out, for A as it is and turned over, below rows that are left out.
    fn check<'a>(m: usize, k: usize, n: usize, skipped: usize, finish: impl Fn() -> Finish<'a>) {
        // B has a row more than is read.
        let (a, b, y) = (random((m, k), 1), random((k + 1, n), 2), random((m, n), 4));
        let mut below = Strips::new(skipped + m, k);
        below.set_rows(skipped, &a, 0..m);
        let mut room = Strips::new(k, skipped + m);
        turn(&mut room, &below);
        let turned = Turned { matrix: room.view(), skipped };
        let [mut c, mut d] = [y.clone(), y.clone()];
        product(c.pieces_mut(), Plain(a.view()), b.view(), finish());
        product(d.pieces_mut(), turned, b.view(), finish());
        for (i, j) in (0..m).flat_map(|i| (0..n).map(move |j| (i, j))) {
            let sum = (0..k).fold(0.0, |sum: f32, t| a.view().at(i, t).mul_add(b.view().at(t, j), sum));
            let expected = match finish() {
                Finish::Squares(_) => sum,
                Finish::Slope if y.view().at(i, j) > 0.0 => sum,
                Finish::Slope => 0.0,
                Finish::Bias(bias, f) => {
                    let z = sum + bias[i / WIDTH].0[i % WIDTH];
                    match f {
                        Activation::Linear => z,
                        Activation::Relu => z.max(0.0),
                        Activation::Tanh | Activation::OpenTanh => z.tanh(),
                    }
                }
            };
            assert_eq!(c.view().at(i, j), expected, "[{i}, {j}] of {m} × {k} × {n}, {:?}", finish());
            assert_eq!(d.view().at(i, j), expected, "[{i}, {j}] of {m} × {k} × {n}, turned over, {:?}", finish());
        }
    }

    proptest! {
        #[test]
        fn every_number_is_one_chain_of_fused_terms(
            m in 1_usize..40, k in 1_usize..100, n in 1_usize..80, skipped in 0_usize..40,
        ) {
            check(m, k, n, skipped, || Finish::Slope);
        }

        #[test]
        fn what_follows_a_sum_is_done_once_to_every_number(m in 1_usize..40, k in 1_usize..40, n in 1_usize..70) {
            let bias = random((1, m), 3);
            for f in [Activation::Linear, Activation::Relu, Activation::Tanh] {
                check(m, k, n, 3, || Finish::Bias(bias.view().pieces, f));
            }
        }
    }

    #[test]
    fn deep_products_are_chains_too() {
        let bias = random((1, 13), 3);
        check(13, 2 * DEPTH + 50, 37, 3, || Finish::Bias(bias.view().pieces, Activation::Relu));
        check(13, DEPTH, 37, 3, || Finish::Bias(bias.view().pieces, Activation::Relu));
        check(13, DEPTH + 1, 37, 3, || Finish::Slope);
    }

    #[test]
    fn narrower_registers_give_the_same_bits() {
        let (m, k, n) = (45, 70 + DEPTH, 64);
        let (a, b) = (random((m, k), 1), random((k, n), 2));
        let [mut widest, mut single] = [Strips::new(m, n), Strips::new(m, n)];
        let [mut squares, mut of_single] = [Piece::ZERO; 2];
        product(widest.pieces_mut(), Plain(a.view()), b.view(), Finish::Squares(&mut squares));
        let finish = &mut Finish::Squares(&mut of_single);
        pulp::Scalar::new().vectorize(Multiply { c: single.pieces_mut(), a: Plain(a.view()), b: b.view(), finish });
        assert_eq!(squares.0, of_single.0);
        for (row, column) in (0..m).flat_map(|row| (0..WIDTH).map(move |column| (row, column))) {
            assert_eq!(widest.view().at(row, column), single.view().at(row, column));
            for strip in [column, WIDTH + column] {
                let z = widest.view().at(row, strip);
                squares.0[column] -= z * z;
            }
        }
        assert!(squares.0.iter().all(|left| left.abs() < 1e-3 * of_single.0[0]), "squares left: {squares:?}");
    }

    #[test]
    fn not_a_number_comes_through() {
        let (a, bias) = (random((9, 2), 1), random((1, 9), 3));
        for bad in [f32::NAN, f32::INFINITY] {
            let mut b = random((2, 5), 2);
            b.set_row(1, &[1.0, bad]);
            let mut c = Strips::new(9, 5);
            product(c.pieces_mut(), Plain(a.view()), b.view(), Finish::Bias(bias.view().pieces, Activation::Relu));
            assert!((0..9).any(|row| !c.view().at(row, 1).is_finite()), "ReLU hides {bad}");
        }
    }

    #[test]
    #[should_panic(expected = "a product of [2, 4] and [3, 5]")]
    fn factors_that_do_not_fit_are_refused() {
        let mut c = Strips::new(2, 5);
        product(c.pieces_mut(), Plain(random((2, 4), 1).view()), random((3, 5), 2).view(), Finish::Slope);
    }
}
