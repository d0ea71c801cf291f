//! The configuration of a run: one commented default, overridden by a file, overridden by `--set key=value`.
//!
//! Every component's settings stand in a file of their own with their commented defaults beside them; this file joins
//! and checks them. A key that no default has is refused with the nearest one that exists.

pub mod command;
pub mod control;
pub mod ddpg;
pub mod merge;
pub mod robot;
pub mod run;
pub mod scenario;
pub mod sim;
pub mod task;

use crate::hash::sha256_hex;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// The commented default configuration, as `herd config` prints it.
pub const DEFAULT: &str = concat!(
    include_str!("run.toml"),
    "\n",
    include_str!("ddpg.toml"),
    "\n",
    include_str!("task.toml"),
    "\n",
    include_str!("control.toml"),
    "\n",
    include_str!("scenario.toml"),
    "\n",
    include_str!("sim.toml"),
    "\n",
    include_str!("robot.toml"),
);

/// Everything that a run is made of, but for its seed's consequences.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Root of the seed tree.
    pub seed: u64,
    /// Episodes to commit before the run is complete.
    pub episodes: u64,
    /// Order of commits and age of policies.
    pub schedule: run::Schedule,
    /// Exploration noise.
    pub exploration: run::Exploration,
    /// Evaluation during training.
    pub evaluation: run::Evaluation,
    /// Journal and checkpoints.
    pub history: run::History,
    /// The learner.
    pub ddpg: ddpg::Config,
    /// What the policy controls and what it is paid for.
    pub task: task::Config,
    /// The low-level controller.
    pub control: control::Config,
    /// What differs from episode to episode.
    pub scenario: scenario::Config,
    /// The simulator.
    pub sim: sim::Config,
    /// The robot.
    pub robot: robot::Config,
}

/// Why a configuration is refused.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A file could not be read.
    #[error("config file {path:?}: {source}")]
    Read {
        /// Which file.
        path: PathBuf,
        /// Why not.
        source: std::io::Error,
    },
    /// A text is not TOML.
    #[error("{origin}: {message}")]
    Syntax {
        /// Which text.
        origin: String,
        /// The parser's words.
        message: String,
    },
    /// A key that does not exist.
    #[error("{origin}: unknown key `{key}`{}", nearest.as_ref().map(|n| format!(", did you mean `{n}`?")).unwrap_or_default())]
    UnknownKey {
        /// Which text.
        origin: String,
        /// The key, with its path.
        key: String,
        /// The nearest key that exists.
        nearest: Option<String>,
    },
    /// A value of the wrong type.
    #[error("{origin}: `{key}` is {found}, expected {expected}")]
    WrongType {
        /// Which text.
        origin: String,
        /// The key, with its path.
        key: String,
        /// Type and value found.
        found: String,
        /// Type expected.
        expected: String,
    },
    /// A value outside its range.
    #[error("config: `{key}` is {value}, expected {expected}")]
    Range {
        /// The key, with its path.
        key: String,
        /// The value found.
        value: String,
        /// What holds.
        expected: String,
    },
}

impl Default for Config {
    fn default() -> Self {
        Self::from_table(merge::default_table()).expect("the default configuration is valid: tested")
    }
}

impl Config {
    /// The default, overridden by `file`, overridden by `sets` (each `key=value`), checked.
    pub fn load(file: Option<&Path>, sets: &[String]) -> Result<Self, Error> {
        let mut table = merge::default_table();
        if let Some(path) = file {
            let text = read(path)?;
            merge::overlay(&mut table, &text, &format!("config file {}", path.display()))?;
        }
        Self::with_sets(table, sets)
    }

    /// This configuration with `sets` applied on top, checked.
    pub fn overridden(&self, sets: &[String]) -> Result<Self, Error> {
        let table = toml::Table::try_from(self)
            .map_err(|e| Error::Syntax { origin: "config".into(), message: e.to_string() })?;
        Self::with_sets(table, sets)
    }

    /// A complete configuration as TOML, such as `config.toml` of a run directory or one from the wire.
    pub fn from_toml(text: &str, origin: &str) -> Result<Self, Error> {
        let mut table = merge::default_table();
        merge::overlay(&mut table, text, origin)?;
        Self::from_table(table)
    }

