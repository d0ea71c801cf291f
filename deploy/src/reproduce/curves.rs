//! Learning curves of several seeds as one: smoothed, compared at equal x, with the median and what lies around it.

use crate::report::records::running_mean;

/// A curve: x ascending, y.
pub(super) type Curve = Vec<(f64, f64)>;

/// Several curves at equal x.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub(super) struct Band {
    /// Where.
    pub(super) x: Vec<f64>,
    /// The lowest of them.
    pub(super) low: Vec<f64>,
    /// The middle one, or the mean of the middle two.
    pub(super) median: Vec<f64>,
    /// The highest.
    pub(super) high: Vec<f64>,
}

/// Episodes that a curve is averaged over.
pub(super) const WINDOW: usize = 20;
/// About how many x a band has: more than a figure shows.
const STEPS: usize = 240;

/// The mean of each point and those before it; it begins where the window is full, or is empty.
pub(super) fn smooth(points: &[(f64, f64)]) -> Curve {
    running_mean(points, WINDOW).into_iter().skip(WINDOW - 1).collect()
}

/// The band of these curves, from where all have begun to where the first ends.
pub(super) fn band(curves: &[Curve]) -> Band {
    let from = curves.iter().try_fold(f64::MIN, |from, curve| Some(from.max(curve.first()?.0)));
    let to = curves.iter().try_fold(f64::MAX, |to, curve| Some(to.min(curve.last()?.0)));
    let (Some(from), Some(to)) = (from, to) else { return Band::default() };
    if curves.is_empty() || from > to {
        return Band::default();
    }
    let mut band = Band::default();
    for step in 0..=STEPS {
        let x = from + (to - from) * step as f64 / STEPS as f64;
        let mut values: Vec<f64> = curves.iter().map(|curve| at(curve, x)).collect();
        values.sort_by(f64::total_cmp);
        band.x.push(x);
        band.low.push(values[0]);
        band.median.push(median(&values));
        band.high.push(values[values.len() - 1]);
    }
    band
}

/// The value of a curve at x, straight between its points, level beyond its ends.
pub(super) fn at(curve: &[(f64, f64)], x: f64) -> f64 {
    let after = curve.partition_point(|(px, _)| *px < x);
    match (after.checked_sub(1).map(|before| curve[before]), curve.get(after)) {
        (Some((x0, y0)), Some((x1, y1))) => y0 + (y1 - y0) * (x - x0) / (x1 - x0),
        (Some((_, y)), None) | (None, Some(&(_, y))) => y,
        (None, None) => f64::NAN,
    }
}

/// The first x from which the curve has reached `level`.
pub(super) fn reaches(curve: &[(f64, f64)], level: f64) -> Option<f64> {
    curve.iter().find(|(_, y)| *y >= level).map(|(x, _)| *x)
}

/// The middle of sorted values, or the mean of the middle two.
pub(super) fn median(sorted: &[f64]) -> f64 {
    let n = sorted.len();
    if n == 0 { f64::NAN } else { f64::midpoint(sorted[(n - 1) / 2], sorted[n / 2]) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_band_is_what_the_curves_have_in_common() {
        let curves = [
            vec![(0.0, 0.0), (10.0, 10.0)],
            vec![(0.0, 4.0), (20.0, 4.0)],
            vec![(2.0, 100.0), (5.0, 100.0), (30.0, 100.0)],
        ];
        let band = band(&curves);
        assert_eq!((band.x[0], band.x[STEPS]), (2.0, 10.0));
        assert_eq!((band.low[0], band.median[0], band.high[0]), (2.0, 4.0, 100.0));
        assert_eq!((band.low[STEPS], band.median[STEPS], band.high[STEPS]), (4.0, 10.0, 100.0));
    }

    #[test]
    fn without_common_ground_there_is_no_band() {
        assert_eq!(band(&[]), Band::default());
        assert_eq!(band(&[vec![(0.0, 1.0)], Vec::new()]), Band::default());
        assert_eq!(band(&[vec![(0.0, 1.0), (1.0, 1.0)], vec![(5.0, 1.0), (6.0, 1.0)]]), Band::default());
    }

    #[test]
    fn curves_are_read_between_and_beyond_their_points() {
        let curve = [(1.0, 10.0), (3.0, 20.0)];
        assert_eq!([0.0, 1.0, 2.0, 3.0, 9.0].map(|x| at(&curve, x)), [10.0, 10.0, 15.0, 20.0, 20.0]);
        assert_eq!((reaches(&curve, 15.0), reaches(&curve, 21.0)), (Some(3.0), None));
    }

    #[test]
    fn smoothing_begins_with_a_full_window() {
        let points: Vec<(f64, f64)> = (0..25).map(|i| (f64::from(i), f64::from(i))).collect();
        let smooth = smooth(&points);
        assert_eq!((smooth.len(), smooth[0]), (6, (19.0, 9.5)));
        assert_eq!(median(&[1.0, 2.0, 4.0, 9.0]), 3.0);
    }
}
