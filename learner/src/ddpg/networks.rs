//! A fully connected network, its target copy, gradient and moments: five rows of one candle tensor.
//!
//! | symbol | name | shape |
//! |---|---|---|
//! | θ, θ′, m, v, g | weights, target weights, Adam's moments, gradient | `[parameters]` each, the rows of `arena` |
//! | W, b | weight and bias of a layer, views into a row | `[inputs, outputs]`, `[outputs]` |
//! | x, y | input and output of a layer, y = f(x W + b) | `[batch, inputs]`, `[batch, outputs]` |
//! | δ | ∂loss/∂(x W + b) | `[batch, outputs]` |
//!
//! Hidden layers are ReLU. W stands input-major, so that the forward pass, of which there are most, need not turn it
//! over. No graph is recorded: `deltas`, `gradients` and `input_gradient` are the backward pass.

use super::kernels::{Activation, Slope, SumRows, write};
use super::product::product;
use super::tile::Finish;
use candle_core::{DType, Device, Result, Tensor};
use herd_common::seed::Seed;
use rand::{Rng, RngExt};

/// The rows of a network's arena.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Row {
    /// θ, what is learned.
    Online,
    /// θ′, which follows slowly.
    Target,
    /// m, Adam's mean of gradients.
    Mean,
    /// v, Adam's mean of squared gradients.
    Square,
    /// g, of the last backward pass; means nothing between updates.
    Gradient,
}

impl Row {
    /// Rows of an arena.
    pub(super) const COUNT: usize = 5;
    /// The rows that last from one update to the next, in the order of the arena.
    pub(super) const LASTING: [Self; 4] = [Self::Online, Self::Target, Self::Mean, Self::Square];

    /// The name in snapshots.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Online => "online",
            Self::Target => "target",
            Self::Mean => "mean",
            Self::Square => "square",
            Self::Gradient => "gradient",
        }
    }
}

/// One weight or bias: where it stands in a row, and its shape there.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Span {
    /// Such as `0.weight`.
    pub(super) name: String,
    /// First number within the row.
    pub(super) start: usize,
    /// `[inputs, outputs]` or `[outputs]`.
    pub(super) shape: Vec<usize>,
}

impl Span {
    /// Numbers in it.
    pub(super) fn len(&self) -> usize {
        self.shape.iter().product()
    }
}

/// What the last layer and the start look like.
#[derive(Clone, Copy, Debug)]
pub(super) struct Head {
    /// Activation of the last layer.
    pub(super) activation: Activation,
    /// The last layer starts uniform within ± this.
    pub(super) init: f64,
}

#[derive(Debug)]
struct Layer {
    weight: Tensor,
    bias: Tensor,
    activation: Activation,
}

/// A network, its target copy, gradient and moments.
#[derive(Debug)]
pub(super) struct Network {
    arena: Tensor,
    spans: Vec<Span>,
    online: Vec<Layer>,
    target: Vec<Layer>,
    gradient: Vec<Layer>,
}

/// What one batch makes of a network on its way forth and back. The tensors are written again and again.
#[derive(Debug)]
pub(super) struct Pass {
    /// y of every layer.
    outputs: Vec<Tensor>,
    /// δ of every layer.
    deltas: Vec<Tensor>,
}

impl Pass {
    /// Room for `rows` rows of a network of these widths (input first).
    fn new(widths: &[usize], rows: usize) -> Result<Self> {
        let fresh = |width: &usize| Tensor::zeros((rows, *width), DType::F32, &Device::Cpu);
        let tensors = || widths[1..].iter().map(fresh).collect::<Result<Vec<_>>>();
        Ok(Self { outputs: tensors()?, deltas: tensors()? })
    }

    /// y of the last layer: what the network answers.
    pub(super) fn output(&self) -> &Tensor {
        self.outputs.last().expect("a network has a layer")
    }

