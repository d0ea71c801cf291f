//! Which herd this is.

/// The commit that it was built from: a short hash, `+dirty` behind it if the sources differ; or `unknown`.
#[cfg(all(feature = "actor", feature = "learner"))]
pub(crate) const COMMIT: &str = env!("HERD_COMMIT");

/// Version and commit, for people.
pub(crate) const VERSION: &str = concat!(env!("CARGO_PKG_VERSION"), " (", env!("HERD_COMMIT"), ")");
