//! One run in a temporary directory, small enough to finish in seconds, and the processes that work on it.

use crate::fingerprint::Fingerprint;
use crate::patience::{LONG, SHORT, eventually};
use crate::process::{Finished, Process};
use crate::processes::{self, Found};
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use tempfile::TempDir;

/// Seed of every run that does not ask for another.
pub const SEED: u64 = 7;

/// Small networks, short episodes, everything that can happen in a run happening early.
const SMALL: [&str; 12] = [
    "task.episode_secs=1",
    "task.settle_secs=0.1",
    "ddpg.hidden=[32, 32]",
    "ddpg.batch_size=16",
    "ddpg.warmup_transitions=10",
    "exploration.warmup_episodes=2",
    "schedule.lag=4",
    "schedule.lease_secs=20",
    "evaluation.every_episodes=8",
    "evaluation.episodes=1",
    "history.checkpoint_episodes=3",
    "ddpg.replay_capacity=10000",
];

/// A run: its directory, its configuration, its processes. Whatever still works on it dies with it.
#[derive(Debug)]
pub struct Run {
    home: TempDir,
    sets: Vec<String>,
    episodes: u64,
}

impl Run {
    /// A small run of this many episodes, not yet started.
    pub fn new(episodes: u64) -> Self {
        let home = TempDir::with_prefix("herd-test-").expect("a temporary directory can be made");
        eprintln!("run in {}, seed {SEED}, {episodes} episodes", home.path().display());
        let seed = format!("seed={SEED}");
        let sets = SMALL.iter().map(ToString::to_string).chain([seed]).collect();
        Self { home, sets, episodes }
    }

    /// The same run with one more `key=value`.
    pub fn with(mut self, set: &str) -> Self {
        self.sets.push(set.to_owned());
        self
    }

    /// The same run to this many episodes.
    pub fn to(mut self, episodes: u64) -> Self {
        self.episodes = episodes;
        self
    }

    // ---- starting things ----

    /// `herd <words> …`, with nothing of the run said.
    pub fn herd(&self, words: &[&str]) -> Command {
        let mut command = Command::new(crate::herd());
        command.args(words).current_dir(self.home.path()).env_remove("HERD_LOG");
        command
    }

    /// `herd <words> --run-dir …` with the run's configuration.
    pub fn configured(&self, words: &[&str]) -> Command {
        let mut command = self.herd(words);
        command.arg("--run-dir").arg(self.dir()).args(["--episodes", &self.episodes.to_string()]);
        self.sets.iter().for_each(|set| _ = command.args(["--set", set]));
        command
    }

    /// Starts any command.
    #[track_caller]
    pub fn spawn(&self, name: &str, command: &mut Command) -> Process {
        Process::spawn(name, command, self.home.path())
    }

    /// Runs `herd <words>` to its end.
    #[track_caller]
    pub fn ask(&self, words: &[&str]) -> Finished {
        self.spawn(words[0], &mut self.herd(words)).wait(SHORT)
    }

    /// Starts `herd train` with this many actors.
    #[track_caller]
    pub fn train(&self, actors: u32) -> Process {
        self.spawn("train", &mut self.configured(&["train", "--actors", &actors.to_string()]))
    }

    /// Starts a learner on a free port, which it writes into the run directory.
    #[track_caller]
    pub fn learner(&self) -> Process {
        self.learner_on("127.0.0.1:0")
    }

    /// Starts a learner on this address.
    #[track_caller]
    pub fn learner_on(&self, listen: &str) -> Process {
        self.spawn("learner", &mut self.configured(&["learner", "--listen", listen]))
    }

    /// Starts an actor that finds the learner by the run directory.
    #[track_caller]
    pub fn actor(&self) -> Process {
        self.actor_of(&format!("file:{}", self.dir().join("address").display()))
    }

    /// Starts an actor of the learner at this address.
    #[track_caller]
    pub fn actor_of(&self, learner: &str) -> Process {
        self.spawn("actor", &mut self.herd(&["actor", "--learner", learner]))
    }

    // ---- looking at things ----