    /// Where the loss's gradient in the output is to be written before `Network::deltas`.
    pub(super) fn output_gradient(&self) -> &Tensor {
        self.deltas.last().expect("a network has a layer")
    }
}

impl Network {
    /// A network of these widths (input first): uniform within ±1/√inputs, the last layer within ±`head.init`.
    pub(super) fn new(widths: &[usize], head: Head, seed: Seed) -> Result<Self> {
        assert!(widths.len() >= 2, "a network has an input and an output");
        let spans = spans(widths);
        let last = widths.len() - 2;
        let mut rng = seed.rng();
        let mut row = Vec::new();
        for (i, span) in spans.iter().enumerate() {
            let layer = i / 2;
            let bound = if layer == last { head.init } else { 1.0 / (widths[layer] as f64).sqrt() };
            row.extend((0..span.len()).map(|_| uniform(bound as f32, &mut rng)));
        }
        let n = row.len();
        let mut numbers = row.repeat(2);
        numbers.resize(Row::COUNT * n, 0.0);
        let arena = Tensor::from_vec(numbers, Row::COUNT * n, &Device::Cpu)?;
        let layers = |row| layers(&arena, &spans, row, head.activation);
        let (online, target, gradient) = (layers(Row::Online)?, layers(Row::Target)?, layers(Row::Gradient)?);
        Ok(Self { arena, spans, online, target, gradient })
    }

    /// The weights and biases in order, input first.
    pub(super) fn spans(&self) -> &[Span] {
        &self.spans
    }

    /// What follows the last layer's sum.
    pub(super) fn activation(&self) -> Activation {
        self.online.last().expect("a network has a layer").activation
    }

    /// All rows in one tensor, `[COUNT · parameters]`.
    pub(super) fn arena(&self) -> &Tensor {
        &self.arena
    }

    /// Numbers in one row.
    pub(super) fn parameters(&self) -> usize {
        parameters(&self.spans)
    }

    /// The numbers of one weight or bias.
    pub(super) fn read(&self, row: Row, span: &Span) -> Result<Vec<f32>> {
        view(&self.arena, self.parameters(), row, span)?.flatten_all()?.to_vec1()
    }

    /// Replaces the first rows by `numbers`; the rest of the arena becomes 0.
    pub(super) fn overwrite(&self, numbers: &[f32]) -> Result<()> {
        write(&self.arena, |arena| {
            let (first, rest) = arena.split_at_mut(numbers.len());
            first.copy_from_slice(numbers);
            rest.fill(0.0);
        })
    }

    /// Room for passes of `rows` rows.
    pub(super) fn pass(&self, rows: usize) -> Result<Pass> {
        let input = self.spans[0].shape[0];
        let outputs = self.spans.iter().skip(1).step_by(2).map(Span::len);
        Pass::new(&std::iter::once(input).chain(outputs).collect::<Vec<_>>(), rows)
    }

    /// Carries `x` `[rows of the pass, inputs]` through the network of this row.
    pub(super) fn forward(&self, row: Row, x: &Tensor, pass: &Pass) -> Result<()> {
        let layers = if row == Row::Target { &self.target } else { &self.online };
        let mut x = x;
        for (layer, y) in layers.iter().zip(&pass.outputs) {
            product(y, x, &layer.weight, Finish::Bias(&layer.bias, layer.activation))?;
            x = y;
        }
        Ok(())
    }

    /// δ of every layer of the online network, from the loss's gradient that stands in `pass.output_gradient()`.
    pub(super) fn deltas(&self, pass: &Pass) -> Result<()> {
        let last = self.online.last().expect("a network has a layer");
        pass.output_gradient().inplace_op2(pass.output(), &Slope(last.activation))?;
        for (i, pair) in self.online.windows(2).enumerate().rev() {
            let slope = Finish::Slope(&pass.outputs[i], pair[0].activation);
            product(&pass.deltas[i], &pass.deltas[i + 1], &pair[1].weight.t()?, slope)?;
        }
        Ok(())
    }

