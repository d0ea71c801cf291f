//! The actor wing of herd: robot, gait, predictive control, simulation, environment and the loop that runs an episode.
//!
//! Cores first, in reading order: no clock, no I/O, randomness only from the seeds passed in. Then the shell that puts
//! robots into threads and connects them to a learner.

pub mod robot;

pub mod gait;

pub mod mpc;

pub mod sim;

pub mod control;

pub mod env;

pub mod explore;

pub mod rollout;

pub mod film;

pub mod trace;

pub mod trial;

mod backoff;
mod meter;
mod policies;
pub mod run;
mod simulated;
mod uplink;
pub mod worker;

#[cfg(test)]
mod testing;
