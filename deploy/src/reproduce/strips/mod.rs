//! Robots drawn from the side or from behind, as a stroboscope and as a film would show them.

mod view;

use super::play::FRAME_SECS;
use crate::report::chart::{Colour, WIDTH};
use crate::report::svg::{sheet, text};
use herd_actor::film::Frame;
use std::fmt::Write;
pub(super) use view::Eye;
use view::View;

/// One robot's strip.
pub(super) struct Strip<'a> {
    /// Above it.
    pub(super) name: String,
    /// Its pictures, evenly in time.
    pub(super) frames: &'a [Frame],
    /// Its colour.
    pub(super) colour: Colour,
    /// Height (m) of the ground along x (m), straight between these; level if empty.
    pub(super) ground: &'a [(f64, f64)],
    /// From where it is seen; only from the right there is a stroboscope.
    pub(super) eye: Eye,
    /// When its pictures are shown.
    pub(super) pace: Pace,
    /// A push to the left: when it begins and how long it lasts, s.
    pub(super) push: Option<(f64, f64)>,
}

/// Times, s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Pace {
    /// Between two poses of the stroboscope.
    pub(super) strobe: f64,
    /// When the film begins, if the episode lasts.
    pub(super) film_from: f64,
    /// Between two pictures of the film.
    pub(super) film: f64,
}

impl Pace {
    /// For gaits of 1.5 m/s and more.
    pub(super) const FAST: Self = Self { strobe: 0.2, film_from: 5.0, film: 0.04 };
}

// Sizes in pixels of the drawing.
const LEFT: f64 = 16.0;
const NAME: f64 = 30.0;
const STROBE: f64 = 128.0;
const FILM: f64 = 100.0;
/// Height above its ground (m) of a robot that fits into these; one that leaps takes more room.
const STROBE_HEADROOM: f64 = 0.26;
const FILM_HEADROOM: f64 = 0.36;
/// Below a ground, for ticks and what is told there.
const FOOT: f64 = 34.0;
/// Pixels of a metre in the stroboscope, and x of its left edge, m.
const STROBE_SCALE: f64 = 290.0;
const STROBE_FROM: f64 = -0.36;
/// Most poses of a stroboscope.
const STROBE_POSES: usize = 8;
/// Room for a label of a pose, pixels.
const LABEL: f64 = 44.0;
/// Cells of the film.
const CELLS: usize = 8;
const CELL: f64 = (WIDTH - 2.0 * LEFT) / CELLS as f64;
/// Pixels of a metre in the film, from the right and from behind, where legs spread when pushed.
const FILM_SCALE: f64 = 170.0;
const BEHIND_SCALE: f64 = 150.0;
/// The camera of the film goes by the ground around the trunk, so that a step does not jolt it.
const LEVELS: i32 = 4;
/// Where the arrow of a push begins and ends, m to the right of the trunk's middle.
const ARROW: [f64; 2] = [0.17, 0.09];

