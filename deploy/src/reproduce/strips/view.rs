//! From a robot in the world to a drawing: seen from its right or from behind, on the ground that it walks on.

use super::Strip;
use crate::reproduce::curves;
use herd_actor::film::{Frame, Point};
use std::fmt::Write;

/// Where the eye is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::reproduce) enum Eye {
    /// At the robot's right: x goes to the right of the page; left legs are behind.
    Right,
    /// Behind it: y goes to the left of the page; front legs are behind.
    Behind,
}

/// From metres to pixels.
#[derive(Clone, Copy)]
pub(super) struct View {
    pub(super) eye: Eye,
    /// Pixels of a metre.
    pub(super) scale: f64,
    /// What is at `left`, m to the right of the origin.
    pub(super) from: f64,
    pub(super) left: f64,
    /// Pixels of z = 0.
    pub(super) ground: f64,
}

/// Radius of a foot, m.
const FOOT: f64 = 0.011;
/// Legs that the others hide, grey.
const FAR_COLOUR: (&str, &str) = ("#9aa1ab", "far");

impl Eye {
    /// How far to the right of the origin this point is seen, m.
    pub(super) fn across(self, point: &Point) -> f64 {
        match self {
            Self::Right => point[0],
            Self::Behind => -point[1],
        }
    }

    /// The trunk's outline.
    pub(super) fn trunk(self, frame: &Frame) -> &[Point; 4] {
        match self {
            Self::Right => &frame.trunk,
            Self::Behind => &frame.across,
        }
    }

    /// Legs behind the trunk, legs before it.
    fn legs(self) -> [[usize; 2]; 2] {
        match self {
            Self::Right => [[0, 2], [1, 3]],
            Self::Behind => [[0, 1], [2, 3]],
        }
    }
}

impl View {
    pub(super) fn at(&self, point: &Point) -> (f64, f64) {
        (self.x(self.eye.across(point)), self.ground - self.scale * point[2])
    }

    pub(super) fn x(&self, across: f64) -> f64 {
        self.left + self.scale * (across - self.from)
    }

    fn path(&self, points: &[Point]) -> String {
        let at = points.iter().map(|point| self.at(point)).map(|(x, y)| format!("{x:.1} {y:.1}"));
        format!("M{}", at.collect::<Vec<_>>().join("L"))
    }

    /// The ground of a strip between these pixels.
    pub(super) fn ground_of(&self, strip: &Strip<'_>, (left, right): (f64, f64)) -> String {
        let (from, to) = (self.from + (left - self.left) / self.scale, self.from + (right - self.left) / self.scale);
        let inside = strip.ground.iter().filter(|(x, _)| self.eye == Eye::Right && *x > from && *x < to);
        let ends = [from, to].map(|x| (x, strip.height(self.eye, x)));
        let points = [ends[0]].into_iter().chain(inside.copied()).chain([ends[1]]);
        let points: Vec<String> =
            points.map(|(x, z)| format!("{:.1} {:.1}", self.x(x), self.ground - self.scale * z)).collect();
        let path = points.join("L");
        format!("<path class=\"ground\" d=\"M{path}\" fill=\"none\" stroke=\"#555\" stroke-width=\"1.2\"/>\n")
    }

    /// The robot of a picture, in a colour of this value and name.
    pub(super) fn pose(&self, frame: &Frame, (colour, name): (&str, &str)) -> String {
        let [far, near] = self.eye.legs();
        let mut svg: String = far.into_iter().map(|leg| self.leg(frame, leg, FAR_COLOUR)).collect();
        let _ = writeln!(
            svg,
            "<path class=\"trunk-{name}\" d=\"{}Z\" fill=\"{colour}\" fill-opacity=\"0.3\" stroke=\"{colour}\" \
             stroke-width=\"1.4\" stroke-linejoin=\"round\"/>",
            self.path(self.eye.trunk(frame))
        );
        svg + &near.into_iter().map(|leg| self.leg(frame, leg, (colour, name))).collect::<String>()
    }

    fn leg(&self, frame: &Frame, leg: usize, (colour, name): (&str, &str)) -> String {
        let [hip, top, knee, foot] = frame.legs[leg];
        let (x, y) = self.at(&foot);
        let fill = if frame.down[leg] { colour } else { "#fff" };
        let class = if frame.down[leg] { format!("foot-{name}") } else { format!("stroke-{name} open") };
        format!(
            "<path class=\"stroke-{name}\" d=\"{}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"2.6\" \
             stroke-linecap=\"round\" stroke-linejoin=\"round\"/>\n\
             <circle class=\"{class}\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{:.1}\" fill=\"{fill}\" stroke=\"{colour}\" \
             stroke-width=\"1.3\"/>\n",
            self.path(&[hip, top, knee, foot]),
            FOOT * self.scale
        )
    }
}

impl Strip<'_> {
    /// Height of the ground at this x, m; seen from behind it is that at y = 0.
    pub(super) fn height(&self, eye: Eye, x: f64) -> f64 {
        if self.ground.is_empty() || eye == Eye::Behind { 0.0 } else { curves::at(self.ground, x) }
    }
}
