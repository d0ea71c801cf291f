//! Checkpoints: everything a learner needs to go on, in one file that is there whole or not at all.
//!
//! | part | type |
//! |---|---|
//! | magic | 8 bytes |
//! | format | u32 |
//! | length of the head | u32 |
//! | head: run, commits, journal position, state, and the shape of each block below, as JSON | bytes |
//! | blocks: the tensors, then weights and biases of the policies, layer by layer | f32 each |
//! | SHA-256 of all that, in hex digits | 64 bytes |
//!
//! All numbers are little-endian. Equal checkpoints give equal bytes: there is no clock, host or path in them. The
//! files are named by commits, the newest [`caps::CHECKPOINTS_KEPT`] stay.

use super::files;
use super::journal::Position;
use super::record::{decode_floats, encode_floats};
use herd_common::caps;
use herd_common::hash::sha256_hex;
use herd_common::policy::Layer;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

const MAGIC: [u8; 8] = *b"herd-chk";
const FORMAT: u32 = 2;
const PREFIX_BYTES: usize = 8 + 4 + 4;
const HASH_BYTES: usize = 64;
const EXTENSION: &str = "ckpt";

/// The state of a run after some commits; `S` is what the trainer adds: counters, schedule, moments of its streams.
#[derive(Clone, Debug, PartialEq)]
pub struct Checkpoint<S> {
    /// Content name of the run.
    pub run: String,
    /// Commits that it has digested.
    pub commits: u64,
    /// Where the journal goes on; what is before it must have been synced.
    pub journal: Position,
    /// Everything small. It must come back from JSON as it was, so no NaN and no infinity.
    pub state: S,
    /// Named tensors, in an order that the caller fixes.
    pub tensors: Vec<Tensor>,
    /// Policies that leases may still name, by version.
    pub policies: Vec<(u64, Vec<Layer>)>,
}

/// A named block of numbers.
#[derive(Clone, Debug, PartialEq)]
pub struct Tensor {
    /// Its name.
    pub name: String,
    /// Its shape; the product is the length of `values`.
    pub shape: Vec<usize>,
    /// Its numbers, row-major.
    pub values: Vec<f32>,
}

/// What was found in a directory of checkpoints.
#[derive(Debug)]
pub struct Loaded<S> {
    /// The newest one that is whole.
    pub checkpoint: Option<Checkpoint<S>>,
    /// Newer ones that are not, and why.
    pub skipped: Vec<Error>,
}

/// Why a checkpoint could not be kept or used.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The file system refused.
    #[error("checkpoint: {what} {path:?}: {source}")]
    Io {
        /// What was tried.
        what: &'static str,
        /// On which file.
        path: PathBuf,
        /// The system's answer.
        source: std::io::Error,
    },
    /// The file is not what was written.
    #[error("checkpoint {path:?} is damaged: {what}")]
    Damaged {
        /// Which file.
        path: PathBuf,
        /// What is wrong.
        what: String,
    },
    /// Written by another version of herd.
    #[error("checkpoint {path:?} has format {found}, expected {FORMAT}")]
    Format {
        /// Which file.
        path: PathBuf,
        /// Its format.
        found: u32,
    },
    /// A whole file whose state is not ours: another version of herd wrote it.
    #[error("checkpoint {path:?} does not hold the state of this version: {what}")]
    State {
        /// Which file.
        path: PathBuf,
        /// The parser's words.
        what: String,
    },
    /// The checkpoint of another run.
    #[error("checkpoint {path:?} belongs to run {found:?}, expected {expected:?}")]
    Foreign {
        /// Which file.
        path: PathBuf,
        /// Its run.
        found: String,
        /// Ours.
        expected: String,
    },
    /// This state would not come back as it is.
    #[error("checkpoint cannot be written: {0}")]
    Unfaithful(String),
}

#[derive(Serialize, Deserialize)]
struct Head {
    run: String,
    commits: u64,
    journal: Position,
    state: serde_json::Value,
    tensors: Vec<(String, Vec<usize>)>,
    policies: Vec<(u64, Vec<(usize, usize)>)>,
}

