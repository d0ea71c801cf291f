//! What does a minibatch cost out of a replay memory that no cache holds?

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use herd_common::seed::Seed;
use herd_common::spaces::{GAIT_ACTION_DIM, OBSERVATION_DIM};
use herd_common::transition::Batch;
use herd_learner::ddpg::{Batch as Minibatch, Dims};
use herd_learner::replay::Replay;

const TRANSITIONS: usize = 200_000;

fn sample(criterion: &mut Criterion) {
    let n = 1000;
    let batch = Batch {
        action_dim: GAIT_ACTION_DIM,
        observations: vec![0.5; n * OBSERVATION_DIM],
        actions: vec![0.5; n * GAIT_ACTION_DIM],
        rewards: vec![1.0; n],
        discounts: vec![0.95; n],
        next_observations: vec![0.5; n * OBSERVATION_DIM],
    };
    let mut replay = Replay::new(TRANSITIONS, OBSERVATION_DIM, GAIT_ACTION_DIM);
    for _ in 0..TRANSITIONS / n {
        replay.push(&batch);
    }
    let mut rng = Seed::from_number(1).rng();
    let dims = Dims { observation: OBSERVATION_DIM, action: GAIT_ACTION_DIM };
    let mut group = criterion.benchmark_group("replay");
    for size in [64, 256] {
        group.throughput(Throughput::Elements(size as u64));
        let minibatch = Minibatch::new(size, dims).expect("tensors");
        group.bench_function(format!("sample/{size}"), |bencher| {
            bencher.iter(|| {
                let rows: Vec<_> = replay.draw(size, &mut rng).collect();
                minibatch.fill(&rows, 1.0).expect("a minibatch");
            });
        });
    }
    group.throughput(Throughput::Elements(n as u64));
    group.bench_function(format!("push/{n}"), |bencher| bencher.iter(|| replay.push(&batch)));
}

criterion_group!(benches, sample);
criterion_main!(benches);
