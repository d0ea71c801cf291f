//! Does one solve fit its period? Building and solving a horizon of ten steps, in a trot, on four feet, and under an
//! erratic policy with pushes.
//!
//! States and feet vary from iteration to iteration, as they do on the robot; both solvers see the same ones.

use criterion::{Criterion, criterion_group, criterion_main};
use herd_actor::mpc::{Body, Mpc, State, Step};
use herd_actor::trial;
use herd_common::config::{Config, control};
use herd_common::seed::Seed;
use nalgebra::{Matrix3, Vector3};
use rand::RngExt;
use std::hint::black_box;

/// Which legs are in stance in a step of the horizon.
type Stance = fn(usize) -> [bool; 4];

/// Disturbed states to cycle through.
const SCENES: u64 = 64;

fn scene(seed: u64, stance: Stance) -> (State, Vec<Step>) {
    let mut rng = Seed::from_number(seed).rng();
    let mut vector = |scale: f64| Vector3::from_fn(|_, _| rng.random_range(-scale..=scale));
    let state = State {
        angles: vector(0.1),
        position: vector(0.01) + Vector3::new(0.0, 0.0, 0.17),
        angular_velocity: vector(0.8),
        velocity: vector(0.3) + Vector3::new(0.5, 0.0, 0.0),
    };
    let scatter: [Vector3<f64>; 4] = std::array::from_fn(|_| vector(0.03).component_mul(&Vector3::new(1.0, 1.0, 0.1)));
    let corners = [(0.07, 0.09), (0.07, -0.09), (-0.07, 0.09), (-0.07, -0.09)];
    let step = |k: usize| {
        let time = (k + 1) as f64 * 0.025;
        let reference = State {
            position: Vector3::new(0.5 * time, 0.0, 0.17),
            velocity: Vector3::new(0.5, 0.0, 0.0),
            ..State::zero()
        };
        let feet = std::array::from_fn(|leg| {
            let (x, y) = corners[leg];
            stance(k)[leg].then(|| Vector3::new(x, y, 0.0) + scatter[leg])
        });
        Step { reference, feet }
    };
    (state, (0..10).map(step).collect())
}

fn trot(step: usize) -> [bool; 4] {
    if step < 5 { [true, false, false, true] } else { [false, true, true, false] }
}

/// What the controller asks under an erratic policy with pushes.
fn asked() -> Vec<(State, Vec<Step>)> {
    let config = Config::default();
    let policy = trial::erratic_policy(&config, Seed::from_number(1));
    let questions = trial::questions(&config, &policy, 10 * SCENES as usize, 3);
    questions.into_iter().map(|question| (question.state, question.horizon)).collect()
}

fn bench(criterion: &mut Criterion) {
    let body = Body { mass_kg: 13.6, inertia: Matrix3::from_diagonal(&Vector3::new(0.040, 0.082, 0.088)) };
    let drawn = |stance: Stance| (0..SCENES).map(|seed| scene(seed, stance)).collect::<Vec<_>>();
    let kinds = [("trot", drawn(trot)), ("four_feet", drawn(|_| [true; 4])), ("pushed_policy", asked())];
    let solvers = [("active_set", control::Solver::ActiveSet), ("clarabel", control::Solver::Clarabel)];
    for (kind, scenes) in kinds {
        for (solver_name, solver) in solvers {
            let mut mpc = Mpc::new(&control::Mpc { solver, ..Config::default().control.mpc }, body);
            let mut next = scenes.iter().cycle();
            criterion.bench_function(&format!("mpc/{kind}/{solver_name}"), |bencher| {
                bencher.iter(|| {
                    let (state, horizon) = next.next().expect("a cycle does not end");
                    black_box(mpc.solve(black_box(state), black_box(horizon)))
                });
            });
        }
    }
}

criterion_group!(benches, bench);
criterion_main!(benches);
