//! Figures of several panels one below the other as SVG text: lines, bands, levels to compare with, legends.
//!
//! Narrow enough that its text can be read on a phone. Colours stand in attributes, so a drawing is complete by itself;
//! everything coloured also has a class, so that a page may give it other colours in the dark.

use super::svg::{Axis, Scale, escape, sheet, text};
use std::fmt::Write;

/// A figure.
#[derive(Debug)]
pub(crate) struct Chart {
    /// From top to bottom.
    pub(crate) panels: Vec<Panel>,
}

/// One pair of axes.
#[derive(Debug)]
pub(crate) struct Panel {
    /// Above it.
    pub(crate) title: String,
    /// Below it, with the unit.
    pub(crate) x_label: String,
    /// Beside it, with the unit.
    pub(crate) y_label: String,
    /// How x goes along its axis.
    pub(crate) x_scale: Scale,
    /// What of y is shown; all of it if none.
    pub(crate) y_range: Option<(f64, f64)>,
    /// What is drawn, first at the bottom.
    pub(crate) marks: Vec<Mark>,
}

/// One thing drawn.
#[derive(Debug)]
pub(crate) struct Mark {
    /// Its name in the legend; it is not there if empty.
    pub(crate) name: String,
    /// Its colour.
    pub(crate) colour: Colour,
    /// What it is.
    pub(crate) shape: Shape,
}

/// What is drawn.
#[derive(Debug)]
pub(crate) enum Shape {
    /// A line through these x and y; it is broken where one is not finite.
    Line(Vec<(f64, f64)>),
    /// The area between the second and the third at the first.
    Band(Vec<(f64, f64, f64)>),
    /// A dashed line at this y, all along.
    Level(f64),
    /// Dots at these x and y; smaller ones if they are many.
    Dots(Vec<(f64, f64)>),
}

/// Colours that can be told apart in grey too.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Colour {
    /// The hierarchy, or the first of several.
    Blue,
    /// Its rival, or the second.
    Orange,
    /// The third.
    Green,
    /// What others said.
    Grey,
}

/// Width of every figure, pixels of the drawing.
pub(crate) const WIDTH: f64 = 640.0;
const LEFT: f64 = 84.0;
const RIGHT: f64 = 32.0;
/// Of a panel: room for title and legend, for the plot, for ticks and label.
const HEAD: f64 = 50.0;
const BODY: f64 = 190.0;
const FOOT: f64 = 56.0;
/// Share of the highest value that is too little to be seen.
const HAIR: f64 = 0.01;
/// Dots that do not get into each other's way.
const FEW_DOTS: usize = 3;
/// About the width of a letter, for room in legends.
const LETTER: f64 = 7.6;

impl Chart {
    /// The drawing.
    pub(crate) fn to_svg(&self) -> String {
        let mut body = String::new();
        for (index, panel) in self.panels.iter().enumerate() {
            body += &panel.draw(index as f64 * Panel::HEIGHT);
        }
        sheet((WIDTH, Panel::HEIGHT * self.panels.len() as f64), &body)
    }
}

impl Panel {
    const HEIGHT: f64 = HEAD + BODY + FOOT;

    fn draw(&self, top: f64) -> String {
        let (top, bottom) = (top + HEAD, top + HEAD + BODY);
        let finite = |(x, y): &(f64, f64)| x.is_finite() && y.is_finite();
        let points: Vec<(f64, f64)> = self.marks.iter().flat_map(Mark::extent).filter(finite).collect();
        let x = Axis::around(points.iter().map(|(x, _)| *x), self.x_scale, (LEFT, WIDTH - RIGHT));
        let levels = self.marks.iter().filter_map(Mark::level_y);
        let ys: Vec<f64> = match self.y_range {
            Some((low, high)) => vec![low, high],
            None => from_zero(points.iter().map(|(_, y)| *y).chain(levels).collect()),
        };
        let y = Axis::around(ys.into_iter(), Scale::Linear, (bottom, top));
        let mut svg = self.frame(&x, &y, top);
        // A drawing within the drawing cuts off what lies outside of the axes.
        let (width, right) = (WIDTH - RIGHT - LEFT, WIDTH - RIGHT);
        let _ = writeln!(
            svg,
            "<svg x=\"{LEFT}\" y=\"{top}\" width=\"{width}\" height=\"{BODY}\" \
             viewBox=\"{LEFT} {top} {width} {BODY}\">"
        );
        // All dots are within axes that were made around them, and a dot at their end is seen whole.
        let (outside, inside): (Vec<&Mark>, Vec<&Mark>) =
            self.marks.iter().partition(|mark| matches!(mark.shape, Shape::Dots(_)) && self.y_range.is_none());
        svg.extend(inside.into_iter().map(|mark| mark.draw(&x, &y, right)));
        svg += "</svg>\n";
        svg.extend(outside.into_iter().map(|mark| mark.draw(&x, &y, right)));
        svg + &self.legend(top)
    }

