//! A policy as an ONNX model, with golden vectors to check whoever runs it.
//!
//! One input `observation` `[batch, n]`, scaled and clipped to [−1, 1] as `herd_common::spaces` says, and one output
//! `action` `[batch, m]` in [−1, 1]: a Gemm a layer, Relu between, Tanh at the end. What the numbers mean stands in the
//! model's metadata. Equal policies give equal bytes. Messages and tags are those of onnx.proto3, as far as needed.

use herd_common::config::Config;
use herd_common::policy::Policy;
use herd_common::seed::Seed;
use herd_common::spaces::Task;
use prost::Message;
use rand::RngExt;
use serde::Serialize;

/// File format and operators that are used: old enough for every runtime in use.
const IR_VERSION: i64 = 8;
const OPSET: i64 = 13;
/// `TensorProto.DataType.FLOAT`
const FLOAT: i32 = 1;
/// Golden vectors of a policy.
const GOLDEN: usize = 16;

/// The bytes of `policy.onnx`; `config` is that of the policy's run.
pub fn onnx(policy: &Policy, config: &Config) -> Vec<u8> {
    let mut graph = GraphProto {
        name: "policy".to_owned(),
        input: vec![port("observation", policy.observation_dim())],
        output: vec![port("action", policy.action_dim())],
        ..GraphProto::default()
    };
    let last = policy.layers().len() - 1;
    let mut x = "observation".to_owned();
    for (i, layer) in policy.layers().iter().enumerate() {
        let [weight, bias, sum] = ["weight", "bias", "sum"].map(|part| format!("actor.{i}.{part}"));
        graph.initializer.push(tensor(&weight, &[layer.inputs, layer.outputs], &layer.weights));
        graph.initializer.push(tensor(&bias, &[layer.outputs], &layer.biases));
        graph.node.push(node("Gemm", vec![x, weight, bias], &sum));
        x = if i < last { format!("actor.{i}") } else { "action".to_owned() };
        graph.node.push(node(if i < last { "Relu" } else { "Tanh" }, vec![sum], &x));
    }
    let model = ModelProto {
        ir_version: IR_VERSION,
        opset_import: vec![OperatorSetIdProto { domain: String::new(), version: OPSET }],
        producer_name: "herd".to_owned(),
        producer_version: env!("CARGO_PKG_VERSION").to_owned(),
        graph: Some(graph),
        metadata_props: metadata(policy, config),
    };
    model.encode_to_vec()
}

/// Observations and the actions that the policy answers them with.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Golden {
    /// Hash of the policy's task.
    pub task_hash: String,
    /// Version of the policy.
    pub version: u64,
    /// Observations, each a row.
    pub observations: Vec<Vec<f32>>,
    /// Its actions, each a row.
    pub actions: Vec<Vec<f32>>,
}

/// The golden vectors of a policy: observations uniform in [−1, 1].
pub fn golden(policy: &Policy) -> Golden {
    let mut rng = Seed::from_number(policy.provenance.version).child("golden", 0).rng();
    let mut observation = || (0..policy.observation_dim()).map(|_| rng.random_range(-1.0..=1.0)).collect();
    let observations: Vec<Vec<f32>> = (0..GOLDEN).map(|_| observation()).collect();
    Golden {
        task_hash: policy.provenance.task_hash.clone(),
        version: policy.provenance.version,
        actions: observations.iter().map(|observation| policy.act(observation)).collect(),
        observations,
    }
}

/// What the numbers mean and where the policy comes from; no clock, host or path.
fn metadata(policy: &Policy, config: &Config) -> Vec<StringStringEntryProto> {
    let provenance = &policy.provenance;
    let task = config.task.kind;
    let blocks = task.observation().map(|b| serde_json::json!([b.start, b.len, b.meaning, b.unit, b.scale]));
    let blocks: Vec<_> = blocks.collect();
    let action = match task {
        Task::Torque => serde_json::json!({ "limit_nm": config.task.torque.limit_nm }),
        Task::Gait | Task::Constant => serde_json::json!(config.task.gait),
        Task::Command => serde_json::json!({ "gait": config.task.gait, "command": config.task.command }),
    };
    [
        ("task", task.name().to_owned()),
        ("task_hash", provenance.task_hash.clone()),
        ("run", provenance.run.clone()),
        ("version", provenance.version.to_string()),
        ("seed", config.seed.to_string()),
        // Rows of first index, length, meaning, unit, and the value that is 1.
        ("observation", serde_json::json!(blocks).to_string()),
        // What [−1, 1] maps onto.
        ("action", action.to_string()),
    ]
    .map(|(key, value)| StringStringEntryProto { key: key.to_owned(), value })
    .into()
}

