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
use super::networks::{Network, parameters};
use candle_core::{CpuStorage, InplaceOp2, Layout, Result, Tensor, bail};

const BETA_1: f64 = 0.9;
const BETA_2: f64 = 0.999;
const EPSILON: f32 = 1e-8;
/// Moments smaller than this become 0: numbers below f32's normal range take the slow path of the CPU.
const SMALLEST_MOMENT: f32 = 1e-30;

/// One network's gradient.
#[derive(Debug)]
pub(super) struct Gradient {
    tensors: Vec<Tensor>,
    norm: f32,
}

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

impl Gradient {
    /// Takes the gradients of all weights and biases, in the order of the network's spans.
    pub(super) fn new(tensors: Vec<Tensor>) -> Result<Self> {
        let mut sum = 0.0;
        for tensor in &tensors {
            sum += f64::from(kernels::sum_of_squares(tensor)?);
        }
        Ok(Self { tensors, norm: sum.sqrt() as f32 })
    }

    /// The gradients, in the order of the network's spans.
    #[cfg(test)]
    pub(super) fn tensors(&self) -> &[Tensor] {
        &self.tensors
    }

    /// Euclidean length over all of the network's parameters.
    pub(super) fn norm(&self) -> f32 {
        self.norm
    }
}

/// Moves weights, moments and target copy by one step.
pub(super) fn apply(network: &Network, gradient: &Gradient, step: Step) -> Result<()> {
    let clip = step.clip as f32;
    let adam = Adam {
        stride: parameters(network.spans()),
        start: 0,
        gradient_scale: if clip > 0.0 && gradient.norm > clip { clip / gradient.norm } else { 1.0 },
        rate: (step.rate / (1.0 - power(BETA_1, step.count))) as f32,
        root_scale: (1.0 / (1.0 - power(BETA_2, step.count)).sqrt()) as f32,
        target_rate: step.target_rate.map(|rate| rate as f32),
    };
    for (span, gradient) in network.spans().iter().zip(&gradient.tensors) {
        network.arena().inplace_op2(gradient, &Adam { start: span.start, ..adam })?;
    }
    Ok(())
}

fn power(base: f64, exponent: u64) -> f64 {
    // Both powers are 0 long before the exponent leaves i32.
    base.powi(i32::try_from(exponent).unwrap_or(i32::MAX))
}

/// The step of one weight or bias; the arena's rows are `stride` apart.
#[derive(Clone, Copy)]
struct Adam {
    stride: usize,
    start: usize,
    gradient_scale: f32,
    rate: f32,
    root_scale: f32,
    target_rate: Option<f32>,
}

impl InplaceOp2 for Adam {
    fn name(&self) -> &'static str {
        "adam"
    }

    fn cpu_fwd(&self, arena: &mut CpuStorage, arena_at: &Layout, g: &CpuStorage, g_at: &Layout) -> Result<()> {
        let (arena, g) = (kernels::slice_mut(arena, arena_at)?, kernels::slice(g, g_at)?);
        let mut rows = arena.chunks_exact_mut(self.stride);
        let mut row = || rows.next().map(|row| &mut row[self.start..][..g.len()]);
        let (Some(weights), Some(targets), Some(means), Some(squares)) = (row(), row(), row(), row()) else {
            bail!("an arena without four rows")
        };
        pulp::Arch::new().dispatch(|| {
            self.weights(weights, means, squares, g);
            if let Some(rate) = self.target_rate {
                targets.iter_mut().zip(&*weights).for_each(|(target, weight)| *target += rate * (weight - *target));
            }
        });
        Ok(())
    }
}

impl Adam {
    #[inline]
    fn weights(&self, weights: &mut [f32], means: &mut [f32], squares: &mut [f32], g: &[f32]) {
        let (keep_1, take_1) = (BETA_1 as f32, (1.0 - BETA_1) as f32);
        let (keep_2, take_2) = (BETA_2 as f32, (1.0 - BETA_2) as f32);
        for (((weight, mean), square), g) in weights.iter_mut().zip(means).zip(squares).zip(g) {
            let g = g * self.gradient_scale;
            let (m, v) = (keep_1 * *mean + take_1 * g, keep_2 * *square + take_2 * g * g);
            *mean = if m.abs() < SMALLEST_MOMENT { 0.0 } else { m };
            *square = if v < SMALLEST_MOMENT { 0.0 } else { v };
            *weight -= self.rate * *mean / (square.sqrt() * self.root_scale + EPSILON);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::kernels::Activation;
    use super::super::networks::{Head, Row, tests::random};
    use super::*;
    use herd_common::seed::Seed;

    fn network() -> Network {
        Network::new(&[5, 9, 2], Head { activation: Activation::Linear, init: 0.3 }, Seed::from_number(8)).unwrap()
    }

    fn row(network: &Network, row: Row) -> Vec<f32> {
        network.spans().iter().flat_map(|span| network.read(row, span).unwrap()).collect()
    }

    fn gradient(network: &Network, seed: u64) -> (Gradient, Vec<f64>) {
        let tensors: Vec<Tensor> =
            network.spans().iter().map(|span| random((1, span.len()), seed + span.start as u64)).collect();
        let numbers = tensors.iter().flat_map(|t| t.flatten_all().unwrap().to_vec1::<f32>().unwrap());
        let numbers = numbers.map(f64::from).collect();
        (Gradient::new(tensors).unwrap(), numbers)
    }

    /// Ten steps against the textbook in f64, with or without clipping and a target that follows.
    fn check(clip: f64, target_rate: Option<f64>) {
        let network = network();
        let mut theta: Vec<f64> = row(&network, Row::Online).into_iter().map(f64::from).collect();
        let mut target = theta.clone();
        let (mut m, mut v) = (vec![0.0; theta.len()], vec![0.0; theta.len()]);
        for t in 1..=10_u64 {
            let (gradient, g) = gradient(&network, 100 * t);
            let norm = g.iter().map(|g| g * g).sum::<f64>().sqrt();
            assert!((norm - f64::from(gradient.norm())).abs() < 1e-5 * norm);
            let scale = if clip > 0.0 && norm > clip { clip / norm } else { 1.0 };
            apply(&network, &gradient, Step { rate: 0.01, count: t, clip, target_rate }).unwrap();
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
        let (gradient, _) = gradient(&network, 1);
        let zeros = |g: &Gradient| g.tensors.iter().map(|t| t.zeros_like().unwrap()).collect();
        let zero = Gradient::new(zeros(&gradient)).unwrap();
        apply(&network, &gradient, Step { rate: 0.01, count: 1, clip: 0.0, target_rate: None }).unwrap();
        for count in 2..900 {
            apply(&network, &zero, Step { rate: 0.01, count, clip: 0.0, target_rate: None }).unwrap();
        }
        assert!(row(&network, Row::Mean).iter().all(|m| *m == 0.0));
        assert!(row(&network, Row::Square).iter().all(|v| *v == 0.0 || v.is_normal()));
    }
}
