//! A fully connected network, its target copy, gradient and moments.
//!
//! | symbol | name | shape |
//! |---|---|---|
//! | θ, θ′, m, v, g | weights, target weights, Adam's moments, gradient | rows of pieces, all laid out alike |
//! | W, b | weight and bias of a layer, pieces of a row | `[outputs, inputs]`, `[outputs]` |
//! | x, y | input and output of a layer, y = f(W x + b); a column is a transition | `[inputs, batch]`, `[outputs, batch]` |
//! | δ | ∂loss/∂(W x + b) | `[outputs, batch]` |
//!
//! Hidden layers are ReLU. All stand in strips: so W x and Wᵀ δ read their factors as they are, and only δ xᵀ wants x
//! turned over. No graph is recorded: `deltas`, `gradients` and `input_gradient` are the way back. Outside, a weight is
//! `[inputs, outputs]`, as spans have it.

use super::kernels::{Activation, add_squares, sum, sum_columns};
use super::product::product;
use super::rows::{Row, Span, parameters, spans};
use super::strips::{Matrix, Piece, Strips, WIDTH, pieces, turn_strip};
use super::tile::{Finish, Plain, Turned};
use herd_common::seed::Seed;
use rand::{Rng, RngExt};
use std::ops::Range;

/// What the last layer and the start look like.
#[derive(Clone, Copy, Debug)]
pub(super) struct Head {
    /// Activation of the last layer.
    pub(super) activation: Activation,
    /// The last layer starts uniform within ± this.
    pub(super) init: f64,
}

/// Where a layer stands in a row, and what follows its sum.
#[derive(Clone, Debug)]
struct Layer {
    inputs: usize,
    outputs: usize,
    weight: Range<usize>,
    bias: Range<usize>,
    activation: Activation,
}

impl Layer {
    fn weight<'a>(&self, row: &'a [Piece]) -> Matrix<'a> {
        Matrix::new(&row[self.weight.clone()], self.outputs, self.inputs)
    }

    /// `y ← f(W x + b)`
    fn forward(&self, row: &[Piece], x: Matrix<'_>, y: &mut [Piece]) {
        product(y, Plain(self.weight(row)), x, Finish::Bias(&row[self.bias.clone()], self.activation));
    }
}

/// A network, its target copy, gradient and moments.
#[derive(Debug)]
pub(super) struct Network {
    spans: Vec<Span>,
    layers: Vec<Layer>,
    /// By `Row`; what is beyond the last input or output is 0.
    rows: [Vec<Piece>; Row::COUNT],
}

/// What one batch makes of a network on its way forth and back. The matrices are written again and again.
#[derive(Debug)]
pub(super) struct Pass {
    /// y of every layer; δ takes its place on the way back, for half of the memory stays in nearer caches.
    layers: Vec<Strips>,
}

impl Pass {
    /// y of the last layer, what the network answers, until the way back begins.
    pub(super) fn output(&self) -> &Strips {
        self.layers.last().expect("a network has a layer")
    }
}

impl Network {
    /// A network of these widths (input first): uniform within ±1/√inputs, the last layer within ±`head.init`.
    pub(super) fn new(widths: &[usize], head: Head, seed: Seed) -> Self {
        assert!(widths.len() >= 2, "a network has an input and an output");
        let (spans, layers) = (spans(widths), layers(widths, head.activation));
        let last = widths.len() - 2;
        let mut rng = seed.rng();
        let mut numbers = Vec::new();
        for (i, span) in spans.iter().enumerate() {
            let layer = i / 2;
            let bound = if layer == last { head.init } else { 1.0 / (widths[layer] as f64).sqrt() };
            numbers.extend((0..span.len()).map(|_| uniform(bound as f32, &mut rng)));
        }
        let row = vec![Piece::ZERO; layers.last().map_or(0, |layer| layer.bias.end)];
        let mut network = Self { spans, layers, rows: std::array::from_fn(|_| row.clone()) };
        network.write(Row::Online, &numbers);
        network.write(Row::Target, &numbers);
        network
    }

    /// The weights and biases in order, input first.
    pub(super) fn spans(&self) -> &[Span] {
        &self.spans
    }

    /// What follows the last layer's sum.
    fn activation(&self) -> Activation {
        self.layers.last().expect("a network has a layer").activation
    }

    /// The pieces of a row.
    pub(super) fn row(&self, row: Row) -> &[Piece] {
        &self.rows[row as usize]
    }

    /// All rows, to be written.
    pub(super) fn rows_mut(&mut self) -> &mut [Vec<Piece>; Row::COUNT] {
        &mut self.rows
    }

