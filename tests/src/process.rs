//! One child process: its output goes to files, it dies with its guard, and a failing test shows its last words.

use crate::patience::{eventually, within};
use rustix::process::{Pid, Signal, kill_process, kill_process_group};
use std::fs::File;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

/// Lines of each output shown when a test fails.
const TAIL_LINES: usize = 40;

/// A running child.
#[derive(Debug)]
pub struct Process {
    name: String,
    child: Child,
    stdout: PathBuf,
    stderr: PathBuf,
}

/// A child that has ended.
#[derive(Debug)]
pub struct Finished {
    /// Exit code; `None` when a signal ended it.
    pub code: Option<i32>,
    /// All it wrote.
    pub stdout: String,
    /// All it wrote there.
    pub stderr: String,
}

impl Finished {
    /// The exit code with both outputs, for the message of an assertion.
    pub fn told(&self) -> String {
        format!("exit {:?}\n--- stdout\n{}\n--- stderr\n{}", self.code, tail(&self.stdout), tail(&self.stderr))
    }

    /// Itself, after making sure that it exited with `code` and that its stderr names each of `words`.
    #[track_caller]
    pub fn expect(self, code: i32, words: &[&str]) -> Self {
        assert_eq!(self.code, Some(code), "{}", self.told());
        for word in words {
            assert!(self.stderr.contains(word), "stderr does not name {word:?}: {}", self.told());
        }
        self
    }
}

impl Process {
    /// Starts `command` in a process group of its own, its output in new files under `logs`.
    #[track_caller]
    pub fn spawn(name: &str, command: &mut Command, logs: &Path) -> Self {
        static NUMBER: AtomicUsize = AtomicUsize::new(0);
        let stem = format!("{name}-{}", NUMBER.fetch_add(1, Ordering::Relaxed));
        let (stdout, stderr) = (logs.join(format!("{stem}.out")), logs.join(format!("{stem}.err")));
        let create = |path: &Path| File::create(path).expect("a log file can be made");
        let child = command
            .stdin(Stdio::null())
            .stdout(create(&stdout))
            .stderr(create(&stderr))
            .process_group(0)
            .spawn()
            .unwrap_or_else(|error| panic!("cannot start {command:?}: {error}"));
        Self { name: name.to_owned(), child, stdout, stderr }
    }

    /// Its process id.
    pub fn pid(&self) -> u32 {
        self.child.id()
    }

    /// What it has written to stdout so far.
    pub fn stdout(&self) -> String {
        read(&self.stdout)
    }

    /// What it has written to stderr so far.
    pub fn stderr(&self) -> String {
        read(&self.stderr)
    }

    /// Sends a signal to it alone.
    pub fn signal(&self, signal: Signal) {
        kill_process(Pid::from_child(&self.child), signal)
            .expect("the child has not been waited for, so its id is its own");
    }

    /// Sends a signal to it and all its children, as a terminal does on Ctrl-C.
    pub fn signal_group(&self, signal: Signal) {
        kill_process_group(Pid::from_child(&self.child), signal).expect("the child leads its group");
    }

    /// Kills it without warning and waits until it is gone.
    pub fn kill(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }

    /// True while it runs.
    pub fn is_running(&mut self) -> bool {
        matches!(self.child.try_wait(), Ok(None))
    }

    /// Waits until it has ended by itself; fails after `limit`.
    #[track_caller]
    pub fn wait(mut self, limit: Duration) -> Finished {
        let ended = |child: &mut Child| child.try_wait().expect("a child can be waited for");
        let status: Option<ExitStatus> = within(limit, || ended(&mut self.child));
        let status = status.unwrap_or_else(|| panic!("{} has not ended within {limit:?}", self.name));
        Finished { code: status.code(), stdout: self.stdout(), stderr: self.stderr() }
    }

    /// Waits until its stderr holds all of `words`.
    #[track_caller]
    pub fn wait_until_it_says(&mut self, limit: Duration, words: &[&str]) {
        eventually(limit, &format!("{} says {words:?}", self.name), || {
            let said = self.stderr();
            words.iter().all(|word| said.contains(word)).then_some(())
        });
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        self.kill();
        if std::thread::panicking() {
            eprintln!("=== {} (pid {})", self.name, self.pid());
            eprintln!("--- stdout\n{}--- stderr\n{}", tail(&self.stdout()), tail(&self.stderr()));
        }
    }
}

fn read(path: &Path) -> String {
    std::fs::read(path).map(|bytes| String::from_utf8_lossy(&bytes).into_owned()).unwrap_or_default()
}

/// The last lines of a text.
pub(crate) fn tail(text: &str) -> String {
    let lines: Vec<&str> = text.lines().collect();
    let first = lines.len().saturating_sub(TAIL_LINES);
    lines[first..].iter().fold(String::new(), |all, line| all + line + "\n")
}
