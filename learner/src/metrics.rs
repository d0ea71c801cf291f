//! `metrics.jsonl` and `evaluations.jsonl`: one line a commit, one line an evaluation, the same for equal runs.
//!
//! Lines carry no clock, host or path. The files are not synced: their length stands in each checkpoint, a restart cuts
//! them there and writes the rest again from the journal.

use herd_common::episode::Outcome;
use serde::Serialize;
use std::fs::{File, OpenOptions};
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::path::Path;

/// One committed episode.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct EpisodeLine {
    /// Its number.
    pub episode: u64,
    /// Policy it was run with.
    pub version: u64,
    /// Exploration noise.
    pub sigma: f32,
    /// Eq 10 summed.
    #[serde(rename = "return")]
    pub value: f64,
    /// Mean forward speed, m/s.
    pub speed_mps: f64,
    /// The rest of its outcome.
    #[serde(flatten)]
    pub outcome: OutcomeFields,
    /// Transitions committed, this episode's included.
    pub transitions: u64,
    /// Updates done, those it triggered included.
    pub updates: u64,
    /// Means over the updates it triggered; null when there were none.
    #[serde(flatten)]
    pub losses: LossFields,
}

/// The fields of an outcome in words of the file.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct OutcomeFields {
    ending: &'static str,
    seconds: f64,
    decisions: u64,
    reward: herd_common::episode::Reward,
    distance_m: f64,
    roll_variance: f64,
    pitch_variance: f64,
    counts: herd_common::episode::Counts,
}

impl From<&Outcome> for OutcomeFields {
    fn from(outcome: &Outcome) -> Self {
        Self {
            ending: outcome.ending.name(),
            seconds: outcome.seconds,
            decisions: outcome.decisions,
            reward: outcome.reward,
            distance_m: outcome.distance_m,
            roll_variance: outcome.roll_variance,
            pitch_variance: outcome.pitch_variance,
            counts: outcome.counts,
        }
    }
}

/// Mean losses over some updates.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct LossFields {
    /// Eq 6.
    pub critic_loss: Option<f64>,
    /// Minus the mean value of the actor's actions.
    pub actor_loss: Option<f64>,
    /// Mean value of the batch.
    pub mean_value: Option<f64>,
}

/// One evaluation.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct EvaluationLine {
    /// Policy evaluated.
    pub version: u64,
    /// Return of each episode.
    pub returns: Vec<f64>,
    /// Length of each, s.
    pub seconds: Vec<f64>,
    /// Ending of each.
    pub endings: Vec<&'static str>,
}

impl EvaluationLine {
    /// The line for these outcomes.
    pub fn new(version: u64, outcomes: &[Outcome]) -> Self {
        Self {
            version,
            returns: outcomes.iter().map(|outcome| outcome.reward.total()).collect(),
            seconds: outcomes.iter().map(|outcome| outcome.seconds).collect(),
            endings: outcomes.iter().map(|outcome| outcome.ending.name()).collect(),
        }
    }
}

/// A file of JSON lines that knows its length.
#[derive(Debug)]
pub struct Lines {
    file: BufWriter<File>,
    bytes: u64,
}

impl Lines {
    /// Opens or makes the file and cuts it after `bytes`, so that what follows is written again.
    pub fn open(path: &Path, bytes: u64) -> io::Result<Self> {
        let mut file = OpenOptions::new().create(true).truncate(false).write(true).open(path)?;
        let found = file.metadata()?.len();
        if found < bytes {
            let text = format!("{} has {found} bytes, expected at least {bytes}", path.display());
            return Err(io::Error::new(io::ErrorKind::InvalidData, text));
        }
        file.set_len(bytes)?;
        file.seek(SeekFrom::Start(bytes))?;
        Ok(Self { file: BufWriter::new(file), bytes })
    }

    /// Appends a line and passes it to the operating system, so that others can follow the file.
    pub fn write(&mut self, line: &impl Serialize) -> io::Result<()> {
        let mut text = serde_json::to_vec(line)?;
        text.push(b'\n');
        self.file.write_all(&text)?;
        self.bytes += text.len() as u64;
        self.file.flush()
    }

    /// Makes what is written durable; a checkpoint may name only bytes that are.
    pub fn sync(&mut self) -> io::Result<()> {
        self.file.flush()?;
        self.file.get_ref().sync_data()
    }

    /// Bytes written so far.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reopening_cuts_what_is_to_be_written_again() {
        let dir = tempfile::tempdir().expect("makes");
        let path = dir.path().join("metrics.jsonl");
        let mut lines = Lines::open(&path, 0).expect("opens");
        lines.write(&1).expect("writes");
        let kept = lines.bytes();
        lines.write(&22).expect("writes");
        drop(lines);
        let mut lines = Lines::open(&path, kept).expect("opens");
        lines.write(&333).expect("writes");
        assert_eq!(std::fs::read_to_string(&path).expect("reads"), "1\n333\n");
        assert!(Lines::open(&path, 1000).is_err());
    }
}
