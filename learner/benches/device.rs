//! Updates of the device's trainer, several at a time: batches of 256, 1024 and 4096, on a GPU with the feature `cuda`.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use herd_common::config::Config;
use herd_common::seed::Seed;
use herd_common::spaces::{GAIT_ACTION_DIM, OBSERVATION_DIM, Task};
use herd_common::transition::Batch;
use herd_learner::ddpg::{Device, OnDevice};
use herd_learner::replay::Replay;
use rand::RngExt;
use std::time::Duration;

#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Updates that are asked for at once; the trainer has as many, a decision being an update.
const TOGETHER: u64 = 32;

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

/// One iteration is `together` updates and one answer.
fn update(criterion: &mut Criterion) {
    let replay = replay(20_000);
    let plain = ["ddpg.twin_critic=false", "ddpg.actor_every=1", "ddpg.smoothing_sigma=0"];
    let td3 = ["ddpg.twin_critic=true", "ddpg.actor_every=2", "ddpg.smoothing_sigma=0.1"];
    for batch_size in [256, 1024, 4096] {
        let mut group = criterion.benchmark_group(format!("device/cuda/{batch_size}"));
        for (algorithm, sets) in [("ddpg", plain), ("td3", td3)] {
            let mut sets = sets.map(str::to_owned).to_vec();
            sets.push(format!("ddpg.batch_size={batch_size}"));
            let config = Config::default().overridden(&sets).expect("valid settings").ddpg;
            for together in [1, TOGETHER] {
                let mut ddpg =
                    OnDevice::new(&config, Task::Gait.dims(), Seed::from_number(2), Device::Cuda).expect("networks");
                group.throughput(Throughput::Elements(together));
                group.bench_function(format!("{algorithm}/{together}"), |bencher| {
                    bencher.iter(|| {
                        let found = ddpg.learn(&replay, together).expect("updates");
                        assert_eq!(found.len() as u64, together, "updates that go together");
                    });
                });
            }
        }
    }
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(20).measurement_time(Duration::from_secs(10));
    targets = update
}
criterion_main!(benches);
