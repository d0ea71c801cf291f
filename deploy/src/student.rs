//! Student's distribution, for 95 % intervals of means.

/// The 97.5 % quantile with these degrees of freedom: exact for few, within 0.1 % beyond (Cornish–Fisher); infinite for
/// none, since one figure tells nothing of the spread.
pub(crate) fn quantile_975(degrees: usize) -> f64 {
    const FEW: [f64; 6] = [12.706, 4.303, 3.182, 2.776, 2.571, 2.447];
    let Some(index) = degrees.checked_sub(1) else { return f64::INFINITY };
    if let Some(exact) = FEW.get(index) {
        return *exact;
    }
    let (z, n) = (1.959_964_f64, degrees as f64);
    let first = (z.powi(3) + z) / 4.0;
    let second = (5.0 * z.powi(5) + 16.0 * z.powi(3) + 3.0 * z) / 96.0;
    let third = (3.0 * z.powi(7) + 19.0 * z.powi(5) + 17.0 * z.powi(3) - 15.0 * z) / 384.0;
    z + first / n + second / n.powi(2) + third / n.powi(3)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_those_of_the_tables() {
        for (degrees, expected) in
            [(1, 12.706), (2, 4.303), (3, 3.182), (7, 2.3646), (9, 2.2622), (19, 2.0930), (49, 2.0096), (1000, 1.9623)]
        {
            assert!((quantile_975(degrees) / expected - 1.0).abs() < 1e-3, "{degrees}");
        }
        assert_eq!(quantile_975(0), f64::INFINITY);
    }
}
