//! Kinematics of one leg: where its points are, how they move, and which angles reach a point.
//!
//! | symbol   | name                                       | unit | shape |
//! |----------|--------------------------------------------|------|-------|
//! | q        | hip roll, hip pitch, knee                  | rad  | [3]   |
//! | L1 L2 L3 | hip link, thigh, calf                      | m    |       |
//! | J        | Jacobian of a point, body frame            | m    | [3, 3]|
//! | J̇ q̇      | acceleration of a point at constant speeds | m/s² | [3]   |
//!
//! Source: paper eqs 1–4 with their signs corrected. Axes are +x, +y, +y and the knee bends backwards (q₃ < 0); the
//! paper turns about −x, −y, −y, so `θ = −q` and `L1 → −L1` lead from one to the other (tested). Body frame: x
//! forward, y left, z up, origin at the middle of the four hips.

use super::Leg;
use nalgebra::{Matrix3, Vector3};

/// Lengths of the legs and places of the hips.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Geometry {
    /// L_x: front to rear hip roll joints, m.
    pub hip_distance_x: f64,
    /// L_y: left to right hip roll joints, m.
    pub hip_distance_y: f64,
    /// L_1: hip roll axis to thigh plane, m.
    pub hip_link: f64,
    /// L_2: hip pitch to knee, m.
    pub thigh: f64,
    /// L_3: knee to foot centre, m.
    pub calf: f64,
}

/// A point of a leg: so far sideways along the hip link, then down the thigh, then down the calf, each in metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LegPoint {
    /// Along the hip link, outwards, m.
    pub outwards: f64,
    /// Down the thigh, m.
    pub thigh: f64,
    /// Down the calf, m.
    pub calf: f64,
}

/// One leg at given angles, with its trigonometry done.
#[derive(Clone, Copy, Debug)]
pub struct Posture {
    hip: Vector3<f64>,
    side: f64,
    roll: (f64, f64),
    pitch: (f64, f64),
    pitch_knee: (f64, f64),
}

impl Geometry {
    /// Hip roll joint in the body frame, m.
    pub fn hip(&self, leg: Leg) -> Vector3<f64> {
        Vector3::new(leg.front() * self.hip_distance_x / 2.0, leg.side() * self.hip_distance_y / 2.0, 0.0)
    }

    /// The centre of the foot as a point of the leg.
    pub fn foot(&self) -> LegPoint {
        LegPoint { outwards: self.hip_link, thigh: self.thigh, calf: self.calf }
    }

    /// The leg at these angles (rad).
    pub fn posture(&self, leg: Leg, q: &Vector3<f64>) -> Posture {
        Posture {
            hip: self.hip(leg),
            side: leg.side(),
            roll: q[0].sin_cos(),
            pitch: q[1].sin_cos(),
            pitch_knee: (q[1] + q[2]).sin_cos(),
        }
    }

    /// Centre of the foot in the body frame, m.
    pub fn foot_in_body(&self, leg: Leg, q: &Vector3<f64>) -> Vector3<f64> {
        self.posture(leg, q).position(self.foot())
    }

    /// The angles (rad) that put the centre of the foot at a point of the body frame, knee backwards; `None` where
    /// the leg cannot reach.
    pub fn joints_at(&self, leg: Leg, foot_in_body: &Vector3<f64>) -> Option<Vector3<f64>> {
        let from_hip = foot_in_body - self.hip(leg);
        let lateral = leg.side() * self.hip_link;
        let down_squared = from_hip.y.powi(2) + from_hip.z.powi(2) - lateral.powi(2);
        if down_squared <= 0.0 {
            return None;
        }
        let plane_z = -down_squared.sqrt();
        let reach_squared = from_hip.x.powi(2) + down_squared;
        let (thigh, calf) = (self.thigh, self.calf);
        let knee_cosine = (reach_squared - thigh.powi(2) - calf.powi(2)) / (2.0 * thigh * calf);
        if knee_cosine.abs() > 1.0 {
            return None;
        }
        let knee = -knee_cosine.acos();
        let pitch =
            f64::atan2(-from_hip.x, -plane_z) - f64::atan2(calf * knee.sin(), thigh + calf * knee_cosine);
        let roll = f64::atan2(from_hip.z, from_hip.y) - f64::atan2(plane_z, lateral);
        Some(Vector3::new(wrapped(roll), pitch, knee))
    }
}

