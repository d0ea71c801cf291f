//! The rows that a dual active-set iteration holds as equations, and the projection onto their complement.
//!
//! | symbol | name                                                    | shape  |
//! |--------|---------------------------------------------------------|--------|
//! | v      | U⁻ᵀ a of a row a, with H = UᵀU                          | [n]    |
//! | V      | one v for every row held                                | [n, q] |
//! | L      | lower triangular, VᵀV = LLᵀ                             | [q, q] |
//! | λ      | multipliers of the rows held, never negative            | [q]    |
//!
//! L gains a row when one is added and is made triangular again by plane rotations when one is dropped. V itself is
//! kept instead of an orthonormal basis: no basis has to be rotated, and the first lanes of most v are zero.

use super::super::qp::LANES;
use super::triangular::{Lane, add_scaled, dot};

/// One row held.
#[derive(Clone, Copy, Debug)]
struct Held {
    row: usize,
    /// Lanes of v before this one are zero.
    first: usize,
    /// Where v is: at slot · width.
    slot: usize,
    multiplier: f64,
}

/// See the module.
#[derive(Debug, Default)]
pub(super) struct WorkingSet {
    width: usize,
    held: Vec<Held>,
    vectors: Vec<Lane>,
    /// Slots of `vectors` that nobody uses.
    free: Vec<usize>,
    /// L, row k at k (k + 1) / 2.
    factor: Vec<f64>,
    /// 1 / L[k, k].
    inverse_diagonal: Vec<f64>,
    /// Which rows are held.
    is_held: Vec<bool>,
}

/// How far the multipliers can grow before one of them becomes zero.
pub(super) struct Blocking {
    /// Step at which it does.
    pub(super) step: f64,
    /// Its index in the working set.
    pub(super) index: usize,
}

impl WorkingSet {
    /// Holds nothing, for vectors of `width` lanes and `rows` rows.
    pub(super) fn reset(&mut self, width: usize, rows: usize) {
        self.width = width;
        self.held.clear();
        self.vectors.clear();
        self.free.clear();
        self.factor.clear();
        self.inverse_diagonal.clear();
        self.is_held.clear();
        self.is_held.resize(rows, false);
    }

    /// Number of rows held.
    pub(super) fn len(&self) -> usize {
        self.held.len()
    }

    /// Whether a row is held.
    pub(super) fn holds(&self, row: usize) -> bool {
        self.is_held[row]
    }

    /// Splits v into V r and the rest z, which is orthogonal to V. Fills `half` with Lᵀ r, `reply` with r and `rest`
    /// with z; v is zero before lane `first`.
    pub(super) fn project(&self, v: &[Lane], first: usize, split: &mut Split) {
        split.half.clear();
        for (k, held) in self.held.iter().enumerate() {
            let from = first.max(held.first);
            let along = dot(&v[from..], self.vector(held, from));
            let row = &self.factor[k * (k + 1) / 2..][..k];
            let known: f64 = row.iter().zip(&split.half).map(|(l, y)| l * y).sum();
            split.half.push((along - known) * self.inverse_diagonal[k]);
        }
        split.reply.clone_from(&split.half);
        for k in (0..self.held.len()).rev() {
            split.reply[k] *= self.inverse_diagonal[k];
            let solved = split.reply[k];
            let row = &self.factor[k * (k + 1) / 2..][..k];
            for (value, l) in split.reply.iter_mut().zip(row) {
                *value -= l * solved;
            }
        }
        split.rest.clear();
        split.rest.extend_from_slice(v);
        for (k, held) in self.held.iter().enumerate() {
            add_scaled(&mut split.rest[held.first..], -split.reply[k], self.vector(held, held.first));
        }
    }

    /// The first multiplier that reaches zero when all move by −`reply` per unit of step.
    pub(super) fn blocking(&self, reply: &[f64]) -> Option<Blocking> {
        let mut found: Option<Blocking> = None;
        for (index, (held, &rate)) in self.held.iter().zip(reply).enumerate() {
            // Rates of rounding size must not drop rows.
            if rate > 1e-12 {
                let step = held.multiplier / rate;
                if found.as_ref().is_none_or(|best| step < best.step) {
                    found = Some(Blocking { step, index });
                }
            }
        }
        found
    }

    /// Moves the multipliers by −`step · reply`, never below zero.
    pub(super) fn advance(&mut self, step: f64, reply: &[f64]) {
        for (held, rate) in self.held.iter_mut().zip(reply) {
            held.multiplier = (held.multiplier - step * rate).max(0.0);
        }
    }

    /// Holds a row whose v was projected: `half` is L⁻¹ Vᵀ v and `rest_norm` the length of z.
    pub(super) fn add(&mut self, row: usize, multiplier: f64, v: (&[Lane], usize), half: &[f64], rest_norm: f64) {
        let slot = self.free.pop().unwrap_or_else(|| {
            self.vectors.resize(self.vectors.len() + self.width, [0.0; LANES]);
            self.vectors.len() / self.width - 1
        });
        self.vectors[slot * self.width..][..self.width].copy_from_slice(v.0);
        self.held.push(Held { row, first: v.1, slot, multiplier });
        self.factor.extend_from_slice(half);
        self.factor.push(rest_norm);
        self.inverse_diagonal.push(1.0 / rest_norm);
        self.is_held[row] = true;
    }

    /// Lets the row at `index` go.
    pub(super) fn drop_at(&mut self, index: usize) {
        let held = self.held.remove(index);
        self.is_held[held.row] = false;
        self.free.push(held.slot);
        self.inverse_diagonal.pop();
        // Without row `index`, row k (once k + 1) has one entry right of the diagonal: rotate it away by columns.
        let q = self.held.len();
        self.factor.drain(index * (index + 1) / 2..(index + 1) * (index + 2) / 2);
        let start = |k: usize| (k + 1) * (k + 2) / 2 - (index + 1);
        for k in index..q {
            let (a, b) = (self.factor[start(k) + k], self.factor[start(k) + k + 1]);
            let length = a.hypot(b);
            let (cos, sin) = (a / length, b / length);
            for below in k..q {
                let at = start(below) + k;
                let (a, b) = (self.factor[at], self.factor[at + 1]);
                self.factor[at] = cos * a + sin * b;
                self.factor[at + 1] = cos * b - sin * a;
            }
            self.inverse_diagonal[k] = 1.0 / length;
        }
        for k in index..q {
            self.factor.copy_within(start(k)..=start(k) + k, k * (k + 1) / 2);
        }
        self.factor.truncate(q * (q + 1) / 2);
    }

    /// The lanes of v from `from` on.
    #[inline]
    fn vector(&self, held: &Held, from: usize) -> &[Lane] {
        &self.vectors[held.slot * self.width..][from..self.width]
    }
}

/// What `project` fills; kept between calls for its room.
#[derive(Debug, Default)]
pub(super) struct Split {
    /// L⁻¹ Vᵀ v.
    pub(super) half: Vec<f64>,
    /// r.
    pub(super) reply: Vec<f64>,
    /// z = v − V r.
    pub(super) rest: Vec<Lane>,
}
