//! Figure 4: robots drawn from the side, as a stroboscope and as a film would show them.
//!
//! Seen from the robot's right, so x goes to the right of the page; right legs are near, left legs grey behind them.

use super::play::FRAME_SECS;
use crate::report::chart::{Colour, WIDTH, sheet};
use crate::report::svg::text;
use herd_actor::film::{Frame, Point};
use std::fmt::Write;

/// One robot's strip.
pub(super) struct Strip<'a> {
    /// Above it.
    pub(super) name: String,
    /// Its pictures, evenly in time.
    pub(super) frames: &'a [Frame],
    /// Its colour.
    pub(super) colour: Colour,
}

// Sizes in pixels of the drawing.
const LEFT: f64 = 16.0;
const NAME: f64 = 30.0;
const STROBE: f64 = 128.0;
const FILM: f64 = 100.0;
const STRIP: f64 = NAME + STROBE + FILM;
/// Pixels of a metre in the stroboscope, and x of its left edge, m.
const STROBE_SCALE: f64 = 290.0;
const STROBE_FROM: f64 = -0.36;
/// Time between its poses, s, and how many there are at most.
const STROBE_SECS: f64 = 0.2;
const STROBE_POSES: usize = 8;
/// Room for a label of a pose, pixels.
const LABEL: f64 = 44.0;
/// Cells of the film, time between them, s, and when it begins if the episode lasts.
const CELLS: usize = 8;
const CELL_SECS: f64 = 0.04;
const FILM_FROM_SECS: f64 = 5.0;
/// Pixels of a metre in the film.
const FILM_SCALE: f64 = 200.0;
/// Legs in the order of drawing: the left ones are behind.
const FAR: [usize; 2] = [0, 2];
const NEAR: [usize; 2] = [1, 3];
/// Radius of a foot, m.
const FOOT: f64 = 0.011;

/// The drawing of these strips, one below the other.
pub(super) fn draw(strips: &[Strip<'_>]) -> String {
    let mut body = String::new();
    for (index, strip) in strips.iter().enumerate() {
        let top = index as f64 * STRIP;
        let _ = writeln!(body, "<g font-weight=\"bold\">{}</g>", text((LEFT, top + 22.0), "start", &strip.name));
        body += &strip.stroboscope(top + NAME);
        body += &strip.film(top + NAME + STROBE);
    }
    sheet(STRIP * strips.len() as f64 + 8.0, &body)
}

/// From metres to pixels.
#[derive(Clone, Copy)]
struct View {
    scale: f64,
    /// World x at `left`, m.
    from: f64,
    left: f64,
    /// Pixels of the ground.
    ground: f64,
}

impl View {
    fn at(&self, point: &Point) -> (f64, f64) {
        (self.x(point[0]), self.ground - self.scale * point[2])
    }

    fn x(&self, x: f64) -> f64 {
        self.left + self.scale * (x - self.from)
    }

    fn path(&self, points: &[Point]) -> String {
        let at = points.iter().map(|point| self.at(point)).map(|(x, y)| format!("{x:.1} {y:.1}"));
        format!("M{}", at.collect::<Vec<_>>().join("L"))
    }
}

impl Strip<'_> {
    fn stroboscope(&self, top: f64) -> String {
        let view = View { scale: STROBE_SCALE, from: STROBE_FROM, left: LEFT, ground: top + STROBE - 34.0 };
        let right = WIDTH - LEFT;
        let to = STROBE_FROM + (right - LEFT) / STROBE_SCALE;
        let mut svg = ground(view.ground, (LEFT, right));
        for half_metre in 0..4 {
            let (x, y) = (view.x(f64::from(half_metre) * 0.5), view.ground);
            let _ = writeln!(svg, "<path class=\"grid\" d=\"M{x:.1} {y}v6\" stroke=\"#888\"/>");
            svg += &text((x, y + 20.0), "middle", &format!("{:.1} m", f64::from(half_metre) * 0.5));
        }
        let poses: Vec<&Frame> = self.every(0.0, STROBE_SECS, STROBE_POSES);
        let poses: Vec<&Frame> = poses.into_iter().take_while(|frame| seen(frame, (STROBE_FROM, to))).collect();
        let mut label_from = f64::MIN;
        for (index, frame) in poses.iter().enumerate() {
            let share = (index + 1) as f64 / poses.len() as f64;
            let _ = writeln!(svg, "<g opacity=\"{:.2}\">{}</g>", 0.2 + 0.8 * share.powi(2), self.pose(&view, frame));
            let x = view.x(frame.centre[0]);
            if (x - label_from).abs() > LABEL {
                svg += &text((x, top + 12.0), "middle", &format!("{:.1} s", frame.secs));
                label_from = x;
            }
        }
        if let (Some(last), true) = (poses.last(), label_from > f64::MIN) {
            let x = view.x(last.centre[0]);
            if (x - label_from).abs() <= LABEL && poses.len() > 1 && x != label_from {
                let y = top + 12.0;
                svg += &text((x.max(label_from) + LABEL, y), "middle", &format!("to {:.1} s", last.secs));
            }
        }
        svg
    }

    fn film(&self, top: f64) -> String {
        let (width, ground_y) = ((WIDTH - 2.0 * LEFT) / CELLS as f64, top + FILM - 34.0);
        let end = self.frames.last().map_or(0.0, |frame| frame.secs);
        let long = end >= CELL_SECS * (CELLS - 1) as f64;
        // An episode that is soon over is shown picture by picture.
        let step = if long { CELL_SECS } else { FRAME_SECS };
        let length = step * (CELLS - 1) as f64;
        let mut svg = String::new();
        for (index, frame) in self.every(FILM_FROM_SECS.min((end - length).max(0.0)), step, CELLS).iter().enumerate() {
            let left = LEFT + width * index as f64;
            let from = frame.centre[0] - width / 2.0 / FILM_SCALE;
            let view = View { scale: FILM_SCALE, from, left, ground: ground_y };
            svg += &ground(ground_y, (left + 1.0, left + width - 1.0));
            let to = from + width / FILM_SCALE;
            for tenth in (from * 10.0).ceil() as i64..=(to * 10.0).floor() as i64 {
                let x = view.x(tenth as f64 / 10.0);
                let _ = writeln!(svg, "<path class=\"grid\" d=\"M{x:.1} {ground_y}v5\" stroke=\"#888\"/>");
            }
            svg += &self.pose(&view, frame);
            svg += &text((left + width / 2.0, ground_y + 20.0), "middle", &format!("{:.2} s", frame.secs));
        }
        svg
    }

    /// At most `count` pictures from `start` on, `step` seconds apart.
    fn every(&self, start: f64, step: f64, count: usize) -> Vec<&Frame> {
        let at = |index: usize| {
            let secs = start + step * index as f64 - 1e-6;
            self.frames.get(self.frames.partition_point(|frame| frame.secs < secs))
        };
        (0..count).map_while(at).collect()
    }

    fn pose(&self, view: &View, frame: &Frame) -> String {
        let (colour, name) = (self.colour.hex(), format!("{:?}", self.colour).to_lowercase());
        let mut svg = String::new();
        for leg in FAR {
            svg += &leg_of(view, frame, leg, ("#9aa1ab", "far"));
        }
        let _ = writeln!(
            svg,
            "<path class=\"trunk-{name}\" d=\"{}Z\" fill=\"{colour}\" fill-opacity=\"0.3\" stroke=\"{colour}\" \
             stroke-width=\"1.4\" stroke-linejoin=\"round\"/>",
            view.path(&frame.trunk)
        );
        for leg in NEAR {
            svg += &leg_of(view, frame, leg, (colour, &name));
        }
        svg
    }
}

