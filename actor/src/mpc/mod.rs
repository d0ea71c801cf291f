//! Convex model-predictive control of the stance legs: which ground forces carry the trunk along its reference.
//!
//! Reading order: `model` predicts a rigid body, `qp` states the quadratic programme, `condense` writes a horizon as
//! one, `solver` solves it, `controller` ties them together. All forces are those of the ground on the robot, in
//! newtons and the world frame (z up). Source: the paper's eqs 11–14; the model is that of Di Carlo et al. 2018.
//!
//! Does not choose the gait or the footholds, and knows no joints: see `gait` and `control`.

mod condense;
mod controller;
mod model;
mod qp;
mod solver;
#[cfg(test)]
mod testing;

pub use condense::{Condenser, Step};
pub use controller::{Mpc, Solution, Status};
pub use model::{Body, GRAVITY, State};
pub use qp::{GaveUp, Qp, QpSolver, Row};
pub use solver::{ActiveSet, InteriorPoint};
