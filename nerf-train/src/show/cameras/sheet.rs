//! The picture to print: two viewpoints side by side, with title and legend.

use super::canvas::{Canvas, Pen};
use super::drawing::{AXES, BOX, CULLED, DISTANCE_MAP, FRUSTUM, INK, LIVE, PAPER, RANGE, RAY, RIM, panel};
use super::projection::Projected;
use super::scene::Scene;
use crate::data::rgb::Picture;
use crate::show::axis;
use crate::show::text;
use crate::show::text::Direction;
use glam::Vec3;

const MARGIN: usize = 16;
const TITLE: f32 = 24.0;
const TEXT: f32 = 17.0;
const FAINT: [f32; 3] = [0.38; 3];
const FRAME: [f32; 3] = [0.8; 3];

/// Draws `scene` from three quarters and from above, `width` × `height` pixels, at least 640 × 400.
pub fn sheet(scene: &Scene, width: usize, height: usize) -> Picture {
    let mut page = Picture::filled(width, height, PAPER);
    let inner = width.saturating_sub(2 * MARGIN);
    let mut y = lines(&mut page, &scene.title(), (MARGIN, MARGIN), TITLE, INK, inner);
    y = lines(&mut page, &scene.facts(), (MARGIN, y), TEXT, FAINT, inner) + 4;

    let legend = Legend::of(scene, inner);
    let bottom = height.saturating_sub(legend.height + MARGIN);
    let label = text::line_height(TEXT);
    let size = (inner.saturating_sub(MARGIN) / 2, bottom.saturating_sub(y + label + 8 + MARGIN));
    let ahead = scene.towards_viewer(0.0);
    let names = [
        ("three-quarter view".to_owned(), scene.towards_viewer(24.0), scene.up),
        (format!("from above (looking along {})", axis_name(-scene.up)), scene.up, -ahead),
    ];
    for (i, (name, towards, up)) in names.iter().enumerate() {
        let left = MARGIN + i * (size.0 + MARGIN);
        text::draw(&mut page, name, (left as i64, y as i64), TEXT, INK, Direction::Right);
        let top = y + label + 4;
        page.paste(&panel(scene, *towards, *up, size), left, top);
        frame(&mut page, (left, top), size);
    }
    legend.draw(&mut page, (MARGIN, bottom));
    page
}

impl Scene {
    /// What is shown, in a line.
    pub fn title(&self) -> String {
        match self.cameras.as_slice() {
            [only] if self.alone => {
                format!("{}: {} camera {} alone ({})", self.name, self.split, only.index, only.name)
            }
            cameras => format!("{}: {} {} cameras", self.name, cameras.len(), self.split),
        }
    }

    /// Which rays and samples, of what, and in which units.
    pub fn facts(&self) -> String {
        let s = &self.step;
        let of = match self.alone {
            true => format!("{} rays that step {} draws where this camera is alone", self.rays.len(), s.step),
            false if self.split == "train" => {
                format!("{} of the {} rays of training step {}", self.rays.len(), s.rays, s.step)
            }
            // Training never sees other views.
            false => format!(
                "{} of the {} rays that step {} would draw from these views",
                self.rays.len(),
                s.rays,
                s.step
            ),
        };
        let culled = match s.occupancy {
            true => format!(", {} culled by the occupancy grid that training starts with", self.culled()),
            false => String::new(),
        };
        let (b, ends) = (&self.bounds, self.bounds.scene_box);
        let range = format!("from near {} to far {}", short(b.near), short(b.far));
        let range = match (s.marched, &b.contraction) {
            (_, Some(_)) => format!("at most {} steps a ray, {range} and on, which is not drawn", s.bins),
            (true, None) => format!("at most {} steps a ray, {range}", s.bins),
            (false, None) => format!("{} bins {range}", s.bins),
        };
        let place = match &b.contraction {
            Some(contraction) => format!(
                "unbounded, contracted outside of a ball of radius {} around {}",
                short(contraction.radius()),
                corner(contraction.centre())
            ),
            None => format!("scene box {} to {}", corner(ends.min), corner(ends.max)),
        };
        format!(
            "{of} (seed {}); {} live samples{culled}; {range}; {place}; lengths in world units",
            s.seed,
            self.live()
        )
    }

    /// What the outline shows.
    pub fn ends(&self) -> &'static str {
        match self.bounds.contraction {
            Some(_) => "ball outside of which space is contracted",
            None => "scene box",
        }
    }
}

