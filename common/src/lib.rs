//! What both wings of herd speak: the spaces, transitions, episodes, policy, seeds, bounds and configuration.
//!
//! Plain data and pure functions, but for `telemetry` and `shutdown`, which shells use. It knows nothing of
//! physics, of candle or of the wire.

pub mod caps;
pub mod config;
pub mod episode;
pub mod hash;
pub mod policy;
pub mod seed;
pub mod shutdown;
pub mod spaces;
pub mod status;
pub mod telemetry;
pub mod transition;
pub mod work;
