//! Text in pictures, with the fonts that are compiled in: no system fonts are needed.

use crate::data::pictures::rgb::Picture;
use crate::system::printable;
use ab_glyph::{Font, FontRef, GlyphId, PxScale, ScaleFont, point};
use std::sync::LazyLock;

/// Fonts in order of preference: Ubuntu Light, then Hack for characters that Ubuntu Light lacks.
static FONTS: LazyLock<Vec<FontRef<'static>>> = LazyLock::new(|| {
    [epaint_default_fonts::UBUNTU_LIGHT, epaint_default_fonts::HACK_REGULAR]
        .into_iter()
        .filter_map(|bytes| FontRef::try_from_slice(bytes).ok())
        .collect()
});

/// Largest line height, pixels; larger line heights are clamped.
const LARGEST: f32 = 400.0;
/// Largest number of characters of a line of text; further characters are left out.
const LONGEST: usize = 2_000;

/// Direction in which a line of text runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    Right,
    /// Bottom to top, as beside the vertical axis of a plot.
    Up,
}

struct Placed {
    font: &'static FontRef<'static>,
    glyph: GlyphId,
    x: f32,
}

/// Places the characters of a line of text of height `size`, pixels. Returns the characters and the width, pixels.
fn layout(text: &str, size: f32) -> (Vec<Placed>, f32) {
    let mut placed: Vec<Placed> = Vec::new();
    let mut x = 0.0;
    for character in printable::line(text).chars().take(LONGEST) {
        let Some(font) = FONTS.iter().find(|f| f.glyph_id(character).0 != 0).or(FONTS.first()) else {
            break;
        };
        let (scaled, glyph) = (font.as_scaled(PxScale::from(size)), font.glyph_id(character));
        if let Some(last) = placed.last().filter(|last| std::ptr::eq(last.font, font)) {
            x += scaled.kern(last.glyph, glyph);
        }
        placed.push(Placed { font, glyph, x });
        x += scaled.h_advance(glyph);
    }
    (placed, x)
}

fn sane(size: f32) -> f32 {
    if size.is_nan() { 1.0 } else { size.clamp(1.0, LARGEST) }
}

/// Returns the width of one line of text, pixels; `size`: line height, pixels.
pub fn width(text: &str, size: f32) -> usize {
    layout(text, sane(size)).1.ceil() as usize
}

/// Returns the height of a picture of one line of text, pixels: `size`, clamped to 1 to `LARGEST` and rounded up.
pub fn line_height(size: f32) -> usize {
    sane(size).ceil() as usize
}

/// Rasterises one line of text, with control characters escaped; `size`: line height, pixels. Returns the width,
/// pixels, and the coverage, `[height * width]`, in [0, 1].
fn rasterise(text: &str, size: f32) -> (usize, Vec<f32>) {
    let size = sane(size);
    let (placed, advance) = layout(text, size);
    let (width, height) = (advance.ceil() as usize, line_height(size));
    let mut coverage = vec![0.0; width * height];
    // Characters of all fonts share one baseline, on a whole pixel so that the lower edges of letters are sharp.
    let baseline = FONTS.first().map_or(0.0, |f| f.as_scaled(size).ascent().round());
    for Placed { font, glyph, x } in placed {
        let glyph = glyph.with_scale_and_position(PxScale::from(size), point(x, baseline));
        let Some(outline) = font.outline_glyph(glyph) else { continue };
        let corner = outline.px_bounds().min;
        outline.draw(|dx, dy, share| {
            let (x, y) = (corner.x as i64 + i64::from(dx), corner.y as i64 + i64::from(dy));
            if (0..width as i64).contains(&x) && (0..height as i64).contains(&y) {
                let old: &mut f32 = &mut coverage[y as usize * width + x as usize];
                // Partial coverage is raised, because a light font at small sizes looks grey on white.
                let share = 1.0 - (1.0 - share.clamp(0.0, 1.0)).powf(1.6);
                *old = old.max(share);
            }
        });
    }
    (width, coverage)
}