    fn frame(&self, x: &Axis, y: &Axis, top: f64) -> String {
        let (bottom, right) = (top + BODY, WIDTH - RIGHT);
        let mut svg = format!("<g font-weight=\"bold\">{}</g>\n", text((LEFT, top - 30.0), "start", &self.title));
        for (value, label) in x.ticks() {
            let at = x.at(value);
            let _ = writeln!(svg, "<path class=\"grid\" d=\"M{at:.1} {top}V{bottom}\" stroke=\"#e4e4e4\"/>");
            svg += &text((at, bottom + 18.0), "middle", &label);
        }
        for (value, label) in y.ticks() {
            let at = y.at(value);
            let _ = writeln!(svg, "<path class=\"grid\" d=\"M{LEFT} {at:.1}H{right}\" stroke=\"#e4e4e4\"/>");
            svg += &text((LEFT - 8.0, at + 4.5), "end", &label);
        }
        svg += &text((f64::midpoint(LEFT, right), bottom + 38.0), "middle", &self.x_label);
        let (middle, label) = (f64::midpoint(top, bottom), escape(&self.y_label));
        svg + &format!("<text transform=\"translate(16 {middle}) rotate(-90)\" text-anchor=\"middle\">{label}</text>\n")
    }

    fn legend(&self, top: f64) -> String {
        let (mut svg, mut x, y) = (String::new(), LEFT, top - 10.0);
        for mark in self.marks.iter().filter(|mark| !mark.name.is_empty()) {
            svg += &mark.sample((x, y));
            svg += &text((x + 26.0, y), "start", &mark.name);
            x += 26.0 + LETTER * mark.name.chars().count() as f64 + 18.0;
        }
        svg
    }
}

/// The values, those a hair below zero left out, so that no part of the axis is empty for their sake.
fn from_zero(mut values: Vec<f64>) -> Vec<f64> {
    let high = values.iter().copied().fold(0.0, f64::max);
    values.retain(|y| !(-HAIR * high..0.0).contains(y));
    values
}

/// Pixels.
fn dot_radius(dots: &[(f64, f64)]) -> f64 {
    if dots.len() > FEW_DOTS { 2.2 } else { 4.5 }
}

impl Mark {
    /// A line.
    pub(crate) fn line(name: &str, colour: Colour, points: Vec<(f64, f64)>) -> Self {
        Self { name: name.to_owned(), colour, shape: Shape::Line(points) }
    }

    /// A level to compare with.
    pub(crate) fn level(name: &str, colour: Colour, y: f64) -> Self {
        Self { name: name.to_owned(), colour, shape: Shape::Level(y) }
    }

    /// The points that axes must reach; a level is none, it has no x.
    fn extent(&self) -> Vec<(f64, f64)> {
        match &self.shape {
            Shape::Line(points) | Shape::Dots(points) => points.clone(),
            Shape::Band(points) => points.iter().flat_map(|(x, low, high)| [(*x, *low), (*x, *high)]).collect(),
            Shape::Level(_) => Vec::new(),
        }
    }

    fn draw(&self, x: &Axis, y: &Axis, right: f64) -> String {
        let (class, paint) = (self.class(), self.paint());
        match &self.shape {
            Shape::Line(points) => {
                let pieces = points.split(|(px, py)| !(px.is_finite() && py.is_finite()));
                let path = |piece: &[(f64, f64)]| {
                    let at: Vec<String> =
                        piece.iter().map(|(px, py)| format!("{:.1} {:.1}", x.at(*px), y.at(*py))).collect();
                    format!("<path class=\"{class}\" d=\"M{}\" {paint}/>\n", at.join("L"))
                };
                pieces.filter(|piece| !piece.is_empty()).map(path).collect()
            }
            Shape::Band(points) if points.is_empty() => String::new(),
            Shape::Band(points) => {
                let there = points.iter().map(|(px, low, _)| (px, low));
                let back = points.iter().rev().map(|(px, _, high)| (px, high));
                let at: Vec<String> =
                    there.chain(back).map(|(px, py)| format!("{:.1} {:.1}", x.at(*px), y.at(*py))).collect();
                format!("<path class=\"{class}\" d=\"M{}Z\" {paint}/>\n", at.join("L"))
            }
            Shape::Dots(points) => {
                let radius = dot_radius(points);
                let dot = |(px, py): &(f64, f64)| {
                    let (cx, cy) = (x.at(*px), y.at(*py));
                    format!("<circle class=\"{class}\" cx=\"{cx:.1}\" cy=\"{cy:.1}\" r=\"{radius}\" {paint}/>\n")
                };
                points.iter().map(dot).collect::<Vec<_>>().concat()
            }
            Shape::Level(level) => {
                let at = y.at(*level);
                format!("<path class=\"{class}\" d=\"M{LEFT} {at:.1}H{right}\" {paint}/>\n")
            }
        }
    }

