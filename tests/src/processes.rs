//! Every process on this machine that works on a run, read from /proc: to find children, and orphans.

use rustix::process::{Pid, Signal, kill_process};
use std::fs;
use std::path::Path;

/// A process whose command line names a directory.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Found {
    /// Its id.
    pub pid: u32,
    /// Its command line, word by word.
    pub words: Vec<String>,
}

impl Found {
    /// True when it is `herd <subcommand>`.
    pub fn is_herd(&self, subcommand: &str) -> bool {
        self.words.iter().skip(1).any(|word| word == subcommand)
    }

    /// Kills it without warning.
    pub fn kill(&self) {
        if let Some(pid) = i32::try_from(self.pid).ok().and_then(Pid::from_raw) {
            // It may have ended meanwhile.
            let _ = kill_process(pid, Signal::KILL);
        }
    }
}

/// The living processes that name `path` on their command line, this one excepted, by id.
pub fn naming(path: &Path) -> Vec<Found> {
    let path = path.to_str().expect("temporary directories have plain names");
    let entries = fs::read_dir("/proc").expect("/proc is mounted");
    let pids = entries.flatten().filter_map(|entry| entry.file_name().to_str()?.parse::<u32>().ok());
    let mut found: Vec<Found> = pids
        .filter(|pid| *pid != std::process::id())
        .filter_map(|pid| {
            // A zombie has an empty command line.
            let line = fs::read(format!("/proc/{pid}/cmdline")).ok()?;
            let words: Vec<String> =
                line.split(|byte| *byte == 0).map(|word| String::from_utf8_lossy(word).into_owned()).collect();
            words.iter().any(|word| word.contains(path)).then_some(Found { pid, words })
        })
        .collect();
    found.sort_by_key(|process| process.pid);
    found
}