    /// Numbers in one row.
    pub(super) fn parameters(&self) -> usize {
        parameters(&self.spans)
    }

    /// The numbers of one weight or bias.
    pub(super) fn read(&self, row: Row, span: &Span) -> Vec<f32> {
        let (row, number) = (self.row(row), self.spans.iter().position(|s| s == span).expect("a span of the network"));
        let layer = &self.layers[number / 2];
        if number % 2 == 1 {
            let bias = Matrix::new(&row[layer.bias.clone()], 1, layer.outputs);
            return (0..layer.outputs).map(|output| bias.at(0, output)).collect();
        }
        let weight = layer.weight(row);
        (0..layer.inputs).flat_map(|input| (0..layer.outputs).map(move |output| weight.at(output, input))).collect()
    }

    /// Replaces a row by the numbers of all weights and biases.
    pub(super) fn write(&mut self, row: Row, numbers: &[f32]) {
        assert_eq!(numbers.len(), self.parameters(), "numbers of a row");
        let row = &mut self.rows[row as usize];
        let mut rest = numbers;
        for layer in &self.layers {
            let weight;
            (weight, rest) = rest.split_at(layer.inputs * layer.outputs);
            for (input, numbers) in weight.chunks_exact(layer.outputs).enumerate() {
                let strip = &mut row[layer.weight.start + input / WIDTH * layer.outputs..];
                strip.iter_mut().zip(numbers).for_each(|(piece, number)| piece.0[input % WIDTH] = *number);
            }
            let bias;
            (bias, rest) = rest.split_at(layer.outputs);
            for (piece, numbers) in row[layer.bias.clone()].iter_mut().zip(bias.chunks(WIDTH)) {
                piece.0[..numbers.len()].copy_from_slice(numbers);
            }
        }
    }

    /// Replaces the lasting rows by `numbers`, one after the other.
    pub(super) fn overwrite(&mut self, numbers: &[f32]) {
        for (row, numbers) in Row::LASTING.into_iter().zip(numbers.chunks_exact(self.parameters())) {
            self.write(row, numbers);
        }
    }

    /// Room for passes of `batch` transitions.
    pub(super) fn pass(&self, batch: usize) -> Pass {
        Pass { layers: self.layers.iter().map(|layer| Strips::new(layer.outputs, batch)).collect() }
    }

    /// Carries `x` through the online network; what x has below the first layer's inputs is not read.
    ///
    /// Strips outside, layers inside: what a layer gives is still near when the next one reads it.
    pub(super) fn forward(&self, x: &Strips, pass: &mut Pass) {
        let row = self.row(Row::Online);
        for (strip, x) in x.view().strips().enumerate() {
            for (i, layer) in self.layers.iter().enumerate() {
                let (before, from_here) = pass.layers.split_at_mut(i);
                let x = before.last().map_or(x, |y| y.strip(strip));
                layer.forward(row, x, from_here[0].strip_mut(strip));
            }
        }
    }

    /// What the network of this row makes of `x`, read as by `forward`; keeps nothing else.
    pub(super) fn answer(&self, row: Row, x: &Strips) -> Strips {
        let row = self.row(row);
        let outputs = |layer: &Layer| layer.outputs;
        let mut answer = Strips::new(self.layers.last().map_or(0, outputs), x.columns());
        let widest = self.layers.iter().map(outputs).max().unwrap_or(0);
        let [mut y, mut next] = [vec![Piece::ZERO; widest], vec![Piece::ZERO; widest]];
        for (strip, x) in x.view().strips().enumerate() {
            let mut inputs = x;
            for layer in &self.layers {
                layer.forward(row, inputs, &mut next[..layer.outputs]);
                std::mem::swap(&mut y, &mut next);
                inputs = Matrix { pieces: &y[..layer.outputs], rows: layer.outputs, columns: x.columns };
            }
            answer.strip_mut(strip).copy_from_slice(inputs.pieces);
        }
        answer
    }

    /// The way back from a forward pass: δ of every layer takes the place of y. `gradient` is the loss's in the output.
    pub(super) fn deltas(&self, pass: &mut Pass, gradient: &Strips) {
        self.last_delta(pass, gradient);
        for strip in 0..gradient.columns().div_ceil(WIDTH) {
            (1..self.layers.len()).rev().for_each(|layer| self.delta_before(layer, pass, strip));
        }
    }