    /// Writes the gradient of every weight and bias into its row, from a pass that began with `x`.
    pub(super) fn gradients(&self, x: &Tensor, pass: &Pass) -> Result<()> {
        let inputs = std::iter::once(x).chain(&pass.outputs);
        for ((input, delta), gradient) in inputs.zip(&pass.deltas).zip(&self.gradient) {
            product(&gradient.weight, &input.t()?, delta, Finish::Nothing)?;
            gradient.bias.inplace_op2(delta, &SumRows)?;
        }
        Ok(())
    }

    /// ∂loss/∂x for the columns from `first_column` on, into `gradient`.
    pub(super) fn input_gradient(&self, pass: &Pass, first_column: usize, gradient: &Tensor) -> Result<()> {
        let weight = &self.online[0].weight;
        let weight = weight.narrow(0, first_column, weight.dim(0)? - first_column)?;
        product(gradient, &pass.deltas[0], &weight.t()?, Finish::Nothing)
    }
}

fn parameters(spans: &[Span]) -> usize {
    spans.iter().map(Span::len).sum()
}

fn spans(widths: &[usize]) -> Vec<Span> {
    let mut spans: Vec<Span> = Vec::new();
    for (i, pair) in widths.windows(2).enumerate() {
        for (kind, shape) in [("weight", vec![pair[0], pair[1]]), ("bias", vec![pair[1]])] {
            spans.push(Span { name: format!("{i}.{kind}"), start: parameters(&spans), shape });
        }
    }
    spans
}

fn view(arena: &Tensor, parameters: usize, row: Row, span: &Span) -> Result<Tensor> {
    arena.narrow(0, row as usize * parameters + span.start, span.len())?.reshape(span.shape.as_slice())
}

fn layers(arena: &Tensor, spans: &[Span], row: Row, last: Activation) -> Result<Vec<Layer>> {
    let count = spans.len() / 2;
    let view = |span| view(arena, parameters(spans), row, span);
    spans
        .chunks_exact(2)
        .enumerate()
        .map(|(i, pair)| {
            let activation = if i + 1 == count { last } else { Activation::Relu };
            Ok(Layer { weight: view(&pair[0])?, bias: view(&pair[1])?, activation })
        })
        .collect()
}

