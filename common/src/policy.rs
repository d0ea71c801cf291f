//! The policy as plain data, with its own `f32` forward pass.
//!
//! Layers are fully connected; hidden ones end in ReLU, the last in tanh, so an action lies in [−1, 1]ⁿ. Every output is
//! summed in the order of its inputs, beginning with the bias and leaving out zeros; outputs lie side by side in vector
//! registers. So the same policy gives the same bits whatever the width of the registers. On disk it is one safetensors
//! file whose metadata names the task.

use crate::caps;
use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use serde::{Deserialize, Serialize};
use std::collections::HashMap;

/// One fully connected layer, `y = W x + b`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Layer {
    /// Length of x.
    pub inputs: usize,
    /// Length of y.
    pub outputs: usize,
    /// W input by input, `[inputs, outputs]`: the numbers that one x is multiplied by are neighbours.
    pub weights: Vec<f32>,
    /// b, `[outputs]`.
    pub biases: Vec<f32>,
}

/// Where a policy comes from; travels and is stored with its weights.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Provenance {
    /// Commits that the learner had digested when it published this policy.
    pub version: u64,
    /// Content name of the run.
    pub run: String,
    /// Hash of the task (spaces, robot, controller, reward) it was trained for.
    pub task_hash: String,
}

/// A policy that can act.
#[derive(Clone, Debug, PartialEq)]
pub struct Policy {
    /// Where it comes from.
    pub provenance: Provenance,
    layers: Vec<Layer>,
}

/// Why something is not a policy.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// Wrong number of layers.
    #[error("policy has {0} layers, expected 1 to {max}", max = caps::POLICY_LAYERS)]
    Layers(usize),
    /// A layer's columns do not fit together.
    #[error("policy layer {layer}: {what} is {found}, expected {expected}")]
    Shape {
        /// Which layer, from 0.
        layer: usize,
        /// Which property.
        what: &'static str,
        /// Found.
        found: usize,
        /// Expected.
        expected: usize,
    },
    /// A weight is NaN or infinite.
    #[error("policy layer {layer}: {what}[{index}] is {value}, expected a finite number")]
    NotFinite {
        /// Which layer, from 0.
        layer: usize,
        /// `weights` or `biases`.
        what: &'static str,
        /// Position.
        index: usize,
        /// The offending number.
        value: f32,
    },
    /// The file is not a safetensors file, or not one of ours.
    #[error("policy file: {0}")]
    File(String),
    /// The policy belongs to another task.
    #[error("policy was trained for task {found}, this is task {expected}: spaces, robot, controller or reward differ")]
    Task {
        /// The policy's task, shortened.
        found: String,
        /// Ours, shortened.
        expected: String,
    },
}

const METADATA_KEY: &str = "herd";

impl Policy {
    /// A policy of these layers; shapes and values are checked.
    pub fn new(provenance: Provenance, layers: Vec<Layer>) -> Result<Self, Error> {
        if layers.is_empty() || layers.len() > caps::POLICY_LAYERS {
            return Err(Error::Layers(layers.len()));
        }
        for (i, layer) in layers.iter().enumerate() {
            check_layer(i, layer, i.checked_sub(1).map(|before| layers[before].outputs))?;
        }
        Ok(Self { provenance, layers })
    }

    /// The layers, input first.
    pub fn layers(&self) -> &[Layer] {
        &self.layers
    }

    /// The layers of a policy that is no longer used, for another one to be written in their memory.
    pub fn into_layers(self) -> Vec<Layer> {
        self.layers
    }

    /// Length of the observation it takes.
    pub fn observation_dim(&self) -> usize {
        self.layers[0].inputs
    }

    /// Length of the action it gives.
    pub fn action_dim(&self) -> usize {
        self.layers[self.layers.len() - 1].outputs
    }

    /// The action for an observation, each element in [−1, 1].
    pub fn act(&self, observation: &[f32]) -> Vec<f32> {
        assert_eq!(observation.len(), self.observation_dim());
        let last = self.layers.len() - 1;
        let mut x = observation.to_vec();
        for (i, layer) in self.layers.iter().enumerate() {
            x = layer.forward(&x);
            for y in &mut x {
                *y = if i < last { y.max(0.0) } else { y.tanh() };
            }
        }
        x
    }

    /// Refuses a policy of another task.
    pub fn expect_task(&self, task_hash: &str) -> Result<(), Error> {
        if self.provenance.task_hash == task_hash {
            return Ok(());
        }
        Err(Error::Task {
            found: crate::hash::short(&self.provenance.task_hash).to_owned(),
            expected: crate::hash::short(task_hash).to_owned(),
        })
    }

