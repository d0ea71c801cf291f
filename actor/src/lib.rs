//! The actor wing: robot, gait, predictive control, simulation, environment and the loop that runs an episode.
//!
//! Everything here is a core: no clock, no I/O, randomness only from the seeds passed in.

pub mod robot;
pub mod sim;
