//! How close an exported mesh is to what is rendered, and to the demo's true shapes.
//!
//! `NERF_BENCH_BLOB=lego.nerf cargo bench -p nerf-train --bench mesh [-- RESOLUTION]` (256). To every vertex light
//! comes along its normal from 2, 2.25, … 10 cells in front (from far away there may be something else before it): counted is
//! the one of which half is gone nearest to the vertex. Of a blob named `demo.nerf` also the distance of its vertices from the
//! analytic shapes, over the diagonal of the scene's box.

use glam::Vec3;
use nerf_core::Kernel;
use nerf_core::blob::Blob;
use nerf_core::camera::Ray;
use nerf_core::memory::Line;
use nerf_core::plan::{Batch, Outputs, Plan, Quality};
use nerf_core::render::{RaySegment, Renderer};
use nerf_train::data::demo;
use nerf_train::show::export::{Field, Lattice, Surface, Vertex, mesh};
use std::time::Instant;

/// Cells in front of a vertex where light comes from.
const BEFORE: std::ops::RangeInclusive<u32> = 8..=40;

fn main() {
    let file = std::env::var("NERF_BENCH_BLOB").expect("NERF_BENCH_BLOB: a scene");
    let resolution = std::env::args().skip(1).find_map(|argument| argument.parse().ok()).unwrap_or(256);
    let bytes = std::fs::read(&file).expect("NERF_BENCH_BLOB: a file");
    let blob = Blob::open(&bytes).expect("NERF_BENCH_BLOB: a blob");
    let bounds = blob.scene_box().expect("a scene");
    let quality = Quality { occupancy: true, ..Quality::EXACT };
    let outputs = Outputs { median_distance: true, ..Outputs::ALL };
    let plan = Plan::new(&blob, &quality, outputs, Batch::FULL).expect("a plan");
    let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, Kernel::detect())];
    let renderer = Renderer::new(blob, Kernel::detect(), &mut memory).expect("a renderer");

    let start = Instant::now();
    let lattice = Lattice::new(&bounds, resolution).expect("a lattice");
    let field = Field::new(&renderer, &plan);
    let mesh = mesh(&field, &lattice, Surface::Seen, |_| {}).expect("a mesh");
    let seconds = start.elapsed().as_secs_f64();
    let threads = rayon::current_num_threads();
    println!(
        "{} vertices, {} triangles in {seconds:.2} s, {threads} threads",
        mesh.vertices.len(),
        mesh.triangles.len()
    );

    let mut away = vec![f32::INFINITY; mesh.vertices.len()];
    for before in BEFORE {
        let found = crossings(&field, lattice.cell, 0.25 * before as f32, &mesh.vertices);
        for ((away, found), vertex) in away.iter_mut().zip(found).zip(&mesh.vertices) {
            let cells = |found: Vec3| found.distance(vertex.position.into()) / lattice.cell;
            *away = away.min(found.map_or(f32::INFINITY, cells));
        }
    }
    let far = away.iter().filter(|&&cells| cells > 2.0).count();
    println!("from where opacity crosses 1/2, cells: {}; further than 2: {far}", spread(&mut away));

    if file.ends_with("demo.nerf") {
        let diagonal = (bounds.max - bounds.min).length();
        let distance =
            |vertex: &Vertex| 100.0 * demo::signed_distance(vertex.position.into()).abs() / diagonal;
        let mut distances: Vec<f32> = mesh.vertices.iter().map(distance).collect();
        println!("from the true shapes, % of the diagonal: {}", spread(&mut distances));
    }
}

/// Where opacity crosses 1/2 along the normal of each vertex, of light that comes from `before` cells in front of it.
fn crossings(field: &Field<'_, '_>, cell: f32, before: f32, vertices: &[Vertex]) -> Vec<Option<Vec3>> {
    let rays = vertices.iter().map(|vertex| {
        let (position, normal) = (Vec3::from(vertex.position), Vec3::from(vertex.normal));
        let ray = Ray { origin: position + before * cell * normal, dir: -normal };
        RaySegment { ray, t_min: 0.0, t_max: (before + 2.0) * cell }
    });
    field.half_way(&rays.collect::<Vec<_>>()).expect("rays")
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
