//! A network on any candle device: forward and backward pass and Adam, in candle's own operations.
//!
//! Symbols are those of `networks` and `optimizer`. The rows θ, θ′, m and v are one tensor each, `[parameters]`; W and b
//! are views into them. Every result is a new tensor, so what an update began with is there until it is known to be
//! finite.

use super::super::kernels::Activation;
use super::super::networks;
use super::super::optimizer::{BETA_1, BETA_2, EPSILON};
use super::super::rows::{Row, Span};
use super::super::snapshot::Stored;
use candle_core::{Device, Result, Tensor};

/// A network, its target copy and moments.
#[derive(Debug)]
pub(super) struct Network {
    spans: Vec<Span>,
    activation: Activation,
    /// In the order of `Row::LASTING`.
    rows: [Tensor; 4],
    /// 1, `[1]`.
    one: Tensor,
}

/// x of every layer, then what the network answers.
pub(super) struct Pass(Vec<Tensor>);

impl Pass {
    /// y of the last layer.
    pub(super) fn output(&self) -> &Tensor {
        self.0.last().expect("a network has a layer")
    }
}

/// How one step is taken; the tensors are `[1]` and stand on the device.
pub(super) struct Step {
    /// Adam's rate, corrected for the mean's start at 0.
    pub(super) rate: Tensor,
    /// The same for the root of the squares.
    pub(super) root_scale: Tensor,
    /// Share of a weight that the step leaves; 1 without decay.
    pub(super) keep: f64,
    /// Largest global gradient norm; 0 for any.
    pub(super) clip: f64,
    /// γ, if the target copy moves too.
    pub(super) target_rate: Option<f64>,
}

impl Network {
    /// A network like this one, all numbers 0.
    pub(super) fn like(model: &networks::Network, device: &Device) -> Result<Self> {
        let (spans, one) = (model.spans().to_vec(), Tensor::new(&[1.0_f32], device)?);
        let row = Tensor::zeros(model.parameters(), one.dtype(), device)?;
        let rows = [row.clone(), row.clone(), row.clone(), row];
        Ok(Self { spans, activation: model.activation(), rows, one })
    }

    /// Replaces all rows by `numbers`, one after the other.
    pub(super) fn overwrite(&mut self, numbers: &[f32]) -> Result<()> {
        let n = numbers.len() / self.rows.len();
        for (row, numbers) in self.rows.iter_mut().zip(numbers.chunks_exact(n)) {
            *row = Tensor::from_slice(numbers, n, row.device())?;
        }
        Ok(())
    }

    /// Carries `x` `[n, inputs]` through the network of this row.
    pub(super) fn forward(&self, row: Row, x: &Tensor) -> Result<Pass> {
        let mut values = vec![x.clone()];
        for layer in 0..self.layers() {
            let weight = self.view(row, 2 * layer)?;
            let sum = values[layer].matmul(&weight)?.broadcast_add(&self.view(row, 2 * layer + 1)?)?;
            values.push(activate(&sum, self.activation_of(layer))?);
        }
        Ok(Pass(values))
    }

    /// δ of every layer of the online network, from the loss's gradient in its output.
    pub(super) fn deltas(&self, pass: &Pass, gradient: &Tensor) -> Result<Vec<Tensor>> {
        let mut deltas = Vec::new();
        let mut gradient = gradient.clone();
        for layer in (0..self.layers()).rev() {
            let delta = slope(&gradient, &pass.0[layer + 1], self.activation_of(layer))?;
            if layer > 0 {
                gradient = delta.matmul(&self.view(Row::Online, 2 * layer)?.t()?)?;
            }
            deltas.push(delta);
        }
        deltas.reverse();
        Ok(deltas)
    }

    /// g, `[parameters]`.
    pub(super) fn gradient(pass: &Pass, deltas: &[Tensor]) -> Result<Tensor> {
        let mut parts = Vec::new();
        for (x, delta) in pass.0.iter().zip(deltas) {
            parts.push(x.t()?.matmul(delta)?.flatten_all()?);
            parts.push(delta.sum(0)?);
        }
        Tensor::cat(&parts, 0)
    }

