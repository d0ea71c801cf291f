//! The losses of DDPG as pure functions of candle tensors, with the gradients that the backward pass starts from.
//!
//! | symbol | name | shape |
//! |---|---|---|
//! | q | values of the batch, Q(s, a) or Q(s, π(s)) | `[n, 1]` |
//! | y | targets | `[n, 1]` |
//! | w | weights of the transitions, 1 unless replay is prioritised | `[n, 1]` |
//! | r, γ | rewards, discounts (0 after a true ending) | `[n, 1]` |
//!
//! Source: paper eqs 6 and 7. The minimum over two critics, where there are two, is taken before these functions.

use candle_core::{Result, Tensor};

/// y = r + γ Q′(s′, π′(s′)).
pub(super) fn targets(rewards: &Tensor, discounts: &Tensor, next_values: &Tensor) -> Result<Tensor> {
    rewards + (discounts * next_values)?
}

/// Eq 6, weighted: J(θ_Q) = 1/n Σ w (y − q)², a scalar.
pub(super) fn critic(values: &Tensor, targets: &Tensor, weights: &Tensor) -> Result<Tensor> {
    ((targets - values)?.sqr()? * weights)?.mean_all()
}

/// ∂J/∂q = 2 w (q − y) / n.
pub(super) fn critic_gradient(values: &Tensor, targets: &Tensor, weights: &Tensor) -> Result<Tensor> {
    ((values - targets)? * weights)?.affine(2.0 / values.elem_count() as f64, 0.0)
}

/// Eq 7 as a loss: −1/n Σ Q(s, π(s)), a scalar; its gradient in θ_π is minus eq 7's.
pub(super) fn actor(values: &Tensor) -> Result<Tensor> {
    values.mean_all()?.neg()
}

/// The gradient of `actor` in q: −1/n each.
pub(super) fn actor_gradient(values: &Tensor) -> Result<Tensor> {
    values.ones_like()?.affine(-1.0 / values.elem_count() as f64, 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::{Device, Var};

    fn column(values: [f32; 2]) -> Tensor {
        Tensor::from_slice(&values, (2, 1), &Device::Cpu).unwrap()
    }

    fn numbers(tensor: &Tensor) -> Vec<f32> {
        tensor.flatten_all().unwrap().to_vec1().unwrap()
    }

    fn scalar(tensor: &Tensor) -> f32 {
        tensor.to_scalar().unwrap()
    }

    #[test]
    fn two_samples_by_hand() {
        // The second transition ended: its next value must not count.
        let y = targets(&column([1.0, -3.0]), &column([0.5, 0.0]), &column([4.0, 1000.0])).unwrap();
        assert_eq!(numbers(&y), [3.0, -3.0]);
        let (q, one) = (column([2.5, 1.0]), column([1.0, 1.0]));
        assert_eq!(scalar(&critic(&q, &y, &one).unwrap()), 8.125);
        assert_eq!(scalar(&critic(&q, &y, &one).unwrap()), scalar(&candle_nn::loss::mse(&q, &y).unwrap()));
        assert_eq!(numbers(&critic_gradient(&q, &y, &one).unwrap()), [-0.5, 4.0]);
        assert_eq!(scalar(&critic(&q, &y, &column([1.0, 0.5])).unwrap()), 4.125);
        assert_eq!(scalar(&actor(&q).unwrap()), -1.75);
        assert_eq!(numbers(&actor_gradient(&q).unwrap()), [-0.5, -0.5]);
    }

    #[test]
    fn gradients_match_differences_and_autograd() {
        let (q, y, w) = ([2.5_f32, 1.0], column([3.0, -3.0]), column([1.0, 0.25]));
        let gradients =
            [critic_gradient(&column(q), &y, &w).unwrap(), actor_gradient(&column(q)).unwrap()].map(|g| numbers(&g));
        let losses: [&dyn Fn(&Tensor) -> Tensor; 2] = [&|q| critic(q, &y, &w).unwrap(), &|q| actor(q).unwrap()];
        for (loss, gradient) in losses.iter().zip(&gradients) {
            let var = Var::from_tensor(&column(q)).unwrap();
            assert_eq!(&numbers(loss(&var).backward().unwrap().get(&var).unwrap()), gradient);
            for i in 0..2 {
                let at = |h: f32| {
                    let mut shifted = q;
                    shifted[i] += h;
                    scalar(&loss(&column(shifted)))
                };
                let difference = (at(0.125) - at(-0.125)) / 0.25;
                assert!((difference - gradient[i]).abs() < 1e-4, "{difference} against {}", gradient[i]);
            }
        }
    }
}
