//! What `herd` answers to words it cannot follow: exit code and the name of what is wrong.
//!
//! 0 done, 64 usage, 75 try again later, 78 the configuration or task is at fault. Being an integration test of this
//! package, it also makes `cargo test --workspace` build the binary that the whole-system tests start.

use std::fs;
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// Every subcommand.
const SUBCOMMANDS: [&str; 14] = [
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
    "scale",
    "export",
    "drive",
];
/// Reaching it means that a command went on which should have refused.
const LIMIT: Duration = Duration::from_mins(1);

/// What a command came to.
struct Answer {
    code: Option<i32>,
    stdout: String,
    stderr: String,
}

/// Runs `herd <words>` in `directory` to its end.
#[track_caller]
#[expect(clippy::disallowed_methods, reason = "a deadline against hanging")]
fn herd(directory: &Path, words: &[&str]) -> Answer {
    let file = |name: &str| fs::File::create(directory.join(name)).expect("an output file can be made");
    let mut child = Command::new(env!("CARGO_BIN_EXE_herd"))
        .args(words)
        .current_dir(directory)
        .stdin(Stdio::null())
        .stdout(file(".out"))
        .stderr(file(".err"))
        .spawn()
        .expect("herd starts");
    let deadline = Instant::now() + LIMIT;
    let status = loop {
        if let Some(status) = child.try_wait().expect("a child can be waited for") {
            break status;
        }
        if Instant::now() > deadline {
            child.kill().and_then(|()| child.wait()).expect("a child can be killed");
            panic!("herd {words:?} goes on, expected it to refuse");
        }
        std::thread::sleep(Duration::from_millis(5));
    };
    let read = |name: &str| String::from_utf8_lossy(&fs::read(directory.join(name)).expect("it is there")).into_owned();
    Answer { code: status.code(), stdout: read(".out"), stderr: read(".err") }
}

/// An empty directory; output files start with a dot, which a run directory may hold.
fn directory() -> TempDir {
    TempDir::with_prefix("herd-cli-").expect("a temporary directory can be made")
}

/// `herd <words>` must exit with `code` and name each of `names` on stderr, once and without a panic.
#[track_caller]
fn refused(directory: &Path, words: &[&str], code: i32, names: &[&str]) {
    let answer = herd(directory, words);
    let said = &answer.stderr;
    assert_eq!(answer.code, Some(code), "herd {words:?}: {said}");
    assert!(!said.contains("panicked"), "{said}");
    for name in names {
        assert!(said.contains(name), "herd {words:?} does not name {name:?}: {said}");
    }
}

#[test]
fn every_subcommand_has_help_with_an_example() {
    let directory = directory();
    for subcommand in SUBCOMMANDS {
        let answer = herd(directory.path(), &[subcommand, "--help"]);
        assert_eq!(answer.code, Some(0), "{}", answer.stderr);
        let example = format!("herd {subcommand}");
        let after_usage = answer.stdout.lines().filter(|line| !line.trim_start().starts_with("Usage"));
        assert!(after_usage.clone().any(|line| line.contains(&example)), "no example: {}", answer.stdout);
    }
    let help = herd(directory.path(), &["--help"]).stdout;
    for subcommand in SUBCOMMANDS {
        assert!(help.contains(subcommand), "herd --help is silent on {subcommand}");
    }
}

#[test]
fn the_version_names_the_commit() {
    let answer = herd(directory().path(), &["--version"]);
    let said = answer.stdout.trim();
    let commit = said.strip_prefix(concat!("herd ", env!("CARGO_PKG_VERSION"), " (")).and_then(|s| s.strip_suffix(')'));
    let commit = commit.unwrap_or_else(|| panic!("{said}"));
    let hash = commit.strip_suffix("+dirty").unwrap_or(commit);
    let is_hash = hash.len() >= 10 && hash.chars().all(|c| c.is_ascii_hexdigit());
    assert!(is_hash || commit == "unknown", "{said}");
}

#[test]
fn words_that_mean_nothing_are_usage_errors() {
    let directory = directory();
    refused(directory.path(), &["trian"], 64, &["trian", "train"]);
    refused(directory.path(), &["train", "--actor", "2"], 64, &["--actor"]);
    refused(directory.path(), &["train", "--actors", "two"], 64, &["two", "--actors"]);
    refused(directory.path(), &["train"], 64, &["--run-dir"]);
}