    /// ∂loss/∂x for the columns from `first_column` on.
    pub(super) fn input_gradient(&self, deltas: &[Tensor], first_column: usize) -> Result<Tensor> {
        let weight = self.view(Row::Online, 0)?;
        let weight = weight.narrow(0, first_column, weight.dim(0)? - first_column)?;
        deltas[0].matmul(&weight.t()?)
    }

    /// Moves weights, moments and target copy by one step along the gradient, whose length is `norm`; where `ok`, `[1]`
    /// of u8, is 0, nothing moves.
    pub(super) fn step(&mut self, gradient: &Tensor, norm: &Tensor, step: &Step, ok: &Tensor) -> Result<()> {
        let [weights, target, mean, square] = &self.rows;
        let gradient = if step.clip > 0.0 {
            let scale = norm.recip()?.affine(step.clip, 0.0)?.minimum(&self.one)?;
            gradient.broadcast_mul(&scale)?
        } else {
            gradient.clone()
        };
        let mean = (mean.affine(BETA_1, 0.0)? + gradient.affine(1.0 - BETA_1, 0.0)?)?;
        let square = (square.affine(BETA_2, 0.0)? + gradient.sqr()?.affine(1.0 - BETA_2, 0.0)?)?;
        let root = square.sqrt()?.broadcast_mul(&step.root_scale)?.affine(1.0, f64::from(EPSILON))?;
        let weights = (weights.affine(step.keep, 0.0)? - (mean.broadcast_mul(&step.rate)? / root)?)?;
        let target = match step.target_rate {
            None => target.clone(),
            Some(rate) => (target + (&weights - target)?.affine(rate, 0.0)?)?,
        };
        let ok = ok.broadcast_as(weights.shape())?;
        for (row, moved) in self.rows.iter_mut().zip([weights, target, mean, square]) {
            *row = ok.where_cond(&moved, row)?;
        }
        Ok(())
    }

    fn layers(&self) -> usize {
        self.spans.len() / 2
    }

    fn activation_of(&self, layer: usize) -> Activation {
        if layer + 1 == self.layers() { self.activation } else { Activation::Relu }
    }

    /// The weight or bias of this number.
    fn view(&self, row: Row, number: usize) -> Result<Tensor> {
        let span = &self.spans[number];
        self.row(row)?.narrow(0, span.start, span.len())?.reshape(span.shape.as_slice())
    }

    fn row(&self, row: Row) -> Result<&Tensor> {
        match self.rows.get(row as usize) {
            Some(row) => Ok(row),
            None => candle_core::bail!("row {row:?} does not last"),
        }
    }
}

impl Stored for Network {
    fn spans(&self) -> &[Span] {
        &self.spans
    }

    fn read(&self, row: Row, span: &Span) -> Result<Vec<f32>> {
        self.row(row)?.narrow(0, span.start, span.len())?.to_vec1()
    }
}

/// Euclidean length of a gradient, `[1]`.
pub(super) fn norm(gradient: &Tensor) -> Result<Tensor> {
    gradient.sqr()?.sum_all()?.sqrt()?.reshape(1)
}

fn activate(sum: &Tensor, activation: Activation) -> Result<Tensor> {
    match activation {
        Activation::Linear => Ok(sum.clone()),
        // candle's ReLU turns NaN into 0, behind which a poisoned weight could hide; its ELU with α = 0 does not.
        Activation::Relu => sum.elu(0.0),
        Activation::Tanh | Activation::OpenTanh => sum.tanh(),
    }
}

/// `gradient · f′` as `Activation::slope` has it, f′ told from f's value y.
fn slope(gradient: &Tensor, y: &Tensor, activation: Activation) -> Result<Tensor> {
    match activation {
        Activation::Linear => Ok(gradient.clone()),
        Activation::Relu => gradient * y.sign()?,
        Activation::Tanh => gradient * y.sqr()?.affine(-1.0, 1.0)?,
        Activation::OpenTanh => {
            let comes_back = (gradient * y)?.relu()?.sign()?;
            gradient * (y.sqr()? * comes_back.affine(1.0, -1.0)?)?.affine(1.0, 1.0)?
        }
    }
}
