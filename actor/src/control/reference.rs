//! Where the trunk is meant to be: a point that moves at the speed asked for and never runs far ahead of the robot.
//!
//! A reference that restarts at the robot at every solve leaves a constant offset in speed, since nothing remembers what
//! was missed. This one remembers, within a bound, so the mean speed follows the command.

use nalgebra::Vector2;

/// A moving point over the ground, world, m.
#[derive(Clone, Copy, Debug)]
pub(super) struct Reference {
    position: Vector2<f64>,
}

impl Reference {
    /// A reference that starts here.
    pub(super) fn new(position: Vector2<f64>) -> Self {
        Self { position }
    }

    /// The point, world, m.
    pub(super) fn position(&self) -> Vector2<f64> {
        self.position
    }

    /// Moves for `secs` at `velocity` (m/s), staying within `bound` (m) of the robot along each axis.
    pub(super) fn advance(&mut self, velocity: &Vector2<f64>, secs: f64, robot: &Vector2<f64>, bound: f64) {
        let moved = self.position + velocity * secs;
        self.position = robot + (moved - robot).map(|lead| lead.clamp(-bound, bound));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_moves_at_the_speed_and_waits_at_its_bound() {
        let mut reference = Reference::new(Vector2::zeros());
        let velocity = Vector2::new(0.5, 0.0);
        for _ in 0..10 {
            reference.advance(&velocity, 0.01, &Vector2::zeros(), 0.1);
        }
        assert!((reference.position().x - 0.05).abs() < 1e-12);
        for _ in 0..100 {
            reference.advance(&velocity, 0.01, &Vector2::zeros(), 0.1);
        }
        assert!((reference.position().x - 0.1).abs() < 1e-12);
    }
}
