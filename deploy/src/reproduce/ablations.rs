//! The default learner with one part changed: one table of trainings that differ from it in a few keys.
//!
//! A further part gets a further line in `TABLE`; nothing else has to know of it.

use anyhow::Context;
use herd_common::config::merge;

/// One training that is made differently.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Ablation {
    /// Part of the name of its directory.
    pub(super) slug: &'static str,
    /// What people call it.
    pub(super) name: &'static str,
    /// In what it differs from the default, each `key=value`.
    pub(super) sets: Vec<String>,
}

const TABLE: [(&str, &str, &[&str]); 10] = [
    (
        "plain-ddpg",
        "plain DDPG: one critic, no smoothing, no delay",
        &["ddpg.twin_critic=false", "ddpg.smoothing_sigma=0", "ddpg.actor_every=1"],
    ),
    ("one-critic", "one critic", &["ddpg.twin_critic=false"]),
    ("no-smoothing", "no noise on the target's action", &["ddpg.smoothing_sigma=0"]),
    ("closed-box", "plain tanh at the ends of the action box", &["ddpg.open_box=false"]),
    ("free-critic", "critics without weight decay", &["ddpg.critic_decay=0"]),
    ("three-steps", "returns of three decisions", &["ddpg.n_step=3"]),
    ("prioritised", "prioritised replay", &["ddpg.priority_alpha=0.6"]),
    ("no-mirror", "no mirroring of the observation", &["task.gait.mirror=false"]),
    ("discount-per-decision", "discount per decision instead of per time", &["task.discount.per=decision"]),
    ("smooth-noise", "exploration that lasts (Ornstein–Uhlenbeck-like)", &["exploration.sigma_smoothing=0.85"]),
];

/// The paper's own learner, as far as it is told.
const PAPER: &str = include_str!("../../config/paper.toml");

/// All of them, the paper's own learner last.
pub(super) fn all() -> anyhow::Result<Vec<Ablation>> {
    let table = TABLE.into_iter().map(|(slug, name, sets)| {
        let sets = sets.iter().map(|set| (*set).to_owned()).collect();
        Ablation { slug, name, sets }
    });
    let paper = Ablation { slug: "paper", name: "the paper's own learner", sets: paper()? };
    Ok(table.chain([paper]).collect())
}

fn paper() -> anyhow::Result<Vec<String>> {
    let table: toml::Table = PAPER.parse().context("read config/paper.toml")?;
    Ok(merge::flatten(&table).into_iter().map(|(key, value)| format!("{key}={value}")).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use herd_common::config::Config;
    use herd_common::config::task::Per;
    use std::collections::BTreeSet;

    #[test]
    fn every_ablation_is_a_valid_run_of_its_own() {
        let all = all().expect("reads");
        let name = |sets: &[String]| Config::load(None, sets).expect("valid").run_name();
        let names: BTreeSet<String> = all.iter().map(|ablation| name(&ablation.sets)).chain([name(&[])]).collect();
        assert_eq!(names.len(), all.len() + 1, "two of them are the same");
        let slugs: BTreeSet<&str> = all.iter().map(|ablation| ablation.slug).collect();
        assert_eq!(slugs.len(), all.len());
    }

    #[test]
    fn the_papers_learner_loads_as_a_file_and_is_what_it_states() {
        let file = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("config/paper.toml");
        let config = Config::load(Some(&file), &[]).expect("valid");
        assert_eq!(config, Config::load(None, &paper().expect("reads")).expect("valid"));
        let (ddpg, discount) = (&config.ddpg, &config.task.discount);
        assert!(!ddpg.twin_critic && ddpg.smoothing_sigma == 0.0 && ddpg.actor_every == 1);
        assert!(!ddpg.open_box && ddpg.n_step == 1 && ddpg.priority_alpha == 0.0 && ddpg.critic_decay == 0.0);
        assert_eq!((ddpg.hidden.as_slice(), ddpg.target_rate), ([512, 256].as_slice(), 0.001));
        assert_eq!((discount.factor, discount.per), (0.95, Per::Decision));
    }
}