fn uniform(bound: f32, rng: &mut impl Rng) -> f32 {
    bound * rng.random_range(-1.0_f32..=1.0)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use candle_core::Var;

    /// The online network by candle's own recorded operations.
    pub(crate) fn recorded_forward(vars: &[Var], x: &Tensor, last: Activation) -> Tensor {
        let count = vars.len() / 2;
        let mut x = x.clone();
        for (i, pair) in vars.chunks_exact(2).enumerate() {
            x = x.matmul(&pair[0]).unwrap().broadcast_add(&pair[1]).unwrap();
            x = match if i + 1 == count { last } else { Activation::Relu } {
                Activation::Linear => x,
                Activation::Relu => x.relu().unwrap(),
                Activation::Tanh | Activation::OpenTanh => x.tanh().unwrap(),
            };
        }
        x
    }

    /// The online weights as variables of candle's autograd.
    pub(crate) fn variables(network: &Network) -> Vec<Var> {
        tensors(network, Row::Online).iter().map(|tensor| Var::from_tensor(tensor).unwrap()).collect()
    }

    /// A copy of a row's weights and biases.
    pub(crate) fn tensors(network: &Network, row: Row) -> Vec<Tensor> {
        let tensor = |span: &Span| {
            Tensor::from_vec(network.read(row, span).unwrap(), span.shape.as_slice(), &Device::Cpu).unwrap()
        };
        network.spans().iter().map(tensor).collect()
    }

    /// Fails unless `found` is within 1e-4 of `expected`, relative to its largest number.
    #[track_caller]
    pub(crate) fn assert_close(what: &str, found: &Tensor, expected: &Tensor) {
        let numbers = |t: &Tensor| t.flatten_all().unwrap().to_vec1::<f32>().unwrap();
        let (found, expected) = (numbers(found), numbers(expected));
        assert_eq!(found.len(), expected.len(), "{what}");
        let scale = expected.iter().fold(0.0_f32, |a, b| a.max(b.abs()));
        assert!(scale > 0.0, "{what} is all zero, which tests nothing");
        for (i, (f, e)) in found.iter().zip(&expected).enumerate() {
            assert!((f - e).abs() <= 1e-4 * scale, "{what}[{i}] is {f}, candle's is {e} (scale {scale})");
        }
    }

    pub(crate) fn random(shape: (usize, usize), seed: u64) -> Tensor {
        let mut rng = Seed::from_number(seed).rng();
        let numbers: Vec<f32> = (0..shape.0 * shape.1).map(|_| uniform(1.0, &mut rng)).collect();
        Tensor::from_vec(numbers, shape, &Device::Cpu).unwrap()
    }

    fn check(widths: &[usize], activation: Activation, batch: usize) {
        let network = Network::new(widths, Head { activation, init: 0.5 }, Seed::from_number(3)).unwrap();
        let (inputs, outputs) = (widths[0], widths[widths.len() - 1]);
        let x = Var::from_tensor(&random((batch, inputs), 4)).unwrap();
        let factor = random((batch, outputs), 5);
        let vars = variables(&network);
        let y = recorded_forward(&vars, &x, activation);
        let store = (y.clone() * &factor).unwrap().sum_all().unwrap().backward().unwrap();

        let pass = network.pass(batch).unwrap();
        network.forward(Row::Online, x.as_tensor(), &pass).unwrap();
        assert_close("output", pass.output(), &y);
        pass.output_gradient().slice_set(&factor, 0, 0).unwrap();
        network.deltas(&pass).unwrap();
        network.gradients(x.as_tensor(), &pass).unwrap();
        let gradients = tensors(&network, Row::Gradient);
        for ((span, gradient), var) in network.spans().iter().zip(&gradients).zip(&vars) {
            assert_close(&span.name, gradient, store.get(var).unwrap());
        }
        let input = store.get(&x).unwrap();
        let input_gradient = |column| {
            let found = Tensor::zeros((batch, inputs - column), DType::F32, &Device::Cpu).unwrap();
            network.input_gradient(&pass, column, &found).unwrap();
            found
        };
        assert_close("input", &input_gradient(0), input);
        assert_close("last columns", &input_gradient(1), &input.narrow(1, 1, inputs - 1).unwrap());
    }

    #[test]
    fn backward_matches_autograd() {
        check(&[5, 7, 6, 3], Activation::Tanh, 4);
        check(&[6, 33, 1], Activation::Linear, 9);
        check(&[60, 128, 64, 1], Activation::Linear, 64);
        check(&[3, 2], Activation::Tanh, 5);
    }

    #[test]
    fn starts_within_bounds_with_an_equal_target() {
        let head = Head { activation: Activation::Tanh, init: 3e-3 };
        let network = Network::new(&[16, 100, 10, 2], head, Seed::from_number(1)).unwrap();
        for (i, span) in network.spans().iter().enumerate() {
            let bound = [0.25, 0.1, 3e-3][i / 2];
            let online = network.read(Row::Online, span).unwrap();
            let largest = online.iter().fold(0.0_f32, |a, b| a.max(b.abs()));
            assert!(largest <= bound && largest > 0.5 * bound, "{}: {largest} of {bound}", span.name);
            assert_eq!(network.read(Row::Target, span).unwrap(), online);
            assert!(network.read(Row::Mean, span).unwrap().iter().all(|m| *m == 0.0));
        }
        let other = Network::new(&[16, 100, 10, 2], head, Seed::from_number(2)).unwrap();
        let first = &network.spans()[0];
        assert_ne!(other.read(Row::Online, first).unwrap(), network.read(Row::Online, first).unwrap());
    }
}
