//! Policies.

use super::numbers::{fill_from_bytes, to_bytes};
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
    policy_from_wire_into(message, None)
}

/// The same, written in the memory of a policy that is no longer used. Memory that is new each time has to be mapped and
/// cleared first, which can take longer than the copy.
pub(crate) fn policy_from_wire_into(message: v1::Policy, unused: Option<Policy>) -> Result<Policy, WireError> {
    let mut unused = unused.map(Policy::into_layers).unwrap_or_default().into_iter();
    let layers = message.layers.iter().map(|layer| layer_from_wire(layer, unused.next().unwrap_or_default()));
    let layers = layers.collect::<Result<Vec<_>, _>>()?;
    let provenance = Provenance { version: message.version, run: message.run, task_hash: message.task_hash };
    Ok(Policy::new(provenance, layers)?)
}

fn layer_from_wire(layer: &v1::Layer, unused: Layer) -> Result<Layer, WireError> {
    let (inputs, outputs) = (layer.inputs as usize, layer.outputs as usize);
    let count = inputs.saturating_mul(outputs);
    if count > caps::POLICY_LAYER_WEIGHTS {
        return Err(WireError::invalid("layer weights", count, format!("at most {}", caps::POLICY_LAYER_WEIGHTS)));
    }
    let Layer { mut weights, mut biases, .. } = unused;
    fill_from_bytes(&mut weights, "weights", &layer.weights, count)?;
    fill_from_bytes(&mut biases, "biases", &layer.biases, outputs)?;
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

    fn layer(inputs: usize, outputs: usize, first: f32) -> Layer {
        let weights = (0..inputs * outputs).map(|i| first + i as f32).collect();
        Layer { inputs, outputs, weights, biases: vec![first; outputs] }
    }

    fn policy(layers: Vec<Layer>) -> Policy {
        Policy::new(Provenance { version: 4, run: "r".into(), task_hash: "t".into() }, layers).expect("valid")
    }

    #[test]
    fn a_policy_is_written_over_one_of_any_shape() {
        let policies = [vec![layer(3, 2, 0.5)], vec![layer(4, 5, 1.5), layer(5, 1, 2.5)], vec![layer(1, 7, 3.5)]];
        let policies = policies.map(policy);
        for unused in &policies {
            for policy in &policies {
                let found = policy_from_wire_into(policy_to_wire(policy, None), Some(unused.clone()));
                assert_eq!(&found.expect("valid"), policy);
            }
        }
    }

    #[test]
    fn a_policy_of_the_same_shape_takes_no_new_memory() {
        let places = |policy: &Policy| -> Vec<_> {
            policy.layers().iter().flat_map(|layer| [layer.weights.as_ptr(), layer.biases.as_ptr()]).collect()
        };
        let unused = policy(vec![layer(4, 5, 0.5), layer(5, 1, 1.5)]);
        let expected = places(&unused);
        let next = policy(vec![layer(4, 5, 2.5), layer(5, 1, 3.5)]);
        let found = policy_from_wire_into(policy_to_wire(&next, None), Some(unused)).expect("valid");
        assert_eq!((places(&found), found), (expected, next));
    }
}
