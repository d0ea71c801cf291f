//! Adam, gradient clipping and the soft target update, in one pass over a network's arena.
//!
//! | symbol | name | value |
//! |---|---|---|
//! | g | gradient, scaled down to the largest norm | – |
//! | m, v | moments: m ← β₁ m + (1 − β₁) g, v ← β₂ v + (1 − β₂) g² | β₁ = .9, β₂ = .999 |
//! | t | steps taken, this one included | – |
//! | θ | θ ← θ − rate · (m / (1 − β₁ᵗ)) / (√(v / (1 − β₂ᵗ)) + ε) | ε = 1e-8 |
//! | θ′ | θ′ ← θ′ + γ (θ − θ′), paper eqs 8–9 | γ = `target_rate` |
//!
//! Source: Kingma & Ba 2015, algorithm 1. There is no weight decay.

use super::kernels;
use super::networks::{Network, Row};
use candle_core::{CpuStorage, InplaceOp1, Layout, Result, bail};

pub(super) const BETA_1: f64 = 0.9;
pub(super) const BETA_2: f64 = 0.999;
pub(super) const EPSILON: f32 = 1e-8;
/// Moments smaller than this become 0: numbers below f32's normal range take the slow path of the CPU.
const SMALLEST_MOMENT: f32 = 1e-30;

/// How one step is taken.
#[derive(Clone, Copy, Debug)]
pub(super) struct Step {
    /// Adam's rate.
    pub(super) rate: f64,
    /// Steps that this network has taken, this one included.
    pub(super) count: u64,
    /// Largest global gradient norm; 0 for any.
    pub(super) clip: f64,
    /// γ, if the target copy moves too.
    pub(super) target_rate: Option<f64>,
}

/// Euclidean length of a network's gradient over all of its parameters.
pub(super) fn norm(network: &Network) -> Result<f32> {
    let n = network.parameters();
    Ok(kernels::sum_of_squares(&network.arena().narrow(0, Row::Gradient as usize * n, n)?)?.sqrt())
}

/// Moves weights, moments and target copy by one step along the gradient, whose length is `norm`.
pub(super) fn apply(network: &Network, norm: f32, step: Step) -> Result<()> {
    let clip = step.clip as f32;
    network.arena().inplace_op1(&Adam {
        parameters: network.parameters(),
        gradient_scale: if clip > 0.0 && norm > clip { clip / norm } else { 1.0 },
        rate: corrected_rate(step.rate, step.count),
        root_scale: root_scale(step.count),
        target_rate: step.target_rate.map(|rate| rate as f32),
    })
}

/// rate / (1 − β₁ᵗ)
pub(super) fn corrected_rate(rate: f64, count: u64) -> f32 {
    (rate / (1.0 - power(BETA_1, count))) as f32
}

/// 1 / √(1 − β₂ᵗ)
pub(super) fn root_scale(count: u64) -> f32 {
    (1.0 / (1.0 - power(BETA_2, count)).sqrt()) as f32
}

fn power(base: f64, exponent: u64) -> f64 {
    // Both powers are 0 long before the exponent leaves i32.
    base.powi(i32::try_from(exponent).unwrap_or(i32::MAX))
}

struct Adam {
    parameters: usize,
    gradient_scale: f32,
    rate: f32,
    root_scale: f32,
    target_rate: Option<f32>,
}

/// The part of every row that one round works on.
struct Rows<'a> {
    weights: &'a mut [f32],
    targets: &'a mut [f32],
    means: &'a mut [f32],
    squares: &'a mut [f32],
    gradient: &'a [f32],
}

/// Numbers of a row that one round works on: what all five rows take of the nearest cache is half of it.
const ROUND: usize = 1024;

impl InplaceOp1 for Adam {
    fn name(&self) -> &'static str {
        "adam"
    }

    fn cpu_fwd(&self, arena: &mut CpuStorage, layout: &Layout) -> Result<()> {
        let mut rows = kernels::slice_mut(arena, layout)?.chunks_exact_mut(self.parameters);
        let mut row = || rows.next().map(|row| row.chunks_mut(ROUND));
        let (Some(weights), Some(targets), Some(means), Some(squares), Some(gradient)) =
            (row(), row(), row(), row(), row())
        else {
            bail!("an arena without five rows")
        };
        let rounds = weights.zip(targets).zip(means.zip(squares)).zip(gradient);
        for (((weights, targets), (means, squares)), gradient) in rounds {
            let rows = Rows { weights, targets, means, squares, gradient };
            pulp::Arch::new().dispatch(|| self.round(rows));
        }
        Ok(())
    }
}

impl Adam {
    #[inline]
    fn round(&self, rows: Rows<'_>) {
        match self.target_rate {
            Some(rate) => self.step(rows, |target, weight| *target += rate * (weight - *target)),
            None => self.step(rows, |_, _| ()),
        }
    }

