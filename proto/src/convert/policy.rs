//! Policies.

use super::numbers::{from_bytes, to_bytes};
use crate::{WireError, v1};
use herd_common::caps;
use herd_common::policy::{Layer, Policy, Provenance};

/// A policy, ready to send; `published_unix_nanos` is for measuring only.
pub fn policy_to_wire(policy: &Policy, published_unix_nanos: Option<u64>) -> v1::Policy {
    let layers = policy.layers().iter().map(|layer| v1::Layer {
        inputs: layer.inputs as u32,
        outputs: layer.outputs as u32,
        weights: to_bytes(&layer.weights),
        biases: to_bytes(&layer.biases),
    });
    v1::Policy {
        version: policy.provenance.version,
        run: policy.provenance.run.clone(),
        task_hash: policy.provenance.task_hash.clone(),
        layers: layers.collect(),
        published_unix_nanos,
    }
}

/// The policy in a message; non-finite weights and shapes that do not chain are refused.
pub fn policy_from_wire(message: v1::Policy) -> Result<Policy, WireError> {
    let layers = message.layers.iter().map(layer_from_wire).collect::<Result<Vec<_>, _>>()?;
    let provenance = Provenance { version: message.version, run: message.run, task_hash: message.task_hash };
    Ok(Policy::new(provenance, layers)?)
}

fn layer_from_wire(layer: &v1::Layer) -> Result<Layer, WireError> {
    let (inputs, outputs) = (layer.inputs as usize, layer.outputs as usize);
    let count = inputs.saturating_mul(outputs);
    if count > caps::POLICY_LAYER_WEIGHTS {
        return Err(WireError::invalid("layer weights", count, format!("at most {}", caps::POLICY_LAYER_WEIGHTS)));
    }
    let weights = from_bytes("weights", &layer.weights, count)?;
    let biases = from_bytes("biases", &layer.biases, outputs)?;
    Ok(Layer { inputs, outputs, weights, biases })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn policies_round_trip_and_bad_ones_are_named() {
        let layer = Layer { inputs: 3, outputs: 2, weights: vec![0.5; 6], biases: vec![1.0, -1.0] };
        let provenance = Provenance { version: 4, run: "r".into(), task_hash: "t".into() };
        let policy = Policy::new(provenance, vec![layer]).expect("valid");
        let mut wire = policy_to_wire(&policy, Some(7));
        assert_eq!(policy_from_wire(wire.clone()).expect("valid"), policy);
        wire.layers[0].weights = to_bytes(&[0.5, 0.5, f32::INFINITY, 0.5, 0.5, 0.5]);
        assert!(policy_from_wire(wire.clone()).expect_err("refused").to_string().contains("weights[2] is inf"));
        wire.layers[0].inputs = u32::MAX;
        assert!(policy_from_wire(wire).is_err());
    }
}