impl Posture {
    /// A point of the leg in the body frame, m.
    pub fn position(&self, point: LegPoint) -> Vector3<f64> {
        let (lateral, x, z) = self.in_plane(point);
        let (s, c) = self.roll;
        self.hip + Vector3::new(x, c * lateral - s * z, s * lateral + c * z)
    }

    /// `∂ position / ∂ q` of a point, body frame, m.
    pub fn jacobian(&self, point: LegPoint) -> Matrix3<f64> {
        let (_, x, z) = self.in_plane(point);
        let (s, c) = self.roll;
        let (knee_x, knee_z) = (-point.calf * self.pitch_knee.1, point.calf * self.pitch_knee.0);
        let from_hip = self.position(point) - self.hip;
        Matrix3::from_columns(&[
            Vector3::new(0.0, -from_hip.z, from_hip.y),
            Vector3::new(z, s * x, -c * x),
            Vector3::new(knee_x, -s * knee_z, c * knee_z),
        ])
    }

    /// The same for a point `offset` (body frame, m) away from `point` and fixed to the calf: `J + axis × offset`.
    pub fn jacobian_with_offset(&self, point: LegPoint, offset: &Vector3<f64>) -> Matrix3<f64> {
        let roll_axis = Vector3::x();
        let pitch_axis = Vector3::new(0.0, self.roll.1, self.roll.0);
        let across = pitch_axis.cross(offset);
        self.jacobian(point) + Matrix3::from_columns(&[roll_axis.cross(offset), across, across])
    }

    /// `J̇ q̇`: acceleration of a point (body frame, m/s²) when the joints turn at constant speeds (rad/s).
    pub fn bias_acceleration(&self, point: LegPoint, qd: &Vector3<f64>) -> Vector3<f64> {
        let (lateral, _, z) = self.in_plane(point);
        let (s, c) = self.roll;
        let (thigh_rate, calf_rate) = (qd[1], qd[1] + qd[2]);
        let (thigh, calf) = (point.thigh, point.calf);
        let plane_x = thigh * self.pitch.0 * thigh_rate.powi(2) + calf * self.pitch_knee.0 * calf_rate.powi(2);
        let plane_z = thigh * self.pitch.1 * thigh_rate.powi(2) + calf * self.pitch_knee.1 * calf_rate.powi(2);
        let plane_z_rate = thigh * self.pitch.0 * thigh_rate + calf * self.pitch_knee.0 * calf_rate;
        // The plane of the leg turns about x at q̇₁: centripetal and Coriolis terms.
        let sideways = -qd[0].powi(2) * lateral - 2.0 * qd[0] * plane_z_rate;
        let down = plane_z - qd[0].powi(2) * z;
        Vector3::new(plane_x, c * sideways - s * down, s * sideways + c * down)
    }

    /// The point in the plane of the leg: lateral offset with its side, x, z.
    fn in_plane(&self, point: LegPoint) -> (f64, f64, f64) {
        let x = -point.thigh * self.pitch.0 - point.calf * self.pitch_knee.0;
        let z = -point.thigh * self.pitch.1 - point.calf * self.pitch_knee.1;
        (self.side * point.outwards, x, z)
    }
}