impl<S: Serialize + DeserializeOwned> Checkpoint<S> {
    /// Puts the checkpoint on disk and removes the oldest ones beyond those kept; returns the file.
    pub fn save(&self, dir: &Path) -> Result<PathBuf, Error> {
        let bytes = self.to_bytes()?;
        let io = |what, path: &Path| {
            let path = path.to_owned();
            move |source| Error::Io { what, path, source }
        };
        files::create_dir(dir).and_then(|()| files::sweep(dir)).map_err(io("create", dir))?;
        let path = dir.join(file_name(self.commits));
        files::replace(&path, &bytes).map_err(io("write", &path))?;
        for (_, old) in list(dir)?.into_iter().skip(caps::CHECKPOINTS_KEPT) {
            std::fs::remove_file(&old).map_err(io("remove", &old))?;
        }
        Ok(path)
    }

    /// The bytes of its file.
    pub fn to_bytes(&self) -> Result<Vec<u8>, Error> {
        let unfaithful = |what: &dyn std::fmt::Display| Error::Unfaithful(what.to_string());
        for Tensor { name, shape, values } in &self.tensors {
            if elements(shape) != Some(values.len()) {
                let count = values.len();
                return Err(Error::Unfaithful(format!("tensor {name} has {count} numbers, expected shape {shape:?}")));
            }
        }
        let layers = |layers: &[Layer]| layers.iter().map(|layer| (layer.inputs, layer.outputs)).collect();
        let head = Head {
            run: self.run.clone(),
            commits: self.commits,
            journal: self.journal,
            state: serde_json::to_value(&self.state).map_err(|e| unfaithful(&e))?,
            tensors: self.tensors.iter().map(|tensor| (tensor.name.clone(), tensor.shape.clone())).collect(),
            policies: self.policies.iter().map(|(version, policy)| (*version, layers(policy))).collect(),
        };
        let head = serde_json::to_vec(&head).map_err(|e| unfaithful(&e))?;
        self.check_faithful(&head)?;
        let mut bytes = MAGIC.to_vec();
        bytes.extend_from_slice(&FORMAT.to_le_bytes());
        bytes.extend_from_slice(&(head.len() as u32).to_le_bytes());
        bytes.extend_from_slice(&head);
        for tensor in &self.tensors {
            encode_floats(&tensor.values, &mut bytes);
        }
        for layer in self.policies.iter().flat_map(|(_, layers)| layers) {
            encode_floats(&layer.weights, &mut bytes);
            encode_floats(&layer.biases, &mut bytes);
        }
        let hash = sha256_hex(&bytes);
        bytes.extend_from_slice(hash.as_bytes());
        Ok(bytes)
    }

    /// JSON has no NaN and knows no bits: what does not come back is refused now, not at the next start.
    fn check_faithful(&self, head: &[u8]) -> Result<(), Error> {
        let unfaithful = |e: serde_json::Error| Error::Unfaithful(format!("state: {e}"));
        let back: Head = serde_json::from_slice(head).map_err(unfaithful)?;
        let state: S = serde_json::from_value(back.state).map_err(unfaithful)?;
        let (before, after) = (serde_json::to_vec(&self.state), serde_json::to_vec(&state));
        if before.map_err(unfaithful)? != after.map_err(unfaithful)? {
            return Err(Error::Unfaithful("the state changes on its way through JSON".to_owned()));
        }
        for (version, layers) in &self.policies {
            let whole =
                |l: &Layer| elements(&[l.inputs, l.outputs]) == Some(l.weights.len()) && l.biases.len() == l.outputs;
            if !layers.iter().all(whole) {
                return Err(Error::Unfaithful(format!("policy {version} has layers of another shape than it says")));
            }
        }
        Ok(())
    }

