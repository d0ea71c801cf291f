//! The robot and its ground as MJCF, MuJoCo's model format, with the numbers of our own simulation.
//!
//! Frames, masses, inertias, joints and contact groups are those of `sim::build`. Steps of 0.1 ms with RK4 make MuJoCo
//! the finer of the two.
//!
//! Contact is nearly rigid, as rapier's is: rapier's feet sink in by a spring of `m ω²` (m is the mass that the contact
//! feels), but that moves them only; later passes give them the velocities of rigid contact. MuJoCo's contact obeys
//! `(1 − d)/d · f/m + a = −b v − k r` with an impedance d. With `k = ω² (1 − d)/d` feet come to rest as deep as rapier's.
//! With d near one they take a second to, so that the spring gives next to no velocity, and b stops a foot as fast as the
//! steps resolve. Rapier's damping ratio only says how fast its feet sink and has no part here.

use super::model::KNEE_RADIUS;
use super::{GRAVITY, Leg, Model};
use herd_common::config::sim;
use nalgebra::{Matrix3, Vector3};
use std::f64::consts::TAU;
use std::fmt::Write as _;

/// Step of the integrator, s.
const TIMESTEP: f64 = 1e-4;
/// Impedance d of a contact: the nearer to one, the less a foot moves under load.
const IMPEDANCE: f64 = 0.99;
/// Time in which a landing foot stops, 1 / b, s: two steps, which RK4 resolves. Rapier's stops within one of its own.
const STOP_SECS: f64 = 2.0 * TIMESTEP;
/// Names of the legs, in their order.
const LEGS: [&str; 4] = ["fl", "fr", "rl", "rr"];
/// Names of a leg's links, and of the joints that carry them, with the joints' axes.
const LINKS: [(&str, &str); 3] = [("hip", "1 0 0"), ("thigh", "0 1 0"), ("calf", "0 1 0")];