/// The same angle in (−π, π].
fn wrapped(angle: f64) -> f64 {
    use std::f64::consts::{PI, TAU};
    if angle > PI {
        angle - TAU
    } else if angle <= -PI {
        angle + TAU
    } else {
        angle
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Matrix4;
    use proptest::prelude::*;
    use std::f64::consts::{FRAC_PI_2, PI};

    const SPOT: Geometry =
        Geometry { hip_distance_x: 0.141, hip_distance_y: 0.078, hip_link: 0.049, thigh: 0.1256, calf: 0.136 };

    fn any_leg() -> impl Strategy<Value = Leg> {
        (0..4_usize).prop_map(|i| Leg::ALL[i])
    }

    fn any_angles() -> impl Strategy<Value = Vector3<f64>> {
        (-0.8..0.8, -1.2..1.6, -2.6..-0.1).prop_map(|(a, b, c)| Vector3::new(a, b, c))
    }

    fn any_point() -> impl Strategy<Value = LegPoint> {
        (0.0..0.05, 0.0..0.13, 0.0..0.14).prop_map(|(outwards, thigh, calf)| LegPoint { outwards, thigh, calf })
    }

    /// Eq 3, as printed but for nothing: left leg, angles about −x, −y, −y.
    fn equation_3(l1: f64, theta: &Vector3<f64>) -> Vector3<f64> {
        let (s1, c1) = theta[0].sin_cos();
        let (s2, c2) = theta[1].sin_cos();
        let (s23, c23) = (theta[1] + theta[2]).sin_cos();
        let down = SPOT.calf * c23 + SPOT.thigh * c2;
        Vector3::new(
            SPOT.calf * s23 + SPOT.thigh * s2 + SPOT.hip_distance_x / 2.0,
            -s1 * down - l1 * c1 + SPOT.hip_distance_y / 2.0,
            -c1 * down + l1 * s1,
        )
    }

    /// Eq 4, as printed.
    fn equation_4(l1: f64, theta: &Vector3<f64>) -> Matrix3<f64> {
        let (s1, c1) = theta[0].sin_cos();
        let (s2, c2) = theta[1].sin_cos();
        let (s23, c23) = (theta[1] + theta[2]).sin_cos();
        let (l2, l3) = (SPOT.thigh, SPOT.calf);
        let down = l3 * c23 + l2 * c2;
        let back = l3 * s23 + l2 * s2;
        Matrix3::new(
            0.0,
            down,
            l3 * c23,
            -c1 * down + l1 * s1,
            s1 * back,
            l3 * s1 * s23,
            s1 * down + l1 * c1,
            c1 * back,
            l3 * c1 * s23,
        )
    }

    /// One row of Table 1: `Rx(α) Tx(a) Rz(θ) Tz(d)`.
    fn table_row(a: f64, alpha: f64, d: f64, theta: f64) -> Matrix4<f64> {
        let about_x = nalgebra::Rotation3::from_axis_angle(&Vector3::x_axis(), alpha).to_homogeneous();
        let about_z = nalgebra::Rotation3::from_axis_angle(&Vector3::z_axis(), theta).to_homogeneous();
        let shift = |v: Vector3<f64>| Matrix4::new_translation(&v);
        about_x * shift(Vector3::new(a, 0.0, 0.0)) * about_z * shift(Vector3::new(0.0, 0.0, d))
    }

    #[test]
    fn the_nominal_stance_is_where_the_angles_put_it() {
        let foot = SPOT.foot_in_body(Leg::FrontLeft, &Vector3::new(0.0, 0.85, -1.7));
        assert!((foot - Vector3::new(0.0705 + 0.0078, 0.039 + 0.049, -0.172_65)).norm() < 1e-4, "{foot}");
    }

    proptest! {
        #[test]
        fn table_1_composes_to_equation_3(theta in any_angles()) {
            let hip = Vector3::new(SPOT.hip_distance_x / 2.0, SPOT.hip_distance_y / 2.0, 0.0);
            let base = Matrix4::new_translation(&hip)
                * nalgebra::Rotation3::from_axis_angle(&Vector3::z_axis(), -FRAC_PI_2).to_homogeneous();
            let chain = base
                * table_row(0.0, FRAC_PI_2, 0.0, theta[0] + FRAC_PI_2)
                * table_row(0.0, FRAC_PI_2, SPOT.hip_link, theta[1] + PI)
                * table_row(SPOT.thigh, 0.0, 0.0, theta[2])
                * table_row(SPOT.calf, 0.0, 0.0, 0.0);
            let foot: Vector3<f64> = chain.fixed_view::<3, 1>(0, 3).into();
            prop_assert!((foot - equation_3(SPOT.hip_link, &theta)).norm() < 1e-12, "{foot} {theta}");
        }

        #[test]
        fn the_papers_left_leg_is_ours_with_angles_and_offset_turned_round(q in any_angles()) {
            let posture = SPOT.posture(Leg::FrontLeft, &q);
            let position = posture.position(SPOT.foot());
            prop_assert!((position - equation_3(-SPOT.hip_link, &-q)).norm() < 1e-12);
            let jacobian = posture.jacobian(SPOT.foot());
            prop_assert!((jacobian + equation_4(-SPOT.hip_link, &-q)).norm() < 1e-12);
        }

        #[test]
        fn joints_at_inverts_foot_in_body(leg in any_leg(), q in any_angles()) {
            // Beyond these the thigh plane passes above the hip, where another solution is nearer.
            let foot = SPOT.foot_in_body(leg, &q);
            let posture = SPOT.posture(leg, &q);
            prop_assume!(posture.in_plane(SPOT.foot()).2 < -0.01);
            let back = SPOT.joints_at(leg, &foot).expect("reachable");
            prop_assert!((back - q).norm() < 1e-9, "{back} {q}");
        }

        #[test]
        fn unreachable_points_are_refused(leg in any_leg(), x in 0.3..1.0) {
            prop_assert_eq!(SPOT.joints_at(leg, &(SPOT.hip(leg) + Vector3::new(x, 0.0, -0.1))), None);
            prop_assert_eq!(SPOT.joints_at(leg, &(SPOT.hip(leg) + Vector3::new(0.1, 0.0, 0.01))), None);
        }

        #[test]
        fn jacobian_is_the_derivative(leg in any_leg(), q in any_angles(), point in any_point()) {
            const STEP: f64 = 1e-6;
            let jacobian = SPOT.posture(leg, &q).jacobian(point);
            for joint in 0..3 {
                let nudge = Vector3::ith(joint, STEP);
                let ahead = SPOT.posture(leg, &(q + nudge)).position(point);
                let behind = SPOT.posture(leg, &(q - nudge)).position(point);
                let difference = (ahead - behind) / (2.0 * STEP);
                prop_assert!((jacobian.column(joint) - difference).norm() < 1e-8, "{joint}");
            }
        }

        #[test]
        fn bias_acceleration_is_the_derivative_of_velocity(
            leg in any_leg(), q in any_angles(), point in any_point(),
            a in -10.0..10.0, b in -10.0..10.0, c in -10.0..10.0,
        ) {
            const STEP: f64 = 1e-6;
            let qd = Vector3::new(a, b, c);
            let velocity = |q: Vector3<f64>| SPOT.posture(leg, &q).jacobian(point) * qd;
            let difference = (velocity(q + qd * STEP) - velocity(q - qd * STEP)) / (2.0 * STEP);
            let bias = SPOT.posture(leg, &q).bias_acceleration(point, &qd);
            prop_assert!((bias - difference).norm() < 1e-5, "{bias} {difference}");
        }

        #[test]
        fn offset_jacobian_follows_the_calf(leg in any_leg(), q in any_angles(), length in -0.02..0.02) {
            // A point further down the calf is a point with an offset along the calf.
            let posture = SPOT.posture(leg, &q);
            let beyond = LegPoint { calf: SPOT.calf + length, ..SPOT.foot() };
            let offset = posture.position(beyond) - posture.position(SPOT.foot());
            let jacobian = posture.jacobian_with_offset(SPOT.foot(), &offset);
            prop_assert!((jacobian - posture.jacobian(beyond)).norm() < 1e-12);
        }
    }
}
