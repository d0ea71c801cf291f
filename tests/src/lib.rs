//! The fixture of the whole-system tests: real `herd` processes, watched, hurt on purpose and cleaned up.
//!
//! Nothing here knows how herd works inside. It starts the binary that people start, looks at what they can see (exit
//! codes, output, the run directory, gRPC) and breaks what breaks in the field (processes, files, cables, messages).

mod binary;
pub mod damage;
mod fingerprint;
pub mod hosts;
pub mod patience;
mod process;
pub mod processes;
mod run;
pub mod wire;

pub use binary::herd;
pub use fingerprint::Fingerprint;
pub use patience::eventually;
pub use process::{Finished, Process};
pub use run::{Run, SEED};
