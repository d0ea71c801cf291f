//! Running figures of a run. Those that the run's bits decide are saved with a checkpoint; rates are of this process.

use herd_common::caps;
use herd_common::episode::{Ending, Outcome};
use herd_common::status::{Losses, Rates, Returns};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// Figures of the episodes committed so far.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Tally {
    /// Transitions committed.
    pub(super) transitions: u64,
    recent: VecDeque<Recent>,
    best: Option<f64>,
    evaluation: Option<f64>,
    endings: [u64; Ending::ALL.len()],
    /// Last losses.
    pub(super) losses: Losses,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct Recent {
    value: f64,
    seconds: f64,
    fell: bool,
    staleness: u64,
}

impl Tally {
    pub(super) fn new() -> Self {
        Self {
            transitions: 0,
            recent: VecDeque::new(),
            best: None,
            evaluation: None,
            endings: [0; Ending::ALL.len()],
            losses: Losses::default(),
        }
    }

    /// Counts a committed episode that was run `staleness` versions behind.
    pub(super) fn commit(&mut self, outcome: &Outcome, transitions: usize, staleness: u64) {
        let value = outcome.reward.total();
        self.transitions += transitions as u64;
        self.best = Some(self.best.map_or(value, |best| best.max(value)));
        if let Some(at) = Ending::ALL.iter().position(|(ending, _)| *ending == outcome.ending) {
            self.endings[at] += 1;
        }
        self.recent.push_back(Recent { value, seconds: outcome.seconds, fell: outcome.ending.is_fall(), staleness });
        if self.recent.len() > caps::RETURN_WINDOW {
            self.recent.pop_front();
        }
    }

    /// Takes the outcomes of an evaluation.
    pub(super) fn evaluate(&mut self, outcomes: &[Outcome]) {
        let sum: f64 = outcomes.iter().map(|outcome| outcome.reward.total()).sum();
        self.evaluation = (!outcomes.is_empty()).then(|| sum / outcomes.len() as f64);
    }

    pub(super) fn returns(&self) -> Returns {
        Returns {
            mean: self.mean(|recent| recent.value),
            last: self.recent.back().map_or(0.0, |recent| recent.value),
            best: self.best.unwrap_or(0.0),
            evaluation: self.evaluation,
            seconds: self.mean(|recent| recent.seconds),
            fall_rate: self.mean(|recent| f64::from(u8::from(recent.fell))),
        }
    }

    /// Mean age, in versions, of the policies behind the recent episodes.
    pub(super) fn staleness(&self) -> f64 {
        self.mean(|recent| recent.staleness as f64)
    }

    /// Endings that occurred, by name.
    pub(super) fn endings(&self) -> Vec<(String, u64)> {
        let counted = Ending::ALL.iter().zip(self.endings).filter(|(_, count)| *count > 0);
        counted.map(|((_, name), count)| ((*name).to_owned(), count)).collect()
    }

    fn mean(&self, of: impl Fn(&Recent) -> f64) -> f64 {
        if self.recent.is_empty() {
            return 0.0;
        }
        self.recent.iter().map(of).sum::<f64>() / self.recent.len() as f64
    }
}

/// Rates over the last seconds, from samples of counters.
#[derive(Debug, Default)]
pub(super) struct Meter {
    samples: VecDeque<Sample>,
}

/// Counters at one moment.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Sample {
    pub(super) at: f64,
    pub(super) episodes: u64,
    pub(super) transitions: u64,
    pub(super) updates: u64,
    /// Time spent in updates so far, s.
    pub(super) busy_secs: f64,
}

/// Samples kept, one a second.
const SAMPLES: usize = 15;

impl Meter {
    /// Adds a sample when the last is a second old.
    pub(super) fn sample(&mut self, sample: Sample) {
        if self.samples.back().is_some_and(|last| sample.at - last.at < 1.0) {
            return;
        }
        self.samples.push_back(sample);
        if self.samples.len() > SAMPLES {
            self.samples.pop_front();
        }
    }

    /// Rates, and the share of time spent in updates.
    pub(super) fn rates(&self) -> (Rates, f64) {
        let (Some(first), Some(last)) = (self.samples.front(), self.samples.back()) else {
            return (Rates::default(), 0.0);
        };
        let span = last.at - first.at;
        if span <= 0.0 {
            return (Rates::default(), 0.0);
        }
        let per_second = |from: u64, to: u64| (to - from) as f64 / span;
        let rates = Rates {
            episodes: per_second(first.episodes, last.episodes),
            transitions: per_second(first.transitions, last.transitions),
            updates: per_second(first.updates, last.updates),
        };
        (rates, (last.busy_secs - first.busy_secs) / span)
    }
}