/// A length with at most three decimals.
pub(super) fn short(value: f32) -> String {
    let text = format!("{value:.3}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

fn corner(p: Vec3) -> String {
    format!("({}, {}, {})", short(p.x), short(p.y), short(p.z))
}

/// `z` or `−z` of a direction along a world axis.
fn axis_name(direction: Vec3) -> String {
    let axis = direction.abs().max_position();
    let sign = if direction[axis] < 0.0 { "−" } else { "" };
    format!("{sign}{}", AXES[axis].0)
}

/// Text broken into lines; the row below it.
fn lines(
    page: &mut Picture,
    text: &str,
    (x, y): (usize, usize),
    size: f32,
    colour: [f32; 3],
    widest: usize,
) -> usize {
    let mut y = y;
    for line in text::wrap(text, size, widest) {
        text::draw(page, &line, (x as i64, y as i64), size, colour, Direction::Right);
        y += text::line_height(size) + 2;
    }
    y
}

fn frame(page: &mut Picture, (left, top): (usize, usize), (width, height): (usize, usize)) {
    let (left, top, right, bottom) = (left as i64, top as i64, (left + width) as i64, (top + height) as i64);
    for x in left..right {
        page.blend(x, top, FRAME, 1.0);
        page.blend(x, bottom - 1, FRAME, 1.0);
    }
    for y in top..bottom {
        page.blend(left, y, FRAME, 1.0);
        page.blend(right - 1, y, FRAME, 1.0);
    }
}

/// What a key looks like.
#[derive(Clone, Copy)]
enum Key {
    Line(Pen),
    Dots(&'static [Pen]),
    Axes,
}

/// Keys in rows, then the colours of the distances.
struct Legend<'s> {
    scene: &'s Scene,
    /// Corner of each key within the legend, pixels.
    keys: Vec<(Key, String, (usize, usize))>,
    height: usize,
}

const KEY: usize = 44;
const BAR: usize = 16;
const LIVE_KEY: [Pen; 2] = [RIM, Pen { colour: [0.13, 0.57, 0.55], ..LIVE }];

impl<'s> Legend<'s> {
    fn of(scene: &'s Scene, widest: usize) -> Self {
        let whose =
            if scene.axes.origin == Vec3::ZERO { "world axes" } else { "world axes at the scene's centre" };
        let mut entries = vec![
            (Key::Line(FRUSTUM), "camera: frustum and photograph".to_owned()),
            (Key::Line(RAY), "ray, from its camera's near to far (fainter before)".to_owned()),
            (Key::Dots(&LIVE_KEY), "live sample, coloured by t".to_owned()),
        ];
        if scene.step.occupancy {
            entries.push((Key::Dots(&[CULLED]), "culled sample".to_owned()));
        }
        entries.push((Key::Line(BOX), scene.ends().to_owned()));
        if scene.alone {
            entries.push((Key::Line(RANGE), "the picture's border at near and at far".to_owned()));
        }
        entries.push((Key::Axes, format!("{whose} x, y, z, {}", scene.axes.length_in_words())));
        let step = text::line_height(TEXT) + 6;
        let (mut x, mut y) = (0, 0);
        let keys = entries.into_iter().map(|(key, name)| {
            let width = KEY + 8 + text::width(&name, TEXT);
            if x > 0 && x + width > widest {
                (x, y) = (0, y + step);
            }
            let corner = (x, y);
            x += width + 28;
            (key, name, corner)
        });
        let keys: Vec<_> = keys.collect();
        let rows = keys.last().map_or(0, |key| key.2.1) + step;
        Self { scene, keys, height: rows + BAR + 10 + text::line_height(TEXT) }
    }

    fn draw(&self, page: &mut Picture, (left, top): (usize, usize)) {
        let line = text::line_height(TEXT);
        for (key, name, (x, y)) in &self.keys {
            let (x, y) = (left + x, top + y);
            page.paste(&key_picture(*key, line), x, y);
            text::draw(page, name, ((x + KEY + 8) as i64, y as i64), TEXT, INK, Direction::Right);
        }
        let range = self.scene.colour_range();
        let (low, high) = (f64::from(range.0), f64::from(range.1));
        let top = top + self.height - BAR - 10 - line;
        let title = "t of live samples along their ray, world units";
        text::draw(page, title, (left as i64, top as i64), TEXT, INK, Direction::Right);
        let bar = left + text::width(title, TEXT) + 16;
        let length = (page.width.saturating_sub(bar + MARGIN + 30)).clamp(100, 640);
        for x in 0..length {
            let colour = DISTANCE_MAP.colour(x as f32 / (length - 1) as f32);
            (0..BAR).for_each(|y| page.blend((bar + x) as i64, (top + y) as i64, colour, 1.0));
        }
        let ticks = axis::nice_ticks(low, high, 7);
        for (tick, label) in ticks.iter().zip(axis::labels(&ticks)) {
            let x = bar as i64 + ((tick - low) / (high - low) * (length - 1) as f64).round() as i64;
            (0..5).for_each(|y| page.blend(x, (top + BAR + y) as i64, INK, 1.0));
            let corner = (x - text::width(&label, TEXT) as i64 / 2, (top + BAR + 6) as i64);
            text::draw(page, &label, corner, TEXT, INK, Direction::Right);
        }
    }
}

/// A key, drawn with the pens that it explains.
fn key_picture(key: Key, height: usize) -> Picture {
    let mut canvas = Canvas::new(KEY, height, PAPER);
    let (width, height) = canvas.size();
    let at = |share: f32| Projected { x: share * width as f32, y: 0.5 * height as f32, inverse_depth: 1.0 };
    match key {
        Key::Line(pen) => canvas.line([at(0.05), at(0.95)], &pen),
        Key::Dots(pens) => {
            for share in [0.2, 0.5, 0.8] {
                pens.iter().for_each(|pen| canvas.dot(at(share), pen));
            }
        }
        Key::Axes => {
            for (i, (_, colour)) in AXES.iter().enumerate() {
                let (from, to) = (0.05 + 0.32 * i as f32, 0.30 + 0.32 * i as f32);
                canvas.line([at(from), at(to)], &Pen { width: 2.6, colour: *colour, opacity: 1.0 });
            }
        }
    }
    canvas.finish()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_short_and_axes_have_names() {
        assert_eq!([short(2.0), short(1.23456), short(-0.5), short(10.0)], ["2", "1.235", "-0.5", "10"]);
        assert_eq!(axis_name(-Vec3::Z), "−z");
        assert_eq!(axis_name(Vec3::Y), "y");
    }
}
