//! Where plotters draws for a PNG: our own picture, with smooth lines and well-spaced text.
//!
//! The library's bitmap back end ignores the side bearings of glyphs and rounds every advance, so
//! that letters run into each other; everything else here is what any back end does.

use crate::data::pictures::rgb::Picture;
use crate::show::text::{self, Direction};
use plotters_backend::text_anchor::{HPos, VPos};
use plotters_backend::{
    BackendColor, BackendCoord, BackendStyle, BackendTextStyle, DrawingBackend, DrawingErrorKind,
    FontTransform,
};
use std::convert::Infallible;

type Drawn = Result<(), DrawingErrorKind<Infallible>>;

pub struct PictureBackend<'a> {
    picture: &'a mut Picture,
}

impl<'a> PictureBackend<'a> {
    pub fn new(picture: &'a mut Picture) -> Self {
        Self { picture }
    }

    /// A line with round ends: each pixel takes the share of its distance from the middle line.
    fn stroke(&mut self, from: BackendCoord, to: BackendCoord, width: u32, colour: BackendColor) {
        let point = |p: BackendCoord| (f64::from(p.0), f64::from(p.1));
        let ((x0, y0), (x1, y1)) = (point(from), point(to));
        let half = f64::from(width.clamp(1, 64)) / 2.0;
        let length2 = (x1 - x0).powi(2) + (y1 - y0).powi(2);
        let reach = half.ceil() + 1.0;
        for y in within(y0.min(y1) - reach, y0.max(y1) + reach, self.picture.height) {
            // Only the columns near the line in this row, not its whole bounding box.
            let (mut left, mut right) = (x0.min(x1), x0.max(x1));
            if (y1 - y0).abs() > 1e-9 {
                let at = |y: f64| x0 + (x1 - x0) * ((y - y0) / (y1 - y0)).clamp(0.0, 1.0);
                let (a, b) = (at(y as f64 - reach), at(y as f64 + reach));
                (left, right) = (a.min(b), a.max(b));
            }
            for x in within(left - reach, right + reach, self.picture.width) {
                let (px, py) = (x as f64 - x0, y as f64 - y0);
                let along = if length2 > 0.0 {
                    ((px * (x1 - x0) + py * (y1 - y0)) / length2).clamp(0.0, 1.0)
                } else {
                    0.0
                };
                let distance = (px - along * (x1 - x0)).hypot(py - along * (y1 - y0));
                self.mix(x, y, colour, half + 0.5 - distance);
            }
        }
    }

    fn mix(&mut self, x: i64, y: i64, colour: BackendColor, share: f64) {
        let share = share.clamp(0.0, 1.0) * colour.alpha;
        if share > 0.0 {
            self.picture.blend(x, y, rgb(colour), share as f32);
        }
    }
}

/// The whole numbers from `low` to `high` that are pixels of a side.
fn within(low: f64, high: f64, side: usize) -> std::ops::Range<i64> {
    (low.floor() as i64).max(0)..(high.ceil() as i64).saturating_add(1).min(side as i64)
}

fn rgb(colour: BackendColor) -> [f32; 3] {
    let (r, g, b) = colour.rgb;
    [r, g, b].map(|v| f32::from(v) / 255.0)
}

impl DrawingBackend for PictureBackend<'_> {
    type ErrorType = Infallible;

    fn get_size(&self) -> (u32, u32) {
        (self.picture.width as u32, self.picture.height as u32)
    }

    fn ensure_prepared(&mut self) -> Drawn {
        Ok(())
    }

    fn present(&mut self) -> Drawn {
        Ok(())
    }

    fn draw_pixel(&mut self, (x, y): BackendCoord, colour: BackendColor) -> Drawn {
        self.mix(i64::from(x), i64::from(y), colour, 1.0);
        Ok(())
    }

    fn draw_line<S: BackendStyle>(&mut self, from: BackendCoord, to: BackendCoord, style: &S) -> Drawn {
        self.stroke(from, to, style.stroke_width(), style.color());
        Ok(())
    }

    fn draw_path<S: BackendStyle, I: IntoIterator<Item = BackendCoord>>(
        &mut self,
        path: I,
        style: &S,
    ) -> Drawn {
        let mut last = None;
        for point in path {
            if let Some(last) = last {
                self.stroke(last, point, style.stroke_width(), style.color());
            }
            last = Some(point);
        }
        Ok(())
    }

    fn draw_circle<S: BackendStyle>(
        &mut self,
        centre: BackendCoord,
        radius: u32,
        style: &S,
        filled: bool,
    ) -> Drawn {
        let (cx, cy, radius) = (f64::from(centre.0), f64::from(centre.1), f64::from(radius));
        let half = f64::from(style.stroke_width().clamp(1, 64)) / 2.0;
        let reach = radius + half + 1.0;
        for y in within(cy - reach, cy + reach, self.picture.height) {
            for x in within(cx - reach, cx + reach, self.picture.width) {
                let distance = (x as f64 - cx).hypot(y as f64 - cy);
                let share =
                    if filled { radius + 0.5 - distance } else { half + 0.5 - (distance - radius).abs() };
                self.mix(x, y, style.color(), share);
            }
        }
        Ok(())
    }

    fn draw_text<S: BackendTextStyle>(&mut self, text: &str, style: &S, pos: BackendCoord) -> Drawn {
        let size = style.size() as f32;
        let (width, height) = (text::width(text, size) as i64, text::line_height(size) as i64);
        let anchor = style.anchor();
        // The offset of the text's own top left corner from the anchor, before turning.
        let dx = match anchor.h_pos {
            HPos::Left => 0,
            HPos::Center => -width / 2,
            HPos::Right => -width,
        };
        let dy = match anchor.v_pos {
            VPos::Top => 0,
            VPos::Center => -height / 2,
            VPos::Bottom => -height,
        };
        let (direction, dx, dy) = match style.transform() {
            FontTransform::Rotate90 => (Direction::Down, -dy - height, dx),
            FontTransform::Rotate270 => (Direction::Up, dy, -dx - width),
            _ => (Direction::Right, dx, dy),
        };
        let corner = (i64::from(pos.0) + dx, i64::from(pos.1) + dy);
        text::draw(self.picture, text, corner, size, rgb(style.color()), direction);
        Ok(())
    }
}
