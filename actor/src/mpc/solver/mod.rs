//! The two solvers: a dual active set that is fast on programmes of this size, and an interior point to fall back on.

mod active_set;
#[cfg(test)]
mod agreement;
mod interior_point;
mod triangular;
mod working_set;

pub use active_set::ActiveSet;
pub use interior_point::InteriorPoint;
