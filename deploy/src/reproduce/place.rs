//! Where robots train and are measured: on the paper's flat ground, and where every episode draws what it meets.

use serde::Serialize;

/// One of the two.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Place {
    /// Level ground, nothing unexpected.
    Flat,
    /// Slope, grip, payload and pushes, all at once, drawn anew for each episode.
    Rough,
}

/// What rough is.
const ROUGH: [&str; 5] = [
    "scenario.slope_deg=[0, 10]",
    "scenario.friction_factor=[0.45, 1.15]",
    "scenario.payload_kg=[0, 4]",
    "scenario.push_ns=[0, 10]",
    "scenario.push_every_secs=[3, 3]",
];
/// The same for people.
pub(super) const ROUGH_IN_WORDS: &str =
    "slopes of 0 to 10° uphill, 0.45 to 1.15 times the friction, 0 to 4 kg of payload, a push of 0 to 10 N·s every 3 s";

impl Place {
    /// In what its configuration differs from the base, each `key=value`.
    pub(super) fn sets(self) -> Vec<String> {
        match self {
            Self::Flat => Vec::new(),
            Self::Rough => ROUGH.map(str::to_owned).into(),
        }
    }

    /// What people call it.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Flat => "flat",
            Self::Rough => "rough",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use herd_common::config::Config;

    #[test]
    fn rough_is_what_it_says() {
        let config = Config::default().overridden(&Place::Rough.sets()).expect("valid");
        let scenario = &config.scenario;
        assert_eq!((scenario.slope_deg, scenario.payload_kg), ([0.0, 10.0], [0.0, 4.0]));
        assert_eq!((scenario.friction_factor, scenario.push_ns), ([0.45, 1.15], [0.0, 10.0]));
        assert_eq!(scenario.push_every_secs, [3.0, 3.0]);
        assert_eq!(Config::default().overridden(&Place::Flat.sets()).expect("valid"), Config::default());
    }
}