    /// As `deltas`, and writes the gradient of every weight and bias into its row; gives the length of them all.
    ///
    /// `turned` is xᵀ of the forward pass, with 0 beyond its last column: so is the gradient then, which is summed and
    /// moved whole. What a layer reads is turned over strip by strip in `room`, which stays in the nearest cache.
    pub(super) fn gradients(
        &mut self,
        turned: Matrix<'_>,
        pass: &mut Pass,
        gradient: &Strips,
        room: &mut [Piece],
    ) -> f32 {
        debug_assert!(turned.is_padded_with_zeros(), "the gradient would have numbers beyond its last input");
        self.last_delta(pass, gradient);
        let mut squares = Piece::ZERO;
        for i in (0..self.layers.len()).rev() {
            let (before, from_here) = pass.layers.split_at_mut(i);
            let (layer, delta) = (&self.layers[i], from_here[0].view());
            let row = &mut self.rows[Row::Gradient as usize];
            for (strip, to) in row[layer.weight.clone()].chunks_exact_mut(layer.outputs).enumerate() {
                let input = before.last().map_or_else(|| turned.strip(strip), |y| turn_strip(room, y, strip));
                product(to, Plain(delta), input, Finish::Squares(&mut squares));
            }
            sum_columns(&mut row[layer.bias.clone()], delta);
            add_squares(&mut squares, &row[layer.bias.clone()]);
            if i > 0 {
                (0..gradient.columns().div_ceil(WIDTH)).for_each(|strip| self.delta_before(i, pass, strip));
            }
        }
        sum(squares).sqrt()
    }

    fn last_delta(&self, pass: &mut Pass, gradient: &Strips) {
        let (y, activation) = (pass.layers.last_mut().expect("a network has a layer"), self.activation());
        assert_eq!((y.rows(), y.columns()), (gradient.rows(), gradient.columns()), "the output's gradient");
        let pieces = y.pieces_mut().iter_mut().zip(gradient.view().pieces);
        for (y, d) in pieces.flat_map(|(y, d)| y.0.iter_mut().zip(d.0)) {
            *y = activation.slope(d, *y);
        }
    }

    /// A strip of δ of the layer before this one.
    fn delta_before(&self, layer: usize, pass: &mut Pass, strip: usize) {
        let (before, from_here) = pass.layers.split_at_mut(layer);
        let weight = Turned { matrix: self.layers[layer].weight(self.row(Row::Online)), skipped: 0 };
        product(before[layer - 1].strip_mut(strip), weight, from_here[0].strip(strip), Finish::Slope);
    }

    /// ∂loss/∂x for the rows of x from `first` on, into `gradient`, once there are deltas.
    pub(super) fn input_gradient(&self, pass: &Pass, first: usize, gradient: &mut Strips) {
        let weight = Turned { matrix: self.layers[0].weight(self.row(Row::Online)), skipped: first };
        product(gradient.pieces_mut(), weight, pass.layers[0].view(), Finish::Squares(&mut { Piece::ZERO }));
    }
}

/// The layers of a network of these widths, one behind the other in a row.
fn layers(widths: &[usize], last: Activation) -> Vec<Layer> {
    let mut end = 0;
    let mut take = |count: usize| {
        end += count;
        end - count..end
    };
    let layer = |(i, pair): (usize, &[usize])| Layer {
        inputs: pair[0],
        outputs: pair[1],
        weight: take(pieces(pair[1], pair[0])),
        bias: take(pieces(1, pair[1])),
        activation: if i + 2 == widths.len() { last } else { Activation::Relu },
    };
    widths.windows(2).enumerate().map(layer).collect()
}

fn uniform(bound: f32, rng: &mut impl Rng) -> f32 {
    bound * rng.random_range(-1.0_f32..=1.0)
}

#[cfg(test)]
pub(super) mod tests {
    use super::super::strips::turn;
    use super::*;
    use candle_core::{Device, Tensor, Var};

