//! The push map as a picture: a disc a subject, its sectors the directions, its rings the impulses.
//!
//! Seen from above: forwards is up, left is left. The deeper a field's blue, the more of the pushes were stood; red, none.

use super::conditions::{DIRECTIONS, IMPULSES_NS, direction_rad};
use super::measure::Pushed;
use crate::report::svg::{sheet, text};
use std::f64::consts::PI;
use std::fmt::Write;

// Sizes in pixels of the drawing.
const DISC: f64 = 450.0;
const HEAD: f64 = 56.0;
const FOOT: f64 = 78.0;
const RING: f64 = 38.0;
/// Of the hole in the middle.
const HOLE: f64 = 22.0;

/// What each colour means: share stood, red, green, blue.
const COLOURS: [(f64, [f64; 3]); 3] =
    [(0.0, [178.0, 24.0, 43.0]), (0.5, [247.0, 247.0, 247.0]), (1.0, [33.0, 102.0, 172.0])];

/// The push maps of all subjects side by side, by label.
pub(super) fn svg(subjects: &[(&str, &[Pushed])]) -> String {
    let (width, height) = (DISC * subjects.len() as f64, HEAD + DISC + FOOT);
    let mut svg = String::new();
    for (n, (label, pushes)) in subjects.iter().enumerate() {
        let middle = DISC * (n as f64 + 0.5);
        svg += &text((middle, 24.0), "middle", "pushes stood, % of the phases of the gait");
        svg += &text((middle, 44.0), "middle", label);
        svg += &disc(pushes, (middle, HEAD + DISC / 2.0));
    }
    svg += &scale((width / 2.0 - 150.0, HEAD + DISC + 6.0));
    sheet((width, height), &svg)
}

fn disc(pushes: &[Pushed], centre: (f64, f64)) -> String {
    let mut svg = String::new();
    for (n, pushed) in pushes.iter().enumerate() {
        let (ring, direction) = (n / DIRECTIONS, direction_rad(n % DIRECTIONS));
        let (inner, half) = (HOLE + RING * ring as f64, PI / DIRECTIONS as f64);
        let corner = |radius: f64, side: f64| {
            let (x, y) = place(centre, radius, direction + side * half);
            format!("{x:.1} {y:.1}")
        };
        let (outer, share) = (inner + RING, pushed.stood());
        let _ = writeln!(
            svg,
            "<path d=\"M{}A{outer} {outer} 0 0 0 {}L{}A{inner} {inner} 0 0 1 {}Z\" fill=\"{}\" stroke=\"#fff\"/>",
            corner(outer, -1.0),
            corner(outer, 1.0),
            corner(inner, 1.0),
            corner(inner, -1.0),
            colour(share),
        );
        let (x, y) = place(centre, inner + RING / 2.0, direction);
        let ink = if (share - 0.5).abs() > 0.3 { "#fff" } else { "#222" };
        let label = text((x, y + 4.5), "middle", &format!("{:.0}", 100.0 * share));
        let _ = writeln!(svg, "<g fill=\"{ink}\" font-size=\"12\">{label}</g>");
    }
    let rim = HOLE + RING * IMPULSES_NS.len() as f64 + 18.0;
    for (direction, name) in [(0, "forwards"), (DIRECTIONS / 4, "left"), (DIRECTIONS / 2, "backwards")] {
        let (x, y) = place(centre, rim, direction_rad(direction));
        svg += &text((x, y + 4.5), if name == "left" { "end" } else { "middle" }, name);
    }
    let (x, y) = place(centre, rim, direction_rad(3 * DIRECTIONS / 4));
    svg += &text((x - 4.0, y + 4.5), "start", "right");
    svg
}

/// A point at this distance from the centre, in this direction (rad, from up towards the left), pixels.
fn place((x, y): (f64, f64), radius: f64, direction: f64) -> (f64, f64) {
    (x - radius * direction.sin(), y - radius * direction.cos())
}

/// A bar of all colours, and which ring is which impulse.
fn scale((left, top): (f64, f64)) -> String {
    let mut svg = String::new();
    for n in 0..100 {
        let (x, fill) = (left + 3.0 * f64::from(n), colour((f64::from(n) + 0.5) / 100.0));
        let _ = writeln!(svg, "<rect x=\"{x}\" y=\"{top}\" width=\"3.5\" height=\"12\" fill=\"{fill}\"/>");
    }
    for (share, label) in [(0.0, "0 %"), (0.5, "50 %"), (1.0, "100 %")] {
        svg += &text((left + 300.0 * share, top + 28.0), "middle", label);
    }
    let rings = IMPULSES_NS.map(|impulse| impulse.to_string()).join(", ");
    svg + &text((left + 150.0, top + 52.0), "middle", &format!("rings from the inside: {rings} N·s in 50 ms"))
}

fn colour(share: f64) -> String {
    let upper = COLOURS.iter().position(|(at, _)| share <= *at).unwrap_or(COLOURS.len() - 1).max(1);
    let ((from, low), (to, high)) = (COLOURS[upper - 1], COLOURS[upper]);
    let along = ((share - from) / (to - from)).clamp(0.0, 1.0);
    let [r, g, b] = std::array::from_fn(|i| (low[i] + (high[i] - low[i]) * along).round() as u8);
    format!("#{r:02x}{g:02x}{b:02x}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_go_from_red_over_white_to_blue() {
        assert_eq!([0.0, 0.5, 1.0].map(colour), ["#b2182b", "#f7f7f7", "#2166ac"]);
        assert_eq!(colour(0.25), "#d58891".to_owned());
    }

    #[test]
    fn forwards_is_up_and_left_is_left() {
        let at = |quarter: usize| place((0.0, 0.0), 1.0, direction_rad(quarter * DIRECTIONS / 4));
        let ((_, up), (left, _)) = (at(0), at(1));
        assert!((up + 1.0).abs() < 1e-12 && (left + 1.0).abs() < 1e-12);
    }
}
