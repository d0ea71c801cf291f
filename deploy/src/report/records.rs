//! `metrics.jsonl` and `evaluations.jsonl` of a run directory.

use crate::exit::Failure;
use anyhow::Context;
use serde::{Deserialize, Serialize};
use std::io::{BufRead, BufReader};
use std::path::Path;

/// What a run has recorded.
#[derive(Debug, Default)]
pub(crate) struct Records {
    /// Episode and return.
    pub(crate) returns: Vec<(f64, f64)>,
    /// Evaluations in order.
    pub(crate) evaluations: Vec<Evaluation>,
}

/// The mean of one evaluation.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct Evaluation {
    /// Policy that was evaluated.
    pub(crate) version: u64,
    /// Its mean return.
    pub(crate) mean_return: f64,
}

#[derive(Deserialize)]
struct EpisodeLine {
    episode: u64,
    #[serde(rename = "return")]
    value: f64,
}

#[derive(Deserialize)]
struct EvaluationLine {
    version: u64,
    returns: Vec<f64>,
}

impl Records {
    /// Reads both files; a run that was never evaluated has no second one.
    pub(crate) fn read(run_dir: &Path) -> anyhow::Result<Self> {
        let metrics = run_dir.join("metrics.jsonl");
        if !metrics.exists() {
            let text = format!("{} does not exist: no run here, or it has no episode yet", metrics.display());
            return Err(Failure::retry(text).into());
        }
        let returns = lines(&metrics)?.into_iter().map(|line: EpisodeLine| (line.episode as f64, line.value)).collect();
        let evaluations = run_dir.join("evaluations.jsonl");
        let evaluations = if evaluations.exists() { lines(&evaluations)? } else { Vec::new() };
        Ok(Self { returns, evaluations: evaluations.iter().filter_map(mean).collect() })
    }

    /// Mean return of the last `n` episodes.
    pub(crate) fn mean_of_last(&self, n: usize) -> Option<f64> {
        running_mean(&self.returns, n).last().map(|(_, mean)| *mean)
    }
}

fn mean(line: &EvaluationLine) -> Option<Evaluation> {
    let n = line.returns.len();
    (n > 0).then(|| Evaluation { version: line.version, mean_return: line.returns.iter().sum::<f64>() / n as f64 })
}

/// The mean of each point and the `window − 1` before it, as far as there are any.
pub(crate) fn running_mean(points: &[(f64, f64)], window: usize) -> Vec<(f64, f64)> {
    let mean = |end: usize| {
        let recent = &points[(end + 1).saturating_sub(window)..=end];
        recent.iter().map(|(_, y)| y).sum::<f64>() / recent.len() as f64
    };
    points.iter().enumerate().map(|(i, (x, _))| (*x, mean(i))).collect()
}

/// The lines of a file that is perhaps being written: an unfinished last line is left out.
pub(crate) fn lines<T: for<'de> Deserialize<'de>>(path: &Path) -> anyhow::Result<Vec<T>> {
    let file = std::fs::File::open(path).with_context(|| format!("open {}", path.display()))?;
    let mut reader = BufReader::new(file);
    let (mut parsed, mut line) = (Vec::new(), String::new());
    while reader.read_line(&mut line).with_context(|| format!("read {}", path.display()))? > 0 {
        if line.ends_with('\n') {
            let number = parsed.len() + 1;
            let value = serde_json::from_str(&line);
            parsed.push(value.with_context(|| format!("read {} line {number}", path.display()))?);
        }
        line.clear();
    }
    Ok(parsed)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_growing_run_can_be_read() {
        let dir = tempfile::tempdir().expect("makes");
        assert!(Records::read(dir.path()).expect_err("no run").to_string().contains("no run here"));
        let metrics = "{\"episode\":0,\"return\":1.5,\"ending\":\"timed_out\"}\n{\"episode\":1,\"return\":2.5}\n{\"epi";
        std::fs::write(dir.path().join("metrics.jsonl"), metrics).expect("writes");
        let evaluations = "{\"version\":50,\"returns\":[1.0,3.0],\"seconds\":[10.0,10.0],\"endings\":[]}\n";
        std::fs::write(dir.path().join("evaluations.jsonl"), evaluations).expect("writes");
        let records = Records::read(dir.path()).expect("reads");
        assert_eq!(records.returns, [(0.0, 1.5), (1.0, 2.5)]);
        assert_eq!(records.evaluations, [Evaluation { version: 50, mean_return: 2.0 }]);
    }

    #[test]
    fn a_broken_line_is_named() {
        let dir = tempfile::tempdir().expect("makes");
        std::fs::write(dir.path().join("metrics.jsonl"), "{\"episode\":0,\"return\":1}\nrubbish\n").expect("writes");
        let error = Records::read(dir.path()).expect_err("refused").to_string();
        assert!(error.ends_with("metrics.jsonl line 2"), "{error}");
    }

    #[test]
    fn the_mean_runs_over_its_window() {
        let points: Vec<(f64, f64)> =
            [2.0, 4.0, 6.0, 8.0].into_iter().enumerate().map(|(i, y)| (i as f64, y)).collect();
        let means: Vec<f64> = running_mean(&points, 2).into_iter().map(|(_, y)| y).collect();
        assert_eq!(means, [2.0, 3.0, 5.0, 7.0]);
    }
}
