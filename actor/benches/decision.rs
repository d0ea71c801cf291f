//! How many decisions a second does one robot give? One decision: policy of the default size, then a swing of Δt = .15 s.

use criterion::{Criterion, criterion_group, criterion_main};
use herd_actor::env::Env;
use herd_common::config::Config;
use herd_common::policy::{Layer, Policy, Provenance};
use herd_common::seed::Seed;
use herd_common::spaces::OBSERVATION_DIM;
use std::hint::black_box;

/// A policy of the paper's size whose actions are the middle of the box.
fn policy() -> Policy {
    let layer = |inputs: usize, outputs: usize| Layer {
        inputs,
        outputs,
        weights: vec![1e-3; inputs * outputs],
        biases: vec![0.0; outputs],
    };
    let mut layers = vec![layer(OBSERVATION_DIM, 512), layer(512, 256), layer(256, 4)];
    layers[2].weights.fill(0.0);
    let provenance = Provenance { version: 0, run: "bench".into(), task_hash: "bench".into() };
    Policy::new(provenance, layers).expect("shapes fit")
}

fn decision(c: &mut Criterion) {
    let policy = policy();
    let mut env = Env::new(&Config::load(None, &["task.episode_secs=1000".to_owned()]).expect("valid"));
    let mut observation = env.reset(Seed::from_number(1));
    c.bench_function("decision", |b| {
        b.iter(|| {
            let step = env.step(&policy.act(black_box(&observation)));
            observation = if step.ending.is_some() { env.reset(Seed::from_number(1)) } else { step.observation };
        });
    });
    c.bench_function("policy", |b| b.iter(|| policy.act(black_box(&observation))));
    c.bench_function("reset", |b| b.iter(|| env.reset(Seed::from_number(2))));
}

criterion_group!(benches, decision);
criterion_main!(benches);
