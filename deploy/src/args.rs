//! Options that several commands share.

use clap::Args;
use herd_common::config::Config;
use herd_proto::address::Address;
use std::path::{Path, PathBuf};

/// What overrides the default configuration.
#[derive(Args, Clone, Debug, Default)]
pub(crate) struct ConfigArgs {
    /// TOML file whose keys override the default configuration.
    #[arg(long, value_name = "FILE")]
    pub(crate) config: Option<PathBuf>,
    /// Override one key, such as --set ddpg.batch_size=128. May be repeated.
    #[arg(long, value_name = "KEY=VALUE")]
    pub(crate) set: Vec<String>,
    /// Root of every random number: short for --set seed=N.
    #[arg(long, value_name = "N")]
    pub(crate) seed: Option<u64>,
}

impl ConfigArgs {
    /// All overrides as `key=value`.
    pub(crate) fn sets(&self) -> Vec<String> {
        let seed = self.seed.map(|seed| format!("seed={seed}"));
        self.set.iter().cloned().chain(seed).collect()
    }

    /// True when nothing is overridden.
    pub(crate) fn is_empty(&self) -> bool {
        self.config.is_none() && self.set.is_empty() && self.seed.is_none()
    }

    /// The configuration that results; that of a run directory takes the place of the default.
    pub(crate) fn load(&self, run_dir: Option<&Path>) -> Result<Config, herd_common::config::Error> {
        let stored = run_dir.map(|dir| dir.join("config.toml")).filter(|path| path.exists());
        match (stored, &self.config) {
            (Some(stored), None) => Config::load(Some(&stored), &self.sets()),
            (_, file) => Config::load(file.as_deref(), &self.sets()),
        }
    }
}

/// Which learner to talk to.
#[derive(Args, Clone, Debug)]
pub(crate) struct LearnerArgs {
    /// HOST:PORT of the learner, or file:PATH of a file that holds it.
    #[arg(long, value_name = "ADDRESS", default_value = DEFAULT_LEARNER)]
    learner: Address,
    /// Find the learner by its run directory instead.
    #[arg(long, value_name = "DIR", conflicts_with = "learner")]
    run_dir: Option<PathBuf>,
}

/// Where a learner listens unless told otherwise.
pub(crate) const DEFAULT_LEARNER: &str = "127.0.0.1:7447";

impl LearnerArgs {
    /// The learner's address.
    pub(crate) fn address(&self) -> Address {
        self.run_dir.as_deref().map_or_else(|| self.learner.clone(), Address::of_run)
    }
}
