//! What does a minibatch cost out of a replay memory that no cache holds, up to ten million transitions?

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use herd_common::seed::Seed;
use herd_common::spaces::{Dims, GAIT_ACTION_DIM, OBSERVATION_DIM};
use herd_common::transition::Batch;
use herd_learner::ddpg::Batch as Minibatch;
use herd_learner::replay::Replay;

/// As in the program.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Transitions of one push.
const PUSH: usize = 1000;
const SMALL: usize = 200_000;
/// 4.7 GB.
const LARGE: usize = 10_000_000;

fn batch() -> Batch {
    Batch {
        observation_dim: OBSERVATION_DIM,
        action_dim: GAIT_ACTION_DIM,
        observations: vec![0.5; PUSH * OBSERVATION_DIM],
        actions: vec![0.5; PUSH * GAIT_ACTION_DIM],
        rewards: vec![1.0; PUSH],
        discounts: vec![0.95; PUSH],
        next_observations: vec![0.5; PUSH * OBSERVATION_DIM],
    }
}

fn full(transitions: usize) -> Replay {
    let (mut replay, batch) = (Replay::new(transitions, OBSERVATION_DIM, GAIT_ACTION_DIM), batch());
    for _ in 0..transitions / PUSH {
        replay.push(&batch);
    }
    replay
}

fn measure(criterion: &mut Criterion, group: &str, transitions: usize) {
    let (mut replay, batch) = (full(transitions), batch());
    let mut rng = Seed::from_number(1).rng();
    let dims = Dims { observation: OBSERVATION_DIM, action: GAIT_ACTION_DIM };
    let mut group = criterion.benchmark_group(group);
    for size in [64, 256] {
        group.throughput(Throughput::Elements(size as u64));
        let mut minibatch = Minibatch::new(size, dims).expect("matrices");
        group.bench_function(format!("sample/{size}"), |bencher| {
            bencher.iter(|| {
                let rows: Vec<_> = replay.draw(size, &mut rng).collect();
                minibatch.fill(&rows, 1.0).expect("a minibatch");
            });
        });
    }
    group.throughput(Throughput::Elements(PUSH as u64));
    group.bench_function(format!("push/{PUSH}"), |bencher| bencher.iter(|| replay.push(&batch)));
    eprintln!("replay of {transitions}: this process holds {}", resident());
}

/// Memory of this process, in the kernel's words.
fn resident() -> String {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    status.lines().find_map(|line| line.strip_prefix("VmRSS:")).unwrap_or("?").trim().to_owned()
}

fn small(criterion: &mut Criterion) {
    measure(criterion, "replay", SMALL);
}

fn large(criterion: &mut Criterion) {
    measure(criterion, "replay-full", LARGE);
}

criterion_group!(benches, small, large);
criterion_main!(benches);
