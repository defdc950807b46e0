//! A picture with depth: textured polygons, smooth lines and dots, each hidden by what is before it.

use super::projection::Projected;
use crate::data::rgb::Picture;

/// Pixels of the canvas per pixel of the picture, each way.
pub const SUPERSAMPLING: usize = 2;
/// What lies on a surface is seen in front of it: relative inverse depth.
const BIAS: f32 = 3e-3;

/// How a line or dot is drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pen {
    /// Width of a line or diameter of a dot, pixels of the finished picture.
    pub width: f32,
    /// Display-encoded.
    pub colour: [f32; 3],
    /// 0 leaves what is there, 1 covers it.
    pub opacity: f32,
}

/// A picture in the making. Points are in pixels of the canvas, from the top left.
pub struct Canvas {
    picture: Picture,
    /// 1 / depth of the nearest surface, 1/world unit; 0 where there is none.
    inverse_depth: Vec<f32>,
}

impl Canvas {
    /// An empty canvas for a picture of `width` × `height` pixels.
    pub fn new(width: usize, height: usize, background: [f32; 3]) -> Self {
        let picture = Picture::filled(width * SUPERSAMPLING, height * SUPERSAMPLING, background);
        Self { inverse_depth: vec![0.0; picture.rgb.len()], picture }
    }

    /// Width and height, pixels of the canvas.
    pub fn size(&self) -> (usize, usize) {
        (self.picture.width, self.picture.height)
    }

    /// Covers a convex polygon with `texture`; `uv` in [0, 1] from its top left, perspective-correct.
    pub fn polygon(&mut self, corners: &[(Projected, [f32; 2])], texture: &Picture) {
        for i in 2..corners.len() {
            self.triangle([corners[0], corners[i - 1], corners[i]], texture);
        }
    }

    fn triangle(&mut self, corners: [(Projected, [f32; 2]); 3], texture: &Picture) {
        let [a, b, c] = corners.map(|(p, _)| p);
        let edge =
            |p: Projected, q: Projected, x: f32, y: f32| (q.x - p.x) * (y - p.y) - (q.y - p.y) * (x - p.x);
        let area = edge(a, b, c.x, c.y);
        if area == 0.0 || !area.is_finite() {
            return;
        }
        let range = |values: [f32; 3], end: usize| {
            let (low, high) =
                (values[0].min(values[1]).min(values[2]), values[0].max(values[1]).max(values[2]));
            low.max(0.0) as usize..(high.max(0.0).ceil() as usize).min(end)
        };
        for y in range([a.y, b.y, c.y], self.picture.height) {
            for x in range([a.x, b.x, c.x], self.picture.width) {
                let (px, py) = (x as f32 + 0.5, y as f32 + 0.5);
                let w = [edge(b, c, px, py) / area, edge(c, a, px, py) / area, edge(a, b, px, py) / area];
                if w.iter().any(|&w| w < 0.0) {
                    continue;
                }
                let inverse = w[0] * a.inverse_depth + w[1] * b.inverse_depth + w[2] * c.inverse_depth;
                let index = y * self.picture.width + x;
                if inverse > self.inverse_depth[index] {
                    // u/z, v/z and 1/z are linear over the picture; u and v are not.
                    let over_depth = |i: usize| -> f32 {
                        (0..3).map(|k| w[k] * corners[k].1[i] * corners[k].0.inverse_depth).sum()
                    };
                    self.inverse_depth[index] = inverse;
                    self.picture.rgb[index] =
                        texel(texture, over_depth(0) / inverse, over_depth(1) / inverse);
                }
            }
        }
    }

    /// A straight line; hidden by nearer surfaces, hiding nothing itself.
    pub fn line(&mut self, [a, b]: [Projected; 2], pen: &Pen) {
        let (width, height) = (self.picture.width as f32, self.picture.height as f32);
        let radius = 0.5 * pen.width * SUPERSAMPLING as f32;
        let margin = radius + 1.0;
        // Only what is near the canvas is walked: an end may be very far off.
        let Some((from, to)) = inside([a.x, a.y], [b.x, b.y], [width, height], margin) else { return };
        let (dx, dy) = (b.x - a.x, b.y - a.y);
        let length = dx.hypot(dy);
        let steep = dy.abs() > dx.abs();
        let major = |share: f32| if steep { a.y + share * dy } else { a.x + share * dx };
        let (m0, m1) = (major(from).min(major(to)) - margin, major(from).max(major(to)) + margin);
        // Across, a slanted line is wider than its width: at most by the square root of 2.
        let reach = margin * std::f32::consts::SQRT_2;
        for m in m0.floor() as i64..=m1.ceil() as i64 {
            let along = m as f32 + 0.5;
            let share = match (steep, length > 0.0) {
                (_, false) => 0.0,
                (true, _) => ((along - a.y) / dy).clamp(from, to),
                (false, _) => ((along - a.x) / dx).clamp(from, to),
            };
            let n = if steep { a.x + share * dx } else { a.y + share * dy };
            for n in (n - reach).floor() as i64..=(n + reach).ceil() as i64 {
                let (x, y) = if steep { (n, m) } else { (m, n) };
                let (px, py) = (x as f32 + 0.5 - a.x, y as f32 + 0.5 - a.y);
                let t = if length > 0.0 {
                    ((px * dx + py * dy) / (length * length)).clamp(0.0, 1.0)
                } else {
                    0.0
                };
                let distance = (px - t * dx).hypot(py - t * dy);
                let inverse = a.inverse_depth + t * (b.inverse_depth - a.inverse_depth);
                self.blend(x, y, inverse, pen, (radius + 0.5 - distance).clamp(0.0, 1.0));
            }
        }
    }