    /// The bytes of `policy.safetensors`: equal policies give equal bytes. There W stands as PyTorch has it,
    /// `[outputs, inputs]`.
    pub fn to_safetensors(&self) -> Result<Vec<u8>, Error> {
        let mut tensors = Vec::new();
        let weights: Vec<_> = self.layers.iter().map(|layer| turned(&layer.weights, layer.outputs)).collect();
        for (i, (layer, weights)) in self.layers.iter().zip(&weights).enumerate() {
            let weights = bytemuck::cast_slice(weights);
            let biases = bytemuck::cast_slice(&layer.biases);
            tensors.push((format!("actor.{i}.weight"), vec![layer.outputs, layer.inputs], weights));
            tensors.push((format!("actor.{i}.bias"), vec![layer.outputs], biases));
        }
        let views = tensors
            .into_iter()
            .map(|(name, shape, bytes)| Ok((name, TensorView::new(Dtype::F32, shape, bytes)?)))
            .collect::<Result<Vec<_>, safetensors::SafeTensorError>>()
            .map_err(|e| Error::File(e.to_string()))?;
        // One metadata key only: the library writes several in the random order of a HashMap.
        let provenance = serde_json::to_string(&self.provenance).map_err(|e| Error::File(e.to_string()))?;
        let metadata = HashMap::from([(METADATA_KEY.to_owned(), provenance)]);
        safetensors::serialize(views, Some(metadata)).map_err(|e| Error::File(e.to_string()))
    }

    /// The policy in the bytes of a `policy.safetensors`.
    pub fn from_safetensors(bytes: &[u8]) -> Result<Self, Error> {
        let file = |e: safetensors::SafeTensorError| Error::File(e.to_string());
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(file)?;
        let provenance = header
            .metadata()
            .as_ref()
            .and_then(|entries| entries.get(METADATA_KEY))
            .ok_or_else(|| Error::File("no `herd` metadata, so this is not a policy that herd wrote".to_owned()))?;
        let provenance: Provenance =
            serde_json::from_str(provenance).map_err(|e| Error::File(format!("`herd` metadata: {e}")))?;
        let tensors = SafeTensors::deserialize(bytes).map_err(file)?;
        let mut layers = Vec::new();
        while let Ok(weight) = tensors.tensor(&format!("actor.{}.weight", layers.len())) {
            let bias = tensors.tensor(&format!("actor.{}.bias", layers.len())).map_err(file)?;
            let &[outputs, inputs] = weight.shape() else {
                return Err(Error::File(format!("actor.{}.weight is not a matrix", layers.len())));
            };
            let weights = turned(&floats(&weight)?, inputs);
            layers.push(Layer { inputs, outputs, weights, biases: floats(&bias)? });
        }
        Self::new(provenance, layers)
    }
}

impl Layer {
    /// W x + b. After a ReLU about half of x is zero, and what it would be multiplied by is not touched.
    fn forward(&self, x: &[f32]) -> Vec<f32> {
        let mut y = self.biases.clone();
        let column = |i: usize| &self.weights[i * self.outputs..][..self.outputs];
        let live: Vec<usize> = (0..x.len()).filter(|&i| x[i] != 0.0).collect();
        let (fours, rest) = live.as_chunks::<4>();
        for four in fours {
            add_four(&mut y, four.map(column), four.map(|i| x[i]));
        }
        for &i in rest {
            y.iter_mut().zip(column(i)).for_each(|(y, w)| *y += w * x[i]);
        }
        y
    }
}

/// The transpose of a matrix with rows of this length.
fn turned(numbers: &[f32], row: usize) -> Vec<f32> {
    (0..row).flat_map(|i| numbers.iter().skip(i).step_by(row).copied()).collect()
}

/// Four inputs at a time, so that y is read and written once for them.
fn add_four(y: &mut [f32], columns: [&[f32]; 4], x: [f32; 4]) {
    let [a, b, c, d] = columns.map(|column| &column[..y.len()]);
    for i in 0..y.len() {
        y[i] = y[i] + a[i] * x[0] + b[i] * x[1] + c[i] * x[2] + d[i] * x[3];
    }
}