/// One leg in a colour, given with the name of its class.
fn leg_of(view: &View, frame: &Frame, leg: usize, (colour, name): (&str, &str)) -> String {
    let [hip, top, knee, foot] = frame.legs[leg];
    let (x, y) = view.at(&foot);
    let fill = if frame.down[leg] { colour } else { "#fff" };
    let class = if frame.down[leg] { format!("foot-{name}") } else { format!("stroke-{name} open") };
    format!(
        "<path class=\"stroke-{name}\" d=\"{}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"2.6\" \
         stroke-linecap=\"round\" stroke-linejoin=\"round\"/>\n\
         <circle class=\"{class}\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{:.1}\" fill=\"{fill}\" stroke=\"{colour}\" \
         stroke-width=\"1.3\"/>\n",
        view.path(&[hip, top, knee, foot]),
        FOOT * view.scale
    )
}

fn ground(y: f64, (left, right): (f64, f64)) -> String {
    format!("<path class=\"ground\" d=\"M{left:.1} {y}H{right:.1}\" stroke=\"#555\" stroke-width=\"1.2\"/>\n")
}

/// True when the whole trunk lies between these x.
fn seen(frame: &Frame, (from, to): (f64, f64)) -> bool {
    frame.trunk.iter().all(|corner| (from..=to).contains(&corner[0]))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(secs: f64, x: f64) -> Frame {
        let corner = |dx: f64, z: f64| [x + dx, 0.0, z];
        let leg = [corner(0.0, 0.18), corner(0.0, 0.18), corner(-0.05, 0.09), corner(0.0, 0.01)];
        let trunk = [corner(0.12, 0.2), corner(0.12, 0.14), corner(-0.12, 0.14), corner(-0.12, 0.2)];
        Frame {
            secs,
            centre: corner(0.0, 0.17),
            angles: [0.0; 3],
            trunk,
            legs: [leg; 4],
            down: [true, false, false, true],
        }
    }

    fn drawn(speed: f64, frames: usize) -> String {
        let frames: Vec<Frame> = (0..frames).map(|i| frame(i as f64 * 0.02, speed * i as f64 * 0.02)).collect();
        draw(&[Strip { name: "robot".into(), frames: &frames, colour: Colour::Blue }])
    }

    #[test]
    fn a_robot_that_walks_shows_poses_while_they_fit() {
        // 1.6 m/s: 0.32 m between two poses, of which six fit; then eight cells.
        let svg = drawn(1.6, 500);
        assert_eq!(svg.matches("trunk-blue").count(), 6 + CELLS, "{svg}");
        assert!(svg.contains(">1.0 s<") && svg.contains(">5.00 s<") && svg.contains(">5.28 s<"), "{svg}");
    }

    #[test]
    fn a_robot_that_stays_has_one_label_and_one_that_falls_shows_its_end() {
        let svg = drawn(0.01, 30);
        // 0.58 s: poses at 0, 0.2, 0.4; the film is the last 0.28 s.
        assert_eq!(svg.matches("trunk-blue").count(), 3 + CELLS, "{svg}");
        assert!(svg.contains(">0.0 s<") && svg.contains(">to 0.4 s<") && !svg.contains(">0.2 s<"), "{svg}");
        assert!(svg.contains(">0.58 s<"), "{svg}");
        assert!(!drawn(0.0, 0).contains("trunk"), "nobody to draw");
    }

    #[test]
    fn feet_tell_whether_they_carry() {
        let svg = drawn(0.0, 1);
        let (full, open) = (svg.matches("foot-").count(), svg.matches(" open\"").count());
        assert_eq!(full, open, "two and two: {svg}");
        assert!(full > 0);
    }
}
