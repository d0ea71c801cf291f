//! The single rigid body that the controller predicts with: massless legs, forces at the feet, linear over one step.
//!
//! | symbol | name                                             | unit        |
//! |--------|--------------------------------------------------|-------------|
//! | Θ      | roll, pitch, yaw: R = Rz(yaw) Ry(pitch) Rx(roll) | rad         |
//! | p, v   | centre of mass, world                            | m, m/s      |
//! | ω      | angular velocity, world                          | rad/s       |
//! | T      | Rz(yaw)ᵀ: world angular velocity to Θ̇            | –           |
//! | I      | R I_body Rᵀ                                      | kg m²       |
//! | r      | foot from the centre of mass, world              | m           |
//!
//! Θ̇ = T ω, ṗ = v, ω̇ = I⁻¹ Σ r × u, v̇ = Σ u / m + g. With T, I and r held over a step the system matrix is
//! nilpotent, so that the discretisation in `advance` is exact. Source: eqs 12–14 (T transposed, gravity downwards,
//! no exponents on per-step matrices). Leaves out ω × Iω and the coupling of roll and pitch rates in T.

use nalgebra::{Matrix3, Rotation3, Vector3};

/// Acceleration of a free body, world, m/s².
pub const GRAVITY: Vector3<f64> = Vector3::new(0.0, 0.0, -9.81);

/// What the controller believes to carry.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Body {
    /// Mass with the legs, kg.
    pub mass_kg: f64,
    /// Inertia about the centre of mass, body frame, kg m².
    pub inertia: Matrix3<f64>,
}

/// Where the body is and how it moves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct State {
    /// Roll, pitch, yaw, rad; yaw may count full turns.
    pub angles: Vector3<f64>,
    /// Centre of mass, world, m.
    pub position: Vector3<f64>,
    /// World frame, rad/s.
    pub angular_velocity: Vector3<f64>,
    /// Of the centre of mass, world, m/s.
    pub velocity: Vector3<f64>,
}

impl State {
    /// At rest in the origin.
    pub fn zero() -> Self {
        let zero = Vector3::zeros();
        Self { angles: zero, position: zero, angular_velocity: zero, velocity: zero }
    }

    /// Whether every number is finite.
    pub fn is_finite(&self) -> bool {
        [self.angles, self.position, self.angular_velocity, self.velocity]
            .iter()
            .all(|vector| vector.iter().all(|value| value.is_finite()))
    }
}

/// The model of one step, linearised about the middle of the motion expected during it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Linearised {
    /// cos and sin of the yaw.
    pub(super) yaw_cos_sin: (f64, f64),
    /// I⁻¹, world, 1/(kg m²).
    pub(super) inertia_inverse: Matrix3<f64>,
    /// Centre of mass that moment arms start from, world, m.
    pub(super) centre: Vector3<f64>,
}

impl Linearised {
    /// The step from `start` to `end` of a body with this inverse inertia (body frame, 1/(kg m²)).
    pub(super) fn between(start: &State, end: &State, inertia_inverse: &Matrix3<f64>) -> Self {
        let angles = (start.angles + end.angles) / 2.0;
        let world_from_body = Rotation3::from_euler_angles(angles.x, angles.y, angles.z);
        let (sin, cos) = angles.z.sin_cos();
        Self {
            yaw_cos_sin: (cos, sin),
            inertia_inverse: world_from_body.matrix() * inertia_inverse * world_from_body.matrix().transpose(),
            centre: (start.position + end.position) / 2.0,
        }
    }

    /// T ω: rates of roll, pitch, yaw, rad/s, of a world angular velocity.
    pub(super) fn angle_rates(&self, angular: &Vector3<f64>) -> Vector3<f64> {
        let (cos, sin) = self.yaw_cos_sin;
        Vector3::new(cos * angular.x + sin * angular.y, cos * angular.y - sin * angular.x, angular.z)
    }

    /// Tᵀ applied to a vector.
    pub(super) fn angle_rates_transposed(&self, angles: &Vector3<f64>) -> Vector3<f64> {
        let (cos, sin) = self.yaw_cos_sin;
        Vector3::new(cos * angles.x - sin * angles.y, sin * angles.x + cos * angles.y, angles.z)
    }

    /// I⁻¹ skew(r): angular acceleration, rad/s², per newton at a foot (world, m).
    pub(super) fn angular_response(&self, foot: &Vector3<f64>) -> Matrix3<f64> {
        self.inertia_inverse * (foot - self.centre).cross_matrix()
    }

