//! One plot as SVG text: equal points give equal bytes, and it needs no font, browser or library to be made.

use std::fmt::Write;

/// A plot of some series over one pair of axes.
#[derive(Debug)]
pub(crate) struct Plot {
    /// Above it.
    pub(crate) title: String,
    /// Below it, with the unit.
    pub(crate) x_label: String,
    /// Beside it, with the unit.
    pub(crate) y_label: String,
    /// How x goes along its axis.
    pub(crate) x_scale: Scale,
    /// What is drawn, first at the bottom.
    pub(crate) series: Vec<Series>,
}

/// How values go along an axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Scale {
    /// Evenly.
    Linear,
    /// By their logarithm; they are positive.
    Decades,
}

/// Points of one kind.
#[derive(Debug)]
pub(crate) struct Series {
    /// Its name in the legend; it is not there if empty.
    pub(crate) name: String,
    /// How it is drawn.
    pub(crate) style: Style,
    /// x and y.
    pub(crate) points: Vec<(f64, f64)>,
}

/// How points are drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Style {
    /// Small grey dots.
    Faint,
    /// A line through them.
    Line,
    /// Large dots.
    Dots,
}

// Sizes in pixels of the drawing.
const WIDTH: f64 = 860.0;
const HEIGHT: f64 = 480.0;
const LEFT: f64 = 88.0;
const RIGHT: f64 = 20.0;
const TOP: f64 = 64.0;
const BOTTOM: f64 = 56.0;
/// About how many marks an axis has.
const TICKS: f64 = 6.0;

impl Plot {
    /// The drawing.
    pub(crate) fn to_svg(&self) -> String {
        let finite = |(x, y): &&(f64, f64)| x.is_finite() && y.is_finite();
        let points = || self.series.iter().flat_map(|series| &series.points).filter(finite);
        let x = Axis::around(points().map(|(x, _)| *x), self.x_scale, (LEFT, WIDTH - RIGHT));
        let y = Axis::around(points().map(|(_, y)| *y), Scale::Linear, (HEIGHT - BOTTOM, TOP));
        let mut svg = self.frame(&x, &y);
        for series in &self.series {
            svg += &series.draw(&x, &y);
        }
        for (index, series) in self.series.iter().filter(|series| !series.name.is_empty()).enumerate() {
            svg += &series.legend(index);
        }
        sheet((WIDTH, HEIGHT), &svg)
    }

    fn frame(&self, x: &Axis, y: &Axis) -> String {
        let mut svg = String::new();
        for (value, label) in x.ticks() {
            let (at, bottom) = (x.at(value), HEIGHT - BOTTOM);
            let _ = writeln!(svg, "<path d=\"M{at:.1} {TOP}V{bottom}\" stroke=\"#e4e4e4\"/>");
            svg += &text((at, bottom + 18.0), "middle", &label);
        }
        for (value, label) in y.ticks() {
            let (at, right) = (y.at(value), WIDTH - RIGHT);
            let _ = writeln!(svg, "<path d=\"M{LEFT} {at:.1}H{right}\" stroke=\"#e4e4e4\"/>");
            svg += &text((LEFT - 8.0, at + 4.0), "end", &label);
        }
        svg += &text((f64::midpoint(LEFT, WIDTH - RIGHT), HEIGHT - 14.0), "middle", &self.x_label);
        svg += &text((LEFT, 22.0), "start", &self.title);
        let middle = f64::midpoint(TOP, HEIGHT - BOTTOM);
        let label = escape(&self.y_label);
        svg + &format!("<text transform=\"translate(18 {middle}) rotate(-90)\" text-anchor=\"middle\">{label}</text>\n")
    }
}

impl Series {
    fn draw(&self, x: &Axis, y: &Axis) -> String {
        let points = self.points.iter().filter(|(px, py)| px.is_finite() && py.is_finite());
        let at = points.map(|(px, py)| (x.at(*px), y.at(*py)));
        let mut svg = format!("<g class=\"{:?}\">\n", self.style).to_lowercase();
        if self.style == Style::Line {
            let path: Vec<String> = at.map(|(px, py)| format!("{px:.1} {py:.1}")).collect();
            if !path.is_empty() {
                let _ = writeln!(svg, "<path d=\"M{}\" {}/>", path.join("L"), self.style.paint());
            }
        } else {
            for (px, py) in at {
                let (r, paint) = (self.style.radius(), self.style.paint());
                let _ = writeln!(svg, "<circle cx=\"{px:.1}\" cy=\"{py:.1}\" r=\"{r}\" {paint}/>");
            }
        }
        svg + "</g>\n"
    }

    fn legend(&self, index: usize) -> String {
        let (x, y) = (LEFT + 240.0 * index as f64, 44.0);
        let paint = self.style.paint();
        let mark = match self.style {
            Style::Line => format!("<path d=\"M{} {}H{}\" {paint}/>\n", x, y - 4.0, x + 18.0),
            style => format!("<circle cx=\"{}\" cy=\"{}\" r=\"{}\" {paint}/>\n", x + 9.0, y - 4.0, style.radius()),
        };
        mark + &text((x + 26.0, y), "start", &self.name)
    }
}

impl Style {
    fn radius(self) -> f64 {
        if self == Self::Dots { 4.0 } else { 1.6 }
    }

    fn paint(self) -> &'static str {
        match self {
            Self::Faint => "fill=\"#9aa7b4\" fill-opacity=\"0.6\"",
            Self::Line => "fill=\"none\" stroke=\"#1f5fa8\" stroke-width=\"2\"",
            Self::Dots => "fill=\"#d0572f\"",
        }
    }
}

