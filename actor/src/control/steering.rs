//! Where the robot is meant to head, and what is asked of it beside its forward velocity.

use nalgebra::{Rotation2, Vector2};

/// A velocity to the left, a yaw rate and the heading that they have led to.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Steering {
    /// To the left, m/s.
    pub(super) lateral_mps: f64,
    /// rad/s
    pub(super) yaw_radps: f64,
    /// Full turns included, rad.
    pub(super) heading: f64,
}

impl Steering {
    /// The velocity asked for together with this one forwards (m/s), world, m/s.
    pub(super) fn world(&self, forward_mps: f64) -> Vector2<f64> {
        Rotation2::new(self.heading) * Vector2::new(forward_mps, self.lateral_mps)
    }

    /// The part of a velocity (world, m/s) along the heading, m/s.
    pub(super) fn ahead(&self, velocity: &Vector2<f64>) -> f64 {
        (Rotation2::new(self.heading).inverse() * velocity).x
    }

    /// True when neither is asked for.
    pub(super) fn is_straight(&self) -> bool {
        self.lateral_mps == 0.0 && self.yaw_radps == 0.0
    }

    /// Turns for `secs`.
    pub(super) fn advance(&mut self, secs: f64) {
        self.heading += self.yaw_radps * secs;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::FRAC_PI_2;

    #[test]
    fn the_velocity_turns_with_the_heading() {
        let mut steering = Steering { lateral_mps: 0.1, yaw_radps: FRAC_PI_2, heading: 0.0 };
        assert_eq!(steering.world(0.5), Vector2::new(0.5, 0.1));
        (0..1000).for_each(|_| steering.advance(0.001));
        let world = steering.world(0.5);
        assert!((world - Vector2::new(-0.1, 0.5)).norm() < 1e-9, "{steering:?}");
        assert!((steering.ahead(&world) - 0.5).abs() < 1e-9);
    }
}
