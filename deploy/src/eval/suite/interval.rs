//! 95 % intervals: of a share after Wilson (1927), of a mean after Student.

use crate::student::quantile_975;

/// Two-sided 95 % quantile of the normal distribution.
const Z: f64 = 1.959_963_984_540_054;

/// The interval around the share `hits / of` of independent trials; all of [0, 1] without a trial.
pub(super) fn of_share(hits: u64, of: u64) -> [f64; 2] {
    if of == 0 {
        return [0.0, 1.0];
    }
    let (n, p) = (of as f64, hits as f64 / of as f64);
    let scale = 1.0 + Z * Z / n;
    let centre = (p + Z * Z / (2.0 * n)) / scale;
    let half = Z / scale * (p * (1.0 - p) / n + Z * Z / (4.0 * n * n)).sqrt();
    [(centre - half).max(0.0), (centre + half).min(1.0)]
}

/// The interval around the mean of these numbers; none for fewer than two.
pub(super) fn of_mean(values: &[f64]) -> Option<[f64; 2]> {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let variance = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / (n - 1.0);
    let half = quantile_975(values.len().saturating_sub(1)) * (variance / n).sqrt();
    (values.len() > 1).then_some([mean - half, mean + half])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[track_caller]
    fn close(found: f64, expected: f64, tolerance: f64) {
        assert!((found - expected).abs() < tolerance, "{found}, expected {expected}");
    }

    #[test]
    fn shares_are_those_of_the_tables() {
        for (hits, of, low, high) in [(0, 10, 0.0, 0.2775), (5, 10, 0.2366, 0.7634), (1, 20, 0.0089, 0.2361)] {
            let [found_low, found_high] = of_share(hits, of);
            close(found_low, low, 1e-3);
            close(found_high, high, 1e-3);
        }
        assert_eq!(of_share(0, 0), [0.0, 1.0]);
    }

    #[test]
    fn a_mean_of_one_has_no_interval() {
        assert_eq!(of_mean(&[3.0]), None);
        let [low, high] = of_mean(&[1.0, 2.0, 3.0, 4.0]).expect("has one");
        close(high - low, 2.0 * 3.182 * (5.0_f64 / 3.0 / 4.0).sqrt(), 0.05);
        close(f64::midpoint(low, high), 2.5, 1e-12);
    }
}
