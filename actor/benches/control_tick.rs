//! Does one robot keep up with the clock? One control tick (2 ms of simulated time): state, torques, MPC, physics.
//!
//! A benchmark iteration is a whole swing, so that the MPC's solves are in it as often as they occur; `per tick` divides
//! by its ticks through criterion's throughput.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use herd_actor::env::Env;
use herd_common::config::Config;
use herd_common::seed::Seed;
use std::hint::black_box;

fn control_tick(c: &mut Criterion) {
    let sets = ["task.kind=constant", "task.episode_secs=1000", "task.constant.step_secs=0.15"].map(str::to_owned);
    let mut env = Env::new(&Config::load(None, &sets).expect("valid"));
    env.reset(Seed::from_number(1));
    let mut group = c.benchmark_group("control_tick");
    group.throughput(Throughput::Elements(75));
    group.bench_function("swing of 75 ticks", |b| b.iter(|| black_box(env.step(&[]))));
    group.finish();
}

criterion_group!(benches, control_tick);
criterion_main!(benches);
