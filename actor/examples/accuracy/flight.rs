//! Open loop: torques of a trot in the air, found in the finest simulation, replayed in coarser ones.
//!
//! The robot floats two metres up and falls, so that no contact decides anything. In the finest simulation joint PD
//! leads the feet along a trot; the torques, held for 2 ms each, are then a fixed input for every other one. On the
//! ground the same comparison would say little: without feedback a trot falls over whatever the step.

use crate::Steps;
use herd_actor::gait::Swing;
use herd_actor::robot::{Leg, Model};
use herd_actor::sim::{Start, World};
use nalgebra::{UnitQuaternion, Vector3};
use std::fmt::Write as _;

/// What the others are measured by.
const FINEST: Steps = Steps::new(1e-4, 1);
/// How long a torque is held, and how long the flight lasts, s.
const HOLD_SECS: f64 = 0.002;
const FLIGHT_SECS: f64 = 0.5;
/// Length, height (m) and duration (s) of a swing.
const STRIDE: f64 = 0.09;
const LIFT: f64 = 0.04;
const STEP_SECS: f64 = 0.15;
/// Joint stiffness, N·m/rad, and damping, N·m·s/rad.
const GAINS: (f64, f64) = (150.0, 3.0);

type Joints = [Vector3<f64>; 4];

/// Errors of the joint angles against the finest simulation.
pub(crate) fn table() -> anyhow::Result<String> {
    let mut torques = Vec::new();
    let truth = fly(FINEST, &mut |model, time, joints, speeds| {
        let torque = track(model, time, joints, speeds);
        torques.push(torque);
        torque
    })?;
    let travel = truth.iter().flatten().flat_map(|leg| leg.iter().copied()).fold(0.0, |most: f64, q| most.max(q.abs()));
    let mut out = "| step | largest joint error, rad | rms, rad |\n|---|---|---|\n".to_owned();
    for steps in Steps::JUDGED {
        let mut held = torques.iter();
        let flight = fly(steps, &mut |_, _, _, _| *held.next().expect("flights are equally long"))?;
        let errors: Vec<f64> =
            flight.iter().zip(&truth).flat_map(|(a, b)| (0..12).map(|i| a[i / 3][i % 3] - b[i / 3][i % 3])).collect();
        let largest = errors.iter().fold(0.0, |most: f64, error| most.max(error.abs()));
        let rms = (errors.iter().map(|error| error * error).sum::<f64>() / errors.len() as f64).sqrt();
        writeln!(out, "| {} | {largest:.4} | {rms:.4} |", steps.name())?;
    }
    writeln!(out, "\nLargest joint angle on the way: {travel:.2} rad.")?;
    Ok(out)
}

/// Joint angles after every hold of a flight whose torques `command` gives from model, time, angles and speeds.
fn fly(steps: Steps, command: &mut dyn FnMut(&Model, f64, &Joints, &Joints) -> Joints) -> anyhow::Result<Vec<Joints>> {
    let config = steps.config(&[])?;
    let model = Model::new(&config.robot);
    let start = Start {
        position: Vector3::new(0.0, 0.0, 2.0),
        rotation: UnitQuaternion::identity(),
        joints: trot(&model, 0.0),
    };
    let mut world = World::new(&model, &config.sim, &start);
    let ticks_held = (HOLD_SECS / steps.tick_secs).round() as usize;
    let holds = (FLIGHT_SECS / HOLD_SECS).round() as usize;
    let mut angles = Vec::new();
    for hold in 0..holds {
        let state = world.state();
        let torques = command(&model, hold as f64 * HOLD_SECS, &state.joints, &state.joint_speeds);
        (0..ticks_held).for_each(|_| world.tick(&torques));
        angles.push(world.state().joints);
    }
    Ok(angles)
}

fn track(model: &Model, time: f64, joints: &Joints, speeds: &Joints) -> Joints {
    let wanted = trot(model, time);
    std::array::from_fn(|leg| (wanted[leg] - joints[leg]) * GAINS.0 - speeds[leg] * GAINS.1)
}

/// Joint angles of a trot on the spot of the air: swing forwards, straight back on the level.
fn trot(model: &Model, time: f64) -> Joints {
    Leg::ALL.map(|leg| {
        let middle = model.geometry.foot_in_body(leg, &model.nominal(leg));
        let (front, back) = (middle + Vector3::x() * STRIDE / 2.0, middle - Vector3::x() * STRIDE / 2.0);
        let lead = if leg.side() * leg.front() > 0.0 { 0.0 } else { STEP_SECS };
        let phase = (time + lead) % (2.0 * STEP_SECS);
        let foot = if phase < STEP_SECS {
            Swing { from: back, lift: LIFT, duration: STEP_SECS, advance_share: 1.0 }.at(phase, &front).position
        } else {
            front + (back - front) * (phase / STEP_SECS - 1.0)
        };
        model.geometry.joints_at(leg, &foot).expect("the path is within reach")
    })
}
