//! What holds on any ground and under any payload: weight, friction, the surface that was asked for. Tests only.

use super::invariants::{Rigid, links, momentum, stand_on, torques};
use super::{Ground, Site, Start, World};
use crate::robot::{GRAVITY, Leg, Model};
use herd_common::config::Config;
use herd_common::seed::Seed;
use nalgebra::{Matrix3, UnitQuaternion, Vector3};

fn ground(slope_deg: f64, bump: f64, step: f64) -> Ground {
    Ground::new(slope_deg.to_radians(), bump, step, Seed::from_number(7))
}

/// The nominal stance parallel to the slope, `gap` metres clear of the ground at (x, 0) if that is even.
fn placed(site: &Site, x: f64, gap: f64) -> (Model, World) {
    let config = Config::default();
    let model = Model::new(&config.robot);
    let ground = &site.ground;
    let up = Vector3::new(-ground.slope_rad().sin(), 0.0, ground.slope_rad().cos());
    let start = Start {
        position: Vector3::new(x, 0.0, ground.height(x, 0.0)) + up * (model.standing_height() + gap),
        rotation: UnitQuaternion::from_axis_angle(&Vector3::y_axis(), -ground.slope_rad()),
        joints: model.nominal_stance(),
    };
    let world = World::at(&model, &config.sim, site, &start);
    (model, world)
}

fn stand(model: &Model, world: &mut World, site: &Site, ticks: usize) {
    stand_on(model, world, site.ground.slope_rad(), ticks);
}

/// Mean normal force on all feet over the next 0.4 s of standing, N.
fn normal(model: &Model, world: &mut World, site: &Site) -> f64 {
    let mut sum = 0.0;
    for _ in 0..200 {
        stand(model, world, site, 1);
        sum += world.contacts().normal.iter().sum::<f64>() / 200.0;
    }
    sum
}

#[test]
fn a_slope_carries_the_part_of_the_weight_that_presses_on_it() {
    let site = Site { ground: ground(15.0, 0.0, 0.0), ..Site::default() };
    let (model, mut world) = placed(&site, 0.0, 0.001);
    stand(&model, &mut world, &site, 500);
    let settled = world.state();
    let expected = model.mass() * GRAVITY * 15.0_f64.to_radians().cos();
    let found = normal(&model, &mut world, &site);
    assert!((found / expected - 1.0).abs() < 0.01, "{found} N for {expected} N");
    let friction: f64 = world.contacts().friction.iter().sum();
    let least = model.mass() * GRAVITY * 15.0_f64.to_radians().sin();
    assert!(friction > 0.98 * least, "{friction} N hold {least} N");
    let drift = (world.state().position - settled.position).norm();
    assert!(drift < 5e-3, "{drift} m in 0.4 s");
}

#[test]
fn friction_holds_up_to_its_limit_and_no_further() {
    let slide = |friction: f64| {
        let site = Site { ground: ground(10.0, 0.0, 0.0), friction_factor: friction / 0.7, ..Site::default() };
        let (model, mut world) = placed(&site, 0.0, 0.0005);
        stand(&model, &mut world, &site, 150);
        let before = world.state().velocity;
        stand(&model, &mut world, &site, 100);
        (world.state().velocity - before).norm() / 0.2
    };
    let slope = 10.0_f64.to_radians();
    let expected = GRAVITY * (slope.sin() - 0.08 * slope.cos());
    let found = slide(0.08);
    assert!((found / expected - 1.0).abs() < 0.05, "{found} m/s² for {expected}");
    let found = slide(0.3);
    assert!(found < 0.1, "{found} m/s², though tan 10° is 0.18");
}

#[test]
fn a_payload_adds_its_weight_to_the_feet() {
    let standing = |payload_kg: f64| {
        let site = Site { payload_kg, ..Site::default() };
        let (model, mut world) = placed(&site, 0.0, 0.001);
        stand(&model, &mut world, &site, 500);
        normal(&model, &mut world, &site)
    };
    let added = standing(4.0) - standing(0.0);
    assert!((added / (4.0 * GRAVITY) - 1.0).abs() < 0.02, "{added} N");
}

