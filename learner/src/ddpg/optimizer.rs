//! Adam, gradient clipping and the soft target update, in one pass over a network.
//!
//! | symbol | name | value |
//! |---|---|---|
//! | g | gradient, scaled down to the largest norm | – |
//! | m, v | moments: m ← β₁ m + (1 − β₁) g, v ← β₂ v + (1 − β₂) g² | β₁ = .9, β₂ = .999 |
//! | t | steps taken, this one included | – |
//! | λ | decoupled weight decay | `critic_decay`; the actor's is 0 |
//! | θ | θ ← (1 − rate · λ) θ − rate · (m / (1 − β₁ᵗ)) / (√(v / (1 − β₂ᵗ)) + ε) | ε = 1e-8 |
//! | θ′ | θ′ ← θ′ + γ (θ − θ′), paper eqs 8–9 | γ = `target_rate` |
//!
//! Sources: Kingma & Ba 2015, algorithm 1; Loshchilov & Hutter 2019, algorithm 2 (decay).

#![expect(clippy::inline_always, reason = "vector code must be inlined into the function that has the features")]

use super::networks::Network;
use super::strips::WIDTH;
use pulp::{Simd, WithSimd};

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
    /// λ of decoupled weight decay; 0 for none.
    pub(super) decay: f64,
    /// Largest global gradient norm; 0 for any.
    pub(super) clip: f64,
    /// γ, if the target copy moves too.
    pub(super) target_rate: Option<f64>,
}

/// Moves weights, moments and target copy by one step along the gradient, whose length is `norm`.
pub(super) fn apply(network: &mut Network, norm: f32, step: Step) {
    pulp::Arch::new().dispatch(Adam { network, numbers: Numbers::new(norm, step) });
}

/// rate / (1 − β₁ᵗ)
pub(super) fn corrected_rate(rate: f64, count: u64) -> f32 {
    (rate / (1.0 - power(BETA_1, count))) as f32
}

/// 1 − rate · λ, the share of a weight that a step leaves
pub(super) fn kept(rate: f64, decay: f64) -> f64 {
    1.0 - rate * decay
}

/// 1 / √(1 − β₂ᵗ)
pub(super) fn root_scale(count: u64) -> f32 {
    (1.0 / (1.0 - power(BETA_2, count)).sqrt()) as f32
}

fn power(base: f64, exponent: u64) -> f64 {
    // Both powers are 0 long before the exponent leaves i32.
    base.powi(i32::try_from(exponent).unwrap_or(i32::MAX))
}

/// Every row in one pass. Not a closure: that would be compiled for the oldest CPU.
struct Adam<'a> {
    network: &'a mut Network,
    numbers: Numbers,
}

/// What a step multiplies by.
struct Numbers {
    gradient_scale: f32,
    rate: f32,
    keep: f32,
    root_scale: f32,
    target_rate: Option<f32>,
}

impl WithSimd for Adam<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let [weights, targets, means, squares, gradient] = self.network.rows_mut();
        let lasting = weights.iter_mut().zip(targets).zip(means.iter_mut().zip(squares));
        for (((weights, targets), (means, squares)), gradient) in lasting.zip(gradient) {
            let (weights, _) = S::as_mut_simd_f32s(&mut weights.0);
            let (targets, _) = S::as_mut_simd_f32s(&mut targets.0);
            let (means, _) = S::as_mut_simd_f32s(&mut means.0);
            let (squares, _) = S::as_mut_simd_f32s(&mut squares.0);
            let (gradient, _) = S::as_simd_f32s(&gradient.0);
            for i in 0..WIDTH / S::F32_LANES {
                [weights[i], means[i], squares[i]] =
                    self.numbers.step(simd, [weights[i], means[i], squares[i]], gradient[i]);
                if let Some(rate) = self.numbers.target_rate {
                    let way = simd.sub_f32s(weights[i], targets[i]);
                    targets[i] = simd.add_f32s(targets[i], simd.mul_f32s(simd.splat_f32s(rate), way));
                }
            }
        }
    }
}

impl Numbers {
    fn new(norm: f32, step: Step) -> Self {
        let clip = step.clip as f32;
        Self {
            gradient_scale: if clip > 0.0 && norm > clip { clip / norm } else { 1.0 },
            rate: corrected_rate(step.rate, step.count),
            keep: kept(step.rate, step.decay) as f32,
            root_scale: root_scale(step.count),
            target_rate: step.target_rate.map(|rate| rate as f32),
        }
    }

