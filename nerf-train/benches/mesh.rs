//! How close an exported mesh is to what is rendered, and to the demo's true shapes.
//!
//! `NERF_BENCH_BLOB=lego.nerf cargo bench -p nerf-train --bench mesh [-- RESOLUTION]` (256). Rays to every vertex are
//! rendered, by as many samples as there can be, along its normal from 2, 2.25, … 10 cells in front (from further away
//! they may meet something else before it): counted is the one whose opacity crosses 1/2 nearest to the vertex. Also
//! the triangles whose normal is against those of their vertices, by area; and of a blob named `demo.nerf` the distance
//! of its vertices from the analytic shapes, over the diagonal of the scene's box, and the angle of their normals to
//! those of the shapes.

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

/// Quarters of a cell in front of a vertex from where rays come.
const BEFORE: std::ops::RangeInclusive<u32> = 8..=40;

/// Samples a ray: the most there can be, whatever steps the mesh was made with.
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

/// Share of the area whose triangles are turned against the normals of their vertices.
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

/// The gradient of the distance from the demo's shapes.
fn true_normal(point: Vec3) -> Vec3 {
    let rise =
        |axis: Vec3| demo::signed_distance(point + 4e-3 * axis) - demo::signed_distance(point - 4e-3 * axis);
    Vec3::from(Vec3::AXES.map(rise)).normalize_or_zero()
}

/// Distance at which the opacity of rays along the vertices' normals crosses 1/2; they start `before` cells in front.
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

/// Median, 95th percentile and largest.
fn spread(values: &mut [f32]) -> String {
    values.sort_by(f32::total_cmp);
    let at =
        |share: f64| values.get(((values.len() - 1) as f64 * share) as usize).copied().unwrap_or(f32::NAN);
    if values.is_empty() {
        return "none".into();
    }
    format!("median {:.3}, 95th percentile {:.3}, largest {:.3}", at(0.5), at(0.95), at(1.0))
}