#[test]
fn a_push_moves_robot_and_payload() {
    let (model, mut world) = placed(&Site { payload_kg: 4.0, ..Site::default() }, 0.0, 1.5);
    world.push(&Vector3::new(0.0, 60.0, 0.0), 25);
    for _ in 0..40 {
        world.tick(&torques(0.0));
    }
    let state = world.state();
    let arm = state.rotation * Vector3::new(0.0, 0.0, 0.035 + 0.03);
    let payload = Rigid {
        mass: 4.0,
        inertia: Matrix3::zeros(),
        position: state.position + arm,
        velocity: state.velocity + state.angular_velocity.cross(&arm),
        spin: state.angular_velocity,
    };
    let mut all = links(&model, &world);
    all.push(payload);
    let found = momentum(&all);
    assert!((found.y - 60.0 * 0.05).abs() < 0.03, "{found}");
    let fall = (model.mass() + 4.0) * GRAVITY * 0.08;
    assert!((found.z + fall).abs() < 0.1, "{found} for {fall}");
}

/// Distance from a point to the ground, m, by looking around below it.
fn distance(ground: &Ground, point: &Vector3<f64>) -> f64 {
    let offsets = || (-60..=60).map(|n| f64::from(n) * 2e-4);
    let surface = offsets().flat_map(|dx| offsets().map(move |dy| (point.x + dx, point.y + dy)));
    surface.map(|(x, y)| (Vector3::new(x, y, ground.height(x, y)) - point).norm()).fold(f64::INFINITY, f64::min)
}

/// While the robot drops on the ground and stands, feet that carry weight touch the surface of the pure function.
#[track_caller]
fn feet_rest_on(site: &Site, x: f64, gap: f64) {
    let (model, mut world) = placed(site, x, gap);
    let mut carrying = 0;
    for _ in 0..25 {
        stand(&model, &mut world, site, 8);
        let (state, contacts) = (world.state(), world.contacts());
        for leg in Leg::ALL.into_iter().filter(|leg| contacts.normal[leg.index()] > 1.0) {
            let in_body = model.geometry.foot_in_body(leg, &state.joints[leg.index()]);
            let foot = state.position + state.rotation * in_body;
            let gap = distance(&site.ground, &foot) - model.foot_radius;
            assert!(gap.abs() < 1e-3, "{leg:?} at {foot} is {gap} m above the ground");
            carrying += 1;
        }
    }
    assert!(carrying >= 20, "feet carry {carrying} times");
}

#[test]
fn feet_rest_on_the_bumps_of_the_function() {
    for x in [0.0, 1.37, -2.9] {
        feet_rest_on(&Site { ground: ground(0.0, 0.02, 0.0), ..Site::default() }, x, 0.02);
        feet_rest_on(&Site { ground: ground(10.0, 0.02, 0.0), ..Site::default() }, x, 0.02);
    }
}

#[test]
fn feet_rest_on_the_steps_of_the_function() {
    for (slope, bump) in [(0.0, 0.0), (8.0, 0.0), (8.0, 0.02)] {
        let site = Site { ground: ground(slope, bump, 0.03), ..Site::default() };
        let (from, to) = site.ground.steps().and_then(|steps| steps.raised().nth(1)).expect("a second tread");
        for x in [f64::midpoint(from, to), -f64::midpoint(from, to), to + 0.25] {
            feet_rest_on(&site, x, 0.001 + bump);
        }
    }
}

#[test]
fn a_foot_that_slides_over_cells_meets_no_edge() {
    // Bumps of almost nothing are a plane cut into triangles: friction alone slows the robot down.
    let speed_left = |bump: f64| {
        let site = Site { ground: ground(0.0, bump, 0.0), friction_factor: 0.1 / 0.7, ..Site::default() };
        let (model, mut world) = placed(&site, 0.0, 0.0005);
        stand(&model, &mut world, &site, 150);
        world.add_velocity(&Vector3::new(0.8, 0.3, 0.0));
        stand(&model, &mut world, &site, 150);
        world.state().velocity.norm()
    };
    let (plane, cells) = (speed_left(0.0), speed_left(1e-6));
    assert!((plane - cells).abs() < 0.02 && plane > 0.3, "{plane} m/s, over cells {cells} m/s");
}
