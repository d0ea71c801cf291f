//! What every source file keeps to.

use crate::root;
use std::fs;
use std::path::Path;

/// Most lines of a file, its tests not counted.
const LINES: usize = 450;
/// Files that own threads, sockets and clocks; everything else in `actor/` and `learner/` is a core.
const ACTOR_CORES: [&str; 10] =
    ["robot", "gait", "mpc", "control", "sim", "env", "explore", "rollout", "film", "kinematics"];
const LEARNER_CORES: [&str; 4] = ["replay", "ddpg", "export", "history"];
const COMMON_SHELLS: [&str; 2] = ["telemetry", "shutdown"];

/// A source file: its path from the workspace's root, its text.
struct Source {
    path: String,
    text: String,
}

impl Source {
    /// The text up to its tests.
    fn product(&self) -> &str {
        self.text.split("#[cfg(test)]\nmod ").next().unwrap_or(&self.text)
    }

    /// The lines that are code, with their numbers.
    fn code(&self) -> impl Iterator<Item = (usize, &str)> {
        let lines = self.product().lines().enumerate().map(|(index, line)| (index + 1, line.trim_start()));
        lines.filter(|(_, line)| !line.starts_with("//"))
    }

    /// The module below `<crate>/src/`: the first name of the path, without `.rs`.
    fn module(&self) -> &str {
        let inner = self.path.split_once("/src/").map_or("", |(_, inner)| inner);
        let first = inner.split('/').next().unwrap_or(inner);
        first.strip_suffix(".rs").unwrap_or(first)
    }

    fn is_core(&self) -> bool {
        match self.path.split_once("/src/").map(|(name, _)| name) {
            Some("actor") => ACTOR_CORES.contains(&self.module()),
            Some("learner") => LEARNER_CORES.contains(&self.module()),
            Some("common") => !COMMON_SHELLS.contains(&self.module()),
            _ => false,
        }
    }
}

/// Every `.rs` file of the workspace's crates.
fn sources() -> Vec<Source> {
    let mut found = Vec::new();
    for name in ["common", "proto", "actor", "learner", "deploy", "tests"] {
        collect(&root().join(name), &mut found);
    }
    assert!(found.len() > 50, "only {} files found", found.len());
    found
}

fn collect(directory: &Path, found: &mut Vec<Source>) {
    for entry in fs::read_dir(directory).expect("a directory of the workspace").flatten() {
        let path = entry.path();
        if path.is_dir() && entry.file_name() != "target" {
            collect(&path, found);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            let text = fs::read_to_string(&path).expect("sources are text");
            let path = path.strip_prefix(root()).expect("below the root").display().to_string();
            found.push(Source { path, text });
        }
    }
}

/// Fails with every place where a line of code of a file that `applies` is `bad`.
#[track_caller]
fn nowhere(rule: &str, applies: impl Fn(&Source) -> bool, bad: impl Fn(&str) -> bool) {
    let sources = sources();
    let places: Vec<String> = sources
        .iter()
        .filter(|source| applies(source))
        .flat_map(|source| source.code().filter(|(_, line)| bad(line)).map(|(at, _)| format!("{}:{at}", source.path)))
        .collect();
    assert!(places.is_empty(), "{rule}: {places:#?}");
}

/// These rules name what they forbid; so this directory is not searched for it.
fn not_here(source: &Source) -> bool {
    !source.path.starts_with("tests/tests/tidy/")
}

#[test]
fn every_file_says_first_what_it_is_for() {
    let silent: Vec<String> =
        sources().into_iter().filter(|s| !s.text.starts_with("//! ")).map(|source| source.path).collect();
    assert!(silent.is_empty(), "no module documentation: {silent:#?}");
}

#[test]
fn files_are_short() {
    let long: Vec<String> = sources()
        .iter()
        .map(|source| (source.product().lines().count(), source))
        .filter(|(lines, _)| *lines > LINES)
        .map(|(lines, source)| format!("{}: {lines}", source.path))
        .collect();
    assert!(long.is_empty(), "more than {LINES} lines without tests: {long:#?}");
}

#[test]
fn nothing_is_left_for_later() {
    for word in ["TODO", "FIXME", "todo!(", "unimplemented!(", "#[ignore"] {
        let holds = sources().into_iter().filter(|source| not_here(source) && source.text.contains(word));
        let places: Vec<String> = holds.map(|source| source.path).collect();
        assert!(places.is_empty(), "{word} in {places:?}");
    }
}

#[test]
fn cores_have_no_clock_and_no_dice() {
    for word in ["Instant::now", "SystemTime::now", "rand::rng(", "from_os_rng", "thread_rng", ".elapsed()"] {
        nowhere(&format!("{word} in a core"), Source::is_core, |line| line.contains(word));
    }
}

#[test]
fn cores_neither_print_nor_open_sockets() {
    for word in ["println!(", "print!(", "std::net", "tokio::", "tonic::"] {
        nowhere(&format!("{word} in a core"), Source::is_core, |line| line.contains(word));
    }
}

#[test]
fn only_the_simulator_knows_rapier() {
    let elsewhere = |source: &Source| not_here(source) && !source.path.starts_with("actor/src/sim");
    nowhere("rapier3d outside actor/src/sim", elsewhere, |line| line.contains("rapier3d"));
}

#[test]
fn only_launching_kernels_is_unsafe() {
    let elsewhere = |source: &Source| not_here(source) && source.path != "learner/src/ddpg/device/cuda.rs";
    let unsafe_code = |line: &str| line.contains("unsafe") && !line.contains("forbid(unsafe_code)");
    nowhere("unsafe outside learner/src/ddpg/device/cuda.rs", elsewhere, unsafe_code);
}

#[test]
fn wire_types_stop_at_the_wire() {
    // `actor/src/testing` is a learner for the actor's own tests.
    let places = ["proto/", "learner/src/service/", "actor/src/uplink", "actor/src/testing/", "tests/"];
    // A learner publishes a policy once and sends it to all: the shelf keeps the message beside the policy. An ONNX file
    // is protobuf that is on no wire.
    let others = ["learner/src/shelf.rs", "learner/src/export/onnx.rs"];
    let elsewhere = |source: &Source| {
        !places.iter().any(|place| source.path.starts_with(place)) && !others.contains(&source.path.as_str())
    };
    let wire = |line: &str| line.contains("herd_proto::v1") || line.contains("v1::") || line.contains("prost::");
    nowhere("wire types far from the wire", elsewhere, wire);
}

#[test]
fn no_crate_root_or_module_root_holds_functions() {
    let root_file = |source: &Source| source.path.ends_with("src/lib.rs");
    nowhere("a function in lib.rs", root_file, |line| line.starts_with("fn ") || line.starts_with("pub fn "));
}
