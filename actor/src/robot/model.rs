//! Masses, inertias and limits of the robot, and its composite body for any posture.
//!
//! Rigid links: the trunk, and for each leg hip, thigh and calf. The trunk's centre of mass is the origin of the body
//! frame. Thigh and calf are rods, the hip a cube. Rotor inertia is not part of the links: it acts on joints only.

use super::{GRAVITY, Geometry, Leg, LegPoint, Posture};
use herd_common::config::robot;
use nalgebra::{Matrix3, Vector3};

/// Radius of the rods that stand for thigh and calf, m; guess, it only matters for their inertia about their length.
const ROD_RADIUS: f64 = 0.012;
/// Edge of the cube that stands for a hip motor, m; guess after small servos.
const HIP_EDGE: f64 = 0.04;
/// Radius of the sphere at each knee that notices the ground, m; guess after the width of a thigh.
pub(crate) const KNEE_RADIUS: f64 = 0.012;

/// One link of a leg.
#[derive(Clone, Copy, Debug)]
pub struct Link {
    /// Mass, kg.
    pub mass: f64,
    /// Inertia about its centre of mass in its own frame (z along the rod), kg m².
    pub inertia: Matrix3<f64>,
    /// Centre of mass as a point of the leg.
    pub centre: LegPoint,
}

/// The robot as one rigid body.
#[derive(Clone, Copy, Debug)]
pub struct Composite {
    /// Mass, kg.
    pub mass: f64,
    /// Centre of mass in the body frame, m.
    pub centre: Vector3<f64>,
    /// Inertia about it, body axes, kg m².
    pub inertia: Matrix3<f64>,
}

/// Everything about the robot's body.
#[derive(Clone, Debug)]
pub struct Model {
    /// Lengths.
    pub geometry: Geometry,
    /// Radius of the foot spheres, m.
    pub foot_radius: f64,
    /// Edges of the trunk box along x, y, z, m.
    pub trunk_size: Vector3<f64>,
    /// Mass of the trunk, kg.
    pub trunk_mass: f64,
    /// Inertia of the trunk, body axes, kg m².
    pub trunk_inertia: Matrix3<f64>,
    /// Hip, thigh and calf of a leg.
    pub links: [Link; 3],
    /// Largest torque of a joint, N·m.
    pub torque_max: f64,
    /// Viscous friction of a joint, N·m·s/rad.
    pub joint_damping: f64,
    /// Rotor inertia seen by a joint, kg m².
    pub joint_armature: f64,
    /// Nominal angles of the left legs, rad; see [`Model::nominal`].
    nominal: Vector3<f64>,
}

impl Link {
    /// Centre of mass in the frame of the `i`-th link of a leg, whose origin is the joint that carries it, m.
    pub(crate) fn centre_in_frame(&self, i: usize, leg: Leg) -> Vector3<f64> {
        match i {
            0 => Vector3::new(0.0, leg.side() * self.centre.outwards, 0.0),
            1 => Vector3::new(0.0, 0.0, -self.centre.thigh),
            _ => Vector3::new(0.0, 0.0, -self.centre.calf),
        }
    }
}

impl Model {
    /// The robot of this configuration.
    pub fn new(config: &robot::Config) -> Self {
        let geometry = Geometry {
            hip_distance_x: config.hip_distance_x_m,
            hip_distance_y: config.hip_distance_y_m,
            hip_link: config.hip_link_m,
            thigh: config.thigh_m,
            calf: config.calf_m,
        };
        let hip = LegPoint { outwards: geometry.hip_link / 2.0, thigh: 0.0, calf: 0.0 };
        let thigh = LegPoint { outwards: geometry.hip_link, thigh: geometry.thigh / 2.0, calf: 0.0 };
        let calf = LegPoint { calf: geometry.calf / 2.0, ..geometry.foot() };
        let trunk_size = Vector3::from(config.trunk_size_m);
        Self {
            foot_radius: config.foot_radius_m,
            trunk_size,
            trunk_mass: config.trunk_mass_kg,
            trunk_inertia: box_inertia(config.trunk_mass_kg, &trunk_size),
            links: [
                Link {
                    mass: config.hip_mass_kg,
                    inertia: box_inertia(config.hip_mass_kg, &Vector3::repeat(HIP_EDGE)),
                    centre: hip,
                },
                Link {
                    mass: config.thigh_mass_kg,
                    inertia: rod_inertia(config.thigh_mass_kg, geometry.thigh),
                    centre: thigh,
                },
                Link {
                    mass: config.calf_mass_kg,
                    inertia: rod_inertia(config.calf_mass_kg, geometry.calf),
                    centre: calf,
                },
            ],
            torque_max: config.torque_max_nm,
            joint_damping: config.joint_damping,
            joint_armature: config.joint_armature,
            nominal: Vector3::from(config.nominal_joint_rad),
            geometry,
        }
    }

