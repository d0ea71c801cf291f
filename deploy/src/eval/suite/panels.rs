//! One quantity of the suite as a picture: falls, return, how far or how fast, and at what cost, over its values.
//!
//! Every subject has its colour. Bars are 95 % intervals.

use super::measure::{Row, Varied};
use crate::report::svg::{Axis, Scale, sheet, text};
use std::fmt::Write;

/// A figure with its interval, if it has one.
type Point = (f64, Option<[f64; 2]>);

/// One pair of axes.
struct Panel {
    y_label: &'static str,
    figure: fn(&Row) -> Option<Point>,
    /// Values that are in view whatever the figures.
    in_view: &'static [f64],
}

const PANELS: [Panel; 3] = [
    Panel {
        y_label: "falls, % of episodes",
        figure: |row| Some((100.0 * row.fall_rate, Some(row.fall_interval.map(|share| 100.0 * share)))),
        in_view: &[0.0, 100.0],
    },
    Panel {
        y_label: "return (eq 10, no unit)",
        figure: |row| Some((row.mean_return, row.return_interval)),
        in_view: &[0.0],
    },
    Panel {
        y_label: "cost of transport (no unit)",
        figure: |row| row.cost_of_transport.map(|cost| (cost, None)),
        in_view: &[0.0],
    },
];
/// The fourth where speed is varied, and elsewhere: a robot that fell was perhaps fast, but came not far.
const SPEED: Panel = Panel { y_label: "mean speed, m/s", figure: |row| Some((row.speed_mps, None)), in_view: &[0.0] };
const DISTANCE: Panel =
    Panel { y_label: "distance of an episode, m", figure: |row| Some((row.distance_m, None)), in_view: &[0.0] };

/// Colours of the subjects.
pub(super) const COLOURS: [&str; 2] = ["#1f5fa8", "#d0572f"];

// Sizes in pixels of the drawing.
const WIDTH: f64 = 900.0;
const HEAD: f64 = 60.0;
const PANEL: (f64, f64) = (450.0, 290.0);
const LEFT: f64 = 70.0;
const RIGHT: f64 = 16.0;
const TOP: f64 = 14.0;
const BOTTOM: f64 = 54.0;

/// The picture of one quantity for all subjects, by label.
pub(super) fn svg(subjects: &[(&str, &Varied)]) -> String {
    let height = HEAD + 2.0 * PANEL.1;
    let mut svg = legend(subjects.iter().map(|(label, _)| *label));
    svg += &text((WIDTH - RIGHT, 22.0), "end", "bars: 95 % intervals");
    let varied: Vec<&Varied> = subjects.iter().map(|(_, varied)| *varied).collect();
    let by_speed = varied.iter().any(|varied| varied.name == "speed");
    let fourth = if by_speed { &SPEED } else { &DISTANCE };
    for (n, panel) in PANELS.iter().chain([fourth]).enumerate() {
        svg += &panel.draw(&varied, (PANEL.0 * (n % 2) as f64, HEAD + PANEL.1 * (n / 2) as f64));
    }
    sheet((WIDTH, height), &svg)
}

fn legend<'a>(labels: impl Iterator<Item = &'a str>) -> String {
    labels.zip(COLOURS).enumerate().fold(String::new(), |svg, (n, (label, colour))| {
        let y = 22.0 + 20.0 * n as f64;
        let mark = format!("<circle cx=\"{}\" cy=\"{}\" r=\"5\" fill=\"{colour}\"/>\n", LEFT, y - 4.5);
        svg + &mark + &text((LEFT + 14.0, y), "start", label)
    })
}

impl Panel {
    fn draw(&self, subjects: &[&Varied], (left, top): (f64, f64)) -> String {
        let (x_pixels, y_pixels) = ((left + LEFT, left + PANEL.0 - RIGHT), (top + PANEL.1 - BOTTOM, top + TOP));
        let rows = || subjects.iter().flat_map(|varied| &varied.rows);
        let values = rows().filter_map(self.figure).flat_map(|(y, interval)| [Some([y, y]), interval]);
        let ys = values.flatten().flatten().chain(self.in_view.iter().copied());
        let x = Axis::around(rows().map(|row| row.value), Scale::Linear, x_pixels);
        let y = Axis::around(ys, Scale::Linear, y_pixels);
        let x_label = subjects.first().map_or(String::new(), |varied| match varied.unit {
            "" => varied.quantity.to_owned(),
            unit => format!("{}, {unit}", varied.quantity),
        });
        let mut svg = self.frame(&x, &y, (x_pixels, y_pixels), &x_label);
        for (n, (varied, colour)) in subjects.iter().zip(COLOURS).enumerate() {
            // Beside one another, so that no interval hides another.
            let shift = 6.0 * (n as f64 - (subjects.len() - 1) as f64 / 2.0);
            let points = varied.rows.iter().filter_map(|row| (self.figure)(row).map(|point| (row.value, point)));
            let points: Vec<(f64, Point)> = points.collect();
            svg += &series(&points, |value| x.at(value) + shift, &y, colour);
        }
        svg
    }

    fn frame(&self, x: &Axis, y: &Axis, (across, up): ((f64, f64), (f64, f64)), x_label: &str) -> String {
        let mut svg = String::new();
        for (value, label) in x.ticks() {
            let at = x.at(value);
            let _ = writeln!(svg, "<path d=\"M{at:.1} {}V{}\" stroke=\"#e4e4e4\"/>", up.1, up.0);
            svg += &text((at, up.0 + 18.0), "middle", &label);
        }
        for (value, label) in y.ticks() {
            let at = y.at(value);
            let _ = writeln!(svg, "<path d=\"M{} {at:.1}H{}\" stroke=\"#e4e4e4\"/>", across.0, across.1);
            svg += &text((across.0 - 8.0, at + 4.5), "end", &label);
        }
        svg += &text((f64::midpoint(across.0, across.1), up.0 + 38.0), "middle", x_label);
        let (beside, middle) = (across.0 - 57.0, f64::midpoint(up.0, up.1));
        let label = text((0.0, 0.0), "middle", self.y_label);
        svg + &format!("<g transform=\"translate({beside:.1} {middle:.1}) rotate(-90)\">{label}</g>\n")
    }
}

/// Dots with their intervals, joined.
fn series(points: &[(f64, Point)], x: impl Fn(f64) -> f64, y: &Axis, colour: &str) -> String {
    let path: Vec<String> =
        points.iter().map(|(at, (value, _))| format!("{:.1} {:.1}", x(*at), y.at(*value))).collect();
    let mut svg = String::new();
    if path.len() > 1 {
        let line = path.join("L");
        let _ = writeln!(svg, "<path d=\"M{line}\" fill=\"none\" stroke=\"{colour}\" stroke-opacity=\"0.45\"/>");
    }
    for (at, (value, interval)) in points {
        let at = x(*at);
        if let Some([low, high]) = interval {
            let (low, high) = (y.at(*low), y.at(*high));
            let caps = format!("M{:.1} {low:.1}h8M{:.1} {high:.1}h8", at - 4.0, at - 4.0);
            let _ = writeln!(svg, "<path d=\"M{at:.1} {low:.1}V{high:.1}{caps}\" stroke=\"{colour}\"/>");
        }
        let _ = writeln!(svg, "<circle cx=\"{at:.1}\" cy=\"{:.1}\" r=\"3.5\" fill=\"{colour}\"/>", y.at(*value));
    }
    svg
}
