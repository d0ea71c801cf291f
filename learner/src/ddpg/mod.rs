//! DDPG (paper eqs 6–9), with the parts of TD3 that tame its overestimation.
//!
//! `Ddpg::update` is one step of learning: sample, both losses' gradients at the same weights, then every weight, moment
//! and target copy in one pass. The backward pass is written out, because a graph of tensors costs as much as the
//! matrix products it records; a test holds it equal to candle's autograd.
//!
//! Bits: everything runs on the calling thread in a fixed order, and update k draws from `seed.child("update", k)`, so a
//! learner's future is a function of its snapshot and of the replay memory.
//!
//! On the CPU all large matrices stand in `strips` and each product is `product`; losses are candle's tensors.
//!
//! `device` takes the same steps on a GPU, several of them at a time. [`Learner`] is the one that the configuration asks
//! for.

mod batch;
mod device;
mod error;
mod kernels;
mod learner;
mod losses;
mod networks;
mod optimizer;
mod priorities;
mod product;
mod rows;
mod snapshot;
mod strips;
#[cfg(test)]
mod tests;
mod tile;
mod update;

pub use batch::Batch;
pub use device::{Device, OnDevice};
pub use error::Error;
pub use learner::Learner;
pub use snapshot::{Counters, Record, Snapshot};
pub use update::{Ddpg, Update};