    /// Angles of a leg in the nominal stance, rad: hip roll is outwards, so it changes sign on the right.
    pub fn nominal(&self, leg: Leg) -> Vector3<f64> {
        Vector3::new(leg.side() * self.nominal[0], self.nominal[1], self.nominal[2])
    }

    /// The nominal stance, rad.
    pub fn nominal_stance(&self) -> [Vector3<f64>; 4] {
        Leg::ALL.map(|leg| self.nominal(leg))
    }

    /// Height of the trunk's origin over level ground in the nominal stance, m.
    pub fn standing_height(&self) -> f64 {
        self.foot_radius - self.geometry.foot_in_body(Leg::FrontLeft, &self.nominal(Leg::FrontLeft)).z
    }

    /// Mass of the whole robot, kg.
    pub fn mass(&self) -> f64 {
        self.trunk_mass + 4.0 * self.links.iter().map(|link| link.mass).sum::<f64>()
    }

    /// The force of the ground on a foot (world, N) that holds its part of the robot standing parallel to a slope that
    /// rises along x by this angle (rad): rear legs carry the more the steeper it is uphill.
    pub fn standing_force(&self, leg: Leg, slope_rad: f64) -> Vector3<f64> {
        let lean = slope_rad.tan() * self.standing_height() / self.geometry.hip(leg).x;
        Vector3::new(0.0, 0.0, self.mass() * GRAVITY / 4.0 * (1.0 - lean))
    }

    /// Centre of mass in the body frame, m.
    pub fn centre(&self, legs: &[Posture; 4]) -> Vector3<f64> {
        let moment: Vector3<f64> = self.parts(legs).map(|(_, link, leg)| link.mass * leg.position(link.centre)).sum();
        moment / self.mass()
    }

    /// Velocity of the centre of mass relative to the trunk's origin, body frame, m/s, from joint speeds in rad/s.
    pub fn centre_velocity(&self, legs: &[Posture; 4], speeds: &[Vector3<f64>; 4]) -> Vector3<f64> {
        let momentum: Vector3<f64> = self
            .parts(legs)
            .map(|(leg, link, posture)| link.mass * (posture.jacobian(link.centre) * speeds[leg.index()]))
            .sum();
        momentum / self.mass()
    }

    /// The robot with its joints (rad) held, as one rigid body.
    pub fn composite(&self, joints: &[Vector3<f64>; 4]) -> Composite {
        let legs = Leg::ALL.map(|leg| self.geometry.posture(leg, &joints[leg.index()]));
        let centre = self.centre(&legs);
        let mut inertia = self.trunk_inertia + point_inertia(self.trunk_mass, &-centre);
        for (leg, link, posture) in self.parts(&legs) {
            let body_from_link = link_rotation(&joints[leg.index()], link);
            inertia += body_from_link * link.inertia * body_from_link.transpose();
            inertia += point_inertia(link.mass, &(posture.position(link.centre) - centre));
        }
        Composite { mass: self.mass(), centre, inertia }
    }

    fn parts<'a>(&'a self, legs: &'a [Posture; 4]) -> impl Iterator<Item = (Leg, &'a Link, &'a Posture)> {
        Leg::ALL
            .into_iter()
            .zip(legs)
            .flat_map(|(leg, posture)| self.links.iter().map(move |link| (leg, link, posture)))
    }
}

