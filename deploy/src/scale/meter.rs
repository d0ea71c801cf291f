//! What the synthetic actors of this process count and time together.

use serde::Serialize;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::time::Duration;

/// Counters and times of all synthetic actors.
#[derive(Debug, Default)]
pub(crate) struct Meter {
    acknowledged_episodes: AtomicU64,
    acknowledged_transitions: AtomicU64,
    refused: AtomicU64,
    commits: Times,
    policies: Times,
    policy_bytes: AtomicU64,
    lost: Mutex<Option<Lost>>,
}

/// Durations since the last look, µs.
#[derive(Debug, Default)]
struct Times(Mutex<Vec<u32>>);

/// Counters at one moment.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub(crate) struct Totals {
    /// Episodes whose commit was acknowledged.
    pub(crate) episodes: u64,
    /// Transitions in them.
    pub(crate) transitions: u64,
    /// Episodes and messages that the learner refused.
    pub(crate) refused: u64,
}

/// Subscribers that no longer follow the policies.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub(crate) struct Lost {
    /// How many.
    pub(crate) subscribers: u32,
    /// Why the first of them does not.
    pub(crate) why: String,
}

/// How long something took.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub(crate) struct Latency {
    /// Times it happened.
    pub(crate) count: usize,
    /// Median, ms.
    pub(crate) p50_ms: f64,
    /// 99 % are not longer, ms.
    pub(crate) p99_ms: f64,
}

const UNPOISONED: &str = "no holder of this lock can panic";

impl Meter {
    /// An episode of this many transitions was acknowledged this long after its end was sent.
    pub(crate) fn committed(&self, transitions: u64, after: Duration) {
        self.acknowledged_episodes.fetch_add(1, Relaxed);
        self.acknowledged_transitions.fetch_add(transitions, Relaxed);
        self.commits.add(after);
    }

    /// A policy of this many bytes was in place this long after the learner published it.
    pub(crate) fn applied(&self, after: Duration, bytes: usize) {
        self.policies.add(after);
        self.policy_bytes.store(bytes as u64, Relaxed);
    }

    /// A subscriber no longer follows the policies.
    pub(crate) fn lost(&self, why: &str) {
        let mut lost = self.lost.lock().expect(UNPOISONED);
        lost.get_or_insert_with(|| Lost { subscribers: 0, why: why.to_owned() }).subscribers += 1;
    }

    /// The learner refused something.
    pub(crate) fn refused(&self) {
        self.refused.fetch_add(1, Relaxed);
    }

    /// Counters so far.
    pub(crate) fn totals(&self) -> Totals {
        Totals {
            episodes: self.acknowledged_episodes.load(Relaxed),
            transitions: self.acknowledged_transitions.load(Relaxed),
            refused: self.refused.load(Relaxed),
        }
    }

    /// Bytes of the policy that was applied last.
    pub(crate) fn policy_bytes(&self) -> Option<u64> {
        Some(self.policy_bytes.load(Relaxed)).filter(|bytes| *bytes > 0)
    }

    /// Subscribers lost so far.
    pub(crate) fn all_lost(&self) -> Option<Lost> {
        self.lost.lock().expect(UNPOISONED).clone()
    }

    /// Commit and broadcast latencies since the last call; `None` where nothing was timed.
    pub(crate) fn take_latencies(&self) -> (Option<Latency>, Option<Latency>) {
        (latency(self.commits.take()), latency(self.policies.take()))
    }
}

impl Times {
    fn add(&self, time: Duration) {
        let micros = u32::try_from(time.as_micros()).unwrap_or(u32::MAX);
        self.0.lock().expect(UNPOISONED).push(micros);
    }

    fn take(&self) -> Vec<u32> {
        std::mem::take(&mut *self.0.lock().expect(UNPOISONED))
    }
}

/// Quantiles of durations in µs.
fn latency(mut micros: Vec<u32>) -> Option<Latency> {
    micros.sort_unstable();
    let last = micros.len().checked_sub(1)?;
    let quantile = |share: f64| f64::from(micros[(share * last as f64).ceil() as usize]) / 1e3;
    Some(Latency { count: micros.len(), p50_ms: quantile(0.5), p99_ms: quantile(0.99) })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_of_a_known_set() {
        let expected = Latency { count: 101, p50_ms: 50.0, p99_ms: 99.0 };
        assert_eq!(latency((0..=100).rev().map(|ms| ms * 1000).collect()), Some(expected));
        assert_eq!(latency(vec![7000]), Some(Latency { count: 1, p50_ms: 7.0, p99_ms: 7.0 }));
        assert_eq!(latency(vec![]), None);
    }

    #[test]
    fn the_first_reason_of_a_loss_is_kept_and_all_are_counted() {
        let meter = Meter::default();
        assert_eq!((meter.all_lost(), meter.policy_bytes()), (None, None));
        meter.applied(Duration::from_millis(1), 643);
        meter.lost("first");
        meter.lost("second");
        assert_eq!(meter.all_lost(), Some(Lost { subscribers: 2, why: "first".into() }));
        assert_eq!(meter.policy_bytes(), Some(643));
    }

    #[test]
    fn times_are_taken_once_and_counters_stay() {
        let meter = Meter::default();
        meter.committed(80, Duration::from_millis(3));
        assert_eq!(meter.take_latencies().0.map(|commit| commit.p50_ms), Some(3.0));
        assert_eq!(meter.take_latencies(), (None, None));
        assert_eq!(meter.totals(), Totals { episodes: 1, transitions: 80, refused: 0 });
    }
}
