//! Point clouds: of the surfaces that views see, or of a mesh.

use super::{Mesh, Vertex};
use crate::data::View;
use crate::data::cameras::scaled;
use crate::measure::frame::{self, Frame};
use anyhow::{Context, anyhow};
use glam::Vec3;
use nerf_core::camera::Camera;
use nerf_core::plan::Plan;
use nerf_core::render::Renderer;
use nerf_core::sampling::{Purpose, uniform};
use nerf_core::space::SceneBox;

/// Number of pixels per view of a first, coarse pass, which estimates the fraction of opaque pixels.
const PILOT: f64 = 1024.0;
/// Opacity above which a pixel shows a surface.
const OPAQUE: f32 = 0.5;

/// Returns a point cloud of about `count` points: at the median distances of the views' rays, with the rays' colours,
/// within the box `within`. `plan` must output colours, opacity, median distances and normals. `each` gets the number
/// of finished views. Fails if no pixel shows a surface within the box.
pub fn points_of_views(
    renderer: &Renderer<'_>,
    plan: &Plan<'_>,
    views: &[View],
    count: usize,
    within: Option<&SceneBox>,
    mut each: impl FnMut(usize),
) -> anyhow::Result<Mesh> {
    let frame_of = |view: &View, pixels: f64| -> anyhow::Result<_> {
        let (width, height) = view.size();
        let share = (pixels / (f64::from(width) * f64::from(height))).sqrt().min(1.0);
        let side = |pixels: u32| ((f64::from(pixels) * share).round() as u32).max(1);
        let camera = scaled(&view.camera, (side(width), side(height))).context("camera")?;
        Ok((camera, frame::render(renderer, plan, &camera)?))
    };
    let hits = |camera: &Camera, frame: &Frame| -> Vec<Vertex> {
        let hit = |pixel: usize| {
            let (x, y) = ((pixel % frame.width) as f32 + 0.5, (pixel / frame.width) as f32 + 0.5);
            let position = camera.ray(x, y).at(frame.median_distance[pixel]);
            let is_in =
                frame.opacity[pixel] > OPAQUE && within.is_none_or(|bounds| bounds.contains(position));
            let (normal, rgb) = (frame.normals[pixel], frame.rgb[pixel]);
            is_in.then(|| Vertex { position: position.into(), normal, rgb })
        };
        (0..frame.rgb.len()).filter_map(hit).collect()
    };
    let (mut seen, mut asked) = (0, 0);
    for view in views {
        let (camera, frame) = frame_of(view, PILOT)?;
        (seen, asked) = (seen + hits(&camera, &frame).len(), asked + frame.opacity.len());
    }
    let nothing = || {
        let views = views.len();
        anyhow!(
            "--data: expected views that see something opaque within the box, found none in {views} views"
        )
    };
    if seen == 0 {
        return Err(nothing());
    }
    let a_view = count as f64 / views.len() as f64 * asked as f64 / seen as f64;
    let mut vertices = Vec::new();
    for (i, view) in views.iter().enumerate() {
        let (camera, frame) = frame_of(view, a_view)?;
        vertices.extend(hits(&camera, &frame));
        each(i + 1);
    }
    match vertices.is_empty() {
        true => Err(nothing()),
        false => Ok(Mesh { vertices, ..Mesh::default() }),
    }
}

/// Samples `count` random points, uniformly distributed over the area of a mesh. The same `seed` gives the same points.
pub fn points_of_surface(mesh: &Mesh, count: usize, seed: u64) -> Mesh {
    let corners = |triangle: &[u32; 3]| triangle.map(|i| mesh.vertices[i as usize]);
    let mut areas = Vec::with_capacity(mesh.triangles.len());
    let mut total = 0.0f64;
    for triangle in &mesh.triangles {
        let [a, b, c] = corners(triangle).map(|vertex| Vec3::from(vertex.position));
        total += 0.5 * f64::from((b - a).cross(c - a).length());
        areas.push(total);
    }
    let draw = |i: usize, axis: u64| f64::from(uniform(seed, Purpose::Jitter, axis, i as u64));
    let point = |i: usize| {
        // Stratified: one point in each of `count` equal parts of the total area.
        let at = (i as f64 + draw(i, 0)) / count as f64 * total;
        let triangle = areas.partition_point(|&area| area <= at).min(areas.len() - 1);
        let (u, v) = (draw(i, 1).sqrt() as f32, draw(i, 2) as f32);
        let shares = [1.0 - u, u * (1.0 - v), u * v];
        let of = corners(&mesh.triangles[triangle]);
        let mix = |part: fn(&Vertex) -> [f32; 3]| -> Vec3 {
            of.iter().zip(shares).map(|(vertex, share)| share * Vec3::from(part(vertex))).sum()
        };
        Vertex {
            position: mix(|vertex| vertex.position).into(),
            normal: mix(|vertex| vertex.normal).normalize_or_zero().into(),
            rgb: mix(|vertex| vertex.rgb).into(),
        }
    };
    let vertices = if areas.is_empty() { Vec::new() } else { (0..count).map(point).collect() };
    Mesh { origin: mesh.origin, vertices, triangles: Vec::new() }
}