    /// The checkpoint in the bytes of a file; `path` is for errors, as is `run` if the file belongs to another.
    pub fn from_bytes(bytes: &[u8], path: &Path, run: &str) -> Result<Self, Error> {
        let damaged = |what: &str| Error::Damaged { path: path.to_owned(), what: what.to_owned() };
        let body = bytes.len().checked_sub(HASH_BYTES).ok_or_else(|| damaged("shorter than a hash"))?;
        let (bytes, hash) = bytes.split_at(body);
        if sha256_hex(bytes).as_bytes() != hash {
            return Err(damaged("its hash is another"));
        }
        let word = |at: usize| bytes.get(at..at + 4)?.first_chunk().copied().map(u32::from_le_bytes);
        let (Some(format), Some(head_bytes)) = (word(8), word(12)) else { return Err(damaged("shorter than a head")) };
        if !bytes.starts_with(&MAGIC) {
            return Err(damaged("it does not begin as a checkpoint"));
        }
        if format != FORMAT {
            return Err(Error::Format { path: path.to_owned(), found: format });
        }
        let (head, mut blocks) = bytes[PREFIX_BYTES..]
            .split_at_checked(head_bytes as usize)
            .ok_or_else(|| damaged("shorter than its head"))?;
        let head: Head = serde_json::from_slice(head).map_err(|e| damaged(&e.to_string()))?;
        if head.run != run {
            return Err(Error::Foreign { path: path.to_owned(), found: head.run, expected: run.to_owned() });
        }
        let mut take =
            |shape: &[usize]| take_floats(&mut blocks, shape).ok_or_else(|| damaged("shorter than its blocks"));
        let mut tensors = Vec::new();
        for (name, shape) in head.tensors {
            tensors.push(Tensor { values: take(&shape)?, name, shape });
        }
        let mut policies = Vec::new();
        for (version, shapes) in head.policies {
            let layer = |(inputs, outputs)| {
                Ok(Layer { inputs, outputs, weights: take(&[inputs, outputs])?, biases: take(&[outputs])? })
            };
            policies.push((version, shapes.into_iter().map(layer).collect::<Result<_, Error>>()?));
        }
        if !blocks.is_empty() {
            return Err(damaged("longer than its blocks"));
        }
        let state = serde_json::from_value(head.state);
        let state = state.map_err(|e| Error::State { path: path.to_owned(), what: e.to_string() })?;
        Ok(Self { run: head.run, commits: head.commits, journal: head.journal, state, tensors, policies })
    }
}

/// The newest whole checkpoint of a run. Damaged ones are skipped and told; one of another run or version is an error,
/// for going on from an older one would overwrite it. `holds` says whether the journal has what a checkpoint stands on.
pub fn load_newest<S: Serialize + DeserializeOwned>(
    dir: &Path,
    run: &str,
    holds: impl Fn(Position) -> bool,
) -> Result<Loaded<S>, Error> {
    let mut skipped = Vec::new();
    for (commits, path) in list(dir)? {
        let bytes = match std::fs::read(&path) {
            Ok(bytes) => bytes,
            Err(source) => {
                skipped.push(Error::Io { what: "read", path, source });
                continue;
            }
        };
        let what = match Checkpoint::from_bytes(&bytes, &path, run) {
            Ok(found) if found.commits != commits => format!("it holds {} commits", found.commits),
            Ok(found) if !holds(found.journal) => {
                format!("the journal does not hold its position, record {}", found.journal.sequence)
            }
            Ok(found) => return Ok(Loaded { checkpoint: Some(found), skipped }),
            Err(Error::Damaged { what, .. }) => what,
            Err(other) => return Err(other),
        };
        skipped.push(Error::Damaged { path, what });
    }
    Ok(Loaded { checkpoint: None, skipped })
}

fn file_name(commits: u64) -> String {
    format!("{commits:012}.{EXTENSION}")
}

/// The checkpoints of a directory by commits, newest first; none when there is no directory yet.
fn list(dir: &Path) -> Result<Vec<(u64, PathBuf)>, Error> {
    let io = |source| Error::Io { what: "list", path: dir.to_owned(), source };
    let entries = match std::fs::read_dir(dir) {
        Err(missing) if missing.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        entries => entries.map_err(io)?,
    };
    let mut found = Vec::new();
    for entry in entries {
        let path = entry.map_err(io)?.path();
        let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
        let commits = name.split_once('.').and_then(|(number, _)| number.parse().ok());
        if let Some(commits) = commits.filter(|commits| file_name(*commits) == name) {
            found.push((commits, path));
        }
    }
    found.sort_by_key(|(commits, _)| std::cmp::Reverse(*commits));
    Ok(found)
}