    #[inline]
    fn step(&self, rows: Rows<'_>, follow: impl Fn(&mut f32, f32)) {
        let Rows { weights, targets, means, squares, gradient } = rows;
        let (keep_1, take_1) = (BETA_1 as f32, (1.0 - BETA_1) as f32);
        let (keep_2, take_2) = (BETA_2 as f32, (1.0 - BETA_2) as f32);
        let lasting = weights.iter_mut().zip(targets).zip(means.iter_mut().zip(squares));
        for (((weight, target), (mean, square)), g) in lasting.zip(gradient) {
            let g = g * self.gradient_scale;
            let (m, v) = (keep_1 * *mean + take_1 * g, keep_2 * *square + take_2 * g * g);
            *mean = if m.abs() < SMALLEST_MOMENT { 0.0 } else { m };
            *square = if v < SMALLEST_MOMENT { 0.0 } else { v };
            *weight -= self.rate * *mean / (square.sqrt() * self.root_scale + EPSILON);
            follow(target, *weight);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::kernels::Activation;
    use super::super::networks::{Head, tests::random};
    use super::*;
    use candle_core::Tensor;
    use herd_common::seed::Seed;

    fn network() -> Network {
        Network::new(&[5, 300, 2], Head { activation: Activation::Linear, init: 0.3 }, Seed::from_number(8)).unwrap()
    }

    fn row(network: &Network, row: Row) -> Vec<f32> {
        network.spans().iter().flat_map(|span| network.read(row, span).unwrap()).collect()
    }

    /// Puts random numbers times `size` into the gradient row.
    fn set_gradient(network: &Network, size: f64, seed: u64) -> Vec<f64> {
        let n = network.parameters();
        let numbers = random((1, n), seed).flatten_all().unwrap().affine(size, 0.0).unwrap();
        let keep = network.arena().narrow(0, 0, Row::Gradient as usize * n).unwrap();
        let all = Tensor::cat(&[&keep, &numbers], 0).unwrap().to_vec1().unwrap();
        network.overwrite(&all).unwrap();
        numbers.to_vec1::<f32>().unwrap().into_iter().map(f64::from).collect()
    }

    /// Ten steps against the textbook in f64, with or without clipping and a target that follows.
    fn check(clip: f64, target_rate: Option<f64>) {
        let network = network();
        let mut theta: Vec<f64> = row(&network, Row::Online).into_iter().map(f64::from).collect();
        let mut target = theta.clone();
        let (mut m, mut v) = (vec![0.0; theta.len()], vec![0.0; theta.len()]);
        for t in 1..=10_u64 {
            let g = set_gradient(&network, 1.0, 100 + t);
            let length = g.iter().map(|g| g * g).sum::<f64>().sqrt();
            let found = norm(&network).unwrap();
            assert!((length - f64::from(found)).abs() < 1e-5 * length);
            let scale = if clip > 0.0 && length > clip { clip / length } else { 1.0 };
            apply(&network, found, Step { rate: 0.01, count: t, clip, target_rate }).unwrap();
            for i in 0..theta.len() {
                let g = g[i] * scale;
                m[i] = 0.9 * m[i] + 0.1 * g;
                v[i] = 0.999 * v[i] + 0.001 * g * g;
                let (m, v) = (m[i] / (1.0 - 0.9_f64.powi(t as i32)), v[i] / (1.0 - 0.999_f64.powi(t as i32)));
                theta[i] -= 0.01 * m / (v.sqrt() + 1e-8);
                target[i] += target_rate.unwrap_or(0.0) * (theta[i] - target[i]);
            }
        }
        for (which, expected) in [(Row::Online, &theta), (Row::Target, &target), (Row::Mean, &m), (Row::Square, &v)] {
            for (found, expected) in row(&network, which).iter().zip(expected) {
                assert!((f64::from(*found) - expected).abs() < 2e-6, "{which:?}: {found}, expected {expected}");
            }
        }
    }

    #[test]
    fn steps_match_the_textbook() {
        check(0.0, None);
        check(0.0, Some(0.25));
        check(1.5, Some(0.005));
    }

    #[test]
    fn moments_never_become_subnormal() {
        let network = network();
        for (count, size) in std::iter::once(1.0).chain(std::iter::repeat_n(0.0, 900)).enumerate() {
            set_gradient(&network, size, 1);
            apply(&network, 1.0, Step { rate: 0.01, count: count as u64 + 1, clip: 0.0, target_rate: None }).unwrap();
        }
        assert!(row(&network, Row::Mean).iter().all(|m| *m == 0.0));
        assert!(row(&network, Row::Square).iter().all(|v| *v == 0.0 || v.is_normal()));
    }
}