    /// The state after `dt` seconds of constant angular (rad/s²) and linear (m/s², gravity included) acceleration.
    pub(super) fn advance(&self, from: &State, angular: &Vector3<f64>, linear: &Vector3<f64>, dt: f64) -> State {
        let mean_rate = from.angular_velocity + angular * (dt / 2.0);
        let mean_velocity = from.velocity + linear * (dt / 2.0);
        State {
            angles: from.angles + self.angle_rates(&mean_rate) * dt,
            position: from.position + mean_velocity * dt,
            angular_velocity: from.angular_velocity + angular * dt,
            velocity: from.velocity + linear * dt,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing;
    use super::*;
    use nalgebra::{SMatrix, SVector};

    fn flat(state: &State) -> SVector<f64, 12> {
        let parts = [state.angles, state.position, state.angular_velocity, state.velocity];
        SVector::from_iterator(parts.iter().flat_map(|part| part.iter().copied()))
    }

    #[test]
    fn an_even_share_of_the_weight_leaves_the_velocity_unchanged() {
        let body = testing::body();
        let share = -GRAVITY * body.mass_kg / 4.0;
        let model = Linearised::between(&State::zero(), &State::zero(), &testing::inertia_inverse());
        let feet = [(0.1, 0.1), (0.1, -0.1), (-0.1, 0.1), (-0.1, -0.1)].map(|(x, y)| Vector3::new(x, y, -0.17));
        let angular: Vector3<f64> = feet.iter().map(|foot| model.angular_response(foot) * share).sum();
        let linear = share * 4.0 / body.mass_kg + GRAVITY;
        let next = model.advance(&State::zero(), &angular, &linear, 0.025);
        assert!(flat(&next).norm() < 1e-14, "{next:?}");
        let fallen = model.advance(&State::zero(), &angular, &GRAVITY, 0.025);
        assert!((fallen.velocity.z + 9.81 * 0.025).abs() < 1e-15);
        assert!((fallen.position.z + 9.81 * 0.025 * 0.025 / 2.0).abs() < 1e-15);
    }

    #[test]
    fn a_step_is_the_exponential_of_the_continuous_system() {
        let from = testing::disturbed(1);
        let to = testing::disturbed(2);
        let model = Linearised::between(&from, &to, &testing::inertia_inverse());
        let (angular, linear) = (Vector3::new(3.0, -2.0, 1.0), Vector3::new(0.4, -0.7, 0.9) + GRAVITY);
        let yaw = f64::midpoint(from.angles.z, to.angles.z);
        let mut system = SMatrix::<f64, 13, 13>::zeros();
        let rates = Rotation3::from_axis_angle(&Vector3::z_axis(), yaw).matrix().transpose();
        system.fixed_view_mut::<3, 3>(0, 6).copy_from(&rates);
        system.fixed_view_mut::<3, 3>(3, 9).copy_from(&Matrix3::identity());
        system.fixed_view_mut::<3, 1>(6, 12).copy_from(&angular);
        system.fixed_view_mut::<3, 1>(9, 12).copy_from(&linear);
        let dt = 0.025;
        let mut start = SVector::<f64, 13>::zeros();
        start.fixed_rows_mut::<12>(0).copy_from(&flat(&from));
        start[12] = 1.0;
        let expected = (system * dt).exp() * start;
        let got = flat(&model.advance(&from, &angular, &linear, dt));
        assert!((got - expected.fixed_rows::<12>(0)).norm() < 1e-13);
    }

    #[test]
    fn a_force_in_front_of_the_centre_pitches_the_nose_up() {
        let model = Linearised::between(&State::zero(), &State::zero(), &testing::inertia_inverse());
        let response = model.angular_response(&Vector3::new(0.1, 0.0, -0.17)) * Vector3::new(0.0, 0.0, 10.0);
        // Positive pitch is nose down: r × u = (0.1, 0, −0.17) × (0, 0, 10) = (0, −1, 0).
        assert!((response - Vector3::new(0.0, -1.0 / testing::body().inertia[(1, 1)], 0.0)).norm() < 1e-12);
    }

    #[test]
    fn angle_rates_are_how_the_angles_of_a_level_body_change() {
        let turn = |secs: f64| {
            let level = Rotation3::from_axis_angle(&Vector3::z_axis(), 1.0);
            let (roll, pitch, yaw) = (Rotation3::new(Vector3::new(0.3, -0.2, 0.5) * secs) * level).euler_angles();
            Vector3::new(roll, pitch, yaw)
        };
        let mut state = State::zero();
        state.angles.z = 1.0;
        let model = Linearised::between(&state, &state, &testing::inertia_inverse());
        let rates = (turn(1e-5) - turn(-1e-5)) / 2e-5;
        assert!((model.angle_rates(&Vector3::new(0.3, -0.2, 0.5)) - rates).norm() < 1e-9, "{rates}");
    }

    #[test]
    fn the_transposed_map_is_the_transpose() {
        let model = Linearised::between(&testing::disturbed(3), &testing::disturbed(4), &testing::inertia_inverse());
        let (a, b) = (Vector3::new(0.3, -0.2, 0.9), Vector3::new(-0.5, 0.1, 0.4));
        assert!((model.angle_rates(&a).dot(&b) - a.dot(&model.angle_rates_transposed(&b))).abs() < 1e-15);
    }
}
