//! Builds the robot and the ground in a fresh rapier world.
//!
//! Joints are those of a multibody (reduced coordinates): rotor inertia exists only there, and 500 Hz torque control
//! of light calves rings without it. The root frame lies in the trunk's centre of mass, since rapier integrates the
//! root's origin with the velocity of its centre of mass. Rapier's damping of every angular degree of freedom, the
//! free root's included, is replaced by that of the robot's joints. Legs do not collide with one another.

use super::convert::{matrix_to_sim, rotation_to_sim, vector_to_sim};
use super::terrain;
use super::world::{Site, Start};
use crate::robot::{KNEE_RADIUS, Leg, Link, Model, box_inertia};
use herd_common::config::sim;
use nalgebra::{Matrix3, Vector3};
use rapier3d::prelude::*;

/// Edges of the payload, a box of even density that stands on the trunk, m; guess: a sandbag of a few kilograms.
const PAYLOAD_SIZE: [f64; 3] = [0.12, 0.08, 0.06];
/// Passes over the contacts that end a solver step, friction included; rapier's default is one. With one, what a foot gets
/// depends on the order of the feet, the more so the longer the step; more than these change little (docs/accuracy.md).
const RELAXATIONS: usize = 4;
/// Degrees of freedom of the free root.
pub(super) const ROOT_DOFS: usize = 6;

/// The handles of a built robot.
pub(super) struct Handles {
    /// The trunk's body.
    pub(super) trunk: RigidBodyHandle,
    /// Hip, thigh and calf of each leg.
    pub(super) links: [[RigidBodyHandle; 3]; 4],
    /// The joint that ends in each link.
    pub(super) joints: [[MultibodyJointHandle; 3]; 4],
    /// The foot spheres.
    pub(super) feet: [ColliderHandle; 4],
    /// The trunk box.
    pub(super) trunk_box: ColliderHandle,
    /// The knee spheres.
    pub(super) knees: [ColliderHandle; 4],
}

/// A world with this ground, gravity along −z and rapier's settings as configured.
pub(super) fn world(config: &sim::Config, site: &Site) -> PhysicsWorld {
    let mut world = PhysicsWorld::new();
    world.gravity = Vector::new(0.0, 0.0, -crate::robot::GRAVITY as f32);
    let parameters = &mut world.integration_parameters;
    parameters.dt = config.tick_secs as f32;
    parameters.num_solver_iterations = config.substeps;
    parameters.num_internal_stabilization_iterations = RELAXATIONS;
    parameters.max_ccd_substeps = 0;
    // Recycled contacts would reuse a foot's contact until it has moved by 5 cm.
    parameters.contact_recycling = false;
    parameters.static_contact_softness =
        SpringCoefficients::new(config.contact_hz as f32, config.contact_damping_ratio as f32);
    for ground in terrain::colliders(&site.ground) {
        let ground = ground.friction(friction(config, site)).collision_groups(groups(Group::GROUP_1, Group::GROUP_2));
        world.insert_collider(ground, None);
    }
    world
}

/// Puts the robot into the world with the pose and angles of `start`, at rest.
pub(super) fn robot(
    world: &mut PhysicsWorld,
    model: &Model,
    config: &sim::Config,
    site: &Site,
    start: &Start,
) -> Handles {
    let trunk = RigidBodyBuilder::dynamic()
        .translation(vector_to_sim(&start.position))
        .rotation(rotation_to_sim(&start.rotation).to_scaled_axis())
        .can_sleep(false)
        .additional_mass_properties(properties(model.trunk_mass, &Vector3::zeros(), &model.trunk_inertia));
    let trunk = world.insert_body(trunk);
    let size = model.trunk_size / 2.0;
    let trunk_box = ColliderBuilder::cuboid(size.x as f32, size.y as f32, size.z as f32);
    let friction = friction(config, site);
    let trunk_box = world.insert_collider(robot_collider(trunk_box, friction), Some(trunk));
    let mut handles = Handles {
        trunk,
        links: [[trunk; 3]; 4],
        joints: [[MultibodyJointHandle::invalid(); 3]; 4],
        feet: [trunk_box; 4],
        trunk_box,
        knees: [trunk_box; 4],
    };
    for leg in Leg::ALL {
        add_leg(world, model, friction, leg, &mut handles);
    }
    if site.payload_kg > 0.0 {
        add_payload(world, model, site.payload_kg, trunk);
    }
    pose(world, model, &handles, start);
    handles
}

