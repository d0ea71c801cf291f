//! Results that are kept between two calls: each a JSON file that knows what it was made from.

use anyhow::Context;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// A directory of results.
#[derive(Clone, Debug)]
pub(super) struct Store {
    root: PathBuf,
}

#[derive(Serialize, Deserialize)]
struct Kept<T> {
    key: String,
    value: T,
}

impl Store {
    /// The results of the reproduction in this directory.
    pub(super) fn of(run_dir: &Path) -> Self {
        Self { root: run_dir.join("results") }
    }

    /// The result of this name, if it was made from what `key` names.
    pub(super) fn get<T: DeserializeOwned>(&self, name: &str, key: &str) -> anyhow::Result<Option<T>> {
        let path = self.path(name);
        if !path.exists() {
            return Ok(None);
        }
        let bytes = std::fs::read(&path).with_context(|| format!("read {}", path.display()))?;
        let kept: Kept<serde_json::Value> =
            serde_json::from_slice(&bytes).with_context(|| format!("read {}", path.display()))?;
        if kept.key != key {
            return Ok(None);
        }
        Ok(Some(serde_json::from_value(kept.value).with_context(|| format!("read {}", path.display()))?))
    }

    /// Keeps a result, whole or not at all.
    pub(super) fn put<T: Serialize>(&self, name: &str, key: &str, value: &T) -> anyhow::Result<()> {
        let path = self.path(name);
        std::fs::create_dir_all(&self.root).context("make the directory of results")?;
        write_whole(&path, &serde_json::to_vec(&Kept { key: key.to_owned(), value })?)
    }

    fn path(&self, name: &str) -> PathBuf {
        self.root.join(format!("{name}.json"))
    }
}

/// Writes a file under a passing name, then gives it its own.
pub(super) fn write_whole(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    let passing = path.with_extension("part");
    std::fs::write(&passing, bytes).with_context(|| format!("write {}", passing.display()))?;
    std::fs::rename(&passing, path).with_context(|| format!("write {}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_result_is_found_by_what_it_was_made_from() {
        let dir = tempfile::tempdir().expect("makes");
        let store = Store::of(dir.path());
        assert_eq!(store.get::<f64>("a", "k").expect("reads"), None);
        store.put("a", "k", &2.5).expect("writes");
        assert_eq!(store.get("a", "k").expect("reads"), Some(2.5));
        assert_eq!(store.get::<f64>("a", "other").expect("reads"), None, "made from something else");
    }

    #[test]
    fn a_broken_file_is_named() {
        let dir = tempfile::tempdir().expect("makes");
        let store = Store::of(dir.path());
        store.put("a", "k", &2.5).expect("writes");
        std::fs::write(dir.path().join("results/a.json"), "{").expect("writes");
        assert!(store.get::<f64>("a", "k").expect_err("broken").to_string().contains("a.json"));
    }
}
