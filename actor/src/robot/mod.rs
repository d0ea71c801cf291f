//! The robot as geometry and masses: what every other part knows of its body.

mod kinematics;
mod leg;
mod mjcf;
mod model;

pub use kinematics::{Geometry, LegPoint, Posture};
pub use leg::Leg;
/// Standard gravity, m/s², along −z of the world.
pub const GRAVITY: f64 = 9.81;

pub use mjcf::mjcf;
pub use model::{Composite, Link, Model};
pub(crate) use model::{KNEE_RADIUS, box_inertia};