    /// A round dot; hidden by nearer surfaces, hiding nothing itself.
    pub fn dot(&mut self, at: Projected, pen: &Pen) {
        self.line([at, at], pen);
    }

    fn blend(&mut self, x: i64, y: i64, inverse_depth: f32, pen: &Pen, coverage: f32) {
        let (Ok(column), Ok(row)) = (usize::try_from(x), usize::try_from(y)) else { return };
        if coverage <= 0.0 || column >= self.picture.width || row >= self.picture.height {
            return;
        }
        if inverse_depth * (1.0 + BIAS) >= self.inverse_depth[row * self.picture.width + column] {
            self.picture.blend(x, y, pen.colour, coverage * pen.opacity);
        }
    }

    /// Whether no surface is before the point.
    pub fn visible(&self, at: Projected) -> bool {
        let (x, y) = (at.x.max(0.0) as usize, at.y.max(0.0) as usize);
        let (width, height) = self.size();
        x >= width || y >= height || at.inverse_depth * (1.0 + BIAS) >= self.inverse_depth[y * width + x]
    }

    /// The finished picture: each pixel the mean of its block.
    pub fn finish(self) -> Picture {
        let (wide, n) = (self.picture.width, SUPERSAMPLING);
        let (width, height) = (wide / n, self.picture.height / n);
        let pixel = |i: usize| {
            let corner = i / width * n * wide + i % width * n;
            let block = (0..n * n).map(|k| self.picture.rgb[corner + k / n * wide + k % n]);
            let sum = block.fold([0.0; 3], |sum: [f32; 3], p| std::array::from_fn(|c| sum[c] + p[c]));
            sum.map(|sum| sum / (n * n) as f32)
        };
        Picture { width, height, rgb: (0..width * height).map(pixel).collect() }
    }
}

/// The shares of the segment between which it is within `margin` of the canvas.
fn inside(a: [f32; 2], b: [f32; 2], size: [f32; 2], margin: f32) -> Option<(f32, f32)> {
    let (mut from, mut to) = (0.0f32, 1.0f32);
    for axis in 0..2 {
        let (low, high, d) = (-margin - a[axis], size[axis] + margin - a[axis], b[axis] - a[axis]);
        if !d.is_finite() || (d == 0.0 && (low > 0.0 || high < 0.0)) {
            return None;
        }
        if d != 0.0 {
            from = from.max((low / d).min(high / d));
            to = to.min((low / d).max(high / d));
        }
    }
    (from <= to).then_some((from, to))
}

/// The texture at (`u`, `v`), between its pixels.
fn texel(texture: &Picture, u: f32, v: f32) -> [f32; 3] {
    let place = |share: f32, length: usize| {
        let at = (share * length as f32 - 0.5).clamp(0.0, (length.max(1) - 1) as f32);
        (at as usize, at.fract())
    };
    let ((x, fx), (y, fy)) = (place(u, texture.width), place(v, texture.height));
    let pixel = |dx: usize, dy: usize| {
        let at = ((x + dx).min(texture.width.max(1) - 1), (y + dy).min(texture.height.max(1) - 1));
        texture.pixel(at.0, at.1).unwrap_or_default()
    };
    let mix = |a: [f32; 3], b: [f32; 3], share: f32| -> [f32; 3] {
        std::array::from_fn(|c| a[c] + share * (b[c] - a[c]))
    };
    mix(mix(pixel(0, 0), pixel(1, 0), fx), mix(pixel(0, 1), pixel(1, 1), fx), fy)
}

#[cfg(test)]
mod tests {
    use super::*;

