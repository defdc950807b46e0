//! One viewpoint of the scene as a picture.

use super::canvas::{Canvas, Pen, SUPERSAMPLING};
use super::projection::Viewpoint;
use super::scene::{Scene, ShownCamera};
use super::sheet::short;
use crate::data::rgb::Picture;
use crate::show::colour_map::ColourMap;
use crate::show::text;
use crate::show::text::Direction;
use glam::Vec3;

/// Vertical field of view, degrees.
const FOV: f32 = 32.0;
const LABEL_SIZE: f32 = 15.0;
const NUMBER_SIZE: f32 = 12.0;

/// Where dots are coloured from near to far; legends show the same.
pub const DISTANCE_MAP: ColourMap = ColourMap::Viridis;
/// Behind everything.
pub const PAPER: [f32; 3] = [1.0, 1.0, 1.0];
/// Text.
pub const INK: [f32; 3] = [0.13, 0.13, 0.15];
/// The world's x, y, z.
pub const AXES: [(&str, [f32; 3]); 3] =
    [("x", [0.80, 0.12, 0.12]), ("y", [0.10, 0.52, 0.14]), ("z", [0.12, 0.25, 0.85])];
/// A camera's frustum.
pub const FRUSTUM: Pen = Pen { width: 1.1, colour: [0.16, 0.19, 0.26], opacity: 0.9 };
/// A ray from near to far.
pub const RAY: Pen = Pen { width: 0.9, colour: [0.45, 0.50, 0.60], opacity: 0.55 };
/// A ray from its camera to near.
const BEFORE_NEAR: Pen = Pen { opacity: 0.22, ..RAY };
/// The scene box.
pub const BOX: Pen = Pen { width: 1.5, colour: [0.85, 0.42, 0.05], opacity: 0.9 };
/// Where the rays of a camera that is alone begin and end.
pub const RANGE: Pen = Pen { width: 1.2, colour: [0.55, 0.20, 0.60], opacity: 0.8 };
/// A sample that the occupancy grid culls.
pub const CULLED: Pen = Pen { width: 1.9, colour: [0.55, 0.56, 0.60], opacity: 0.8 };
/// The rim of a live sample, so that pale ones stand out from paper.
pub const RIM: Pen = Pen { width: 5.2, colour: [0.15, 0.15, 0.2], opacity: 0.6 };
/// Dots of many samples shrink to this share.
const SMALLEST_DOT: f32 = 0.55;
/// A live sample; its colour is its distance.
pub const LIVE: Pen = Pen { width: 4.2, colour: [0.0; 3], opacity: 1.0 };

/// The scene as seen by someone in direction `towards` of it, with `up` upwards, `size` in pixels.
pub fn panel(scene: &Scene, towards: Vec3, up: Vec3, size: (usize, usize)) -> Picture {
    let mut canvas = Canvas::new(size.0, size.1, PAPER);
    let view = Viewpoint::fitted(&scene.points(), towards, up, canvas.size(), FOV);
    for camera in &scene.cameras {
        draw_photograph(&mut canvas, &view, camera, scene.frustum);
    }
    let mut line = |a: Vec3, b: Vec3, pen: &Pen| {
        if let Some(ends) = view.segment(a, b) {
            canvas.line(ends, pen);
        }
    };
    for lines in scene.outline() {
        lines.windows(2).for_each(|ends| line(ends[0], ends[1], &BOX));
    }
    for ray in &scene.rays {
        line(ray.origin, ray.at(ray.near), &BEFORE_NEAR);
        line(ray.at(ray.near), ray.at(scene.bounds.far), &RAY);
    }
    for camera in &scene.cameras {
        let corners = camera.corners(scene.frustum);
        for i in 0..4 {
            line(camera.camera.pose().position, corners[i], &FRUSTUM);
            line(corners[i], corners[(i + 1) % 4], &FRUSTUM);
        }
        if scene.alone {
            for t in [camera.near, scene.bounds.far] {
                let border = camera.border(t);
                border.windows(2).for_each(|ends| line(ends[0], ends[1], &RANGE));
            }
        }
    }
    draw_samples(&mut canvas, &view, scene);
    draw_axes(&mut canvas, &view, scene);
    let labels = labels(&canvas, &view, scene);
    let (mut picture, mut taken) = (canvas.finish(), Vec::new());
    labels.iter().for_each(|label| label.draw(&mut picture, &mut taken));
    picture
}

fn draw_photograph(canvas: &mut Canvas, view: &Viewpoint, camera: &ShownCamera, z: f32) {
    let [a, b, c, d] = camera.corners(z);
    let corners = [(a, [0.0, 0.0]), (b, [1.0, 0.0]), (c, [1.0, 1.0]), (d, [0.0, 1.0])];
    canvas.polygon(&view.polygon(&corners), &camera.thumbnail.0);
}

