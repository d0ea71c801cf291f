//! What holds for any robot in any world: momentum, energy, weight, stillness. Tests only.

use super::{Start, World};
use crate::control::Body;
use crate::robot::{GRAVITY, Leg, Model};
use herd_common::config::Config;
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

/// Mass, inertia (world), position, velocity, angular velocity of one rigid link.
pub(super) struct Rigid {
    pub(super) mass: f64,
    pub(super) inertia: Matrix3<f64>,
    pub(super) position: Vector3<f64>,
    pub(super) velocity: Vector3<f64>,
    pub(super) spin: Vector3<f64>,
}

fn setup(height: f64, sets: &[&str]) -> (Config, Model, World) {
    let sets: Vec<String> = sets.iter().map(|set| (*set).to_owned()).collect();
    let config = Config::load(None, &sets).expect("valid");
    let model = Model::new(&config.robot);
    let start = Start {
        position: Vector3::new(0.0, 0.0, height),
        rotation: UnitQuaternion::from_euler_angles(0.1, -0.2, 0.3),
        joints: model.nominal_stance(),
    };
    let world = World::new(&model, &config.sim, &start);
    (config, model, world)
}

/// Every link of the robot, from kinematics alone.
pub(super) fn links(model: &Model, world: &World) -> Vec<Rigid> {
    let state = world.state();
    let rotation = state.rotation.to_rotation_matrix();
    let (w, v) = (state.angular_velocity, state.velocity);
    let spun = |r: Rotation3<f64>, i: &Matrix3<f64>| r.matrix() * i * r.matrix().transpose();
    let mut all = vec![Rigid {
        mass: model.trunk_mass,
        inertia: spun(rotation, &model.trunk_inertia),
        position: state.position,
        velocity: v,
        spin: w,
    }];
    for leg in Leg::ALL {
        let (q, qd) = (state.joints[leg.index()], state.joint_speeds[leg.index()]);
        let posture = model.geometry.posture(leg, &q);
        let roll = rotation * Rotation3::from_axis_angle(&Vector3::x_axis(), q[0]);
        let turn = |angle| roll * Rotation3::from_axis_angle(&Vector3::y_axis(), angle);
        let roll_spin = w + rotation * Vector3::x() * qd[0];
        let frames = [
            (roll, roll_spin),
            (turn(q[1]), roll_spin + roll * Vector3::y() * qd[1]),
            (turn(q[1] + q[2]), roll_spin + roll * Vector3::y() * (qd[1] + qd[2])),
        ];
        for (link, (frame, spin)) in model.links.iter().zip(frames) {
            let arm = rotation * posture.position(link.centre);
            all.push(Rigid {
                mass: link.mass,
                inertia: spun(frame, &link.inertia),
                position: state.position + arm,
                velocity: v + w.cross(&arm) + rotation * (posture.jacobian(link.centre) * qd),
                spin,
            });
        }
    }
    all
}

pub(super) fn momentum(links: &[Rigid]) -> Vector3<f64> {
    links.iter().map(|link| link.velocity * link.mass).sum()
}

/// The centre of mass.
fn centre(links: &[Rigid]) -> Vector3<f64> {
    let mass: f64 = links.iter().map(|link| link.mass).sum();
    links.iter().map(|link| link.position * link.mass).sum::<Vector3<f64>>() / mass
}

/// About the centre of mass.
fn angular_momentum(links: &[Rigid]) -> Vector3<f64> {
    let centre = centre(links);
    links.iter().map(|link| (link.position - centre).cross(&link.velocity) * link.mass + link.inertia * link.spin).sum()
}

/// Kinetic and potential energy, rotors included, J.
fn energy(model: &Model, world: &World) -> f64 {
    let rotors: f64 =
        world.state().joint_speeds.iter().map(Vector3::norm_squared).sum::<f64>() * model.joint_armature / 2.0;
    let bodies: f64 = links(model, world)
        .iter()
        .map(|link| {
            let kinetic = link.mass * link.velocity.norm_squared() + link.spin.dot(&(link.inertia * link.spin));
            kinetic / 2.0 + link.mass * GRAVITY * link.position.z
        })
        .sum();
    rotors + bodies
}

/// Different torques on every joint, N·m.
pub(super) fn torques(scale: f64) -> [Vector3<f64>; 4] {
    [0.3, -0.7, 1.0, -0.2].map(|x| Vector3::new(x, 1.0 - x, -0.5 * x) * scale)
}

#[test]
fn momentum_in_free_flight_changes_by_gravity_alone() {
    let (config, model, mut world) = setup(2.0, &[]);
    world.add_velocity(&Vector3::new(0.5, -0.25, 0.0));
    let before = momentum(&links(&model, &world));
    for _ in 0..100 {
        world.tick(&torques(1.0));
    }
    let fall = Vector3::z() * (model.mass() * GRAVITY * 100.0 * config.sim.tick_secs);
    let after = momentum(&links(&model, &world));
    assert!((after - before + fall).norm() < 0.1, "{before} {after}");
    assert!(world.state().joint_speeds[2].norm() > 3.0, "the torques moved the legs");
}

