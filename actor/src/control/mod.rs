//! The low-level controller (paper §3.3): from gait parameters to joint torques, at every tick.
//!
//! `reference` says where the trunk should be, `steering` where it should head, `contact` which legs carry, `terrain` what
//! ground they feel, `stance` asks the MPC for their forces, `leg` turns forces and paths into torques, `controller` ties
//! them together.

mod contact;
mod controller;
mod latency;
mod leg;
mod reference;
mod stance;
mod steering;
mod terrain;

pub use controller::{Controller, Timer, Watcher};
pub use latency::Latency;
pub use leg::Body;