fn check_layer(i: usize, layer: &Layer, inputs: Option<usize>) -> Result<(), Error> {
    let shape = |what, found, expected| Error::Shape { layer: i, what, found, expected };
    let count = layer.inputs.saturating_mul(layer.outputs);
    if count == 0 || count > caps::POLICY_LAYER_WEIGHTS {
        return Err(shape("number of weights", count, caps::POLICY_LAYER_WEIGHTS));
    }
    if layer.weights.len() != count {
        return Err(shape("number of weights", layer.weights.len(), count));
    }
    if layer.biases.len() != layer.outputs {
        return Err(shape("number of biases", layer.biases.len(), layer.outputs));
    }
    if let Some(expected) = inputs.filter(|n| *n != layer.inputs) {
        return Err(shape("number of inputs", layer.inputs, expected));
    }
    for (what, numbers) in [("weights", &layer.weights), ("biases", &layer.biases)] {
        // To count is vectorised, to search is not; a count as wide as the numbers needs no widening.
        if numbers.iter().map(|x| u32::from(!x.is_finite())).sum::<u32>() == 0 {
            continue;
        }
        if let Some(index) = numbers.iter().position(|x| !x.is_finite()) {
            return Err(Error::NotFinite { layer: i, what, index, value: numbers[index] });
        }
    }
    Ok(())
}

fn floats(view: &TensorView<'_>) -> Result<Vec<f32>, Error> {
    if view.dtype() != Dtype::F32 {
        return Err(Error::File(format!("tensor of type {:?}, expected F32", view.dtype())));
    }
    Ok(bytemuck::pod_collect_to_vec(view.data()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn provenance() -> Provenance {
        Provenance { version: 3, run: "r".into(), task_hash: "t".into() }
    }

    fn policy() -> Policy {
        let hidden = Layer { inputs: 2, outputs: 2, weights: vec![1.0, 0.5, 0.0, -1.0], biases: vec![0.5, 0.25] };
        let last = Layer { inputs: 2, outputs: 1, weights: vec![2.0, 4.0], biases: vec![-1.0] };
        Policy::new(provenance(), vec![hidden, last]).expect("valid")
    }

    #[test]
    fn forward_matches_hand_computation() {
        // hidden: relu(1·.25 + 0·1 + .5, .5·.25 − 1·1 + .25) = (.75, 0); output: tanh(2·.75 − 1) = tanh(.5)
        assert_eq!(policy().act(&[0.25, 1.0]), vec![0.5_f32.tanh()]);
    }

    #[test]
    fn every_output_is_summed_in_the_order_of_its_inputs() {
        for (inputs, outputs) in [(1, 1), (3, 5), (4, 16), (57, 33)] {
            let weights: Vec<f32> = (0..inputs * outputs).map(|i| (i as f32 * 0.7).sin()).collect();
            let biases: Vec<f32> = (0..outputs).map(|o| o as f32 * 0.1).collect();
            let x: Vec<f32> = (0..inputs).map(|i| if i % 3 == 1 { 0.0 } else { (i as f32).cos() }).collect();
            let layer = Layer { inputs, outputs, weights, biases };
            let expected: Vec<f32> = (0..outputs)
                .map(|o| (0..inputs).fold(layer.biases[o], |sum, i| sum + layer.weights[i * outputs + o] * x[i]))
                .collect();
            assert_eq!(layer.forward(&x), expected, "{inputs} to {outputs}");
        }
    }

    #[test]
    fn files_round_trip_and_repeat() {
        let bytes = policy().to_safetensors().expect("serialises");
        assert_eq!(bytes, policy().to_safetensors().expect("serialises"));
        assert_eq!(Policy::from_safetensors(&bytes).expect("reads"), policy());
    }

    #[test]
    fn files_hold_weights_as_pytorch_does() {
        let bytes = policy().to_safetensors().expect("serialises");
        let tensors = SafeTensors::deserialize(&bytes).expect("a file");
        let weight = tensors.tensor("actor.0.weight").expect("the first layer");
        assert_eq!(floats(&weight).expect("numbers"), [1.0, 0.0, 0.5, -1.0]);
    }

    #[test]
    fn bad_files_are_refused() {
        let bytes = policy().to_safetensors().expect("serialises");
        for cut in [0, 4, 20, bytes.len() - 1] {
            assert!(Policy::from_safetensors(&bytes[..cut]).is_err(), "{cut}");
        }
        assert!(policy().expect_task("other").expect_err("refused").to_string().contains("task t, this is task other"));
    }

    #[test]
    fn bad_layers_are_named() {
        let mut layers = policy().layers().to_vec();
        layers[1].weights[1] = f32::NAN;
        let error = Policy::new(provenance(), layers).expect_err("refused").to_string();
        assert_eq!(error, "policy layer 1: weights[1] is NaN, expected a finite number");
    }
}
