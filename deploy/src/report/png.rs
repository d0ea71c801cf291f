//! SVG text to PNG bytes, with one font that is part of the binary: equal text gives equal bytes on any machine.

use anyhow::Context;
use resvg::tiny_skia::{Pixmap, Transform};
use resvg::usvg::{Options, Tree, fontdb::Database};
use std::sync::Arc;

/// Pixels of the picture for one of the drawing, so that it is sharp on a dense screen.
const SCALE: f32 = 2.0;

/// The picture of a drawing, twice as large as it says.
pub(crate) fn render(svg: &str) -> anyhow::Result<Vec<u8>> {
    let mut fonts = Database::new();
    fonts.load_font_data(dejavu::sans::regular().to_vec());
    fonts.load_font_data(dejavu::sans::bold().to_vec());
    // Whatever family the drawing asks for, there is this one.
    fonts.set_sans_serif_family("DejaVu Sans");
    let options = Options { font_family: "DejaVu Sans".to_owned(), fontdb: Arc::new(fonts), ..Options::default() };
    let tree = Tree::from_str(svg, &options).context("read the drawing")?;
    let size = tree.size().to_int_size().scale_by(SCALE).context("scale the drawing")?;
    let mut pixels = Pixmap::new(size.width(), size.height()).context("make room for the picture")?;
    resvg::render(&tree, Transform::from_scale(SCALE, SCALE), &mut pixels.as_mut());
    pixels.encode_png().context("encode the picture")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Dark pixels of a drawing of 40 × 20 with this inside.
    fn ink(inside: &str) -> usize {
        let svg = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"40\" height=\"20\" font-family=\"sans-serif\" \
             font-size=\"14\"><rect width=\"40\" height=\"20\" fill=\"#fff\"/>{inside}</svg>"
        );
        let png = render(&svg).expect("renders");
        let pixels = Pixmap::decode_png(&png).expect("is a PNG");
        assert_eq!((pixels.width(), pixels.height()), (80, 40));
        pixels.pixels().iter().filter(|pixel| pixel.red() < 128).count()
    }

    #[test]
    fn text_is_drawn_whatever_fonts_the_machine_has() {
        assert_eq!(ink(""), 0);
        let letters = ink("<text x=\"2\" y=\"15\">Δτ²</text>");
        assert!((40..600).contains(&letters), "{letters} dark pixels");
    }

    #[test]
    fn what_is_no_drawing_is_an_error() {
        assert!(render("poem").expect_err("refused").to_string().contains("drawing"));
    }
}
