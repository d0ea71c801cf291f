//! The simulated world: the only place that knows rapier, and where its `f32` ends and our `f64` begins.

mod build;
mod contact;
mod convert;
#[cfg(test)]
mod invariants;
mod world;

pub use contact::Contacts;
pub use world::{RobotState, Start, World};
