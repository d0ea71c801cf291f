//! The simulated world: the only place that knows rapier, and where its `f32` ends and our `f64` begins.
//!
//! An episode sees a `Plant`: rapier's `World`, or a `remote` one that another program simulates.

mod build;
mod contact;
mod convert;
mod ground;
#[cfg(test)]
mod invariants;
mod plant;
mod remote;
#[cfg(test)]
mod site_invariants;
mod snapshot;
mod terrain;
mod world;

pub use contact::Contacts;
pub use ground::Ground;
pub use plant::{Plant, Spawn, rapier};
pub use remote::{Ask, Asker, Pose, remote};
pub use snapshot::{Snapshot, flat, legs};
pub use world::{RobotState, Site, Start, World};