/// Adds hip, thigh and calf, parents before children.
fn add_leg(world: &mut PhysicsWorld, model: &Model, friction: f32, leg: Leg, handles: &mut Handles) {
    let geometry = &model.geometry;
    let anchors = [
        geometry.hip(leg),
        Vector3::new(0.0, leg.side() * geometry.hip_link, 0.0),
        Vector3::new(0.0, 0.0, -geometry.thigh),
    ];
    let axes = [Vector::X, Vector::Y, Vector::Y];
    let mut parent = handles.trunk;
    for i in 0..3 {
        let body = RigidBodyBuilder::dynamic().can_sleep(false).additional_mass_properties(link_properties(
            &model.links[i],
            i,
            leg,
        ));
        let body = world.insert_body(body);
        let joint =
            RevoluteJointBuilder::new(axes[i]).local_anchor1(vector_to_sim(&anchors[i])).contacts_enabled(false);
        let joint = world.insert_multibody_joint(parent, body, joint).expect("a tree has no cycle");
        handles.links[leg.index()][i] = body;
        handles.joints[leg.index()][i] = joint;
        parent = body;
    }
    let ball = |radius: f32| robot_collider(ColliderBuilder::ball(radius), friction);
    let foot = ball(model.foot_radius as f32).translation(Vector::new(0.0, 0.0, -geometry.calf as f32));
    handles.feet[leg.index()] = world.insert_collider(foot, Some(parent));
    handles.knees[leg.index()] = world.insert_collider(ball(KNEE_RADIUS as f32), Some(parent));
}

/// Fixes a box to the top of the trunk. It is a link of its own: the root's frame has to stay in its centre of mass.
fn add_payload(world: &mut PhysicsWorld, model: &Model, mass: f64, trunk: RigidBodyHandle) {
    let size = Vector3::from(PAYLOAD_SIZE);
    let body = RigidBodyBuilder::dynamic().can_sleep(false).additional_mass_properties(properties(
        mass,
        &Vector3::zeros(),
        &box_inertia(mass, &size),
    ));
    let body = world.insert_body(body);
    let place = Vector3::new(0.0, 0.0, f64::midpoint(model.trunk_size.z, size.z));
    let joint = FixedJointBuilder::new().local_anchor1(vector_to_sim(&place)).contacts_enabled(false);
    world.insert_multibody_joint(trunk, body, joint).expect("a tree has no cycle");
}

/// Sets damping, rotor inertia and joint angles once the tree is complete.
fn pose(world: &mut PhysicsWorld, model: &Model, handles: &Handles, start: &Start) {
    let any_joint = handles.joints[0][0];
    let (multibody, _) = world.multibody_joints.get_mut(any_joint).expect("just inserted");
    multibody.set_self_contacts_enabled(false);
    // The root becomes free, with its six degrees of freedom, at the first forward kinematics.
    multibody.forward_kinematics(&world.bodies, true);
    multibody.damping_mut().fill(0.0);
    let mut displacement = vec![0.0_f32; multibody.ndofs()];
    for leg in Leg::ALL {
        for i in 0..3 {
            let dof = dof(world, handles.joints[leg.index()][i]);
            let (multibody, _) = world.multibody_joints.get_mut(any_joint).expect("just inserted");
            multibody.damping_mut()[dof] = model.joint_damping as f32;
            multibody.armature_mut()[dof] = model.joint_armature as f32;
            displacement[dof] = start.joints[leg.index()][i] as f32;
        }
    }
    let (multibody, _) = world.multibody_joints.get_mut(any_joint).expect("just inserted");
    multibody.apply_displacements(&displacement);
    multibody.forward_kinematics(&world.bodies, true);
    multibody.update_rigid_bodies(&mut world.bodies, true);
}

/// Index of a joint in the generalised coordinates.
pub(super) fn dof(world: &PhysicsWorld, joint: MultibodyJointHandle) -> usize {
    let (multibody, id) = world.multibody_joints.get(joint).expect("the robot stays in the world");
    multibody.link(id).expect("the joint's own link").assembly_id()
}

/// μ between the robot and the ground.
fn friction(config: &sim::Config, site: &Site) -> f32 {
    (config.ground_friction * site.friction_factor) as f32
}

fn robot_collider(collider: ColliderBuilder, friction: f32) -> ColliderBuilder {
    // Densities of zero: the bodies carry exact mass properties. Friction is the ground's own, whatever the average.
    collider.density(0.0).friction(friction).collision_groups(groups(Group::GROUP_2, Group::GROUP_1))
}

fn groups(member: Group, with: Group) -> InteractionGroups {
    InteractionGroups::new(member, with, InteractionTestMode::And)
}

fn properties(mass: f64, centre: &Vector3<f64>, inertia: &Matrix3<f64>) -> MassProperties {
    MassProperties::with_inertia_matrix(vector_to_sim(centre), mass as f32, matrix_to_sim(inertia))
}

/// Mass properties of a link in its own frame, whose origin is the joint that carries it.
fn link_properties(link: &Link, i: usize, leg: Leg) -> MassProperties {
    properties(link.mass, &link.centre_in_frame(i, leg), &link.inertia)
}
