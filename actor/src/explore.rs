//! Exploration: what is added to a policy's actions while it learns.
//!
//! Gaussian noise `action = clip(policy + n)`, with `n ← κ n + √(1 − κ²) σ N(0, 1)`: κ, the share of the last noise
//! kept, makes it smooth without changing its spread σ (κ = 0: white). Warm-up acts uniformly in the box instead.

use herd_common::seed::Seed;
use rand::{Rng, RngExt};
use rand_distr::{Distribution, StandardNormal};

/// What is done to a policy's actions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Exploration {
    /// Nothing: evaluation.
    None,
    /// Gaussian noise.
    Gaussian {
        /// σ, in units of the action box's half width.
        sigma: f64,
        /// κ, share of the last decision's noise kept.
        smoothing: f64,
    },
    /// The policy is not asked: uniform in the box.
    Uniform,
}

/// Explores through one episode.
pub struct Explorer<R> {
    exploration: Exploration,
    noise: Vec<f64>,
    rng: R,
}

/// An explorer whose randomness descends from this (episode's) seed.
pub fn explorer(exploration: Exploration, seed: Seed) -> Explorer<impl Rng> {
    Explorer { exploration, noise: Vec::new(), rng: seed.child("explore", 0).rng() }
}

impl<R: Rng> Explorer<R> {
    /// Changes an action of the policy in place.
    pub fn apply(&mut self, action: &mut [f32]) {
        match self.exploration {
            Exploration::None => {}
            Exploration::Uniform => {
                for x in action {
                    *x = 2.0 * self.rng.random::<f32>() - 1.0;
                }
            }
            Exploration::Gaussian { sigma, smoothing } => {
                let fresh = (1.0 - smoothing * smoothing).sqrt();
                let first = self.noise.is_empty();
                self.noise.resize(action.len(), 0.0);
                for (x, noise) in action.iter_mut().zip(&mut self.noise) {
                    let normal: f64 = StandardNormal.sample(&mut self.rng);
                    *noise = if first { sigma * normal } else { smoothing * *noise + fresh * sigma * normal };
                    *x = (*x + *noise as f32).clamp(-1.0, 1.0);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn actions(exploration: Exploration, seed: u64, count: usize) -> Vec<f32> {
        let mut explorer = explorer(exploration, Seed::from_number(seed));
        (0..count)
            .flat_map(|_| {
                let mut action = [0.0, 0.25];
                explorer.apply(&mut action);
                action
            })
            .collect()
    }

    #[test]
    fn equal_seeds_give_equal_noise() {
        let gaussian = Exploration::Gaussian { sigma: 0.3, smoothing: 0.5 };
        assert_eq!(actions(gaussian, 1, 20), actions(gaussian, 1, 20));
        assert_ne!(actions(gaussian, 1, 20), actions(gaussian, 2, 20));
        assert_eq!(actions(Exploration::None, 1, 1), [0.0, 0.25]);
    }

    #[test]
    fn noise_has_its_spread_whatever_is_kept() {
        for smoothing in [0.0, 0.85] {
            let actions = actions(Exploration::Gaussian { sigma: 0.1, smoothing }, 3, 20_000);
            let first: Vec<f64> = actions.iter().step_by(2).map(|x| f64::from(*x)).collect();
            let spread = (first.iter().map(|x| x * x).sum::<f64>() / first.len() as f64).sqrt();
            assert!((spread - 0.1).abs() < 0.01, "{smoothing}: {spread}");
            let kept = first.windows(2).map(|pair| pair[0] * pair[1]).sum::<f64>() / first.len() as f64 / 0.01;
            assert!((kept - smoothing).abs() < 0.05, "{smoothing}: {kept}");
        }
    }

    #[test]
    fn actions_stay_in_the_box_and_warm_up_fills_it() {
        for exploration in [Exploration::Gaussian { sigma: 2.0, smoothing: 0.0 }, Exploration::Uniform] {
            let actions = actions(exploration, 4, 1000);
            assert!(actions.iter().all(|x| (-1.0..=1.0).contains(x)));
            assert!(actions.iter().any(|x| *x < -0.9) && actions.iter().any(|x| *x > 0.9));
        }
    }
}
