//! Accuracy of an exported mesh, compared with renderings and with the demo's true shapes.
//!
//! `NERF_BENCH_BLOB=lego.nerf cargo bench -p nerf-train --bench mesh [-- RESOLUTION]` exports a mesh, and prints the
//! figures below. Default resolution: 256.
//!
//! - Distance, in cells, from each vertex to the point where the opacity of a ray crosses 1/2. Rays run inward along
//!   the vertex's normal, from 2, 2.25, … 10 cells in front of the vertex; the crossing nearest to the vertex counts.
//!   Rays from further away may meet another surface first.
//! - Triangles that face against the normals of their vertices, as a percentage of the mesh's area.
//! - For a blob named `demo.nerf`: distance of the vertices from the analytic shapes, as a percentage of the diagonal
//!   of the scene box, and angle between the vertices' normals and those of the shapes.

use glam::Vec3;
use nerf_core::Kernel;
use nerf_core::blob::Blob;
use nerf_core::camera::Ray;
use nerf_core::memory::Line;
use nerf_core::plan::{Batch, Outputs, Plan, Quality};
use nerf_core::render::{RaySegment, Renderer, Worker};
use nerf_core::volume::Pixel;
use nerf_train::data::demo;
use nerf_train::show::export::{Field, Lattice, Mesh, Surface, Vertex, mesh};
use std::time::Instant;

/// Distances from the starts of a vertex's rays to the vertex, in quarters of a cell.
const BEFORE: std::ops::RangeInclusive<u32> = 8..=40;

/// Number of samples per ray in the comparison with renderings; the largest number that a plan allows.
const FINEST: u16 = 4096;

fn main() {
    let file = std::env::var("NERF_BENCH_BLOB").expect("NERF_BENCH_BLOB: a scene");
    let resolution = std::env::args().skip(1).find_map(|argument| argument.parse().ok()).unwrap_or(256);
    let bytes = std::fs::read(&file).expect("NERF_BENCH_BLOB: a file");
    let blob = Blob::open(&bytes).expect("NERF_BENCH_BLOB: a blob");
    let bounds = blob.scene_box().expect("a scene");
    let quality = Quality { occupancy: true, ..Quality::EXACT };
    let plan = Plan::new(&blob, &quality, Outputs::ALL, Batch::FULL).expect("a plan");
    let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, Kernel::detect())];
    let renderer = Renderer::new(blob, Kernel::detect(), &mut memory).expect("a renderer");

    let start = Instant::now();
    let lattice = Lattice::new(&bounds, resolution).expect("a lattice");
    let field = Field::new(&renderer, &plan);
    let mesh = mesh(&field, &lattice, Surface::Visible, |_| {}).expect("a mesh");
    let seconds = start.elapsed().as_secs_f64();
    let threads = rayon::current_num_threads();
    println!(
        "{} vertices, {} triangles in {seconds:.2} s, {threads} threads",
        mesh.vertices.len(),
        mesh.triangles.len()
    );

    let quality = Quality { samples: FINEST, ..quality };
    let outputs = Outputs { median_distance: true, ..Outputs::ALL };
    let plan = Plan::new(renderer.blob(), &quality, outputs, Batch::FULL).expect("a plan");
    let mut workspace = vec![Line::UNINIT; renderer.workspace_lines(&plan)];
    let mut worker = renderer.worker(&plan, &mut workspace).expect("a worker");
    let mut away = vec![f32::INFINITY; mesh.vertices.len()];
    for before in BEFORE {
        let found = crossings(&mut worker, lattice.cell, 0.25 * before as f32, &mesh.vertices);
        for (away, found) in away.iter_mut().zip(found) {
            let cells = |distance: f32| (distance / lattice.cell - 0.25 * before as f32).abs();
            *away = away.min(found.map_or(f32::INFINITY, cells));
        }
    }
    let far = away.iter().filter(|&&cells| cells > 2.0).count();
    println!("from where opacity crosses 1/2, cells: {}; further than 2: {far}", spread(&mut away));
    println!("triangles against their normals: {:.2} % of the area", 100.0 * turned_away(&mesh));

    if file.ends_with("demo.nerf") {
        let diagonal = (bounds.max - bounds.min).length();
        let distance =
            |vertex: &Vertex| 100.0 * demo::signed_distance(vertex.position.into()).abs() / diagonal;
        let mut distances: Vec<f32> = mesh.vertices.iter().map(distance).collect();
        println!("from the true shapes, % of the diagonal: {}", spread(&mut distances));
        let angle = |vertex: &Vertex| true_normal(vertex.position.into()).angle_between(vertex.normal.into());
        let mut angles: Vec<f32> = mesh.vertices.iter().map(|vertex| angle(vertex).to_degrees()).collect();
        println!("of the true normals, degrees: {}", spread(&mut angles));
    }
}

/// Returns the fraction of the mesh's area in triangles that face against the normals of their vertices.
fn turned_away(mesh: &Mesh) -> f32 {
    let (mut away, mut all) = (0.0, 0.0);
    for triangle in &mesh.triangles {
        let corners = triangle.map(|i| mesh.vertices[i as usize]);
        let [a, b, c] = corners.map(|vertex| Vec3::from(vertex.position));
        let normal: Vec3 = corners.iter().map(|vertex| Vec3::from(vertex.normal)).sum();
        let across = (b - a).cross(c - a);
        all += across.length();
        away += if across.dot(normal) < 0.0 { across.length() } else { 0.0 };
    }
    away / all
}

/// Returns the unit normal of the demo's shapes at `point`: the normalised gradient of their signed distance.
fn true_normal(point: Vec3) -> Vec3 {
    let rise =
        |axis: Vec3| demo::signed_distance(point + 4e-3 * axis) - demo::signed_distance(point - 4e-3 * axis);
    Vec3::from(Vec3::AXES.map(rise)).normalize_or_zero()
}

/// Returns, for each vertex, the distance at which the opacity along the vertex's ray crosses 1/2, world units; `None`
/// if the opacity stays below 1/2. A ray starts `before` cells in front of its vertex, and runs against the normal.
fn crossings(worker: &mut Worker<'_>, cell: f32, before: f32, vertices: &[Vertex]) -> Vec<Option<f32>> {
    let ray = |vertex: &Vertex| {
        let (position, normal) = (Vec3::from(vertex.position), Vec3::from(vertex.normal));
        let ray = Ray { origin: position + before * cell * normal, dir: -normal };
        RaySegment { ray, t_min: 0.0, t_max: (before + 2.0) * cell }
    };
    let rays: Vec<RaySegment> = vertices.iter().map(ray).collect();
    let mut found = vec![None; rays.len()];
    let mut take = |i: usize, pixel: &Pixel| {
        found[i] = (pixel.opacity >= 0.5).then_some(pixel.median_distance);
    };
    worker.render_rays(&rays, None, &mut take).expect("rays");
    found
}

/// Sorts `values`, and returns median, 95th percentile and largest value as text; "none" if there are no values.
fn spread(values: &mut [f32]) -> String {
    values.sort_by(f32::total_cmp);
    let at =
        |share: f64| values.get(((values.len() - 1) as f64 * share) as usize).copied().unwrap_or(f32::NAN);
    if values.is_empty() {
        return "none".into();
    }
    format!("median {:.3}, 95th percentile {:.3}, largest {:.3}", at(0.5), at(0.95), at(1.0))
}