fn draw_axes(canvas: &mut Canvas, view: &Viewpoint, scene: &Scene) {
    for (axis, (_, colour)) in AXES.iter().enumerate() {
        let pen = Pen { width: 2.6, colour: *colour, opacity: 1.0 };
        if let Some(ends) = view.segment(scene.axes.origin, scene.axes.tip(Vec3::AXES[axis])) {
            canvas.line(ends, &pen);
        }
    }
}

/// Culled samples below live ones, far ones below near ones.
fn draw_samples(canvas: &mut Canvas, view: &Viewpoint, scene: &Scene) {
    let mut live = Vec::new();
    let (low, high) = scene.colour_range();
    // Thousands of dots would cover each other.
    let scale = (800.0 / scene.live().max(1) as f32).sqrt().clamp(SMALLEST_DOT, 1.0);
    let sized = |pen: Pen| Pen { width: pen.width * scale, ..pen };
    let colour = |t: f32| DISTANCE_MAP.colour((t - low) / (high - low));
    for ray in &scene.rays {
        for at in ray.culled.iter().filter_map(|&t| view.project(ray.at(t))) {
            canvas.dot(at, &CULLED);
        }
        live.extend(ray.live.iter().filter_map(|&t| Some((view.project(ray.at(t))?, colour(t)))));
    }
    live.sort_by(|a, b| a.0.inverse_depth.total_cmp(&b.0.inverse_depth));
    for (at, colour) in live {
        canvas.dot(at, &sized(RIM));
        canvas.dot(at, &sized(Pen { colour, ..LIVE }));
    }
}

/// A word beside a point of the scene.
struct Label {
    text: String,
    size: f32,
    colour: [f32; 3],
    /// Pixels of the picture.
    corner: (i64, i64),
}

impl Label {
    /// Above and to the right of `at`, or below where `below` says so; `None` behind the viewer.
    fn new(
        view: &Viewpoint,
        at: Vec3,
        text: String,
        (size, colour): (f32, [f32; 3]),
        below: bool,
    ) -> Option<Self> {
        let at = view.project(at)?;
        let scale = SUPERSAMPLING as f32;
        let rise = if below { 5.0 } else { -size - 1.0 };
        let corner = (at.x / scale + 5.0, at.y / scale + rise);
        Some(Self { text, size, colour, corner: (corner.0 as i64, corner.1 as i64) })
    }

    /// Draws it on a halo of paper, moved inside where it would be cut off; not over those in `taken`.
    fn draw(&self, picture: &mut Picture, taken: &mut Vec<[i64; 4]>) {
        let (w, h) = (text::width(&self.text, self.size), text::line_height(self.size));
        let most = |length: usize, used: usize| (length.saturating_sub(used + 2) as i64).max(2);
        let x = self.corner.0.clamp(2, most(picture.width, w));
        let y = self.corner.1.clamp(2, most(picture.height, h));
        let place = [x, y, x + w as i64, y + h as i64];
        if taken.iter().any(|t| t[0] < place[2] && place[0] < t[2] && t[1] < place[3] && place[1] < t[3]) {
            return;
        }
        taken.push(place);
        for (dx, dy) in [(-1, 0), (1, 0), (0, -1), (0, 1), (-1, -1), (1, 1), (-1, 1), (1, -1)] {
            text::draw(picture, &self.text, (x + dx, y + dy), self.size, PAPER, Direction::Right);
        }
        text::draw(picture, &self.text, (x, y), self.size, self.colour, Direction::Right);
    }
}

/// The words of a viewpoint, the most important ones first.
fn labels(canvas: &Canvas, view: &Viewpoint, scene: &Scene) -> Vec<Label> {
    let mut labels = Vec::new();
    for (axis, (name, colour)) in AXES.iter().enumerate() {
        let style = (LABEL_SIZE + 7.0, *colour);
        labels.push(Label::new(view, scene.axes.tip(Vec3::AXES[axis]), (*name).into(), style, false));
    }
    if let (true, Some(camera)) = (scene.alone, scene.cameras.first()) {
        let style = (LABEL_SIZE, INK);
        let name = format!("camera {}", camera.index);
        // On the side that the camera looks away from.
        let pose = camera.camera.pose();
        let height = |p: Vec3| view.project(p).map_or(0.0, |p| p.y);
        let below = height(pose.position + pose.forward() * scene.frustum) < height(pose.position);
        labels.push(Label::new(view, pose.position, name, style, below));
        for (t, name) in [(camera.near, "near"), (scene.bounds.far, "far")] {
            let style = (LABEL_SIZE, RANGE.colour);
            let corner = camera.border(t).first().copied();
            labels
                .extend(corner.map(|at| Label::new(view, at, format!("{name} {}", short(t)), style, false)));
        }
    } else {
        let style = (NUMBER_SIZE, INK);
        for camera in &scene.cameras {
            let at = camera.camera.pose().position;
            if view.project(at).is_some_and(|at| canvas.visible(at)) {
                labels.push(Label::new(view, at, camera.index.to_string(), style, false));
            }
        }
    }
    labels.into_iter().flatten().collect()
}
