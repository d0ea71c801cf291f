//! Who may write: every start of a learner takes the next epoch, and whoever holds a lower one must stop.
//!
//! An epoch is an empty file in `epoch/` of the run directory, named by its number and created so that only one process
//! can succeed. That needs no locks, which network file systems do not always keep, and no clock. A learner that was
//! taken for dead finds the higher number and stops; what it may still write until then, the journal overrules.

use super::files;
use std::fs::OpenOptions;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

/// Learners that may start at the same moment before one of them gives up.
const RACES: u32 = 100;

/// The right to write into a run directory, until someone takes the next.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Epoch {
    dir: PathBuf,
    number: u64,
}

/// Why no epoch could be taken or compared.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The file system refused.
    #[error("epoch: {what} {path:?}: {source}")]
    Io {
        /// What was tried.
        what: &'static str,
        /// On which file.
        path: PathBuf,
        /// The system's answer.
        source: io::Error,
    },
    /// Others were always faster.
    #[error("epoch: {RACES} numbers in a row were taken by other learners in {0:?}, expected at most one learner")]
    Contended(PathBuf),
}

impl Epoch {
    /// Takes the next epoch of a run directory, which fences every learner before.
    pub fn take(run_dir: &Path) -> Result<Self, Error> {
        let dir = run_dir.join("epoch");
        files::create_dir(&dir).map_err(|source| Error::Io { what: "create", path: dir.clone(), source })?;
        let mut number = highest(&dir)? + 1;
        for _ in 0..RACES {
            let path = dir.join(number.to_string());
            let created = OpenOptions::new().write(true).create_new(true).open(&path).and_then(|file| file.sync_all());
            match created.and_then(|()| files::sync_dir(&dir)) {
                Ok(()) => return Ok(Self { dir, number }),
                Err(taken) if taken.kind() == ErrorKind::AlreadyExists => number = highest(&dir)?.max(number) + 1,
                Err(source) => return Err(Error::Io { what: "create", path, source }),
            }
        }
        Err(Error::Contended(dir))
    }

    /// Its number, from 1.
    pub fn number(&self) -> u64 {
        self.number
    }

    /// False once a later learner has taken over: this one must stop and write nothing more.
    pub fn is_current(&self) -> Result<bool, Error> {
        Ok(highest(&self.dir)? <= self.number)
    }
}

fn highest(dir: &Path) -> Result<u64, Error> {
    let io = |source| Error::Io { what: "list", path: dir.to_owned(), source };
    let mut highest = 0;
    for entry in std::fs::read_dir(dir).map_err(io)? {
        let number = entry.map_err(io)?.file_name().to_str().and_then(|name| name.parse().ok());
        highest = highest.max(number.unwrap_or(0));
    }
    Ok(highest)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn the_next_learner_fences_the_one_before() {
        let dir = tempfile::tempdir().expect("directory");
        let first = Epoch::take(dir.path()).expect("taken");
        assert!(first.is_current().expect("listed"));
        let second = Epoch::take(dir.path()).expect("taken");
        assert_eq!((first.number(), second.number()), (1, 2));
        assert!(!first.is_current().expect("listed"));
        assert!(second.is_current().expect("listed"));
    }

    #[test]
    fn learners_that_start_together_get_different_numbers() {
        let dir = tempfile::tempdir().expect("directory");
        let take = || Epoch::take(dir.path()).expect("taken");
        let epochs: Vec<Epoch> = std::thread::scope(|scope| {
            let threads: Vec<_> = (0..8).map(|_| scope.spawn(take)).collect();
            threads.into_iter().map(|thread| thread.join().expect("no panic")).collect()
        });
        assert_eq!(epochs.iter().map(Epoch::number).collect::<BTreeSet<_>>(), (1..=8).collect());
        assert_eq!(epochs.iter().filter(|epoch| epoch.is_current().expect("listed")).count(), 1);
    }

    #[test]
    fn a_directory_that_is_gone_is_an_error() {
        let dir = tempfile::tempdir().expect("directory");
        let epoch = Epoch::take(dir.path()).expect("taken");
        drop(dir);
        assert!(epoch.is_current().expect_err("gone").to_string().starts_with("epoch: list"));
    }
}