    /// The online network by candle's own recorded operations; x and what it gives are `[batch, features]`.
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
        let tensor =
            |span: &Span| Tensor::from_vec(network.read(row, span), span.shape.as_slice(), &Device::Cpu).unwrap();
        network.spans().iter().map(tensor).collect()
    }

    /// A copy of these columns, one a row.
    pub(crate) fn by_column(matrix: &Strips) -> Tensor {
        let numbers = (0..matrix.rows()).flat_map(|row| matrix.row(row)).collect::<Vec<_>>();
        let tensor = Tensor::from_vec(numbers, (matrix.rows(), matrix.columns()), &Device::Cpu).unwrap();
        tensor.t().unwrap().contiguous().unwrap()
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

    pub(crate) fn random(shape: (usize, usize), seed: u64) -> Strips {
        let mut rng = Seed::from_number(seed).rng();
        let mut matrix = Strips::new(shape.0, shape.1);
        for row in 0..shape.0 {
            matrix.set_row(row, &(0..shape.1).map(|_| uniform(1.0, &mut rng)).collect::<Vec<_>>());
        }
        matrix
    }

    fn check(widths: &[usize], activation: Activation, batch: usize) {
        let mut network = Network::new(widths, Head { activation, init: 0.5 }, Seed::from_number(3));
        let (inputs, outputs) = (widths[0], widths[widths.len() - 1]);
        let (turned, factor) = (random((batch, inputs), 4), random((outputs, batch), 5));
        let mut x = Strips::new(inputs, batch);
        turn(&mut x, &turned);
        let vars = variables(&network);
        let recorded = Var::from_tensor(&by_column(&x)).unwrap();
        let y = recorded_forward(&vars, &recorded, activation);
        let store = (y.clone() * by_column(&factor)).unwrap().sum_all().unwrap().backward().unwrap();

        let mut pass = network.pass(batch);
        network.forward(&x, &mut pass);
        assert_close("output", &by_column(pass.output()), &y);
        let answer = network.answer(Row::Online, &x);
        (0..outputs).for_each(|row| assert_eq!(answer.row(row), pass.output().row(row)));
        let norm = network.gradients(turned.view(), &mut pass, &factor, &mut vec![Piece::ZERO; batch]);
        let gradients = tensors(&network, Row::Gradient);
        let squares = gradients.iter().map(|g| g.sqr().unwrap().sum_all().unwrap().to_scalar::<f32>().unwrap());
        let expected = squares.sum::<f32>().sqrt();
        assert!((norm - expected).abs() < 1e-5 * expected, "length {norm}, expected {expected}");
        for ((span, gradient), var) in network.spans().iter().zip(&gradients).zip(&vars) {
            assert_close(&span.name, gradient, store.get(var).unwrap());
        }
        let input = store.get(&recorded).unwrap();
        let input_gradient = |first| {
            let mut found = Strips::new(inputs - first, batch);
            network.input_gradient(&pass, first, &mut found);
            by_column(&found)
        };
        assert_close("input", &input_gradient(0), input);
        assert_close("last rows", &input_gradient(1), &input.narrow(1, 1, inputs - 1).unwrap());

        let mut again = network.pass(batch);
        network.forward(&x, &mut again);
        network.deltas(&mut again, &factor);
        for (again, delta) in again.layers.iter().zip(&pass.layers) {
            (0..delta.rows()).for_each(|row| assert_eq!(again.row(row), delta.row(row)));
        }
    }

    #[test]
    fn backward_matches_autograd() {
        check(&[5, 7, 6, 3], Activation::Tanh, 4);
        check(&[6, 33, 1], Activation::Linear, 9);
        check(&[60, 128, 64, 1], Activation::Linear, 64);
        check(&[3, 2], Activation::Tanh, 5);
        check(&[37, 40, 35, 2], Activation::Tanh, 70);
    }

    #[test]
    fn numbers_are_read_as_they_were_written() {
        let head = Head { activation: Activation::Linear, init: 0.3 };
        let mut network = Network::new(&[40, 35, 2], head, Seed::from_number(8));
        let numbers: Vec<f32> = (0..network.parameters()).map(|i| i as f32).collect();
        network.write(Row::Square, &numbers);
        let read: Vec<f32> = network.spans().iter().flat_map(|span| network.read(Row::Square, span)).collect();
        assert_eq!(read, numbers);
    }

    #[test]
    fn starts_within_bounds_with_an_equal_target() {
        let head = Head { activation: Activation::Tanh, init: 3e-3 };
        let network = Network::new(&[16, 100, 10, 2], head, Seed::from_number(1));
        for (i, span) in network.spans().iter().enumerate() {
            let bound = [0.25, 0.1, 3e-3][i / 2];
            let online = network.read(Row::Online, span);
            let largest = online.iter().fold(0.0_f32, |a, b| a.max(b.abs()));
            assert!(largest <= bound && largest > 0.5 * bound, "{}: {largest} of {bound}", span.name);
            assert_eq!(network.read(Row::Target, span), online);
            assert!(network.read(Row::Mean, span).iter().all(|m| *m == 0.0));
        }
        let other = Network::new(&[16, 100, 10, 2], head, Seed::from_number(2));
        let first = &network.spans()[0];
        assert_ne!(other.read(Row::Online, first), network.read(Row::Online, first));
    }
}
