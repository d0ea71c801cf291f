//! What is to be evaluated: one policy, one gait, a sweep or a grid of gaits.

use super::{Args, commands};
use crate::exit::Failure;
use anyhow::Context;
use herd_actor::env::Observation;
use herd_common::config::Config;
use herd_common::config::task::Constant;
use herd_common::policy::Policy;
use herd_common::spaces::Task;
use std::path::Path;
use std::sync::Arc;

/// One thing to evaluate.
#[derive(Clone, Debug)]
pub(crate) struct Case {
    /// What people call it.
    pub(crate) label: String,
    /// The configuration it runs under.
    pub(crate) config: Config,
    /// The policy; none for a constant gait.
    pub(crate) policy: Option<Arc<Policy>>,
}

impl Case {
    /// The gait, for a case of the constant task.
    pub(crate) fn gait(&self) -> Option<Constant> {
        (self.config.task.kind == Task::Constant).then_some(self.config.task.constant)
    }

    /// What it does on seeing this; without a policy nothing, which a constant gait does not mind.
    pub(crate) fn act(&self, observation: &Observation) -> Vec<f32> {
        let still = || vec![0.0; self.config.task.kind.action_dim()];
        self.policy.as_ref().map_or_else(still, |policy| policy.act(observation))
    }
}

/// The cases that the options mean.
pub(crate) fn of(args: &Args, config: &Config) -> anyhow::Result<Vec<Case>> {
    if !args.commands.is_empty() {
        commands::check(config.task.kind)?;
    }
    if config.task.kind == Task::Constant {
        if args.policy.is_some() {
            return Err(Failure::usage("the constant task takes no --policy").into());
        }
        if !args.commands.is_empty() {
            return Ok(commands::cases(config, &args.commands, None)?);
        }
        return Ok(constant(args, config)?);
    }
    let (label, policy) = policy(args, config)?;
    policy.expect_task(&config.task_hash())?;
    let (found, expected) = (
        (policy.observation_dim(), policy.action_dim()),
        (config.task.kind.observation_dim(), config.task.kind.action_dim()),
    );
    if found != expected {
        return Err(Failure::config(format!("{label} takes and gives {found:?} numbers, expected {expected:?}")).into());
    }
    let policy = Arc::new(policy);
    if !args.commands.is_empty() {
        return Ok(commands::cases(config, &args.commands, Some(&policy))?);
    }
    Ok(vec![Case { label, config: config.clone(), policy: Some(policy) }])
}

fn constant(args: &Args, config: &Config) -> Result<Vec<Case>, herd_common::config::Error> {
    let gaits = match args.grid {
        Some(points) => grid(config, points),
        None if args.speeds.is_empty() => vec![config.task.constant],
        None => args.speeds.iter().map(|speed| at_speed(config.task.constant, *speed)).collect(),
    };
    of_gaits(config, &gaits)
}

/// A case for each of these gaits; the configuration is of the constant task.
pub(crate) fn of_gaits(config: &Config, gaits: &[Constant]) -> Result<Vec<Case>, herd_common::config::Error> {
    gaits.iter().map(|gait| case_of(config, gait)).collect()
}

/// The gait at another speed: the feet swing as far as the trunk moves in one step.
pub(crate) fn at_speed(gait: Constant, velocity_mps: f64) -> Constant {
    Constant { velocity_mps, stride_m: velocity_mps * gait.step_secs, ..gait }
}

/// `points` values a dimension, ends included, over the box of the gait action.
fn grid(config: &Config, points: u32) -> Vec<Constant> {
    let at = |i: u32| if points > 1 { 2.0 * i as f32 / (points - 1) as f32 - 1.0 } else { 0.0 };
    (0..points.pow(4))
        .map(|n| {
            let action = [n / points.pow(3), n / points.pow(2) % points, n / points % points, n % points].map(at);
            config.task.gait.from_action(&action)
        })
        .collect()
}

/// The overrides that make this the gait of the constant task.
pub(crate) fn gait_sets(gait: &Constant) -> [String; 4] {
    let set = |key: &str, value: f64| format!("task.constant.{key}={value:?}");
    [
        set("velocity_mps", gait.velocity_mps),
        set("stride_m", gait.stride_m),
        set("lift_m", gait.lift_m),
        set("step_secs", gait.step_secs),
    ]
}

fn case_of(config: &Config, gait: &Constant) -> Result<Case, herd_common::config::Error> {
    let config = config.overridden(&gait_sets(gait))?;
    let label = format!(
        "v_x {:.2} m/s, S {:.3} m, H {:.4} m, Δt {:.3} s",
        gait.velocity_mps, gait.stride_m, gait.lift_m, gait.step_secs
    );
    Ok(Case { label, config, policy: None })
}

fn policy(args: &Args, config: &Config) -> anyhow::Result<(String, Policy)> {
    #[cfg(feature = "learner")]
    if args.untrained {
        let policy = crate::wing::run::untrained_policy(config).map_err(crate::wing::told)?;
        return Ok((format!("untrained policy of seed {}", config.seed), policy));
    }
    let beside_config = args.run_dir.as_ref().map(|dir| dir.join("policy.safetensors"));
    let Some(file) = args.policy.clone().or(beside_config) else {
        let text = format!("the {} task needs --policy, --run-dir or --untrained", config.task.kind.name());
        return Err(Failure::usage(text).into());
    };
    let policy = read(&file)?;
    Ok((format!("policy {} of {}", policy.provenance.version, file.display()), policy))
}

fn read(file: &Path) -> anyhow::Result<Policy> {
    let bytes = std::fs::read(file).map_err(|e| Failure::usage(format!("read policy {}: {e}", file.display())))?;
    Policy::from_safetensors(&bytes).with_context(|| format!("read policy {}", file.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_grid_has_every_corner_once() {
        let config = Config::default();
        let gaits = grid(&config, 3);
        assert_eq!(gaits.len(), 81);
        let corner = |end: usize| {
            let gait = &config.task.gait;
            let close = |a: f64, b: f64| (a - b).abs() < 1e-6;
            gaits
                .iter()
                .filter(|g| close(g.velocity_mps, gait.velocity_mps[end]) && close(g.stride_m, gait.stride_m[end]))
                .filter(|g| close(g.lift_m, gait.lift_m[end]) && close(g.step_secs, gait.step_secs[end]))
                .count()
        };
        assert_eq!((corner(0), corner(1)), (1, 1));
    }

    #[test]
    fn a_case_runs_exactly_its_gait() {
        let config = Config::load(None, &["task.kind=constant".into()]).expect("valid");
        let gait = at_speed(config.task.constant, 0.8);
        assert_eq!(gait.stride_m, 0.8 * gait.step_secs);
        assert_eq!(case_of(&config, &gait).expect("valid").gait(), Some(gait));
    }
}
