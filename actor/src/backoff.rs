//! Pauses between tries to reach a learner, and how often to complain about it.
//!
//! Full jitter: the pause is uniform between a floor and a ceiling that doubles with each failure, so that a thousand
//! actors whose learner comes back do not knock in step. The dice are a seed; the caller does the sleeping.

use herd_common::caps;
use herd_common::seed::Seed;
use rand::RngExt;
use std::time::Duration;

/// The pauses of one actor.
#[derive(Debug)]
pub(crate) struct Backoff {
    seed: Seed,
    pauses: u64,
    failures: u32,
}

impl Backoff {
    /// Pauses that depend on `seed` alone.
    pub(crate) fn new(seed: Seed) -> Self {
        Self { seed, pauses: 0, failures: 0 }
    }

    /// The next pause, longer on average after each failure.
    pub(crate) fn pause(&mut self) -> Duration {
        let (shortest, longest) = caps::RECONNECT_PAUSE;
        let ceiling = shortest.saturating_mul(1 << self.failures.min(16)).min(longest);
        self.failures = self.failures.saturating_add(1);
        self.pauses += 1;
        let share: f64 = self.seed.child("pause", self.pauses).rng().random();
        let floor = shortest / 4;
        floor + ceiling.saturating_sub(floor).mul_f64(share)
    }

    /// Starts again at the shortest pause, after a success.
    pub(crate) fn reset(&mut self) {
        self.failures = 0;
    }
}

/// Keeps one repeated reason from filling the log.
#[derive(Debug, Default)]
pub(crate) struct Complaints {
    last: Option<(String, Duration)>,
}

impl Complaints {
    /// True when `reason` is to be told at `now` (since any fixed origin): it is a new one, or some time has passed.
    pub(crate) fn is_due(&mut self, reason: &str, now: Duration) -> bool {
        let known = self.last.as_ref().is_some_and(|(last, at)| last == reason && now.saturating_sub(*at) < EVERY);
        if !known {
            self.last = Some((reason.to_owned(), now));
        }
        !known
    }
}

/// A reason is repeated no sooner.
const EVERY: Duration = Duration::from_secs(5);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pauses_grow_to_their_bound_and_start_again() {
        let (shortest, longest) = caps::RECONNECT_PAUSE;
        let mut backoff = Backoff::new(Seed::from_number(1));
        let first = backoff.pause();
        assert!(first >= shortest / 4 && first <= shortest, "{first:?}");
        let later: Vec<Duration> = (0..200).map(|_| backoff.pause()).collect();
        assert!(later.iter().all(|pause| *pause <= longest));
        assert!(later.iter().any(|pause| *pause > longest / 2));
        backoff.reset();
        assert!(backoff.pause() <= shortest);
    }

    #[test]
    fn two_actors_do_not_knock_in_step() {
        let pauses = |number| {
            let mut backoff = Backoff::new(Seed::from_number(number));
            (0..10).map(|_| backoff.pause()).collect::<Vec<_>>()
        };
        assert_eq!(pauses(1), pauses(1));
        assert_ne!(pauses(1), pauses(2));
    }

    #[test]
    fn a_reason_is_told_once_in_a_while() {
        let mut complaints = Complaints::default();
        let at = Duration::from_secs;
        assert!(complaints.is_due("refused", at(10)));
        assert!(!complaints.is_due("refused", at(12)));
        assert!(complaints.is_due("no route", at(12)));
        assert!(complaints.is_due("refused", at(13)));
        assert!(complaints.is_due("refused", at(18)));
    }
}