fn elements(shape: &[usize]) -> Option<usize> {
    shape.iter().try_fold(1_usize, |product, n| product.checked_mul(*n))
}

fn take_floats(blocks: &mut &[u8], shape: &[usize]) -> Option<Vec<f32>> {
    let (head, rest) = blocks.split_at_checked(elements(shape)?.checked_mul(4)?)?;
    *blocks = rest;
    Some(decode_floats(head))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    struct State {
        updates: u64,
        best: f64,
    }

    fn checkpoint(commits: u64) -> Checkpoint<State> {
        let tensor = |name: &str, shape: &[usize], seed: f32| {
            let values = (0..shape.iter().product()).map(|i: usize| (i as f32 + seed).sin()).collect();
            Tensor { name: name.to_owned(), shape: shape.to_vec(), values }
        };
        let layer = Layer {
            inputs: 3,
            outputs: 2,
            weights: vec![0.5, -0.0, f32::MIN_POSITIVE, 1e-30, 7.0, 0.1],
            biases: vec![0.25, 1.0],
        };
        Checkpoint {
            run: "run".to_owned(),
            commits,
            journal: Position { epoch: 2, sequence: commits + 3 },
            state: State { updates: u64::MAX - 1, best: 0.1 + 0.2 },
            tensors: vec![tensor("actor.0", &[4, 5], 0.0), tensor("empty", &[0, 5], 0.0), tensor("scalar", &[], 9.0)],
            policies: vec![(commits, vec![layer.clone()]), (commits - 1, vec![layer])],
        }
    }

    fn load(dir: &Path) -> Loaded<State> {
        load_newest(dir, "run", |_| true).expect("loads")
    }

    #[test]
    fn it_comes_back_and_repeats_its_bytes() {
        let dir = tempfile::tempdir().expect("directory");
        let before = checkpoint(41);
        let path = before.save(dir.path()).expect("saved");
        assert_eq!(load(dir.path()).checkpoint, Some(before.clone()));
        assert_eq!(std::fs::read(&path).expect("read"), before.to_bytes().expect("bytes"));
        assert!(path.ends_with("000000000041.ckpt"));
    }

    #[test]
    fn the_newest_are_kept() {
        let dir = tempfile::tempdir().expect("directory");
        assert!(load(&dir.path().join("none")).checkpoint.is_none());
        std::fs::write(dir.path().join("notes.txt"), "mine").expect("written");
        for commits in [5, 20, 100, 7, 300] {
            checkpoint(commits).save(dir.path()).expect("saved");
        }
        let kept: Vec<u64> = list(dir.path()).expect("listed").into_iter().map(|(commits, _)| commits).collect();
        assert_eq!(kept, [300, 100, 20]);
        assert_eq!(std::fs::read_dir(dir.path()).expect("listed").count(), 4, "and what is not ours");
    }

    #[test]
    fn a_cut_at_every_byte_falls_back_to_the_one_before() {
        let dir = tempfile::tempdir().expect("directory");
        checkpoint(1).save(dir.path()).expect("saved");
        let path = checkpoint(2).save(dir.path()).expect("saved");
        let bytes = std::fs::read(&path).expect("read");
        for end in 0..bytes.len() {
            std::fs::write(&path, &bytes[..end]).expect("written");
            let loaded = load(dir.path());
            assert_eq!(loaded.checkpoint.map(|c| c.commits), Some(1), "cut at {end}");
            assert_eq!(loaded.skipped.len(), 1);
        }
    }

    proptest! {
        #[test]
        fn a_state_keeps_its_bits(best in any::<f64>().prop_filter("JSON has no other", |best| best.is_finite())) {
            let mut before = checkpoint(2);
            before.state.best = best;
            let bytes = before.to_bytes().expect("bytes");
            let after = Checkpoint::<State>::from_bytes(&bytes, Path::new("f"), "run").expect("whole");
            prop_assert_eq!(after.state.best.to_bits(), best.to_bits());
        }

        #[test]
        fn a_flipped_bit_is_always_detected(at in any::<prop::sample::Index>(), bit in 0_u8..8) {
            let mut bytes = checkpoint(2).to_bytes().expect("bytes");
            let at = at.index(bytes.len());
            bytes[at] ^= 1 << bit;
            let error = Checkpoint::<State>::from_bytes(&bytes, Path::new("f"), "run").expect_err("refused");
            prop_assert!(matches!(error, Error::Damaged { .. }), "{}", error);
        }

        /// Bytes whose hash is right but whose inside is not: nothing panics, nothing is allocated for what is not there.
        #[test]
        fn a_wrong_inside_is_refused(at in 0_usize..900, byte in any::<u8>()) {
            let mut bytes = checkpoint(2).to_bytes().expect("bytes");
            bytes.truncate(bytes.len() - HASH_BYTES);
            let at = at % bytes.len();
            bytes[at] = byte;
            bytes.extend_from_slice(sha256_hex(&bytes).as_bytes());
            if let Ok(other) = Checkpoint::<State>::from_bytes(&bytes, Path::new("f"), "run") {
                prop_assert!(other.to_bytes().is_ok());
            }
        }
    }

    #[test]
    fn what_is_not_ours_is_refused() {
        let dir = tempfile::tempdir().expect("directory");
        let path = checkpoint(2).save(dir.path()).expect("saved");
        let error = load_newest::<State>(dir.path(), "other", |_| true).expect_err("refused").to_string();
        assert!(error.ends_with(r#"belongs to run "run", expected "other""#), "{error}");
        let error = load_newest::<Vec<u8>>(dir.path(), "run", |_| true).expect_err("refused");
        assert!(matches!(error, Error::State { .. }), "{error}");
        let mut bytes = std::fs::read(&path).expect("read");
        bytes.truncate(bytes.len() - HASH_BYTES);
        bytes[8] = 9;
        bytes.extend_from_slice(sha256_hex(&bytes).as_bytes());
        std::fs::write(&path, bytes).expect("written");
        let error = load_newest::<State>(dir.path(), "run", |_| true).expect_err("refused").to_string();
        assert!(error.ends_with("has format 9, expected 2"), "{error}");
    }

    #[test]
    fn one_under_a_wrong_name_or_without_its_journal_is_skipped() {
        let dir = tempfile::tempdir().expect("directory");
        for commits in [1, 2, 3] {
            checkpoint(commits).save(dir.path()).expect("saved");
        }
        std::fs::rename(dir.path().join(file_name(2)), dir.path().join(file_name(3))).expect("renamed");
        let loaded = load_newest::<State>(dir.path(), "run", |position| position.sequence < 5).expect("loads");
        assert_eq!(loaded.checkpoint.map(|c| c.commits), Some(1));
        assert!(loaded.skipped[0].to_string().ends_with("it holds 2 commits"));
        checkpoint(2).save(dir.path()).expect("saved");
        let loaded = load_newest::<State>(dir.path(), "run", |position| position.sequence < 5).expect("loads");
        assert!(
            loaded.skipped[1].to_string().ends_with("does not hold its position, record 5"),
            "{:?}",
            loaded.skipped
        );
    }

    #[test]
    fn what_would_not_come_back_is_not_written() {
        let mut bad = checkpoint(1);
        bad.state.best = f64::NEG_INFINITY;
        assert!(bad.to_bytes().expect_err("refused").to_string().starts_with("checkpoint cannot be written: state"));
        let mut bad = checkpoint(1);
        bad.tensors[0].shape[0] = 3;
        let error = bad.to_bytes().expect_err("refused").to_string();
        assert_eq!(error, "checkpoint cannot be written: tensor actor.0 has 20 numbers, expected shape [3, 5]");
        let mut bad = checkpoint(1);
        bad.policies[0].1[0].biases.pop();
        assert!(bad.to_bytes().is_err());
    }
}