    /// Its mark in the legend, 20 wide, before (x + 26, y).
    fn sample(&self, (x, y): (f64, f64)) -> String {
        let (class, paint) = (self.class(), self.paint());
        let middle = y - 4.5;
        match self.shape {
            Shape::Dots(ref points) => {
                let (x, radius) = (x + 10.0, dot_radius(points));
                format!("<circle class=\"{class}\" cx=\"{x}\" cy=\"{middle}\" r=\"{radius}\" {paint}/>\n")
            }
            Shape::Band(_) => {
                let (top, low, right) = (middle - 5.0, middle + 5.0, x + 20.0);
                format!("<path class=\"{class}\" d=\"M{x} {top}H{right}V{low}H{x}Z\" {paint}/>\n")
            }
            _ => format!("<path class=\"{class}\" d=\"M{x} {middle}H{}\" {paint}/>\n", x + 20.0),
        }
    }

    fn class(&self) -> String {
        let kind = if matches!(self.shape, Shape::Band(_) | Shape::Dots(_)) { "fill" } else { "stroke" };
        format!("{kind}-{}", self.colour.name())
    }

    fn paint(&self) -> String {
        let colour = self.colour.hex();
        match self.shape {
            Shape::Line(_) => format!("fill=\"none\" stroke=\"{colour}\" stroke-width=\"1.8\""),
            Shape::Dots(_) => format!("fill=\"{colour}\""),
            Shape::Band(_) => format!("fill=\"{colour}\" fill-opacity=\"0.22\""),
            Shape::Level(_) => {
                format!("fill=\"none\" stroke=\"{colour}\" stroke-width=\"1.4\" stroke-dasharray=\"6 4\"")
            }
        }
    }

    fn level_y(&self) -> Option<f64> {
        if let Shape::Level(y) = self.shape { Some(y) } else { None }
    }
}

impl Colour {
    /// On white paper.
    pub(crate) fn hex(self) -> &'static str {
        match self {
            Self::Blue => "#1f5fa8",
            Self::Orange => "#c8501e",
            Self::Green => "#2c7f4f",
            Self::Grey => "#6b7280",
        }
    }

    /// In classes.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Blue => "blue",
            Self::Orange => "orange",
            Self::Green => "green",
            Self::Grey => "grey",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn panel(marks: Vec<Mark>, y_range: Option<(f64, f64)>) -> Panel {
        let word = |text: &str| text.to_owned();
        Panel { title: word("a < b"), x_label: word("x"), y_label: word("y"), x_scale: Scale::Linear, y_range, marks }
    }

    #[test]
    fn lines_break_where_there_is_no_number() {
        let points = vec![(0.0, 1.0), (1.0, 2.0), (2.0, f64::NAN), (3.0, 2.0), (4.0, 1.0)];
        let svg = Chart { panels: vec![panel(vec![Mark::line("", Colour::Blue, points)], None)] }.to_svg();
        assert_eq!(svg.matches("class=\"stroke-blue\"").count(), 2, "{svg}");
        assert!(svg.contains("a &lt; b") && !svg.contains("NaN"), "{svg}");
    }

    #[test]
    fn axes_reach_levels_and_bands() {
        let band = Mark { name: "seeds".into(), colour: Colour::Orange, shape: Shape::Band(vec![(0.0, 1.0, 9.0)]) };
        let level = Mark::level("paper", Colour::Grey, 175.0);
        let svg = Chart { panels: vec![panel(vec![band, level], None)] }.to_svg();
        assert!(svg.contains(">200</text>"), "the level is out of sight: {svg}");
        assert_eq!(svg.matches("fill-orange").count(), 2, "band and legend: {svg}");
    }

    #[test]
    fn a_range_is_kept_whatever_lies_outside() {
        let far = Mark::line("", Colour::Blue, vec![(0.0, -5e3), (1.0, 5e3)]);
        let svg = Chart { panels: vec![panel(vec![far], Some((0.0, 200.0)))] }.to_svg();
        assert!(svg.contains(">200</text>") && !svg.contains(">5,000</text>"), "{svg}");
    }

    #[test]
    fn a_hair_below_zero_takes_no_room() {
        let svg = |low: f64| {
            let line = Mark::line("", Colour::Blue, vec![(0.0, low), (1.0, 17.0)]);
            Chart { panels: vec![panel(vec![line], None)] }.to_svg()
        };
        assert!(!svg(-0.01).contains(">-5</text>") && svg(-1.0).contains(">-5</text>"));
    }

    #[test]
    fn nothing_to_draw_is_still_a_drawing() {
        let empty = Mark { name: String::new(), colour: Colour::Green, shape: Shape::Band(Vec::new()) };
        let marks = vec![Mark::line("", Colour::Blue, Vec::new()), empty];
        let svg = Chart { panels: vec![panel(marks, None), panel(Vec::new(), None)] }.to_svg();
        assert!(svg.ends_with("</svg>\n") && svg.matches("<svg").count() == 3, "{svg}");
    }
}
