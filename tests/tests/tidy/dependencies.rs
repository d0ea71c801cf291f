//! common ← proto ← {actor, learner} ← {deploy, tests}, and what each wing must never see.

use crate::{root, text};
use std::collections::BTreeSet;
use std::process::Command;

/// Crate, its directory, the crates of the workspace that it may use outside its tests.
const ALLOWED: [(&str, &str, &[&str]); 6] = [
    ("herd-common", "common", &[]),
    ("herd-proto", "proto", &["herd-common"]),
    ("herd-actor", "actor", &["herd-common", "herd-proto"]),
    ("herd-learner", "learner", &["herd-common", "herd-proto"]),
    ("herd", "deploy", &["herd-actor", "herd-common", "herd-learner", "herd-proto"]),
    ("herd-tests", "tests", &["herd-common", "herd-proto"]),
];

/// The names of all packages that `cargo tree <words>` prints.
#[track_caller]
fn tree(words: &[&str]) -> BTreeSet<String> {
    let output = Command::new(env!("CARGO"))
        .args(["tree", "--locked", "--offline", "--edges", "normal", "--prefix", "none", "--format", "{p}"])
        .args(words)
        .current_dir(root())
        .output()
        .expect("cargo starts");
    assert!(output.status.success(), "cargo tree {words:?}: {}", String::from_utf8_lossy(&output.stderr));
    let printed = String::from_utf8(output.stdout).expect("cargo prints text");
    printed.lines().filter_map(|line| line.split(' ').next()).map(str::to_owned).collect()
}

/// Fails if any of `forbidden` is in the tree of `words`; a name ending in `-` stands for all that begin so.
#[track_caller]
fn never_sees(words: &[&str], forbidden: &[&str]) {
    let found = tree(words);
    assert!(found.len() > 3, "this is no tree: {found:?}");
    let matches = |name: &str, rule: &str| name == rule || (rule.ends_with('-') && name.starts_with(rule));
    let seen: Vec<_> = found.iter().filter(|name| forbidden.iter().any(|rule| matches(name, rule))).collect();
    assert!(seen.is_empty(), "cargo tree {words:?} has {seen:?}");
}

#[test]
fn arrows_between_crates_point_one_way() {
    for (name, directory, allowed) in ALLOWED {
        let manifest: toml::Table = text(&format!("{directory}/Cargo.toml")).parse().expect("a manifest is TOML");
        assert_eq!(manifest["package"]["name"].as_str(), Some(name));
        let ours: BTreeSet<&str> = manifest
            .get("dependencies")
            .and_then(toml::Value::as_table)
            .into_iter()
            .flat_map(toml::Table::keys)
            .map(String::as_str)
            .filter(|dependency| dependency.starts_with("herd"))
            .collect();
        assert_eq!(ours, allowed.iter().copied().collect(), "{directory}/Cargo.toml");
    }
}

#[test]
fn every_crate_takes_versions_and_lints_from_the_workspace() {
    for (_, directory, _) in ALLOWED {
        let manifest: toml::Table = text(&format!("{directory}/Cargo.toml")).parse().expect("a manifest is TOML");
        assert_eq!(manifest["lints"]["workspace"].as_bool(), Some(true), "{directory}");
        for section in ["dependencies", "dev-dependencies", "build-dependencies"] {
            for (dependency, wanted) in manifest.get(section).and_then(toml::Value::as_table).into_iter().flatten() {
                let shared = wanted.get("workspace").and_then(toml::Value::as_bool);
                assert_eq!(shared, Some(true), "{directory}: {dependency} names a version of its own");
            }
        }
    }
}

#[test]
fn the_actor_never_sees_candle() {
    never_sees(&["-p", "herd-actor"], &["candle-", "herd-learner"]);
}

#[test]
fn the_learner_never_sees_physics() {
    never_sees(&["-p", "herd-learner"], &["rapier3d", "parry3d", "clarabel", "nalgebra", "herd-actor"]);
}

#[test]
fn the_slim_binary_has_no_learner_in_it() {
    let slim = ["-p", "herd", "--no-default-features", "--features", "actor"];
    never_sees(&slim, &["candle-", "gemm", "herd-learner"]);
    assert!(tree(&slim).contains("rapier3d"), "the slim binary has no simulator in it");
}

#[test]
fn the_ground_floor_carries_neither_wing() {
    never_sees(&["-p", "herd-common"], &["tonic", "prost", "rapier3d", "candle-", "nalgebra"]);
    never_sees(&["-p", "herd-proto"], &["rapier3d", "candle-", "nalgebra", "clarabel"]);
}
