//! The start of an episode: a robot spawned just above the ground, settled on its legs, then jostled by its seed.
//!
//! While it settles, joint PD holds the drawn stance and a quarter of the weight is fed forward to each foot. What the
//! seed draws, in this order: yaw, twelve joint angles, velocity along x and y.

use crate::control::Body;
use crate::robot::{GRAVITY, Leg, Model};
use crate::sim::{RobotState, Start, World};
use herd_common::config::Config;
use herd_common::seed::Seed;
use nalgebra::{UnitQuaternion, Vector3};
use rand::{Rng, RngExt};

/// Joint stiffness, N·m/rad, and damping, N·m·s/rad, while settling. Measured over 30 seeds: after 0.2 s no trunk moves
/// faster than 0.02 m/s and 0.06 rad/s, as after 0.4 s with 150 and 3; damping of 6 makes a foot in the air ring.
const STIFFNESS: f64 = 100.0;
const DAMPING: f64 = 4.0;
/// Clearance below the lowest foot at the start, m.
const CLEARANCE: f64 = 0.001;

/// The world of this seed at t = 0, with the robot's state in it.
pub(super) fn world(model: &Model, config: &Config, seed: Seed) -> (World, RobotState) {
    let mut rng = seed.child("reset", 0).rng();
    let reset = &config.task.reset;
    let yaw = spread(&mut rng, reset.yaw_rad);
    let stance = Leg::ALL.map(|leg| model.nominal(leg) + Vector3::from_fn(|_, _| spread(&mut rng, reset.joint_rad)));
    let velocity = Vector3::new(spread(&mut rng, reset.velocity_mps), spread(&mut rng, reset.velocity_mps), 0.0);

    let lowest = Leg::ALL.map(|leg| model.geometry.foot_in_body(leg, &stance[leg.index()]).z);
    let lowest = lowest.into_iter().fold(f64::INFINITY, f64::min);
    let start = Start {
        position: Vector3::new(0.0, 0.0, model.foot_radius + CLEARANCE - lowest),
        rotation: UnitQuaternion::from_euler_angles(0.0, 0.0, yaw),
        joints: stance,
    };
    let mut world = World::new(model, &config.sim, &start);
    let share = Vector3::new(0.0, 0.0, model.mass() * GRAVITY / 4.0);
    for _ in 0..(config.task.settle_secs / config.sim.tick_secs).round() as u64 {
        let state = world.state();
        let body = Body::new(model, &state);
        let torques = Leg::ALL.map(|leg| {
            let i = leg.index();
            let hold = (stance[i] - state.joints[i]) * STIFFNESS - state.joint_speeds[i] * DAMPING;
            (hold + body.stance_torques(leg, &share)).map(|x| x.clamp(-model.torque_max, model.torque_max))
        });
        world.tick(&torques);
    }
    world.add_velocity(&velocity);
    let state = world.state();
    (world, state)
}

/// Uniform within ± `half`.
fn spread(rng: &mut impl Rng, half: f64) -> f64 {
    (2.0 * rng.random::<f64>() - 1.0) * half
}
