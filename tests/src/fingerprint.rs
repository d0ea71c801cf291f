//! What must be equal to the bit between two runs of the same seed and configuration.

use herd_common::hash::sha256_hex;
use std::fs;
use std::path::Path;

/// Digests of what a run leaves: the weights, the line of every commit, the line of every evaluation.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Fingerprint {
    /// Of `policy.safetensors`.
    pub policy: String,
    /// Of `metrics.jsonl`.
    pub metrics: String,
    /// Of `evaluations.jsonl`.
    pub evaluations: String,
}

impl Fingerprint {
    /// That of the run in this directory.
    #[track_caller]
    pub fn of(run_dir: &Path) -> Self {
        let digest = |name: &str| {
            let path = run_dir.join(name);
            sha256_hex(fs::read(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display())))
        };
        Self {
            policy: digest("policy.safetensors"),
            metrics: digest("metrics.jsonl"),
            evaluations: digest("evaluations.jsonl"),
        }
    }
}