#[test]
fn a_suite_that_makes_no_sense_is_refused() {
    let directory = directory();
    refused(directory.path(), &["eval", "--quick"], 64, &["--suite"]);
    refused(directory.path(), &["eval", "--task", "constant", "--suite", "--speeds", "1"], 64, &["--speeds"]);
    let itself = ["eval", "--task", "constant", "--suite", "--beside", "constant"];
    refused(directory.path(), &itself, 64, &["--beside constant"]);
}

#[test]
fn mistakes_in_the_configuration_are_named() {
    let directory = directory();
    let cases: [(&str, &[&str]); 5] = [
        ("ddpg.batchsize=3", &["ddpg.batchsize", "ddpg.batch_size"]),
        ("ddpg.batch_size=\"many\"", &["ddpg.batch_size", "many", "integer"]),
        ("task.episode_secs=-1", &["task.episode_secs", "-1"]),
        ("task.kind=fly", &["fly"]),
        ("ddpg.batch_size", &["key=value"]),
    ];
    for (set, names) in cases {
        refused(directory.path(), &["config", "--set", set], 78, names);
        refused(directory.path(), &["train", "--actors", "1", "--run-dir", "run", "--set", set], 78, names);
        let run = directory.path().join("run");
        assert!(!run.join("config.toml").exists(), "a refused configuration was written");
    }
}

#[test]
fn a_config_file_that_is_not_one_is_named() {
    let directory = directory();
    let file = |name: &str, text: &str| {
        fs::write(directory.path().join(name), text).expect("it can be written");
        name.to_owned()
    };
    let refuse = |name: &str, names: &[&str]| {
        refused(directory.path(), &["learner", "--run-dir", "run", "--config", name], 78, names);
    };
    refuse("absent.toml", &["absent.toml", "No such file"]);
    refuse(".", &["directory"]);
    refuse(&file("torn.toml", "[ddpg\n"), &["torn.toml"]);
    refuse(&file("typo.toml", "[ddpg]\nhiden = [8]\n"), &["typo.toml", "ddpg.hiden", "ddpg.hidden"]);
}

#[test]
fn the_default_configuration_can_be_given_back() {
    let directory = directory();
    let printed = herd(directory.path(), &["config"]);
    assert_eq!(printed.code, Some(0), "{}", printed.stderr);
    fs::write(directory.path().join("default.toml"), &printed.stdout).expect("it can be written");
    let effective = herd(directory.path(), &["config", "--config", "default.toml"]);
    let unset = herd(directory.path(), &["config", "--set", "seed=1"]);
    assert_eq!((effective.code, unset.code), (Some(0), Some(0)), "{}", effective.stderr);
    assert_eq!(effective.stdout, unset.stdout);
}

#[test]
fn a_port_in_use_is_named_and_worth_another_try() {
    let directory = directory();
    let taken = TcpListener::bind("127.0.0.1:0").expect("a port is free");
    let address = taken.local_addr().expect("it is bound").to_string();
    refused(directory.path(), &["learner", "--run-dir", "run", "--listen", &address], 75, &[&address, "in use"]);
}

#[test]
fn an_address_that_others_can_reach_needs_to_be_asked_for() {
    let directory = directory();
    for address in ["0.0.0.0:0", "[::]:0"] {
        refused(directory.path(), &["learner", "--run-dir", "run", "--listen", address], 78, &["--insecure", address]);
    }
}

#[test]
fn a_learner_that_is_not_there_is_worth_another_try() {
    let directory = directory();
    // Bound and dropped: nobody listens there.
    let address = TcpListener::bind("127.0.0.1:0").and_then(|port| port.local_addr()).expect("a port is free");
    let address = address.to_string();
    for subcommand in ["status", "stop", "checkpoint"] {
        refused(directory.path(), &[subcommand, "--learner", &address], 75, &[&address]);
    }
    refused(directory.path(), &["wait-ready", "--learner", &address, "--timeout", "1"], 75, &[&address]);
    refused(directory.path(), &["status", "--run-dir", "nowhere"], 75, &["nowhere"]);
}