    /// The run directory.
    pub fn dir(&self) -> PathBuf {
        self.home.path().join("run")
    }

    /// Where the learner listens, as soon as it does.
    #[track_caller]
    pub fn address(&self) -> String {
        let read = || fs::read_to_string(self.dir().join("address")).ok();
        eventually(SHORT, "the learner writes its address", read).trim_end().to_owned()
    }

    /// `herd status --json`, when it answers.
    pub fn status(&self) -> Option<Value> {
        let asked = self.ask(&["status", "--run-dir", self.dir().to_str().expect("plain name"), "--json"]);
        (asked.code == Some(0)).then(|| serde_json::from_str(&asked.stdout).expect("status --json is JSON"))
    }

    /// `herd status --json` as soon as `holds` of it.
    #[track_caller]
    pub fn status_when(&self, what: &str, holds: impl Fn(&Value) -> bool) -> Value {
        eventually(SHORT, what, || self.status().filter(&holds))
    }

    /// Commits that metrics.jsonl tells of.
    pub fn committed(&self) -> u64 {
        let text = fs::read(self.dir().join("metrics.jsonl")).unwrap_or_default();
        text.iter().filter(|byte| **byte == b'\n').count() as u64
    }

    /// Waits until this many episodes are committed.
    #[track_caller]
    pub fn wait_for_commits(&self, episodes: u64) {
        let enough = || (self.committed() >= episodes).then_some(());
        eventually(LONG, &format!("{episodes} episodes are committed"), enough);
    }

    /// Fails unless some but not all episodes are committed: what was just done was done in the middle of the run.
    #[track_caller]
    pub fn assert_midway(&self) {
        let (committed, target) = (self.committed(), self.episodes);
        assert!(0 < committed && committed < target, "{committed} of {target} episodes: not in the middle of the run");
    }

    /// The lines of metrics.jsonl.
    #[track_caller]
    pub fn metrics(&self) -> Vec<Value> {
        let text = fs::read_to_string(self.dir().join("metrics.jsonl")).expect("metrics.jsonl is there");
        text.lines().map(|line| serde_json::from_str(line).expect("each line is JSON")).collect()
    }

    /// The episode numbers in metrics.jsonl, in its order.
    #[track_caller]
    pub fn episodes(&self) -> Vec<u64> {
        self.metrics().iter().map(|line| line["episode"].as_u64().expect("each line has its episode")).collect()
    }

    /// What must be equal to the bit between equal runs.
    #[track_caller]
    pub fn fingerprint(&self) -> Fingerprint {
        Fingerprint::of(&self.dir())
    }

    /// The living processes that work on this run.
    pub fn processes(&self) -> Vec<Found> {
        processes::naming(&self.dir())
    }

    /// Waits until there are `count` living processes `herd <subcommand>` on this run.
    #[track_caller]
    pub fn wait_for(&self, count: usize, subcommand: &str) -> Vec<Found> {
        eventually(SHORT, &format!("{count} × herd {subcommand}"), || {
            let mut found = self.processes();
            found.retain(|process| process.is_herd(subcommand));
            (found.len() == count).then_some(found)
        })
    }

    /// Waits until nothing works on this run any more.
    #[track_caller]
    pub fn assert_no_orphans(&self) {
        let still = |found: &[Found]| found.iter().map(|p| p.words.join(" ")).collect::<Vec<_>>();
        let gone = crate::patience::within(SHORT, || self.processes().is_empty().then_some(()));
        assert!(gone.is_some(), "orphans: {:#?}", still(&self.processes()));
    }
}

impl Drop for Run {
    fn drop(&mut self) {
        processes::naming(self.home.path()).iter().for_each(Found::kill);
        if std::thread::panicking() {
            show_logs(&self.dir().join("logs"));
        }
    }
}

/// The last words of the children of `herd train`.
fn show_logs(logs: &Path) {
    for entry in fs::read_dir(logs).into_iter().flatten().flatten() {
        let text = fs::read_to_string(entry.path()).unwrap_or_default();
        eprintln!("=== {}\n{}", entry.path().display(), crate::process::tail(&text));
    }
}