    const WHITE: [f32; 3] = [1.0; 3];
    const PEN: Pen = Pen { width: 2.0, colour: [0.0; 3], opacity: 1.0 };

    fn at(x: f32, y: f32, depth: f32) -> Projected {
        Projected { x, y, inverse_depth: 1.0 / depth }
    }

    /// A square over columns 4 to 16 of the picture whose right edge is `right` deep.
    fn square(right: f32) -> [(Projected, [f32; 2]); 4] {
        [
            (at(8.0, 0.0, 1.0), [0.0, 0.0]),
            (at(32.0, 0.0, right), [1.0, 0.0]),
            (at(32.0, 40.0, right), [1.0, 1.0]),
            (at(8.0, 40.0, 1.0), [0.0, 1.0]),
        ]
    }

    fn ramp() -> Picture {
        Picture::new(256, 1, (0..256).map(|i| [i as f32 / 255.0, 0.0, 0.0]).collect()).unwrap()
    }

    #[test]
    fn textures_are_perspective_correct() {
        for (right, middle) in [(1.0, 0.5), (3.0, 0.25)] {
            let mut canvas = Canvas::new(20, 20, WHITE);
            canvas.polygon(&square(right), &ramp());
            let picture = canvas.finish();
            // Half way over the picture: u = ½ · (1/right) / mean(1, 1/right).
            let found = picture.pixel(9, 10).unwrap()[0] * 0.5 + picture.pixel(10, 10).unwrap()[0] * 0.5;
            assert!((found - middle).abs() < 0.01, "{right}: {found}");
            assert_eq!(picture.pixel(3, 10), Some(WHITE));
            assert_eq!(picture.pixel(16, 10), Some(WHITE));
        }
    }

    #[test]
    fn nearer_surfaces_hide_whatever_the_order() {
        let (near, far) =
            (square(1.0), square(1.0).map(|(p, uv)| (Projected { inverse_depth: 0.5, ..p }, uv)));
        let red = Picture::filled(1, 1, [1.0, 0.0, 0.0]);
        for order in [[&near, &far], [&far, &near]] {
            let mut canvas = Canvas::new(20, 20, WHITE);
            for corners in order {
                let texture = if corners == &near { &red } else { &ramp() };
                canvas.polygon(corners, texture);
            }
            // A line behind the surface, and one on it.
            canvas.line([at(0.0, 10.0, 2.0), at(40.0, 10.0, 2.0)], &PEN);
            canvas.line([at(0.0, 30.0, 1.0), at(40.0, 30.0, 1.0)], &PEN);
            let picture = canvas.finish();
            assert_eq!(picture.pixel(10, 5), Some([1.0, 0.0, 0.0]));
            assert_eq!(picture.pixel(1, 5), Some([0.0; 3]));
            assert_eq!(picture.pixel(10, 15), Some([0.0; 3]));
        }
    }

    #[test]
    fn a_line_has_its_width_at_every_slope() {
        for (dx, dy) in [(30.0, 0.0), (0.0, 30.0), (25.0, 20.0), (-20.0, 25.0)] {
            let mut canvas = Canvas::new(60, 60, WHITE);
            canvas.line([at(60.0 - dx, 60.0 - dy, 1.0), at(60.0 + dx, 60.0 + dy, 1.0)], &PEN);
            let ink: f32 = canvas.finish().rgb.iter().map(|p| 1.0 - p[0]).sum();
            let expected = dx.hypot(dy) * PEN.width + std::f32::consts::PI;
            assert!((ink / expected - 1.0).abs() < 0.04, "{dx} {dy}: {ink} {expected}");
        }
    }

    #[test]
    fn what_leaves_the_canvas_is_cut_off_at_once() {
        let mut canvas = Canvas::new(20, 20, WHITE);
        canvas.line([at(-1e9, 20.0, 1.0), at(1e9, 20.0, 1.0)], &PEN);
        canvas.line([at(f32::NAN, 0.0, 1.0), at(5.0, 5.0, 1.0)], &PEN);
        canvas.line([at(-5.0, -1e12, 1.0), at(-50.0, 1e12, 1.0)], &PEN);
        canvas.dot(at(-900.0, 3.0, 1.0), &PEN);
        let off = |p: Projected| (Projected { x: p.x * 1e6 - 3e6, ..p }, [0.0; 2]);
        canvas.polygon(&[off(at(0.0, 0.0, 1.0)), off(at(9.0, 0.0, 1.0)), off(at(0.0, 9.0, 1.0))], &ramp());
        let picture = canvas.finish();
        assert!(picture.pixel(10, 10).unwrap()[0] < 0.1);
        assert!(picture.pixel(10, 2).unwrap()[0] < 0.05);
    }
}
