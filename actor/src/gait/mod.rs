//! The trot: which legs swing when, where they land, and how they get there.

mod foothold;
mod schedule;
mod swing;

pub use foothold::{Motion, Planner};
pub use schedule::{Pair, Schedule};
pub use swing::{Point, Swing, advance, lift};
