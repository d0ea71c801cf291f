//! What an actor measures of itself: simulated time and solver times, shared by its robot threads.
//!
//! These figures depend on the clock; they go into heartbeats and nowhere else.

use crate::control::Latency;
use herd_common::episode::Counts;
use herd_common::status::Qp;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

/// Counters of one actor since it started.
#[derive(Debug, Default)]
pub struct Meter {
    simulated_micros: AtomicU64,
    solver: Mutex<Solver>,
}

#[derive(Debug, Default)]
struct Solver {
    times: Latency,
    solves: u64,
    failures: u64,
}

impl Meter {
    /// Adds simulated time, s.
    pub fn add_simulated(&self, seconds: f64) {
        self.simulated_micros.fetch_add((seconds * 1e6).round() as u64, Ordering::Relaxed);
    }

    /// Adds what a controller counted over an episode, and how long its solver took each time.
    pub fn add_solver(&self, counts: &Counts, times: &Latency) {
        let mut solver = self.solver.lock().expect("no holder of this lock can panic");
        solver.solves += counts.qp_solves;
        solver.failures += counts.qp_failures;
        solver.times.merge(times);
    }

    /// Simulated time so far, s, summed over robots.
    pub fn simulated_secs(&self) -> f64 {
        self.simulated_micros.load(Ordering::Relaxed) as f64 / 1e6
    }

    /// Solver figures so far.
    pub fn qp(&self) -> Qp {
        let solver = self.solver.lock().expect("no holder of this lock can panic");
        let quantile = |share| solver.times.quantile_micros(share);
        Qp {
            solves: solver.solves,
            failures: solver.failures,
            p50_micros: quantile(0.5),
            p99_micros: quantile(0.99),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_add_up() {
        let meter = Meter::default();
        let mut times = Latency::default();
        (0..100).for_each(|i| times.record(if i < 98 { 50_000 } else { 4_000_000 }));
        let counts = Counts { qp_solves: 100, qp_failures: 2, ..Counts::default() };
        meter.add_solver(&counts, &times);
        meter.add_solver(&counts, &times);
        meter.add_simulated(0.25);
        meter.add_simulated(0.5);
        let qp = meter.qp();
        assert_eq!((qp.solves, qp.failures), (200, 4));
        assert!((qp.p50_micros - 50.0).abs() < 10.0, "{qp:?}");
        assert!((qp.p99_micros - 4000.0).abs() < 800.0, "{qp:?}");
        assert_eq!(meter.simulated_secs(), 0.75);
    }
}
