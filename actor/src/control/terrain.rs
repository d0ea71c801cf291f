//! The ground as felt by the feet: a plane through the places where they stood last. No eyes, no map.
//!
//! | symbol | name                                        | unit |
//! |--------|---------------------------------------------|------|
//! | p_i    | where foot i stands, or stood last          | m    |
//! | z(x, y)| `z̄ + g · ((x, y) − (x̄, ȳ))`, the least-squares plane through the four p_i | m |
//! | g      | its gradient, followed with a time constant so that one stone does not tip the trunk | 1 |
//!
//! The trunk is to stand over this plane at its height and parallel to it, and feet aim at it. Source: the slope estimate
//! of the MIT Cheetah 3 (Bledt et al. 2018).

use super::contact::Duty;
use super::leg::Body;
use crate::robot::Leg;
use crate::sim::Contacts;
use nalgebra::{Rotation2, Vector2, Vector3};

/// Time in which the gradient follows what the feet feel, s: about one step.
const FOLLOW_SECS: f64 = 0.12;
/// Steepest gradient that is believed, 25°.
const STEEPEST: f64 = 0.466;
/// Feet nearer to one line than this spread (m⁴) tell no gradient.
const SPREAD_MIN: f64 = 1e-6;

/// What the feet know of the ground.
#[derive(Clone, Copy, Debug)]
pub(super) struct Terrain {
    /// p_i by leg; none before the first tick.
    feet: Option<[Vector3<f64>; 4]>,
    middle: Vector3<f64>,
    gradient: Vector2<f64>,
}

impl Terrain {
    /// Level ground at z = 0, until something else is felt.
    pub(super) fn level() -> Self {
        Self { feet: None, middle: Vector3::zeros(), gradient: Vector2::zeros() }
    }

    /// Feels the ground through the feet that press on it, `secs` after the last time.
    pub(super) fn feel(&mut self, body: &Body<'_>, duties: &[Duty; 4], contacts: &Contacts, secs: f64) {
        let here = Leg::ALL.map(|leg| body.contact_point(leg));
        let first = self.feet.is_none();
        let feet = self.feet.get_or_insert(here);
        for leg in Leg::ALL {
            let i = leg.index();
            if duties[i].stands() && contacts.feet[i] {
                feet[i] = here[i];
            }
        }
        let (middle, slope) = plane(feet);
        let share = if first { 1.0 } else { (secs / FOLLOW_SECS).min(1.0) };
        self.middle = middle;
        self.gradient += (slope.map(|g| g.clamp(-STEEPEST, STEEPEST)) - self.gradient) * share;
    }

    /// True after the first tick.
    pub(super) fn is_felt(&self) -> bool {
        self.feet.is_some()
    }

    /// Height of the plane over a point, world, m.
    pub(super) fn height(&self, place: &Vector2<f64>) -> f64 {
        self.middle.z + self.gradient.dot(&(place - self.middle.xy()))
    }

    /// Rise per second of a point that moves over the plane at this velocity (world, m/s).
    pub(super) fn climb(&self, velocity: &Vector2<f64>) -> f64 {
        self.gradient.dot(velocity)
    }

    /// Roll and pitch of a trunk parallel to the plane with this yaw, rad.
    pub(super) fn tilt(&self, yaw: f64) -> Vector2<f64> {
        let ahead = Rotation2::new(yaw).inverse() * self.gradient;
        Vector2::new(ahead.y.atan(), -ahead.x.atan())
    }
}

/// Middle and gradient of the least-squares plane through four points.
fn plane(points: &[Vector3<f64>; 4]) -> (Vector3<f64>, Vector2<f64>) {
    let middle = points.iter().sum::<Vector3<f64>>() / 4.0;
    let (mut xx, mut xy, mut yy, mut xz, mut yz) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for p in points {
        let d = p - middle;
        xx += d.x * d.x;
        xy += d.x * d.y;
        yy += d.y * d.y;
        xz += d.x * d.z;
        yz += d.y * d.z;
    }
    let spread = xx * yy - xy * xy;
    if spread < SPREAD_MIN {
        return (middle, Vector2::zeros());
    }
    (middle, Vector2::new((xz * yy - yz * xy) / spread, (yz * xx - xz * xy) / spread))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::Model;
    use crate::sim::RobotState;
    use herd_common::config::Config;
    use nalgebra::UnitQuaternion;

    fn on_plane(gradient: Vector2<f64>) -> [Vector3<f64>; 4] {
        [[0.1, 0.09], [0.05, -0.08], [-0.09, 0.1], [-0.07, -0.09]].map(|[x, y]| {
            let place = Vector2::new(x, y);
            Vector3::new(1.0 + x, y - 2.0, 0.3 + gradient.dot(&place))
        })
    }

    #[test]
    fn a_plane_is_found_from_points_on_it() {
        let gradient = Vector2::new(0.2, -0.1);
        let (middle, found) = plane(&on_plane(gradient));
        assert!((found - gradient).norm() < 1e-12);
        let terrain = Terrain { feet: None, middle, gradient: found };
        let place = Vector2::new(5.0, 1.0);
        let expected = 0.3 + gradient.dot(&(place - Vector2::new(1.0, -2.0)));
        assert!((terrain.height(&place) - expected).abs() < 1e-9);
        assert!((terrain.climb(&Vector2::new(2.0, 1.0)) - 0.3).abs() < 1e-12);
    }

    #[test]
    fn a_foot_that_has_yet_to_arrive_tells_nothing() {
        let model = Model::new(&Config::default().robot);
        let state = |z: f64| RobotState {
            position: Vector3::z() * z,
            rotation: UnitQuaternion::identity(),
            velocity: Vector3::zeros(),
            angular_velocity: Vector3::zeros(),
            joints: model.nominal_stance(),
            joint_speeds: [Vector3::zeros(); 4],
        };
        let mut terrain = Terrain::level();
        let mut feel = |z: f64, feet: [bool; 4]| {
            let contacts = Contacts { normal: [60.0; 4], feet, ..Contacts::default() };
            terrain.feel(&Body::new(&model, &state(z)), &[Duty::Stands; 4], &contacts, 0.002);
            terrain.feet.expect("it has felt").map(|foot| foot.z)
        };
        let first = feel(0.2, [true; 4]);
        let later = feel(0.3, [false, true, true, true]);
        assert_eq!(later[0], first[0]);
        assert!((later[1] - first[1] - 0.1).abs() < 1e-12, "{later:?}");
    }

    #[test]
    fn points_on_a_line_tell_no_gradient() {
        let line = [0.0, 0.1, 0.2, 0.3].map(|x| Vector3::new(x, 2.0 * x, x));
        assert_eq!(plane(&line).1, Vector2::zeros());
    }

    #[test]
    fn uphill_the_nose_points_up_whichever_way_it_looks() {
        let terrain = Terrain { feet: None, middle: Vector3::zeros(), gradient: Vector2::new(0.2, 0.0) };
        let angle = 0.2_f64.atan();
        assert!((terrain.tilt(0.0) - Vector2::new(0.0, -angle)).norm() < 1e-12);
        // Facing left with the hill to the right: the right side is up, a negative roll.
        assert!((terrain.tilt(std::f64::consts::FRAC_PI_2) - Vector2::new(-angle, 0.0)).norm() < 1e-12);
    }
}
