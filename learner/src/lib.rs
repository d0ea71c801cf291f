//! The learner wing of herd: what was gathered becomes a better policy, and nothing of it is ever lost.
//!
//! Cores, without sockets or clocks: [`replay`], [`ddpg`], [`export`], [`history`]. Shell: [`trainer`] owns a run's state
//! on one thread, [`service`] is its gRPC door, [`run`] puts a learner together. It knows nothing of physics.

#![cfg_attr(not(feature = "cuda"), forbid(unsafe_code))]

pub mod ddpg;
pub mod export;
pub mod fold;
pub mod history;
pub mod metrics;
pub mod replay;
pub mod run;
pub mod run_dir;
pub mod service;
pub mod shelf;
pub mod trainer;