/// Rotation from the frame of a link (z along its rod) to the body frame.
fn link_rotation(q: &Vector3<f64>, link: &Link) -> Matrix3<f64> {
    let pitch = if link.centre.calf > 0.0 {
        q[1] + q[2]
    } else if link.centre.thigh > 0.0 {
        q[1]
    } else {
        0.0
    };
    let about_x = nalgebra::Rotation3::from_axis_angle(&Vector3::x_axis(), q[0]);
    let about_y = nalgebra::Rotation3::from_axis_angle(&Vector3::y_axis(), pitch);
    (about_x * about_y).into_inner()
}

/// Inertia of a uniform box about its centre, kg m².
pub(crate) fn box_inertia(mass: f64, size: &Vector3<f64>) -> Matrix3<f64> {
    let [x, y, z] = [size.x.powi(2), size.y.powi(2), size.z.powi(2)];
    Matrix3::from_diagonal(&Vector3::new(y + z, x + z, x + y)) * (mass / 12.0)
}

/// Inertia of a uniform rod along z about its centre, kg m².
fn rod_inertia(mass: f64, length: f64) -> Matrix3<f64> {
    let across = mass * (3.0 * ROD_RADIUS.powi(2) + length.powi(2)) / 12.0;
    Matrix3::from_diagonal(&Vector3::new(across, across, mass * ROD_RADIUS.powi(2) / 2.0))
}

/// Inertia of a point mass at `r` about the origin, kg m².
fn point_inertia(mass: f64, r: &Vector3<f64>) -> Matrix3<f64> {
    mass * (Matrix3::identity() * r.norm_squared() - r * r.transpose())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn model() -> Model {
        Model::new(&herd_common::config::Config::default().robot)
    }

    #[test]
    fn masses_and_inertias_are_those_of_the_tables() {
        let model = model();
        assert!((model.mass() - 13.6).abs() < 1e-12);
        let trunk = model.trunk_inertia.diagonal();
        assert!((trunk - Vector3::new(0.0170, 0.0615, 0.0687)).norm() < 1e-4, "{trunk}");
        let composite = model.composite(&model.nominal_stance());
        let expected = Vector3::new(0.040, 0.082, 0.088);
        assert!((composite.inertia.diagonal() - expected).amax() < 0.004, "{}", composite.inertia);
        assert!(composite.centre.y.abs() < 1e-12);
    }

    #[test]
    fn standing_height_is_the_leg_and_the_foot() {
        assert!((model().standing_height() - 0.182_65).abs() < 1e-4);
    }

    #[test]
    fn standing_forces_balance_on_a_slope() {
        let (model, slope) = (model(), 0.2);
        let force = |leg| model.standing_force(leg, slope);
        let total: Vector3<f64> = Leg::ALL.into_iter().map(force).sum();
        assert!((total.z - model.mass() * GRAVITY).abs() < 1e-9);
        // About the centre of mass, along and across the slope.
        let moment = |leg: Leg| {
            let (along, across) = (force(leg).z * slope.sin(), force(leg).z * slope.cos());
            across * model.geometry.hip(leg).x + along * model.standing_height()
        };
        assert!(Leg::ALL.into_iter().map(moment).sum::<f64>().abs() < 1e-9);
    }

    #[test]
    fn the_centre_moves_as_its_velocity_says() {
        const STEP: f64 = 1e-6;
        let model = model();
        let speeds = [0.3, -1.0, 2.0, 0.7].map(|x| Vector3::new(x, 2.0 * x, -x));
        let at = |time: f64| {
            let joints = std::array::from_fn::<_, 4, _>(|i| model.nominal(Leg::ALL[i]) + speeds[i] * time);
            Leg::ALL.map(|leg| model.geometry.posture(leg, &joints[leg.index()]))
        };
        let difference = (model.centre(&at(STEP)) - model.centre(&at(-STEP))) / (2.0 * STEP);
        assert!((difference - model.centre_velocity(&at(0.0), &speeds)).norm() < 1e-8);
    }
}
