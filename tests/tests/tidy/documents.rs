//! What people read agrees with what there is.

use crate::text;

#[test]
fn the_readme_knows_every_subcommand() {
    let readme = text("README.md");
    for subcommand in [
        "train",
        "learner",
        "actor",
        "status",
        "eval",
        "config",
        "checkpoint",
        "stop",
        "wait-ready",
        "report",
        "reproduce",
        "export",
        "drive",
        "scale",
    ] {
        assert!(readme.contains(&format!("herd {subcommand}")), "README.md is silent on herd {subcommand}");
    }
}

#[test]
fn changes_are_told() {
    assert!(text("CHANGELOG.md").lines().count() > 3, "CHANGELOG.md is empty");
}

#[test]
fn every_section_of_the_default_configuration_says_something_for_people() {
    let silent: Vec<&str> = herd_common::config::DEFAULT
        .split("\n[")
        .filter(|section| !section.contains('#'))
        .map(|section| section.lines().next().unwrap_or(section))
        .collect();
    // Sections whose keys all carry their unit or meaning in their names.
    let plain = ["task.constant]", "task.ending]"];
    let silent: Vec<&str> = silent.into_iter().filter(|section| !plain.contains(section)).collect();
    assert!(silent.is_empty(), "sections without a comment: {silent:?}");
}