/// A float tensor `[batch, length]` that goes in or comes out.
fn port(name: &str, length: usize) -> ValueInfoProto {
    let batch = Dimension { dim_value: None, dim_param: Some("batch".to_owned()) };
    let length = Dimension { dim_value: Some(signed(length)), dim_param: None };
    let shape = Some(TensorShapeProto { dim: vec![batch, length] });
    let tensor_type = Some(TensorTypeProto { elem_type: FLOAT, shape });
    ValueInfoProto { name: name.to_owned(), r#type: Some(TypeProto { tensor_type }) }
}

fn tensor(name: &str, shape: &[usize], numbers: &[f32]) -> TensorProto {
    TensorProto {
        dims: shape.iter().map(|length| signed(*length)).collect(),
        data_type: FLOAT,
        name: name.to_owned(),
        raw_data: numbers.iter().flat_map(|number| number.to_le_bytes()).collect(),
    }
}

fn signed(length: usize) -> i64 {
    i64::try_from(length).expect("a policy's layers are bounded")
}

fn node(op_type: &str, input: Vec<String>, output: &str) -> NodeProto {
    NodeProto { input, output: vec![output.to_owned()], name: output.to_owned(), op_type: op_type.to_owned() }
}

#[derive(Clone, PartialEq, Message)]
struct ModelProto {
    #[prost(int64, tag = "1")]
    ir_version: i64,
    #[prost(string, tag = "2")]
    producer_name: String,
    #[prost(string, tag = "3")]
    producer_version: String,
    #[prost(message, optional, tag = "7")]
    graph: Option<GraphProto>,
    #[prost(message, repeated, tag = "8")]
    opset_import: Vec<OperatorSetIdProto>,
    #[prost(message, repeated, tag = "14")]
    metadata_props: Vec<StringStringEntryProto>,
}

#[derive(Clone, PartialEq, Message)]
struct OperatorSetIdProto {
    #[prost(string, tag = "1")]
    domain: String,
    #[prost(int64, tag = "2")]
    version: i64,
}

#[derive(Clone, PartialEq, Message)]
struct StringStringEntryProto {
    #[prost(string, tag = "1")]
    key: String,
    #[prost(string, tag = "2")]
    value: String,
}

#[derive(Clone, PartialEq, Message)]
struct GraphProto {
    #[prost(message, repeated, tag = "1")]
    node: Vec<NodeProto>,
    #[prost(string, tag = "2")]
    name: String,
    #[prost(message, repeated, tag = "5")]
    initializer: Vec<TensorProto>,
    #[prost(message, repeated, tag = "11")]
    input: Vec<ValueInfoProto>,
    #[prost(message, repeated, tag = "12")]
    output: Vec<ValueInfoProto>,
}

#[derive(Clone, PartialEq, Message)]
struct NodeProto {
    #[prost(string, repeated, tag = "1")]
    input: Vec<String>,
    #[prost(string, repeated, tag = "2")]
    output: Vec<String>,
    #[prost(string, tag = "3")]
    name: String,
    #[prost(string, tag = "4")]
    op_type: String,
}

#[derive(Clone, PartialEq, Message)]
struct TensorProto {
    #[prost(int64, repeated, tag = "1")]
    dims: Vec<i64>,
    #[prost(int32, tag = "2")]
    data_type: i32,
    #[prost(string, tag = "8")]
    name: String,
    #[prost(bytes = "vec", tag = "9")]
    raw_data: Vec<u8>,
}

#[derive(Clone, PartialEq, Message)]
struct ValueInfoProto {
    #[prost(string, tag = "1")]
    name: String,
    #[prost(message, optional, tag = "2")]
    r#type: Option<TypeProto>,
}

#[derive(Clone, PartialEq, Message)]
struct TypeProto {
    #[prost(message, optional, tag = "1")]
    tensor_type: Option<TensorTypeProto>,
}

#[derive(Clone, PartialEq, Message)]
struct TensorTypeProto {
    #[prost(int32, tag = "1")]
    elem_type: i32,
    #[prost(message, optional, tag = "2")]
    shape: Option<TensorShapeProto>,
}

#[derive(Clone, PartialEq, Message)]
struct TensorShapeProto {
    #[prost(message, repeated, tag = "1")]
    dim: Vec<Dimension>,
}

/// One of the two.
#[derive(Clone, PartialEq, Message)]
struct Dimension {
    #[prost(int64, optional, tag = "1")]
    dim_value: Option<i64>,
    #[prost(string, optional, tag = "2")]
    dim_param: Option<String>,
}

#[cfg(test)]
mod tests {
    use super::*;
    use herd_common::policy::{Layer, Provenance};
    use std::collections::BTreeMap;

    fn policy() -> Policy {
        let mut rng = Seed::from_number(3).rng();
        let mut layer = |inputs: usize, outputs: usize| {
            let mut numbers = |count: usize| (0..count).map(|_| rng.random_range(-0.5..=0.5)).collect();
            Layer { inputs, outputs, weights: numbers(inputs * outputs), biases: numbers(outputs) }
        };
        let provenance = Provenance { version: 9, run: "run".into(), task_hash: "task".into() };
        Policy::new(provenance, vec![layer(56, 24), layer(24, 10), layer(10, 4)]).expect("well formed")
    }

    /// Runs the graph as ONNX defines its operators, node by node, for one row.
    fn interpret(graph: &GraphProto, observation: &[f32]) -> Vec<f32> {
        let numbers = |t: &TensorProto| {
            let (fours, []) = t.raw_data.as_chunks::<4>() else { panic!("{} is torn", t.name) };
            fours.iter().map(|four| f32::from_le_bytes(*four)).collect::<Vec<_>>()
        };
        let constants: BTreeMap<&str, (&[i64], Vec<f32>)> =
            graph.initializer.iter().map(|t| (t.name.as_str(), (t.dims.as_slice(), numbers(t)))).collect();
        let mut values = BTreeMap::from([(graph.input[0].name.as_str(), observation.to_vec())]);
        for node in &graph.node {
            let x = &values[node.input[0].as_str()];
            let y = match node.op_type.as_str() {
                "Relu" => x.iter().map(|x| x.max(0.0)).collect(),
                "Tanh" => x.iter().map(|x| x.tanh()).collect(),
                "Gemm" => {
                    let ((shape, w), (_, b)) = (&constants[node.input[1].as_str()], &constants[node.input[2].as_str()]);
                    assert_eq!(*shape, [signed(x.len()), signed(b.len())]);
                    let row = |o: usize| x.iter().enumerate().map(move |(i, x)| x * w[i * b.len() + o]).sum::<f32>();
                    (0..b.len()).map(|o| row(o) + b[o]).collect()
                }
                other => panic!("operator {other}"),
            };
            values.insert(&node.output[0], y);
        }
        values[graph.output[0].name.as_str()].clone()
    }

    #[test]
    fn the_model_does_what_the_policy_does() {
        let policy = policy();
        let bytes = onnx(&policy, &Config::default());
        let model = ModelProto::decode(bytes.as_slice()).expect("decodes");
        let graph = model.graph.expect("a graph");
        let golden = golden(&policy);
        assert_eq!((golden.observations.len(), golden.version), (GOLDEN, 9));
        for (observation, expected) in golden.observations.iter().zip(&golden.actions) {
            let action = interpret(&graph, observation);
            assert!(expected.iter().any(|a| a.abs() > 0.01), "an action of zeros tests nothing");
            assert_eq!(action.len(), expected.len());
            for (found, expected) in action.iter().zip(expected) {
                assert!((found - expected).abs() < 1e-5, "{found} {expected}");
            }
        }
    }

    #[test]
    fn equal_policies_give_equal_files_that_name_them() {
        let config = Config::load(None, &["seed=77".to_owned()]).expect("valid");
        let bytes = onnx(&policy(), &config);
        assert_eq!(bytes, onnx(&policy(), &config));
        assert_eq!(golden(&policy()), golden(&policy()));
        let model = ModelProto::decode(bytes.as_slice()).expect("decodes");
        let said: BTreeMap<_, _> = model.metadata_props.into_iter().map(|entry| (entry.key, entry.value)).collect();
        assert_eq!((&*said["task_hash"], &*said["version"], &*said["seed"]), ("task", "9", "77"));
        assert!(said["observation"].contains("hip") || said["observation"].contains("trunk"));
        assert!(said["action"].contains("velocity_mps"));
    }
}