#[test]
fn an_address_that_is_none_is_named() {
    let directory = directory();
    refused(directory.path(), &["status", "--learner", "http://"], 64, &["http://", "HOST:PORT"]);
}

#[test]
fn files_that_are_no_policy_are_named() {
    let directory = directory();
    let write = |name: &str, bytes: &[u8]| fs::write(directory.path().join(name), bytes).expect("it can be written");
    write("poem.safetensors", b"Under the greenwood tree");
    write("huge.safetensors", &[0xff; 64]);
    write("empty.safetensors", b"");
    for name in ["poem.safetensors", "huge.safetensors", "empty.safetensors"] {
        refused(directory.path(), &["eval", "--policy", name, "--episodes", "1"], 78, &[name]);
    }
}

#[test]
fn exports_that_cannot_be_are_named() {
    let directory = directory();
    refused(directory.path(), &["export", "policy"], 64, &["--run-dir", "--policy"]);
    refused(directory.path(), &["export", "trace"], 64, &["gait", "--policy"]);
    refused(directory.path(), &["export", "trace", "--replay", "absent.jsonl"], 64, &["absent.jsonl"]);
    let short = ["export", "trace", "--task", "constant", "--set", "task.episode_secs=0.1", "--out", "short.jsonl"];
    assert_eq!(herd(directory.path(), &short).code, Some(0));
    let late = ["export", "trace", "--replay", "short.jsonl", "--at", "1"];
    refused(directory.path(), &late, 64, &["--at is 1 s", "0.100 s"]);
    let coarse = ["export", "trace", "--replay", "short.jsonl", "--set", "sim.tick_secs=0.003"];
    refused(directory.path(), &coarse, 64, &["sim.tick_secs is 0.003", "0.002"]);
    fs::write(directory.path().join("torn.jsonl"), "{\"tick\":\n").expect("it can be written");
    refused(directory.path(), &["export", "trace", "--replay", "torn.jsonl"], 78, &["torn.jsonl", "line 1"]);
    let steep = ["drive", "--task", "constant", "--set", "scenario.slope_deg=[5, 5]"];
    refused(directory.path(), &steep, 64, &["scenario.slope_deg is [5.0, 5.0]"]);
    // Nobody answers.
    refused(directory.path(), &["drive", "--task", "constant"], 64, &["stdin ended"]);
}

#[test]
fn a_policy_of_another_task_is_refused() {
    let directory = directory();
    let policy = trained(directory.path());
    let policy = policy.to_str().expect("plain name");
    let other = ["eval", "--policy", policy, "--episodes", "1", "--set", "robot.trunk_mass_kg=9.0"];
    refused(directory.path(), &other, 78, &["task"]);
    let mut same = vec!["eval", "--policy", policy, "--episodes", "1", "--json"];
    TINY.iter().filter(|set| set.starts_with("task.")).for_each(|set| same.extend(["--set", set]));
    let answer = herd(directory.path(), &same);
    assert_eq!(answer.code, Some(0), "{}", answer.stderr);
    assert!(answer.stdout.trim_start().starts_with(['{', '[']), "not JSON: {}", answer.stdout);
    let export = herd(directory.path(), &["export", "policy", "--run-dir", "tiny"]);
    assert_eq!(export.code, Some(0), "{}", export.stderr);
    for file in ["policy.onnx", "policy.golden.json"] {
        assert!(fs::metadata(directory.path().join(file)).is_ok_and(|file| file.len() > 1000), "{file}");
    }
}

/// Just enough of a run to have a policy.
const TINY: [&str; 4] =
    ["task.episode_secs=0.5", "ddpg.hidden=[8, 8]", "evaluation.every_episodes=0", "history.durability=memory"];

/// The policy of a tiny run in `directory`.
#[track_caller]
fn trained(directory: &Path) -> PathBuf {
    let mut words = vec!["train", "--actors", "1", "--run-dir", "tiny", "--episodes", "1"];
    for set in TINY {
        words.extend(["--set", set]);
    }
    let answer = herd(directory, &words);
    assert_eq!(answer.code, Some(0), "{}", answer.stderr);
    directory.join("tiny/policy.safetensors")
}