    /// The complete configuration as TOML: equal configurations give equal texts.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).expect("plain data serialises")
    }

    /// Names what actor and learner must agree on: spaces, task, robot, controller, scenario, simulator.
    pub fn task_hash(&self) -> String {
        let blocks: Vec<_> = self.task.kind.observation().map(|b| (b.meaning, b.scale.to_bits())).collect();
        let parts = (blocks, REVISION);
        let task = self.task.identity();
        let text = serde_json::to_string(&(parts, &task, &self.control, &self.scenario, &self.sim, &self.robot));
        sha256_hex(text.expect("plain data serialises"))
    }

    /// Names the run: everything that its bits depend on, so neither its length nor how it is kept on disk.
    pub fn run_name(&self) -> String {
        let identity = Self { episodes: 0, history: run::History::default(), ..self.clone() };
        sha256_hex(serde_json::to_string(&(&identity, self.task_hash())).expect("plain data serialises"))
    }

    /// The keys in which two configurations differ, with both values as TOML.
    pub fn differences(&self, other: &Self) -> Vec<(String, String, String)> {
        let flat = |config: &Self| merge::flatten(&toml::Table::try_from(config).expect("plain data serialises"));
        let (ours, theirs) = (flat(self), flat(other));
        let both = ours.into_iter().zip(theirs).filter(|(a, b)| a != b);
        both.map(|((key, ours), (_, theirs))| (key, ours, theirs)).collect()
    }

    fn with_sets(mut table: toml::Table, sets: &[String]) -> Result<Self, Error> {
        for set in sets {
            merge::set(&mut table, set)?;
        }
        Self::from_table(table)
    }

    fn from_table(table: toml::Table) -> Result<Self, Error> {
        let config: Self = table
            .try_into()
            .map_err(|e: toml::de::Error| Error::Syntax { origin: "config".into(), message: e.message().to_owned() })?;
        config.validate()?;
        Ok(config)
    }

    fn validate(&self) -> Result<(), Error> {
        check("episodes", self.episodes, 0..=crate::caps::EPISODES)?;
        self.schedule.validate()?;
        self.exploration.validate()?;
        self.evaluation.validate()?;
        self.history.validate()?;
        self.ddpg.validate()?;
        self.task.validate()?;
        self.control.validate()?;
        self.scenario.validate()?;
        self.sim.validate()?;
        self.robot.validate()
    }
}

/// Counts changes of controller and simulator that no configuration key shows; part of the task hash.
const REVISION: u32 = 5;

fn read(path: &Path) -> Result<String, Error> {
    std::fs::read_to_string(path).map_err(|source| Error::Read { path: path.to_owned(), source })
}

/// Refuses a value outside `range`; NaN is outside every range.
pub(crate) fn check<T: PartialOrd + Copy + std::fmt::Debug>(
    key: &str,
    value: T,
    range: std::ops::RangeInclusive<T>,
) -> Result<(), Error> {
    if range.contains(&value) {
        return Ok(());
    }
    let expected = format!("{:?} to {:?}", range.start(), range.end());
    Err(Error::Range { key: key.into(), value: format!("{value:?}"), expected })
}

/// Refuses a `[lowest, highest]` pair that is out of order or leaves `range`.
pub(crate) fn check_span<T: PartialOrd + Copy + std::fmt::Debug>(
    key: &str,
    span: [T; 2],
    range: std::ops::RangeInclusive<T>,
) -> Result<(), Error> {
    if range.contains(&span[0]) && range.contains(&span[1]) && span[0] <= span[1] {
        return Ok(());
    }
    let expected = format!("[lowest, highest] within {:?} to {:?}", range.start(), range.end());
    Err(Error::Range { key: key.into(), value: format!("{span:?}"), expected })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[track_caller]
    fn refused(set: &str, expected: &str) {
        let error = Config::load(None, &[set.to_owned()]).expect_err("refused").to_string();
        assert!(error.contains(expected), "{error}");
    }

    #[test]
    fn the_default_is_valid_and_comes_back() {
        let config = Config::default();
        assert_eq!(Config::from_toml(&config.to_toml(), "effective").expect("reads"), config);
    }

    #[test]
    fn mistakes_are_named() {
        refused("ddpg.batchsize=3", "unknown key `ddpg.batchsize`, did you mean `ddpg.batch_size`?");
        refused("dpg.batch_size=3", "unknown key `dpg`, did you mean `ddpg`?");
        refused("ddpg.batch_size=\"many\"", "`ddpg.batch_size` is string \"many\", expected integer");
        refused("ddpg.batch_size", "expected key=value");
        refused("task.episode_secs=-1", "`task.episode_secs` is -1.0, expected");
        refused("task.gait.lift_m=[0.06, 0.01]", "`task.gait.lift_m` is [0.06, 0.01], expected [lowest, highest]");
        refused("task.kind=fly", "unknown variant `fly`");
    }

    #[test]
    fn whole_numbers_do_for_floats() {
        let config = Config::load(None, &["task.episode_secs=3".to_owned()]).expect("valid");
        assert_eq!(config.task.episode_secs, 3.0);
    }

    #[test]
    fn names_change_with_what_matters_only() {
        let base = Config::default();
        let with = |set: &str| base.overridden(&[set.to_owned()]).expect("valid");
        assert_eq!(with("episodes=7").run_name(), base.run_name());
        assert_ne!(with("seed=99").run_name(), base.run_name());
        assert_ne!(with("ddpg.batch_size=32").run_name(), base.run_name());
        assert_eq!(with("ddpg.batch_size=32").task_hash(), base.task_hash());
        assert_ne!(with("robot.trunk_mass_kg=10.0").task_hash(), base.task_hash());
    }
}