#[test]
fn a_fall_is_as_long_as_gravity_makes_it() {
    for substeps in [1, 4] {
        let (config, model, mut world) = setup(2.0, &[&format!("sim.substeps={substeps}")]);
        let sideways = Vector3::new(0.5, -0.25, 0.0);
        let start = centre(&links(&model, &world));
        world.add_velocity(&sideways);
        for ticks in 1..=150 {
            world.tick(&torques(0.0));
            let secs = f64::from(ticks) * config.sim.tick_secs;
            let expected = start + sideways * secs - Vector3::z() * (GRAVITY * secs.powi(2) / 2.0);
            let apart = centre(&links(&model, &world)) - expected;
            assert!(apart.norm() < 2e-4, "{apart} m after {secs} s, {substeps} substeps");
        }
    }
}

#[test]
fn a_change_of_velocity_moves_nothing_by_itself() {
    let (_, _, mut world) = setup(2.0, &[]);
    (0..30).for_each(|_| world.tick(&torques(1.0)));
    let before = world.state();
    world.add_velocity(&Vector3::new(2.0, -1.0, 0.5));
    let after = world.state();
    assert!((after.position - before.position).norm() < 1e-6, "{} {}", before.position, after.position);
    assert!((after.velocity - before.velocity - Vector3::new(2.0, -1.0, 0.5)).norm() < 1e-6);
    assert_eq!(after.joints, before.joints);

    let (_, _, mut other) = setup(2.0, &[]);
    let still = other.state();
    other.set_speeds(&before);
    let set = other.state();
    assert!((set.position - still.position).norm() < 1e-6 && set.rotation.angle_to(&still.rotation) < 1e-6);
    let apart = set.joints.iter().zip(&still.joints).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
    assert!(apart < 1e-6, "{apart} rad");
    assert!((set.joint_speeds[3] - before.joint_speeds[3]).norm() < 1e-6 && before.joint_speeds[3].norm() > 1.0);
}

#[test]
fn joint_torques_and_damping_leave_angular_momentum_alone() {
    let (_, model, mut world) = setup(2.0, &["robot.joint_damping=0.1"]);
    for _ in 0..60 {
        world.tick(&torques(1.0));
    }
    let turning = world.state().angular_velocity.norm();
    assert!(turning > 0.5, "the legs' reaction turns the trunk: {turning}");
    for _ in 0..60 {
        world.tick(&torques(0.0));
    }
    let left = angular_momentum(&links(&model, &world)).norm();
    assert!(left < 0.01, "{left} N m s from nothing");
}

#[test]
fn energy_in_free_flight_is_kept_without_joint_damping() {
    let (_, model, mut world) = setup(2.0, &["robot.joint_damping=0.0", "sim.substeps=4"]);
    for _ in 0..30 {
        world.tick(&torques(1.0));
    }
    let before = energy(&model, &world);
    for _ in 0..50 {
        world.tick(&torques(0.0));
    }
    let moving = energy(&model, &world) - before;
    let kinetic: f64 = links(&model, &world).iter().map(|link| link.mass * link.velocity.norm_squared() / 2.0).sum();
    assert!(moving.abs() < 0.02 * kinetic, "{moving} J of {kinetic} J");
}

#[test]
fn the_free_root_is_not_damped() {
    let (_, _, mut world) = setup(2.0, &[]);
    for _ in 0..30 {
        world.tick(&torques(1.0));
    }
    let (_, model, _) = setup(2.0, &[]);
    let spun = angular_momentum(&links(&model, &world)).norm();
    assert!(spun < 0.01, "{spun}");
    world.add_velocity(&Vector3::new(1.0, 0.0, 0.0));
    let before = momentum(&links(&model, &world)).x;
    (0..50).for_each(|_| world.tick(&torques(0.0)));
    assert!((momentum(&links(&model, &world)).x - before).abs() < 0.01);
}

/// Holds the nominal stance by PD with the weight fed forward, on level ground.
fn stand(model: &Model, world: &mut World, ticks: usize) {
    stand_on(model, world, 0.0, ticks);
}

/// The same on a slope, rad.
pub(super) fn stand_on(model: &Model, world: &mut World, slope_rad: f64, ticks: usize) {
    for _ in 0..ticks {
        let state = world.state();
        let body = Body::new(model, &state);
        let torques = Leg::ALL.map(|leg| {
            let i = leg.index();
            (model.nominal(leg) - state.joints[i]) * 150.0 - state.joint_speeds[i] * 3.0
                + body.stance_torques(leg, &model.standing_force(leg, slope_rad))
        });
        world.tick(&torques);
    }
}

