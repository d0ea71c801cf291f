//! One child process: started, watched, started again when it dies, ended when asked.

use crate::exit::{self, Failure};
use anyhow::Context;
use herd_common::caps;
use std::collections::VecDeque;
use std::ffi::OsString;
use std::fs::{File, OpenOptions};
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::process::{ExitStatus, Stdio};
use std::time::Duration;
use tokio::process;
use tokio::time::{Instant, sleep, timeout};
use tokio_util::sync::CancellationToken;

/// How a child came to its end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum End {
    /// It was done.
    Done,
    /// It was asked to stop.
    Stopped,
}

/// What to start.
#[derive(Debug)]
pub(crate) struct Child {
    name: String,
    words: Vec<OsString>,
    log: PathBuf,
    program: PathBuf,
}

/// Patience with a child that was asked to stop.
const STOP_PATIENCE: Duration = Duration::from_secs(20);
/// Of a child's log, bytes looked at for its last words.
const LAST_WORDS_BYTES: i64 = 4096;
/// Lives that may end with the same error before the child is given up.
const SAME_ERRORS: usize = 3;
/// Lines of them shown.
const LAST_WORDS: usize = 5;

impl Child {
    /// A child that runs this executable with these words and logs into the run directory.
    pub(crate) fn new(name: &str, words: Vec<OsString>, run_dir: &Path) -> anyhow::Result<Self> {
        let program = std::env::current_exe().context("find this executable")?;
        Ok(Self { name: name.to_owned(), words, log: run_dir.join("logs").join(format!("{name}.log")), program })
    }

    /// Starts it, once.
    pub(crate) fn start(&self) -> anyhow::Result<process::Child> {
        let log = || {
            OpenOptions::new()
                .create(true)
                .append(true)
                .open(&self.log)
                .with_context(|| format!("open {}", self.log.display()))
        };
        process::Command::new(&self.program)
            .args(&self.words)
            .args(["--die-with-parent", &std::process::id().to_string()])
            .stdin(Stdio::null())
            .stdout(log()?)
            .stderr(log()?)
            // A group of its own: Ctrl-C reaches us alone, and we decide who stops when.
            .process_group(0)
            .kill_on_drop(true)
            .spawn()
            .with_context(|| format!("start {}", self.name))
    }

    /// The error that it told last.
    fn last_error(&self) -> Option<String> {
        self.log_end().lines().rev().find(|line| line.starts_with("error: ")).map(str::to_owned)
    }

    /// The last lines of its log, for people.
    pub(crate) fn last_words(&self) -> String {
        let text = self.log_end();
        let lines: Vec<&str> = text.lines().collect();
        lines[lines.len().saturating_sub(LAST_WORDS)..].join("\n")
    }

    fn log_end(&self) -> String {
        let read = || -> std::io::Result<String> {
            let mut file = File::open(&self.log)?;
            let back = LAST_WORDS_BYTES.min(file.metadata()?.len().cast_signed());
            file.seek(SeekFrom::End(-back))?;
            let mut bytes = Vec::new();
            file.read_to_end(&mut bytes)?;
            Ok(String::from_utf8_lossy(&bytes).into_owned())
        };
        read().unwrap_or_default()
    }

    fn failure(&self, code: u8, how: &str) -> Failure {
        let (words, log) = (self.last_words(), self.log.display());
        Failure::child(code, format!("{} {how}; its log {log} ends with:\n{words}", self.name))
    }
}

/// Runs a child until it is done or `stop` is cancelled; starts it again when it dies, within bounds.
pub(crate) async fn supervise(child: Child, stop: CancellationToken) -> anyhow::Result<End> {
    let (mut deaths, mut told) = (VecDeque::new(), Vec::new());
    loop {
        let mut process = child.start()?;
        let status = tokio::select! {
            status = process.wait() => status.with_context(|| format!("wait for {}", child.name))?,
            () = stop.cancelled() => return end(&child, process).await,
        };
        match status.code() {
            Some(0) => return Ok(End::Done),
            Some(code) if [exit::USAGE, exit::CONFIG].map(i32::from).contains(&code) => {
                return Err(child.failure(code as u8, &format!("ended with exit code {code}")).into());
            }
            Some(code) if again_and_again(&mut told, child.last_error()) => {
                let how = format!("ended {} times with the same error", told.len());
                return Err(child.failure(code as u8, &how).into());
            }
            _ => {}
        }
        if too_often(&mut deaths, Instant::now()) {
            let (n, secs) = (caps::RESTARTS, caps::RESTART_WINDOW.as_secs());
            return Err(child.failure(exit::INTERNAL, &format!("died more than {n} times within {secs} s")).into());
        }
        tracing::warn!(part = child.name, how = describe(status), log = %child.log.display(), "died, starting it again");
        tokio::select! {
            () = sleep(caps::RESTART_PAUSE) => {}
            () = stop.cancelled() => return Ok(End::Stopped),
        }
    }
}

