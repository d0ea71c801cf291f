//! The run directory: where everything of a run lies, and whose it is.
//!
//! ```text
//! config.toml            the effective configuration: identity of the run
//! journal/               every commit, in order
//! checkpoints/           everything else, the newest few
//! epoch/                 one file a learner ever started here; the highest number may write
//! policy.safetensors     the newest policy
//! metrics.jsonl          one line a commit
//! evaluations.jsonl      one line an evaluation
//! address                HOST:PORT while a learner listens
//! ```

use herd_common::config::{self, Config};
use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// The paths of one run.
#[derive(Clone, Debug)]
pub struct RunDir {
    root: PathBuf,
}

/// Why a directory cannot hold this run.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The configuration is not valid.
    #[error(transparent)]
    Config(#[from] config::Error),
    /// Reading or writing failed.
    #[error("run directory {path:?}: {source}")]
    Io {
        /// Which path.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// There is something in it that herd did not put there.
    #[error("run directory {path:?} holds {found:?} but no config.toml, expected an empty directory or a run of herd")]
    Foreign {
        /// Which directory.
        path: PathBuf,
        /// One of the things in it.
        found: String,
    },
    /// It holds another run.
    #[error(
        "run directory {path:?} holds another run, these keys differ: {differences}; choose another --run-dir, or drop the options"
    )]
    OtherRun {
        /// Which directory.
        path: PathBuf,
        /// `key: theirs there, ours here` for each.
        differences: String,
    },
}

impl RunDir {
    /// The run directory at this path, whether or not it exists.
    pub fn at(root: &Path) -> Self {
        Self { root: root.to_owned() }
    }

    /// Makes it, or takes it up again; writes `config.toml`.
    pub fn open(root: &Path, config: &Config) -> Result<Self, Error> {
        let dir = Self::at(root);
        fs::create_dir_all(root).map_err(|source| Error::Io { path: root.to_owned(), source })?;
        if let Some(stored) = dir.stored_config()? {
            refuse_other_run(root, &stored, config)?;
        }
        let path = dir.config_file();
        write_whole(&path, config.to_toml().as_bytes()).map_err(|source| Error::Io { path, source })?;
        Ok(dir)
    }

    /// The configuration of the run that lies here, if one does.
    pub fn stored_config(&self) -> Result<Option<Config>, Error> {
        let path = self.config_file();
        match fs::read_to_string(&path) {
            Ok(text) => Ok(Some(Config::from_toml(&text, &path.display().to_string())?)),
            Err(error) if error.kind() == io::ErrorKind::NotFound => self.refuse_foreign().map(|()| None),
            Err(source) => Err(Error::Io { path, source }),
        }
    }

    fn refuse_foreign(&self) -> Result<(), Error> {
        let entries = match fs::read_dir(&self.root) {
            Ok(entries) => entries,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
            Err(source) => return Err(Error::Io { path: self.root.clone(), source }),
        };
        // `herd train` opens its log files before the learner writes the configuration.
        let ours = |name: &str| name == "logs" || name.starts_with('.');
        let foreign = entries.flatten().map(|e| e.file_name().to_string_lossy().into_owned()).find(|name| !ours(name));
        match foreign {
            None => Ok(()),
            Some(found) => Err(Error::Foreign { path: self.root.clone(), found }),
        }
    }

    /// `config.toml`
    pub fn config_file(&self) -> PathBuf {
        self.root.join("config.toml")
    }

    /// `journal/`
    pub fn journal(&self) -> PathBuf {
        self.root.join("journal")
    }

    /// `checkpoints/`
    pub fn checkpoints(&self) -> PathBuf {
        self.root.join("checkpoints")
    }

    /// `policy.safetensors`
    pub fn policy(&self) -> PathBuf {
        self.root.join("policy.safetensors")
    }

    /// `metrics.jsonl`
    pub fn metrics(&self) -> PathBuf {
        self.root.join("metrics.jsonl")
    }

    /// `evaluations.jsonl`
    pub fn evaluations(&self) -> PathBuf {
        self.root.join("evaluations.jsonl")
    }

    /// `address`
    pub fn address(&self) -> PathBuf {
        self.root.join("address")
    }

    /// The directory itself.
    pub fn root(&self) -> &Path {
        &self.root
    }
}

/// Replaces a file as a whole: readers see the old or the new, also after a power cut.
pub fn write_whole(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let aside = path.with_extension("tmp");
    let mut file = File::create(&aside)?;
    file.write_all(bytes)?;
    file.sync_all()?;
    fs::rename(&aside, path)?;
    path.parent().map_or(Ok(()), |parent| File::open(parent)?.sync_all())
}

fn refuse_other_run(path: &Path, stored: &Config, ours: &Config) -> Result<(), Error> {
    if stored.run_name() == ours.run_name() {
        return Ok(());
    }
    let free = |key: &str| key == "episodes" || key.starts_with("history.");
    let differences: Vec<String> = stored
        .differences(ours)
        .into_iter()
        .filter(|(key, ..)| !free(key))
        .map(|(key, there, here)| format!("{key}: {there} there, {here} here"))
        .collect();
    let differences =
        if differences.is_empty() { "none, but the build does".to_owned() } else { differences.join("; ") };
    Err(Error::OtherRun { path: path.to_owned(), differences })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn config(set: &str) -> Config {
        Config::load(None, &[set.to_owned()]).expect("valid")
    }

    #[test]
    fn a_run_is_taken_up_again_and_may_grow() {
        let dir = tempfile::tempdir().expect("makes");
        RunDir::open(dir.path(), &config("episodes=3")).expect("makes");
        let again = RunDir::open(dir.path(), &config("episodes=5")).expect("same run");
        assert_eq!(again.stored_config().expect("reads").expect("is there").episodes, 5);
    }

    #[test]
    fn another_run_and_foreign_directories_are_refused_by_name() {
        let dir = tempfile::tempdir().expect("makes");
        RunDir::open(dir.path(), &config("seed=1")).expect("makes");
        let error = RunDir::open(dir.path(), &config("seed=2")).expect_err("refused").to_string();
        assert!(error.contains("seed: 1 there, 2 here"), "{error}");

        let foreign = tempfile::tempdir().expect("makes");
        fs::write(foreign.path().join("thesis.tex"), "x").expect("writes");
        let error = RunDir::open(foreign.path(), &config("seed=1")).expect_err("refused").to_string();
        assert!(error.contains("thesis.tex"), "{error}");
    }
}
