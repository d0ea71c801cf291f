//! Does one update keep up with the herd? Updates of the paper's networks, plain DDPG and TD3.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use herd_common::config::Config;
use herd_common::seed::Seed;
use herd_common::spaces::{Dims, GAIT_ACTION_DIM, OBSERVATION_DIM};
use herd_common::transition::Batch;
use herd_learner::ddpg::Ddpg;
use herd_learner::replay::Replay;
use rand::RngExt;

// The allocator of the `herd` binary: half of a tensor's cost is its memory.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn replay(transitions: usize) -> Replay {
    let mut rng = Seed::from_number(1).rng();
    let mut column = |width: usize| (0..transitions * width).map(|_| rng.random_range(-1.0_f32..1.0)).collect();
    let batch = Batch {
        observation_dim: OBSERVATION_DIM,
        action_dim: GAIT_ACTION_DIM,
        observations: column(OBSERVATION_DIM),
        actions: column(GAIT_ACTION_DIM),
        rewards: column(1),
        discounts: vec![0.95; transitions],
        next_observations: column(OBSERVATION_DIM),
    };
    let mut replay = Replay::new(transitions, OBSERVATION_DIM, GAIT_ACTION_DIM);
    replay.push(&batch);
    replay
}

fn update(criterion: &mut Criterion) {
    let replay = replay(20_000);
    let plain = ["ddpg.twin_critic=false", "ddpg.actor_every=1", "ddpg.smoothing_sigma=0"];
    let td3 = ["ddpg.twin_critic=true", "ddpg.actor_every=2", "ddpg.smoothing_sigma=0.1"];
    for batch_size in [64, 256] {
        let mut group = criterion.benchmark_group(format!("update/{batch_size}"));
        group.throughput(Throughput::Elements(1));
        for (name, sets) in [("ddpg", plain), ("td3", td3)] {
            let mut sets = sets.map(str::to_owned).to_vec();
            sets.push(format!("ddpg.batch_size={batch_size}"));
            let config = Config::default().overridden(&sets).expect("valid settings").ddpg;
            let dims = Dims { observation: OBSERVATION_DIM, action: GAIT_ACTION_DIM };
            let mut ddpg = Ddpg::new(&config, dims, Seed::from_number(2)).expect("networks");
            group.bench_function(name, |bencher| bencher.iter(|| ddpg.update(&replay).expect("an update")));
        }
    }
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(50);
    targets = update
}
criterion_main!(benches);