    /// θ, m and v after the step.
    #[inline(always)]
    fn step<S: Simd>(&self, simd: S, [weight, m, v]: [S::f32s; 3], gradient: S::f32s) -> [S::f32s; 3] {
        let times = |factor: f32, x| simd.mul_f32s(simd.splat_f32s(factor), x);
        let zero = simd.splat_f32s(0.0);
        let smallest = simd.splat_f32s(SMALLEST_MOMENT);
        let g = times(self.gradient_scale, gradient);
        let m = simd.add_f32s(times(BETA_1 as f32, m), times((1.0 - BETA_1) as f32, g));
        let v = simd.add_f32s(times(BETA_2 as f32, v), simd.mul_f32s(times((1.0 - BETA_2) as f32, g), g));
        let m = simd.select_f32s(simd.less_than_f32s(simd.abs_f32s(m), smallest), zero, m);
        let v = simd.select_f32s(simd.less_than_f32s(v, smallest), zero, v);
        let root = simd.add_f32s(times(self.root_scale, simd.sqrt_f32s(v)), simd.splat_f32s(EPSILON));
        let step = simd.div_f32s(times(self.rate, m), root);
        [simd.sub_f32s(times(self.keep, weight), step), m, v]
    }
}

#[cfg(test)]
mod tests {
    use super::super::kernels::Activation;
    use super::super::networks::{Head, tests::random};
    use super::super::rows::Row;
    use super::*;
    use herd_common::seed::Seed;

    fn network() -> Network {
        Network::new(&[5, 300, 2], Head { activation: Activation::Linear, init: 0.3 }, Seed::from_number(8))
    }

    fn row(network: &Network, row: Row) -> Vec<f32> {
        network.spans().iter().flat_map(|span| network.read(row, span)).collect()
    }

    /// Puts random numbers times `size` into the gradient row.
    fn set_gradient(network: &mut Network, size: f32, seed: u64) -> Vec<f64> {
        let numbers: Vec<f32> = random((1, network.parameters()), seed).row(0).iter().map(|x| size * x).collect();
        network.write(Row::Gradient, &numbers);
        numbers.into_iter().map(f64::from).collect()
    }

    /// Ten steps against the textbook in f64, with or without decay, clipping and a target that follows.
    fn check(decay: f64, clip: f64, target_rate: Option<f64>) {
        let mut network = network();
        let mut theta: Vec<f64> = row(&network, Row::Online).into_iter().map(f64::from).collect();
        let mut target = theta.clone();
        let (mut m, mut v) = (vec![0.0; theta.len()], vec![0.0; theta.len()]);
        for t in 1..=10_u64 {
            let g = set_gradient(&mut network, 1.0, 100 + t);
            let length = g.iter().map(|g| g * g).sum::<f64>().sqrt();
            let scale = if clip > 0.0 && length > clip { clip / length } else { 1.0 };
            apply(&mut network, length as f32, Step { rate: 0.01, count: t, decay, clip, target_rate });
            for i in 0..theta.len() {
                let g = g[i] * scale;
                m[i] = 0.9 * m[i] + 0.1 * g;
                v[i] = 0.999 * v[i] + 0.001 * g * g;
                let (m, v) = (m[i] / (1.0 - 0.9_f64.powi(t as i32)), v[i] / (1.0 - 0.999_f64.powi(t as i32)));
                theta[i] -= 0.01 * (m / (v.sqrt() + 1e-8) + decay * theta[i]);
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
        check(0.0, 0.0, None);
        check(0.0, 0.0, Some(0.25));
        check(0.0, 1.5, Some(0.005));
        check(2.0, 1.5, Some(0.005));
    }

    #[test]
    fn narrower_registers_give_the_same_bits() {
        let [mut widest, mut single] = [network(), network()];
        for count in 1..=3 {
            let norm = 1.5;
            set_gradient(&mut widest, 0.3, count);
            set_gradient(&mut single, 0.3, count);
            let step = Step { rate: 0.01, count, decay: 0.1, clip: 1.0, target_rate: Some(0.05) };
            apply(&mut widest, norm, step);
            pulp::Scalar::new().vectorize(Adam { network: &mut single, numbers: Numbers::new(norm, step) });
        }
        for lasting in Row::LASTING {
            assert_eq!(row(&widest, lasting), row(&single, lasting), "{lasting:?}");
        }
    }

    #[test]
    fn moments_never_become_subnormal() {
        let mut network = network();
        for (count, size) in std::iter::once(1.0).chain(std::iter::repeat_n(0.0, 900)).enumerate() {
            set_gradient(&mut network, size, 1);
            let count = count as u64 + 1;
            apply(&mut network, 1.0, Step { rate: 0.01, count, decay: 0.0, clip: 0.0, target_rate: None });
        }
        assert!(row(&network, Row::Mean).iter().all(|m| *m == 0.0));
        assert!(row(&network, Row::Square).iter().all(|v| *v == 0.0 || v.is_normal()));
    }
}
