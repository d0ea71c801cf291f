//! What an actor measures of itself: simulated time and solver times, shared by its robot threads.
//!
//! These figures depend on the clock; they go into heartbeats and nowhere else.

use crate::control::Latency;
use herd_common::episode::Outcome;
use herd_common::status::Qp;
use std::collections::{BTreeMap, VecDeque};
use std::sync::{Mutex, MutexGuard};
use std::time::Duration;

/// Counters of one actor since it started.
#[derive(Debug, Default)]
pub struct Meter {
    figures: Mutex<Figures>,
}

#[derive(Debug, Default)]
struct Figures {
    simulated_secs: f64,
    solves: u64,
    failures: u64,
    /// Solver times by robot, each over the life of that robot.
    times: BTreeMap<usize, Latency>,
}

impl Meter {
    /// Adds a finished episode of a robot, whose solver took `times` since it was built.
    pub fn add_episode(&self, robot: usize, outcome: &Outcome, times: &Latency) {
        let mut figures = self.figures();
        figures.simulated_secs += outcome.seconds;
        figures.solves += outcome.counts.qp_solves;
        figures.failures += outcome.counts.qp_failures;
        figures.times.insert(robot, times.clone());
    }

    /// Simulated time so far, s, summed over robots.
    pub fn simulated_secs(&self) -> f64 {
        self.figures().simulated_secs
    }

    /// Solver figures so far.
    pub fn qp(&self) -> Qp {
        let figures = self.figures();
        let mut times = Latency::default();
        figures.times.values().for_each(|robot| times.merge(robot));
        Qp {
            solves: figures.solves,
            failures: figures.failures,
            p50_micros: times.quantile_micros(0.5),
            p99_micros: times.quantile_micros(0.99),
        }
    }

    fn figures(&self) -> MutexGuard<'_, Figures> {
        self.figures.lock().expect("no holder of this lock can panic")
    }
}

/// Simulated seconds per second, over a window: episodes end seldom, so one report's worth says little.
#[derive(Debug)]
pub(crate) struct Realtime {
    /// When and how much was simulated by then, s, oldest first.
    marks: VecDeque<(Duration, f64)>,
}

/// Marks kept: with one a heartbeat, ten seconds.
const MARKS: usize = 11;

impl Realtime {
    /// A window that begins at `now` (since any fixed moment).
    pub(crate) fn new(now: Duration, simulated_secs: f64) -> Self {
        Self { marks: VecDeque::from([(now, simulated_secs)]) }
    }

    /// The factor at `now`.
    pub(crate) fn factor(&mut self, now: Duration, simulated_secs: f64) -> f64 {
        self.marks.push_back((now, simulated_secs));
        while self.marks.len() > MARKS {
            self.marks.pop_front();
        }
        let (then, before) = self.marks[0];
        let elapsed = now.saturating_sub(then).as_secs_f64();
        if elapsed > 0.0 { (simulated_secs - before) / elapsed } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::outcome;
    use herd_common::episode::Counts;

    #[test]
    fn figures_add_up() {
        let meter = Meter::default();
        let mut times = Latency::default();
        (0..100).for_each(|i| times.record(if i < 98 { 50_000 } else { 4_000_000 }));
        let counts = Counts { qp_solves: 100, qp_failures: 2, ..Counts::default() };
        let episode = Outcome { counts, ..outcome(70) };
        meter.add_episode(0, &episode, &times);
        meter.add_episode(1, &episode, &times);
        meter.add_episode(1, &episode, &times);
        let qp = meter.qp();
        assert_eq!((qp.solves, qp.failures), (300, 6));
        assert!((qp.p50_micros / 50.0).ln().abs() < 0.2, "{qp:?}");
        assert!((qp.p99_micros / 4000.0).ln().abs() < 0.2, "{qp:?}");
        assert_eq!(meter.simulated_secs(), 30.0);
    }

    #[test]
    fn the_factor_is_that_of_the_window() {
        let at = Duration::from_secs;
        let mut realtime = Realtime::new(at(100), 50.0);
        assert_eq!(realtime.factor(at(100), 50.0), 0.0);
        assert_eq!(realtime.factor(at(102), 70.0), 10.0);
        for second in 103..130 {
            realtime.factor(at(second), 70.0);
        }
        assert_eq!(realtime.factor(at(130), 70.0), 0.0, "what was before the window is forgotten");
    }
}
