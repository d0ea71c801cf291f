//! The actor wing of herd: robot, gait, predictive control, simulation, environment and the loop that runs an episode.
//!
//! Everything here is a core: no clock, no I/O, randomness only from the seeds passed in. Reading order:

pub mod robot;

pub mod gait;

pub mod mpc;

pub mod sim;

pub mod control;

pub mod env;

pub mod explore;

pub mod rollout;