/// Values along one direction of the drawing. In decades, `from`, `to` and `step` are those of the logarithm.
pub(crate) struct Axis {
    scale: Scale,
    from: f64,
    to: f64,
    step: f64,
    pixels: (f64, f64),
}

impl Axis {
    /// An axis whose ends are round numbers around all values.
    pub(crate) fn around(values: impl Iterator<Item = f64>, scale: Scale, pixels: (f64, f64)) -> Self {
        let values = values.map(|value| scale.along(value));
        let (low, high) = values.fold((f64::MAX, f64::MIN), |(low, high), v| (low.min(v), high.max(v)));
        let (low, high) = if low > high { (0.0, 1.0) } else { (low, high) };
        let span = if high - low > 1e-9 * (1.0 + high.abs()) { high - low } else { 1.0 };
        let step = if scale == Scale::Decades { 1.0 } else { round_step(span / TICKS) };
        let (from, to) = ((low / step).floor() * step, (high / step).ceil() * step);
        Self { scale, from, to: if to > from { to } else { from + step }, step, pixels }
    }

    /// Where a value lies, pixels.
    pub(crate) fn at(&self, value: f64) -> f64 {
        let (first, last) = self.pixels;
        first + (last - first) * (self.scale.along(value) - self.from) / (self.to - self.from)
    }

    /// Round values along it with their labels.
    pub(crate) fn ticks(&self) -> Vec<(f64, String)> {
        let count = ((self.to - self.from) / self.step).round() as u32;
        let decimals = (-self.step.log10().floor()).max(0.0) as usize;
        // Adding zero turns −0 into 0.
        let along = |i: u32| self.from + self.step * f64::from(i) + 0.0;
        let value = |i: u32| if self.scale == Scale::Decades { 10.0_f64.powf(along(i)) } else { along(i) };
        (0..=count).map(|i| (value(i), grouped(&format!("{:.decimals$}", value(i))))).collect()
    }
}

impl Scale {
    fn along(self, value: f64) -> f64 {
        if self == Self::Decades { value.max(f64::MIN_POSITIVE).log10() } else { value }
    }
}

/// A number with commas between its thousands.
fn grouped(number: &str) -> String {
    let (whole, rest) = number.split_at(number.find('.').unwrap_or(number.len()));
    let digits = whole.trim_start_matches('-').len();
    let mut text = String::new();
    for (i, c) in whole.chars().enumerate() {
        let left = whole.len() - i;
        if c != '-' && left < digits && left % 3 == 0 {
            text.push(',');
        }
        text.push(c);
    }
    text + rest
}

/// The smallest of 1, 2, 5 × 10ⁿ that is not below `least`.
fn round_step(least: f64) -> f64 {
    let unit = 10.0_f64.powf(least.log10().floor());
    [1.0, 2.0, 5.0].into_iter().map(|m| m * unit).find(|step| *step >= least).unwrap_or(10.0 * unit)
}

/// A drawing of this width and height with this in it, on white paper.
pub(crate) fn sheet((width, height): (f64, f64), body: &str) -> String {
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" width=\"{width}\" \
         height=\"{height}\" font-family=\"sans-serif\" font-size=\"13\" fill=\"#222\">\n\
         <rect class=\"paper\" width=\"100%\" height=\"100%\" fill=\"#fff\"/>\n{body}</svg>\n"
    )
}

/// One line of text whose anchor (`start`, `middle`, `end`) is at (x, y), pixels.
pub(crate) fn text((x, y): (f64, f64), anchor: &str, text: &str) -> String {
    format!("<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\">{}</text>\n", escape(text))
}

/// Text as it may stand between tags.
pub(crate) fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_end_at_round_numbers() {
        let axis = Axis::around([-3.0, 178.0].into_iter(), Scale::Linear, (0.0, 100.0));
        let labels: Vec<String> = axis.ticks().into_iter().map(|(_, label)| label).collect();
        assert_eq!(labels, ["-50", "0", "50", "100", "150", "200"]);
        assert_eq!((axis.at(-50.0), axis.at(200.0)), (0.0, 100.0));
        let fine = Axis::around([0.0, 0.5].into_iter(), Scale::Linear, (0.0, 1.0)).ticks();
        assert_eq!(fine[1].1, "0.1");
        let decades = Axis::around([1.0, 300.0].into_iter(), Scale::Decades, (0.0, 3.0));
        let labels: Vec<String> = decades.ticks().into_iter().map(|(_, label)| label).collect();
        assert_eq!(labels, ["1", "10", "100", "1,000"]);
        assert!((decades.at(100.0) - 2.0).abs() < 1e-12);
    }

    #[test]
    fn thousands_are_told_apart() {
        for (number, expected) in [("7", "7"), ("-999", "-999"), ("1000", "1,000"), ("-1234567.50", "-1,234,567.50")] {
            assert_eq!(grouped(number), expected);
        }
    }

    #[test]
    fn any_points_make_a_drawing() {
        let plot = |points: Vec<(f64, f64)>| Plot {
            title: "a < b".into(),
            x_label: "x".into(),
            y_label: "y".into(),
            x_scale: Scale::Linear,
            series: [Style::Faint, Style::Line, Style::Dots]
                .map(|style| Series { name: "s".into(), style, points: points.clone() })
                .into(),
        };
        for points in [vec![], vec![(0.0, 5.0)], vec![(0.0, f64::NAN), (1.0, 2.0), (2.0, -1e9)]] {
            let count = points.iter().filter(|(_, y)| y.is_finite()).count();
            let svg = plot(points).to_svg();
            assert!(svg.contains("a &lt; b") && !svg.contains("NaN") && !svg.contains("inf"), "{svg}");
            assert_eq!(svg.matches("<circle").count(), 2 * count + 2, "points and legend: {svg}");
        }
    }
}