/// The model on level ground, in the nominal stance as keyframe `nominal`; joints and motors in the order of `Leg::ALL`,
/// each hip roll, hip pitch, knee.
pub fn mjcf(model: &Model, config: &sim::Config) -> String {
    // MuJoCo divides what it is given by d.
    let (stiffness, damping) = ((TAU * config.contact_hz).powi(2) * (1.0 - IMPEDANCE), IMPEDANCE / STOP_SECS);
    let (friction, torque) = (config.ground_friction, model.torque_max);
    let legs: String = Leg::ALL.iter().map(|leg| leg_body(model, *leg)).collect();
    let motors: String = names().fold(String::new(), |mut motors, name| {
        let _ = writeln!(motors, r#"    <motor name="{name}" joint="{name}"/>"#);
        motors
    });
    let stance: Vec<f64> = model.nominal_stance().iter().flat_map(|leg| leg.iter().copied()).collect();
    let height = model.standing_height();
    format!(
        r#"<mujoco model="herd">
  <compiler angle="radian" autolimits="true" inertiafromgeom="false"/>
  <option timestep="{TIMESTEP}" integrator="RK4" gravity="0 0 {down}" cone="elliptic"/>
  <default>
    <geom contype="2" conaffinity="1" condim="3" friction="{friction} 0 0" mass="0"
          solref="{} {}" solimp="{IMPEDANCE} {IMPEDANCE} 0.001 0.5 2"/>
    <joint type="hinge" damping="{}" armature="{}"/>
    <motor gear="1" ctrlrange="-{torque} {torque}" forcerange="-{torque} {torque}"/>
  </default>
  <worldbody>
    <light pos="0 0 3"/>
    <geom name="ground" type="plane" size="0 0 1" contype="1" conaffinity="2"/>
    <body name="trunk" pos="0 0 {height}">
      <freejoint name="root"/>
      {}
      <geom name="trunk" type="box" size="{}"/>
{legs}    </body>
  </worldbody>
  <actuator>
{motors}  </actuator>
  <keyframe>
    <key name="nominal" qpos="0 0 {height} 1 0 0 0 {}"/>
  </keyframe>
</mujoco>
"#,
        -stiffness,
        -damping,
        model.joint_damping,
        model.joint_armature,
        inertial(model.trunk_mass, &Vector3::zeros(), &model.trunk_inertia),
        numbers((model.trunk_size / 2.0).as_slice()),
        numbers(&stance),
        down = -GRAVITY,
    )
}

/// The joints' names, in order.
fn names() -> impl Iterator<Item = String> {
    LEGS.iter().flat_map(|leg| LINKS.iter().map(move |(link, _)| format!("{leg}_{link}")))
}

/// Hip, thigh and calf, one within the other, with the spheres of knee and foot on the calf.
fn leg_body(model: &Model, leg: Leg) -> String {
    let (name, geometry) = (LEGS[leg.index()], &model.geometry);
    let anchors = [
        geometry.hip(leg),
        Vector3::new(0.0, leg.side() * geometry.hip_link, 0.0),
        Vector3::new(0.0, 0.0, -geometry.thigh),
    ];
    let mut out = String::new();
    for (i, ((link, axis), anchor)) in LINKS.iter().zip(&anchors).enumerate() {
        let indent = " ".repeat(6 + 2 * i);
        let mass = inertial(model.links[i].mass, &model.links[i].centre_in_frame(i, leg), &model.links[i].inertia);
        let _ = write!(
            out,
            "{indent}<body name=\"{name}_{link}\" pos=\"{}\">\n\
             {indent}  {mass}\n\
             {indent}  <joint name=\"{name}_{link}\" axis=\"{axis}\"/>\n",
            numbers(anchor.as_slice()),
        );
    }
    let foot = numbers(&[0.0, 0.0, -geometry.calf]);
    let _ = write!(
        out,
        "            <geom name=\"{name}_knee\" type=\"sphere\" size=\"{KNEE_RADIUS}\"/>\n\
         \x20           <geom name=\"{name}_foot\" type=\"sphere\" size=\"{}\" pos=\"{foot}\"/>\n",
        model.foot_radius,
    );
    for i in (0..LINKS.len()).rev() {
        let _ = writeln!(out, "{}</body>", " ".repeat(6 + 2 * i));
    }
    out
}

fn inertial(mass: f64, centre: &Vector3<f64>, inertia: &Matrix3<f64>) -> String {
    let i = inertia;
    let full = [i[(0, 0)], i[(1, 1)], i[(2, 2)], i[(0, 1)], i[(0, 2)], i[(1, 2)]];
    let (centre, full) = (numbers(centre.as_slice()), numbers(&full));
    format!(r#"<inertial pos="{centre}" mass="{mass}" fullinertia="{full}"/>"#)
}

/// Numbers as attributes hold them: the shortest text that gives the same f64 back.
fn numbers(values: &[f64]) -> String {
    values
        .iter()
        .map(|value| if *value == 0.0 { "0".to_owned() } else { value.to_string() })
        .collect::<Vec<_>>()
        .join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use herd_common::config::Config;
    use nalgebra::Rotation3;
    use roxmltree::{Document, Node};

    fn model() -> (Model, String) {
        let config = Config::default();
        let model = Model::new(&config.robot);
        let text = mjcf(&model, &config.sim);
        (model, text)
    }

    fn list(node: Node<'_, '_>, attribute: &str) -> Vec<f64> {
        let text = node.attribute(attribute).unwrap_or_default();
        text.split_whitespace().map(|number| number.parse().expect("a number")).collect()
    }

    fn vector(node: Node<'_, '_>, attribute: &str) -> Vector3<f64> {
        let numbers = list(node, attribute);
        if numbers.is_empty() { Vector3::zeros() } else { Vector3::from_column_slice(&numbers) }
    }

    fn all<'a>(document: &'a Document<'_>, tag: &'a str) -> Vec<Node<'a, 'a>> {
        document.descendants().filter(|node| node.has_tag_name(tag)).collect()
    }

    /// Where a geom is in the trunk's frame with its joints at the angles that `angle` gives, as MJCF nests frames.
    fn place(geom: Node<'_, '_>, angle: &dyn Fn(&str) -> f64) -> Vector3<f64> {
        let mut point = vector(geom, "pos");
        let bodies =
            geom.ancestors().filter(|node| node.has_tag_name("body") && node.attribute("name") != Some("trunk"));
        for body in bodies {
            let joint = body.children().find(|node| node.has_tag_name("joint")).expect("a joint");
            let turn = vector(joint, "axis") * angle(joint.attribute("name").expect("a name"));
            point = vector(body, "pos") + Rotation3::from_scaled_axis(turn) * point;
        }
        point
    }

    #[test]
    fn masses_add_up_to_the_robots() {
        let (model, text) = model();
        let document = Document::parse(&text).expect("well-formed");
        let inertials = all(&document, "inertial");
        assert_eq!(inertials.len(), 13);
        let mass: f64 = inertials.iter().map(|node| list(*node, "mass")[0]).sum();
        assert!((mass - model.mass()).abs() < 1e-12, "{mass}");
        let trunk = list(inertials[0], "fullinertia");
        assert_eq!(trunk[..3], model.trunk_inertia.diagonal().as_slice()[..]);
    }

    #[test]
    fn feet_and_centres_of_mass_are_where_our_kinematics_has_them() {
        let (model, text) = model();
        let document = Document::parse(&text).expect("well-formed");
        let joints: Vec<String> = names().collect();
        let angle = |name: &str| {
            let i = joints.iter().position(|joint| joint == name).expect("a joint of ours");
            [0.2, 0.7, -1.4][i % 3] + 0.05 * i as f64
        };
        for leg in Leg::ALL {
            let name = LEGS[leg.index()];
            let q = Vector3::from_iterator(LINKS.iter().map(|(link, _)| angle(&format!("{name}_{link}"))));
            let posture = model.geometry.posture(leg, &q);
            let foot = document.descendants().find(|node| node.attribute("name") == Some(&format!("{name}_foot")));
            let foot = place(foot.expect("a foot"), &angle);
            assert!((foot - model.geometry.foot_in_body(leg, &q)).norm() < 1e-12, "{name} {foot}");
            for (link, (part, _)) in model.links.iter().zip(LINKS) {
                let named = format!("{name}_{part}");
                let mut bodies = all(&document, "body").into_iter();
                let body = bodies.rfind(|node| node.attribute("name") == Some(&named));
                let inertial = body.and_then(|node| node.children().find(|node| node.has_tag_name("inertial")));
                let centre = place(inertial.expect("an inertial"), &angle);
                assert!((centre - posture.position(link.centre)).norm() < 1e-12, "{name} {part} {centre}");
            }
        }
    }

    #[test]
    fn joints_motors_and_stance_come_in_our_order() {
        let (model, text) = model();
        let document = Document::parse(&text).expect("well-formed");
        let named = |tag: &str| -> Vec<String> {
            let named = all(&document, tag).into_iter().filter_map(|node| node.attribute("name").map(str::to_owned));
            named.collect()
        };
        assert_eq!(named("joint"), names().collect::<Vec<_>>());
        assert_eq!(named("motor"), named("joint"));
        let stance = list(all(&document, "key")[0], "qpos");
        assert_eq!(stance.len(), 19);
        assert_eq!((stance[2], stance[8]), (model.standing_height(), model.nominal(Leg::FrontLeft)[1]));
    }

    #[test]
    fn a_foot_sinks_as_far_as_rapiers_and_stops_as_fast_as_the_steps_resolve() {
        let config = Config::load(None, &["sim.contact_hz=60".to_owned()]).expect("valid");
        let text = mjcf(&Model::new(&config.robot), &config.sim);
        let document = Document::parse(&text).expect("well-formed");
        let geom = document.descendants().find(|node| node.has_attribute("solref")).expect("the default");
        let (law, impedance) = (list(geom, "solref"), list(geom, "solimp")[0]);
        // At rest and for m = 1, (1 − d)/d f = −k r, where k and b are what MuJoCo makes of the text.
        let (k, b) = (-law[0] / impedance, -law[1] / impedance);
        let force_per_depth = k * impedance / (1.0 - impedance);
        assert!((force_per_depth / (TAU * 60.0).powi(2) - 1.0).abs() < 1e-9, "{force_per_depth}");
        let step = list(all(&document, "option")[0], "timestep")[0];
        assert!((1.0 / b / step - 2.0).abs() < 1e-9, "{b}");
    }

    #[test]
    fn only_robot_and_ground_touch() {
        let (_, text) = model();
        let document = Document::parse(&text).expect("well-formed");
        let mask = |node: Node<'_, '_>, name| node.attribute(name).map(|bits| bits.parse::<u32>().expect("bits"));
        let geoms = all(&document, "geom");
        let robot = geoms.iter().find(|node| node.attribute("name").is_none()).expect("the default");
        let ground = geoms.iter().find(|node| node.attribute("name") == Some("ground")).expect("the ground");
        let touch = |a: Node<'_, '_>, b: Node<'_, '_>| {
            let one_way = |a, b| mask(a, "contype").zip(mask(b, "conaffinity")).is_some_and(|(x, y)| x & y != 0);
            one_way(a, b) || one_way(b, a)
        };
        assert!(touch(*robot, *ground) && !touch(*robot, *robot));
        let own = geoms.iter().filter(|node| node.has_attribute("contype")).count();
        assert_eq!(own, 2, "every other geom has the default");
    }
}