/// Asks a process of this child to stop, and insists after a while.
pub(crate) async fn end(child: &Child, mut process: process::Child) -> anyhow::Result<End> {
    if let Some(pid) = process.id().and_then(|pid| rustix::process::Pid::from_raw(pid.cast_signed())) {
        // It may have ended by itself just now.
        let _ = rustix::process::kill_process(pid, rustix::process::Signal::TERM);
    }
    if timeout(STOP_PATIENCE, process.wait()).await.is_err() {
        tracing::warn!(part = child.name, patience_secs = STOP_PATIENCE.as_secs(), "does not stop, killing it");
        process.kill().await.with_context(|| format!("kill {}", child.name))?;
    }
    Ok(End::Stopped)
}

/// Notes what a child said when it gave up; true when it has said the same too many times running, so that another life
/// would end no better.
fn again_and_again(told: &mut Vec<String>, error: Option<String>) -> bool {
    told.retain(|earlier| Some(earlier) == error.as_ref());
    told.extend(error);
    told.len() >= SAME_ERRORS
}

/// Notes a death; true when there were more than allowed within the window.
fn too_often(deaths: &mut VecDeque<Instant>, now: Instant) -> bool {
    deaths.push_back(now);
    deaths.retain(|at| now.duration_since(*at) < caps::RESTART_WINDOW);
    deaths.len() > caps::RESTARTS
}

fn describe(status: ExitStatus) -> String {
    use std::os::unix::process::ExitStatusExt;
    match (status.code(), status.signal()) {
        (Some(code), _) => format!("exit code {code}"),
        (None, Some(signal)) => format!("signal {signal}"),
        (None, None) => "unknown".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shell(script: &str) -> (tempfile::TempDir, Child) {
        let dir = tempfile::tempdir().expect("makes");
        let words = vec!["-c".into(), script.into(), "child".into()];
        let log = dir.path().join("log");
        (dir, Child { name: "child".into(), words, log, program: "/bin/sh".into() })
    }

    async fn supervised(script: &str) -> anyhow::Result<End> {
        let (_dir, child) = shell(script);
        supervise(child, CancellationToken::new()).await
    }

    #[tokio::test]
    async fn a_child_that_is_done_is_not_started_again() {
        assert_eq!(supervised("exit 0").await.expect("done"), End::Done);
    }

    #[tokio::test]
    async fn a_mismatch_ends_with_the_childs_words_and_code() {
        let error = supervised("echo error: the task differs >&2; exit 78").await.expect_err("ends");
        assert!(error.to_string().contains("error: the task differs"), "{error}");
        assert!(error.to_string().contains("exit code 78"), "{error}");
    }

    #[tokio::test]
    async fn a_child_that_fails_alike_every_time_is_given_up() {
        let error = supervised("echo error: no room on the disk >&2; exit 70").await.expect_err("ends");
        assert!(error.to_string().contains("ended 3 times with the same error"), "{error}");
        assert!(error.to_string().contains("no room on the disk"), "{error}");
        let mut told = Vec::new();
        for words in ["a", "b", "a", "a"] {
            assert!(!again_and_again(&mut told, Some(words.to_owned())), "{words}");
        }
        assert!(!again_and_again(&mut told, None), "a death without words is another matter");
    }

    #[tokio::test]
    async fn a_child_that_dies_is_started_again() {
        let (dir, child) = shell("");
        let mark = dir.path().join("mark").display().to_string();
        let words = vec!["-c".into(), format!("test -e {mark} && exit 0; touch {mark}; kill -9 $$").into()];
        let end = supervise(Child { words, ..child }, CancellationToken::new()).await;
        assert_eq!(end.expect("second life"), End::Done);
    }

    #[tokio::test]
    async fn a_child_is_ended_when_asked() {
        let (_dir, child) = shell("exec sleep 1000");
        let stop = CancellationToken::new();
        stop.cancel();
        assert_eq!(supervise(child, stop).await.expect("stops"), End::Stopped);
    }

    #[test]
    fn deaths_count_within_their_window_only() {
        let (mut deaths, start) = (VecDeque::new(), Instant::now());
        for _ in 0..caps::RESTARTS {
            assert!(!too_often(&mut deaths, start));
        }
        assert!(!too_often(&mut deaths.clone(), start + caps::RESTART_WINDOW));
        assert!(too_often(&mut deaths, start));
    }
}
