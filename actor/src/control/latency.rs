//! A histogram of durations with fixed buckets, so that those of many robots add up.
//!
//! Buckets grow by a factor of 2^¼ from 1 µs, so a quantile is exact to 19 %.

/// Number of buckets: the last one begins at 2^17.75 µs ≈ 0.22 s and takes everything beyond.
const BUCKETS: usize = 72;
/// Buckets between a duration and its double.
const PER_OCTAVE: f64 = 4.0;

/// How long something took, over and over.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Latency {
    counts: [u64; BUCKETS],
}

impl Default for Latency {
    fn default() -> Self {
        Self { counts: [0; BUCKETS] }
    }
}

impl Latency {
    /// Adds one duration, ns.
    pub fn record(&mut self, nanos: u64) {
        let micros = (nanos as f64 / 1e3).max(1.0);
        let bucket = (micros.log2() * PER_OCTAVE) as usize;
        self.counts[bucket.min(BUCKETS - 1)] += 1;
    }

    /// Adds everything that another histogram holds.
    pub fn merge(&mut self, other: &Self) {
        for (count, more) in self.counts.iter_mut().zip(other.counts) {
            *count += more;
        }
    }

    /// Durations recorded.
    pub fn count(&self) -> u64 {
        self.counts.iter().sum()
    }

    /// The duration (µs) that this share of all stays below: the middle of its bucket; 0 when there is none.
    pub fn quantile_micros(&self, share: f64) -> f64 {
        let total = self.count();
        if total == 0 {
            return 0.0;
        }
        let rank = ((share.clamp(0.0, 1.0) * total as f64).ceil() as u64).max(1);
        let mut below = 0;
        let bucket = self.counts.iter().position(|count| {
            below += count;
            below >= rank
        });
        ((bucket.unwrap_or(BUCKETS - 1) as f64 + 0.5) / PER_OCTAVE).exp2()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_of_a_known_set() {
        let mut latency = Latency::default();
        assert_eq!(latency.quantile_micros(0.5), 0.0);
        for micros in 1..=1000_u64 {
            latency.record(micros * 1000);
        }
        for (share, expected) in [(0.5, 500.0), (0.99, 990.0), (0.0, 1.0)] {
            let found = latency.quantile_micros(share);
            assert!((found / expected).ln().abs() < 0.2, "{share}: {found}");
        }
    }

    #[test]
    fn merging_is_recording_in_one() {
        let (mut one, mut two, mut both) = (Latency::default(), Latency::default(), Latency::default());
        for nanos in [1, 900, 45_000, 1 << 40] {
            one.record(nanos);
            both.record(nanos);
        }
        two.record(7_000);
        both.record(7_000);
        one.merge(&two);
        assert_eq!(one, both);
        assert_eq!(one.count(), 5);
    }
}
