//! Who walks: the options of the commands that run one robot through one episode.

use crate::args::ConfigArgs;
use crate::exit::Failure;
use anyhow::Context;
use herd_common::config::Config;
use herd_common::config::scenario::Config as Scenario;
use herd_common::policy::Policy;
use herd_common::seed::Seed;
use herd_common::spaces::Task;
use std::path::{Path, PathBuf};

/// A policy or a constant gait, and an episode.
#[derive(clap::Args, Clone, Debug)]
pub(crate) struct WalkerArgs {
    /// Policy that acts; its configuration is the one beside it.
    #[arg(long, value_name = "FILE")]
    policy: Option<PathBuf>,
    /// Take configuration and policy of this run.
    #[arg(long, value_name = "DIR")]
    run_dir: Option<PathBuf>,
    /// Task: short for --set task.kind=KIND; `constant` needs no policy.
    #[arg(long, value_name = "KIND", value_parser = ["gait", "torque", "constant", "command"])]
    task: Option<String>,
    /// Number of the episode, counted as `herd eval` counts them.
    #[arg(long, value_name = "N", default_value_t = 0)]
    episode: u64,
    #[command(flatten)]
    config: ConfigArgs,
}

impl WalkerArgs {
    /// The configuration: the run's, or the file's, or the one beside the policy, with the overrides on top.
    pub(crate) fn load(&self) -> Result<Config, herd_common::config::Error> {
        let mut config = self.config.clone();
        config.set.splice(0..0, self.task.iter().map(|kind| format!("task.kind={kind}")));
        let beside = self.policy.as_ref().and_then(|file| file.parent());
        config.load(self.run_dir.as_deref().or(beside))
    }

    /// The policy that the options name, checked against `config`; none for the constant task.
    pub(crate) fn policy(&self, config: &Config) -> anyhow::Result<Option<Policy>> {
        if config.task.kind == Task::Constant {
            return Ok(None);
        }
        let of_run = self.run_dir.as_ref().map(|dir| dir.join("policy.safetensors"));
        let Some(file) = self.policy.clone().or(of_run) else { return Ok(None) };
        let policy = read(&file)?;
        policy.expect_task(&config.task_hash())?;
        Ok(Some(policy))
    }

    /// Number and seed of the episode.
    pub(crate) fn episode(&self, config: &Config) -> (u64, Seed) {
        (self.episode, Seed::from_number(config.seed).child("evaluation", self.episode))
    }
}

/// Refuses a scenario whose ground or load are not the plain ones.
pub(crate) fn expect_level(config: &Config) -> Result<(), Failure> {
    let (asked, plain) = (&config.scenario, Scenario::plain());
    for (key, asked, plain) in [
        ("friction_factor", asked.friction_factor, plain.friction_factor),
        ("payload_kg", asked.payload_kg, plain.payload_kg),
        ("slope_deg", asked.slope_deg, plain.slope_deg),
        ("bump_m", asked.bump_m, plain.bump_m),
        ("step_m", asked.step_m, plain.step_m),
    ] {
        if asked != plain {
            let text =
                format!("scenario.{key} is {asked:?}, expected {plain:?}: here ground is level and nothing carried");
            return Err(Failure::usage(text));
        }
    }
    Ok(())
}

/// The policy in a `policy.safetensors`.
fn read(file: &Path) -> anyhow::Result<Policy> {
    let bytes = std::fs::read(file).map_err(|e| Failure::usage(format!("read policy {}: {e}", file.display())))?;
    Policy::from_safetensors(&bytes).with_context(|| format!("read policy {}", file.display()))
}
