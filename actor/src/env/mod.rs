//! The environment: one robot, one task, episodes of decisions.
//!
//! `observation` is what the policy sees, `reward` what it is paid for, `ending` when it is over; `scenario` is what the
//! robot meets, `sensor` what it measures, `command` what it is told; `episode` runs it.

mod command;
mod ending;
mod episode;
mod observation;
mod reward;
mod scenario;
mod sensor;
mod settle;
mod summary;

pub use command::Following;
pub use episode::{Env, Observer, Step};
pub use observation::{Observation, Sense, observe};
pub use scenario::PUSH_SECS;
pub use summary::Figures;
