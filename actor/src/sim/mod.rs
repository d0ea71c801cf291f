//! The simulated world: the only place that knows rapier, and where its `f32` ends and our `f64` begins.

mod build;
mod contact;
mod convert;
mod ground;
#[cfg(test)]
mod invariants;
#[cfg(test)]
mod site_invariants;
mod terrain;
mod world;

pub use contact::Contacts;
pub use ground::Ground;
pub use world::{RobotState, Site, Start, World};