/// Draws one line of text into `picture`, cut off at the picture's edges. (`x`, `y`): top left pixel of the rectangle
/// that the text covers, for both values of `direction`. `size`: line height, pixels.
pub fn draw(
    picture: &mut Picture,
    text: &str,
    (x, y): (i64, i64),
    size: f32,
    colour: [f32; 3],
    direction: Direction,
) {
    let (width, coverage) = rasterise(text, size);
    for (row, shares) in coverage.chunks_exact(width.max(1)).enumerate() {
        for (column, &share) in shares.iter().enumerate() {
            let (dx, dy) = match direction {
                Direction::Right => (column, row),
                Direction::Up => (row, width - 1 - column),
            };
            if share > 0.0 {
                picture.blend(x + dx as i64, y + dy as i64, colour, share);
            }
        }
    }
}

/// Breaks `text` into lines no wider than `widest` pixels: at line ends, at spaces, and inside a word that is too long
/// for a line. Only a line of a single character may be wider. `size`: line height, pixels.
pub fn wrap(text: &str, size: f32, widest: usize) -> Vec<String> {
    let mut lines = Vec::new();
    for paragraph in text.lines() {
        let mut line = String::new();
        for word in paragraph.split_whitespace() {
            let candidate = if line.is_empty() { word.to_owned() } else { format!("{line} {word}") };
            if width(&candidate, size) <= widest {
                line = candidate;
                continue;
            }
            if !line.is_empty() {
                lines.push(std::mem::take(&mut line));
            }
            for character in word.chars() {
                line.push(character);
                if width(&line, size) > widest && line.chars().count() > 1 {
                    line.pop();
                    lines.push(std::mem::replace(&mut line, character.to_string()));
                }
            }
        }
        lines.push(line);
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_fonts_are_compiled_in() {
        assert_eq!(FONTS.len(), 2);
    }

    #[test]
    fn text_leaves_ink_inside_its_box_in_each_direction() {
        for direction in [Direction::Right, Direction::Up] {
            let mut picture = Picture::filled(300, 300, [1.0; 3]);
            draw(&mut picture, "Ågq dB σ ≤ 1×", (20, 20), 24.0, [0.0; 3], direction);
            let (w, h) = (width("Ågq dB σ ≤ 1×", 24.0), line_height(24.0));
            let (w, h) = if direction == Direction::Right { (w, h) } else { (h, w) };
            let inked: Vec<(usize, usize)> =
                (0..300 * 300).filter(|&i| picture.rgb[i][0] < 0.5).map(|i| (i % 300, i / 300)).collect();
            assert!(inked.len() > 100);
            assert!(inked.iter().all(|&(x, y)| (20..20 + w).contains(&x) && (20..20 + h).contains(&y)));
        }
    }

    #[test]
    fn odd_inputs_are_drawn_or_left_out() {
        let mut picture = Picture::filled(8, 8, [1.0; 3]);
        for size in [f32::NAN, -1.0, 0.0, 1e30] {
            draw(&mut picture, "a\0\n\u{10FFFF}漢", (-5, i64::MIN / 2), size, [0.0; 3], Direction::Up);
        }
        draw(&mut picture, "", (0, 0), 12.0, [0.0; 3], Direction::Right);
        let mut short = Picture { width: 50, height: 50, rgb: vec![[0.0; 3]; 10] };
        draw(&mut short, "abc", (0, 0), 40.0, [1.0; 3], Direction::Right);
    }

    #[test]
    fn wrapped_lines_fit_and_lose_nothing() {
        let text = "a caption that is rather long, with averyveryverylongwordindeed inside\nand more";
        let lines = wrap(text, 14.0, 100);
        assert!(lines.len() > 4);
        assert!(lines.iter().all(|line| width(line, 14.0) <= 100), "{lines:?}");
        let squeeze = |s: &str| s.chars().filter(|c| !c.is_whitespace()).collect::<String>();
        assert_eq!(squeeze(&lines.concat()), squeeze(text));
        assert_eq!(wrap("abc", 14.0, 0), ["a", "b", "c"]);
    }
}