fn standing() -> (Config, Model, World) {
    let config = Config::default();
    let model = Model::new(&config.robot);
    let start = Start {
        position: Vector3::new(0.0, 0.0, model.standing_height() + 0.001),
        rotation: UnitQuaternion::identity(),
        joints: model.nominal_stance(),
    };
    let world = World::new(&model, &config.sim, &start);
    (config, model, world)
}

#[test]
fn the_feet_carry_the_weight_and_the_robot_stays_put() {
    let (_, model, mut world) = standing();
    stand(&model, &mut world, 500);
    let settled = world.state();
    let mut normal = 0.0;
    for _ in 0..200 {
        stand(&model, &mut world, 1);
        normal += world.contacts().normal.iter().sum::<f64>() / 200.0;
    }
    let weight = model.mass() * GRAVITY;
    assert!((normal / weight - 1.0).abs() < 0.01, "{normal} N for {weight} N");
    let drift = (world.state().position - settled.position).norm();
    assert!(drift < 2e-3, "{drift} m in 0.4 s");
    assert!((settled.position.z - model.standing_height()).abs() < 1e-3);
    let contacts = world.contacts();
    assert!(contacts.feet == [true; 4] && !contacts.trunk && !contacts.knee);
}

/// The first tick, from 1, after which any foot is on the ground, of a robot that falls from this high above it, m.
fn touchdown(clearance: f64, substeps: usize) -> u32 {
    let config = Config::load(None, &[format!("sim.substeps={substeps}")]).expect("valid");
    let model = Model::new(&config.robot);
    let start = Start {
        position: Vector3::new(0.0, 0.0, model.standing_height() + clearance),
        rotation: UnitQuaternion::identity(),
        joints: model.nominal_stance(),
    };
    let mut world = World::new(&model, &config.sim, &start);
    let lands = |_: &u32| {
        world.tick(&torques(0.0));
        world.contacts().feet.contains(&true)
    };
    (1..200).find(lands).expect("it lands")
}

#[test]
fn a_foot_is_on_the_ground_from_the_tick_in_which_it_arrives() {
    // Close to both borders of a tick: a foot whose own acceleration were left out would be told a tick late at .99.
    for ticks in (20..26).flat_map(|whole| [0.01, 0.3, 0.49, 0.51, 0.7, 0.99].map(|part| f64::from(whole) + part)) {
        // Nothing moves the legs in a free fall.
        let clearance = GRAVITY * (ticks * Config::default().sim.tick_secs).powi(2) / 2.0;
        for substeps in [1, 2, 4] {
            let found = touchdown(clearance, substeps);
            assert_eq!(f64::from(found), ticks.ceil(), "arrives at {ticks} ticks, {substeps} substeps");
        }
    }
}

#[test]
fn velocities_of_feet_are_those_of_kinematics() {
    let (_, model, mut world) = setup(2.0, &[]);
    (0..30).for_each(|_| world.tick(&torques(1.0)));
    let (_, _, mut fresh) = setup(2.0, &[]);
    fresh.set_speeds(&world.state());
    for world in [&world, &fresh] {
        let (found, state) = (world.foot_velocities(), world.ahead());
        for leg in Leg::ALL {
            let posture = model.geometry.posture(leg, &state.joints[leg.index()]);
            let foot = model.geometry.foot();
            let swing = posture.jacobian(foot) * state.joint_speeds[leg.index()];
            let arm = state.rotation * posture.position(foot);
            let expected = state.velocity + state.angular_velocity.cross(&arm) + state.rotation * swing;
            let apart = (found[leg.index()] - expected).norm();
            assert!(apart < 1e-3 && expected.norm() > 0.5, "{leg:?}: {} {expected}", found[leg.index()]);
        }
    }
}

#[test]
fn a_limp_robot_ends_on_its_knees_or_trunk() {
    let (_, _, mut world) = standing();
    let touched = (0..500).any(|_| {
        world.tick(&torques(0.0));
        world.contacts().trunk || world.contacts().knee
    });
    assert!(touched);
}

#[test]
fn a_push_adds_its_impulse_and_then_stops() {
    let (config, model, mut world) = setup(2.0, &[]);
    world.push(&Vector3::new(0.0, 40.0, 0.0), 10);
    for _ in 0..30 {
        world.tick(&torques(0.0));
    }
    let impulse = 40.0 * 10.0 * config.sim.tick_secs;
    assert!((momentum(&links(&model, &world)).y - impulse).abs() < 0.02);
}

#[test]
fn equal_worlds_stay_equal_to_the_bit() {
    let run = || {
        let (_, model, mut world) = standing();
        stand(&model, &mut world, 50);
        (0..50).for_each(|_| world.tick(&torques(2.0)));
        (world.state(), world.contacts())
    };
    assert_eq!(run(), run());
}