/// The drawing of these strips, one below the other.
pub(super) fn draw(strips: &[Strip<'_>]) -> String {
    let (mut body, mut top) = (String::new(), 0.0);
    for strip in strips {
        let _ = writeln!(body, "<g font-weight=\"bold\">{}</g>", text((LEFT, top + 22.0), "start", &strip.name));
        top += NAME;
        if strip.eye == Eye::Right {
            body += &strip.stroboscope(top);
            top += strip.stroboscope_height();
        }
        body += &strip.film(top);
        top += strip.film_height();
    }
    sheet((WIDTH, top + 8.0), &body)
}

impl Strip<'_> {
    /// The lowest and highest of the ground in the stroboscope, m.
    fn relief(&self) -> (f64, f64) {
        let inside = self.ground.iter().filter(|(x, _)| (STROBE_FROM..=strobe_to()).contains(x)).map(|(_, z)| *z);
        let ends = [STROBE_FROM, strobe_to()].map(|x| self.height(self.eye, x));
        inside.chain(ends).fold((0.0, 0.0), |(low, high), z| (low.min(z), high.max(z)))
    }

    fn stroboscope_height(&self) -> f64 {
        let (low, high) = self.relief();
        let top = self.poses().into_iter().map(highest).fold(high, f64::max);
        STROBE + STROBE_SCALE * (high - low + (top - high - STROBE_HEADROOM).max(0.0))
    }

    /// Those that the stroboscope shows.
    fn poses(&self) -> Vec<&Frame> {
        self.every(0.0, self.pace.strobe, STROBE_POSES).into_iter().take_while(|frame| seen(frame)).collect()
    }

    fn stroboscope(&self, top: f64) -> String {
        let bottom = top + self.stroboscope_height() - FOOT;
        let ground = bottom + STROBE_SCALE * self.relief().0;
        let view = View { eye: self.eye, scale: STROBE_SCALE, from: STROBE_FROM, left: LEFT, ground };
        let mut svg = view.ground_of(self, (LEFT, WIDTH - LEFT));
        for half_metre in 0..4 {
            let x = f64::from(half_metre) * 0.5;
            let (x, y) = view.at(&[x, 0.0, self.height(self.eye, x)]);
            let _ = writeln!(svg, "<path class=\"grid\" d=\"M{x:.1} {y:.1}v6\" stroke=\"#888\"/>");
            svg += &text((x, y + 20.0), "middle", &format!("{:.1} m", f64::from(half_metre) * 0.5));
        }
        let poses = self.poses();
        let mut label_from = f64::MIN;
        for (index, frame) in poses.iter().enumerate() {
            let share = (index + 1) as f64 / poses.len() as f64;
            let pose = view.pose(frame, self.paint());
            let _ = writeln!(svg, "<g opacity=\"{:.2}\">{pose}</g>", 0.2 + 0.8 * share.powi(2));
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

    /// Pictures of the film.
    fn cells(&self) -> Vec<&Frame> {
        let end = self.frames.last().map_or(0.0, |frame| frame.secs);
        let long = end >= self.pace.film * (CELLS - 1) as f64;
        // An episode that is soon over is shown picture by picture.
        let step = if long { self.pace.film } else { FRAME_SECS };
        let length = step * (CELLS - 1) as f64;
        self.every(self.pace.film_from.min((end - length).max(0.0)), step, CELLS)
    }

    fn film_scale(&self) -> f64 {
        if self.eye == Eye::Right { FILM_SCALE } else { BEHIND_SCALE }
    }

    /// Half of what a cell shows across, m.
    fn cell_half(&self) -> f64 {
        CELL / 2.0 / self.film_scale()
    }

    /// The height that the camera takes for the ground, m.
    fn level(&self, frame: &Frame) -> f64 {
        let (middle, half) = (self.eye.across(&frame.centre), self.cell_half());
        let around = (-LEVELS..=LEVELS).map(|i| middle + half * f64::from(i) / f64::from(LEVELS));
        around.map(|x| self.height(self.eye, x)).sum::<f64>() / f64::from(2 * LEVELS + 1)
    }

    fn film_height(&self) -> f64 {
        let above = self.cells().into_iter().map(|frame| highest(frame) - self.level(frame));
        FILM + self.film_scale() * (above.fold(0.0, f64::max) - FILM_HEADROOM).max(0.0)
    }

    fn film(&self, top: f64) -> String {
        let (scale, bottom) = (self.film_scale(), top + self.film_height() - FOOT);
        let mut svg = String::new();
        for (index, frame) in self.cells().into_iter().enumerate() {
            let (width, left) = (CELL, LEFT + CELL * index as f64);
            let (middle, half) = (self.eye.across(&frame.centre), self.cell_half());
            let (from, to) = (middle - half, middle + half);
            let ground = bottom + scale * self.level(frame);
            let view = View { eye: self.eye, scale, from, left, ground };
            svg += &view.ground_of(self, (left + 1.0, left + width - 1.0));
            for tenth in (from * 10.0).ceil() as i64..=(to * 10.0).floor() as i64 {
                let across = tenth as f64 / 10.0;
                let (x, y) = (view.x(across), ground - scale * self.height(self.eye, across));
                let _ = writeln!(svg, "<path class=\"grid\" d=\"M{x:.1} {y:.1}v5\" stroke=\"#888\"/>");
            }
            svg += &view.pose(frame, self.paint());
            svg += &self.arrow(&view, frame);
            svg += &text((left + width / 2.0, bottom + 22.0), "middle", &format!("{:.2} s", frame.secs));
        }
        svg
    }

    /// The push, while it lasts.
    fn arrow(&self, view: &View, frame: &Frame) -> String {
        let lasts = |(from, secs): &(f64, f64)| frame.secs > from - 1e-6 && frame.secs < from + secs - 1e-6;
        if !self.push.as_ref().is_some_and(lasts) {
            return String::new();
        }
        let [from, to] = ARROW.map(|right| view.at(&[frame.centre[0], frame.centre[1] - right, frame.centre[2]]));
        format!(
            "<path class=\"ground\" d=\"M{:.1} {y:.1}H{x:.1}m5 -4l-5 4l5 4\" fill=\"none\" stroke=\"#555\" \
             stroke-width=\"1.8\"/>\n",
            from.0,
            x = to.0,
            y = to.1
        )
    }

    /// At most `count` pictures from `start` on, `step` seconds apart.
    fn every(&self, start: f64, step: f64, count: usize) -> Vec<&Frame> {
        let at = |index: usize| {
            let secs = start + step * index as f64 - 1e-6;
            self.frames.get(self.frames.partition_point(|frame| frame.secs < secs))
        };
        (0..count).map_while(at).collect()
    }

    /// Its colour, and the colour's name.
    fn paint(&self) -> (&'static str, &'static str) {
        (self.colour.hex(), self.colour.name())
    }
}

/// x of the stroboscope's right edge, m.
fn strobe_to() -> f64 {
    STROBE_FROM + (WIDTH - 2.0 * LEFT) / STROBE_SCALE
}

/// z of its highest point, m.
fn highest(frame: &Frame) -> f64 {
    frame.trunk.iter().chain(frame.legs.as_flattened()).map(|point| point[2]).fold(f64::MIN, f64::max)
}

/// True when the whole trunk lies within the stroboscope.
fn seen(frame: &Frame) -> bool {
    frame.trunk.iter().all(|corner| (STROBE_FROM..=strobe_to()).contains(&corner[0]))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(secs: f64, x: f64) -> Frame {
        let corner = |dx: f64, z: f64| [x + dx, 0.0, z];
        let leg = [corner(0.0, 0.18), corner(0.0, 0.18), corner(-0.05, 0.09), corner(0.0, 0.01)];
        let across = [[x, 0.06, 0.2], [x, 0.06, 0.14], [x, -0.06, 0.14], [x, -0.06, 0.2]];
        let trunk = [corner(0.12, 0.2), corner(0.12, 0.14), corner(-0.12, 0.14), corner(-0.12, 0.2)];
        Frame {
            secs,
            centre: corner(0.0, 0.17),
            angles: [0.0; 3],
            trunk,
            across,
            legs: [leg; 4],
            down: [true, false, false, true],
        }
    }

    fn drawn(speed: f64, frames: usize) -> String {
        let frames: Vec<Frame> = (0..frames).map(|i| frame(i as f64 * 0.02, speed * i as f64 * 0.02)).collect();
        draw(&[strip(&frames)])
    }

    fn strip(frames: &[Frame]) -> Strip<'_> {
        let (colour, eye, pace) = (Colour::Blue, Eye::Right, Pace::FAST);
        Strip { name: "robot".into(), frames, colour, ground: &[], eye, pace, push: None }
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

    #[test]
    fn a_slope_takes_room_and_is_drawn_as_it_is() {
        let ground = [(-1.0, -0.1), (4.0, 0.4)];
        let frames = [frame(0.0, 0.0)];
        let (level, slope) = (strip(&frames), Strip { ground: &ground, ..strip(&frames) });
        // From x = −0.36 m to the right edge it rises by a tenth of that.
        let rise = STROBE_SCALE * 0.1 * (strobe_to() - STROBE_FROM);
        assert!((slope.stroboscope_height() - level.stroboscope_height() - rise).abs() < 1e-9, "{rise}");
        assert!((slope.height(Eye::Right, 1.005) - 0.1005).abs() < 1e-12);
        assert!(draw(&[slope]).contains("0.5 m"));
    }

    #[test]
    fn a_robot_that_leaps_takes_room_above_itself() {
        let leap = |rise: f64| {
            let mut frames: Vec<Frame> = (0..30).map(|i| frame(f64::from(i) * 0.02, 0.0)).collect();
            // A foot is flung up at 0.40 s, a pose of the stroboscope, and at 0.42 s, a picture of the film.
            frames[20..22].iter_mut().for_each(|frame| frame.legs[0][3][2] = 0.2 + rise);
            let strip = strip(&frames);
            (strip.stroboscope_height(), strip.film_height())
        };
        assert_eq!(leap(0.05), (STROBE, FILM), "it fits");
        let (stroboscope, film) = leap(0.4);
        assert!((stroboscope - STROBE - STROBE_SCALE * (0.6 - STROBE_HEADROOM)).abs() < 1e-9, "{stroboscope}");
        assert!((film - FILM - FILM_SCALE * (0.6 - FILM_HEADROOM)).abs() < 1e-9, "{film}");
    }

    #[test]
    fn a_push_is_seen_from_behind_while_it_lasts() {
        let frames: Vec<Frame> = (0..60).map(|i| frame(f64::from(i) * 0.02, 0.0)).collect();
        let pace = Pace { film_from: 0.3, film: 0.1, ..Pace::FAST };
        let pushed = Strip { eye: Eye::Behind, pace, push: Some((0.4, 0.05)), ..strip(&frames) };
        let svg = draw(&[pushed]);
        assert_eq!((svg.matches("trunk-blue").count(), svg.matches("l-5 4l5 4").count()), (CELLS, 1), "{svg}");
        // Left is left: the trunk's first corner, 6 cm to the left, stands left of the middle of its cell.
        let view = View { eye: Eye::Behind, scale: 100.0, from: -1.0, left: 0.0, ground: 50.0 };
        assert_eq!(view.at(&[9.0, 0.06, 0.2]), (94.0, 30.0));
    }
}
