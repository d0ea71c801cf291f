//! The path of a foot through the air, eq 15 with its height corrected.
//!
//! | symbol | name                                 | unit |
//! |--------|--------------------------------------|------|
//! | s      | share of the swing that is over      | 1    |
//! | σ      | share of the swing in which the foot advances | 1 |
//! | c(s)   | advance, 0 to 1: `s − sin(2πs)/2π`   | 1    |
//! | b(s)   | lift, 0 to 1 at s = ½ and back: `2s − sin(4πs)/2π`, mirrored after mid-swing | 1 |
//! | H      | apex                                 | m    |
//!
//! Position is `from + (to − from) c(min(s/σ, 1)) + H b(s) ẑ`; σ = 1 is the paper's. Velocity and acceleration vanish at
//! both ends in the world frame, so a foot leaves and meets the ground without scuffing. The eq 15 that is printed ends its
//! height at H.

use nalgebra::Vector3;
use std::f64::consts::{PI, TAU};

/// Position, velocity and acceleration of a foot, world frame, m, m/s, m/s².
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// m
    pub position: Vector3<f64>,
    /// m/s
    pub velocity: Vector3<f64>,
    /// m/s²
    pub acceleration: Vector3<f64>,
}

/// One swing of one foot.
#[derive(Clone, Copy, Debug)]
pub struct Swing {
    /// Where the foot left the ground, world, m.
    pub from: Vector3<f64>,
    /// H, m.
    pub lift: f64,
    /// Δt, s.
    pub duration: f64,
    /// σ, above 0 and at most 1.
    pub advance_share: f64,
}

/// c(s) with its first two derivatives.
pub fn advance(s: f64) -> [f64; 3] {
    let angle = TAU * s;
    [s - angle.sin() / TAU, 1.0 - angle.cos(), TAU * angle.sin()]
}

/// b(s) with its first two derivatives.
pub fn lift(s: f64) -> [f64; 3] {
    let angle = 2.0 * TAU * s;
    let rising = [2.0 * s - angle.sin() / TAU, 2.0 * (1.0 - angle.cos()), 8.0 * PI * angle.sin()];
    if s < 0.5 { rising } else { [2.0 - rising[0], -rising[1], -rising[2]] }
}

impl Swing {
    /// Where the foot should be `elapsed` seconds into the swing if it is to land at `to` (world, m).
    pub fn at(&self, elapsed: f64, to: &Vector3<f64>) -> Point {
        let s = (elapsed / self.duration).clamp(0.0, 1.0);
        let [c, b] = [advance((s / self.advance_share).min(1.0)), lift(s)];
        let way = to - self.from;
        let up = Vector3::z() * self.lift;
        let rate = 1.0 / (self.duration * self.advance_share);
        Point {
            position: self.from + way * c[0] + up * b[0],
            velocity: way * (c[1] * rate) + up * (b[1] / self.duration),
            acceleration: way * (c[2] * rate.powi(2)) + up * (b[2] / self.duration.powi(2)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn ends_are_at_rest_and_the_apex_is_h() {
        for profile in [advance, lift] {
            for s in [0.0, 1.0] {
                let [_, rate, bend] = profile(s);
                assert!(rate.abs() < 1e-12 && bend.abs() < 1e-12, "{s}");
            }
        }
        assert_eq!(advance(0.0)[0], 0.0);
        assert!((advance(1.0)[0] - 1.0).abs() < 1e-12);
        assert!(lift(0.0)[0].abs() < 1e-12 && lift(1.0)[0].abs() < 1e-12);
        assert!((lift(0.5)[0] - 1.0).abs() < 1e-12 && (lift(0.5 - 1e-9)[0] - 1.0).abs() < 1e-7);
    }

    #[test]
    fn the_printed_height_differs_only_in_its_slope_term() {
        // Eq 15 prints t/Δt where 2t/Δt belongs: half-way through the rise it is short by exactly t/Δt.
        let s = 0.25;
        let printed = (s - (2.0 * TAU * s).sin() / TAU - 1.0) + 1.0;
        assert!((lift(s)[0] - printed - s).abs() < 1e-12);
    }

    proptest! {
        #[test]
        fn derivatives_are_derivatives(s in 0.01_f64..0.99) {
            const STEP: f64 = 1e-6;
            prop_assume!((s - 0.5).abs() > 2.0 * STEP);
            for profile in [advance, lift] {
                let (ahead, here, behind) = (profile(s + STEP), profile(s), profile(s - STEP));
                prop_assert!(((ahead[0] - behind[0]) / (2.0 * STEP) - here[1]).abs() < 1e-6);
                prop_assert!(((ahead[1] - behind[1]) / (2.0 * STEP) - here[2]).abs() < 1e-6);
            }
        }

        #[test]
        fn a_swing_goes_from_here_to_there(x in -0.1..0.1, y in -0.1..0.1, height in 0.0..0.06, duration in 0.1..0.2,
            advance_share in 0.8..1.0) {
            let swing = Swing { from: Vector3::new(0.3, -0.1, 0.01), lift: height, duration, advance_share };
            let to = swing.from + Vector3::new(x, y, -0.002);
            prop_assert!((swing.at(0.0, &to).position - swing.from).norm() < 1e-12);
            prop_assert!((swing.at(duration, &to).position - to).norm() < 1e-12);
            let sinking = swing.at(duration * (1.0 + advance_share) / 2.0, &to);
            prop_assert!(advance_share == 1.0 || sinking.velocity.xy().norm() < 1e-9, "it only sinks at the end");
            let apex = swing.at(duration / 2.0, &to).position.z;
            let sunk = -0.002 * advance((0.5 / advance_share).min(1.0))[0];
            prop_assert!((apex - swing.from.z - height - sunk).abs() < 1e-9);
        }
    }
}
