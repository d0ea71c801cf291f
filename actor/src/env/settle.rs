//! The start of an episode: a robot spawned just above the ground, settled on its legs, then jostled by its seed.
//!
//! On a slope it starts parallel to the ground. While it settles, joint PD holds the drawn stance and each foot's part of
//! the weight is fed forward to it. What the seed draws, in this order: yaw, twelve joint angles, velocity along x and y.

use crate::control::Body;
use crate::robot::{Leg, Model};
use crate::sim::{Ground, Plant, Site, Spawn, Start};
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

/// The world of this seed at t = 0, made by `spawn`, with the torques (N·m) that were the last to act in it.
pub(super) fn world(
    model: &Model,
    config: &Config,
    site: &Site,
    seed: Seed,
    spawn: &mut Spawn,
) -> (Box<dyn Plant>, [Vector3<f64>; 4]) {
    let mut rng = seed.child("reset", 0).rng();
    let reset = &config.task.reset;
    let yaw = spread(&mut rng, reset.yaw_rad);
    let stance = Leg::ALL.map(|leg| model.nominal(leg) + Vector3::from_fn(|_, _| spread(&mut rng, reset.joint_rad)));
    let velocity = Vector3::new(spread(&mut rng, reset.velocity_mps), spread(&mut rng, reset.velocity_mps), 0.0);

    let start = start(model, &site.ground, yaw, &stance);
    let mut world = spawn(model, &config.sim, site, &start);
    let slope = site.ground.slope_rad();
    let mut torques = [Vector3::zeros(); 4];
    for _ in 0..(config.task.settle_secs / config.sim.tick_secs).round() as u64 {
        let state = world.state();
        let body = Body::new(model, &state);
        torques = Leg::ALL.map(|leg| {
            let i = leg.index();
            let hold = (stance[i] - state.joints[i]) * STIFFNESS - state.joint_speeds[i] * DAMPING;
            (hold + body.stance_torques(leg, &model.standing_force(leg, slope)))
                .map(|x| x.clamp(-model.torque_max, model.torque_max))
        });
        world.tick(&torques);
    }
    world.add_velocity(&velocity);
    (world, torques)
}

/// The pose with these joint angles (rad) whose lowest foot is just above the ground, with the trunk over the origin.
fn start(model: &Model, ground: &Ground, yaw: f64, stance: &[Vector3<f64>; 4]) -> Start {
    let uphill = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), -ground.slope_rad());
    let rotation = uphill * UnitQuaternion::from_euler_angles(0.0, 0.0, yaw);
    // How far each foot would stick in the ground if the trunk were at z = 0.
    let depths = Leg::ALL.map(|leg| {
        let foot = rotation * model.geometry.foot_in_body(leg, &stance[leg.index()]);
        let radius = model.foot_radius / ground.normal(foot.x, foot.y).z;
        radius + CLEARANCE + ground.height(foot.x, foot.y) - foot.z
    });
    let height = depths.into_iter().fold(f64::NEG_INFINITY, f64::max);
    Start { position: Vector3::new(0.0, 0.0, height), rotation, joints: *stance }
}

/// Uniform within ± `half`.
fn spread(rng: &mut impl Rng, half: f64) -> f64 {
    (2.0 * rng.random::<f64>() - 1.0) * half
}
