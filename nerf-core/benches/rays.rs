//! Benchmark of rays given by the caller: time per ray in one call for all rays, in tile order and shuffled, and in
//! calls of 256, 16 and 1 rays. Collisions are drawn with the random number ½.
//!
//! All rows render the same 16,384 rays, of four cameras: three around the scene and one inside. The ratio of a row is
//! its time divided by the time of the first row, which renders the rays tile by tile as a frame does.
//! `NERF_BENCH_BLOB=scene.nerf` selects another scene than the seed network.

mod support;

use nerf_core::camera::Ray;
use nerf_core::memory::Line;
use nerf_core::render::{Instance, RaySegment, Worker};
use nerf_core::space::Placement;
use nerf_core::{Batch, Blob, Camera, Intrinsics, Kernel, Lens, Outputs, Plan, Pose, Quality, Renderer};
use std::hint::black_box;
use std::time::Instant;

/// Side of a camera's image, pixels.
const SIDE: u32 = 64;
/// Number of times that each row is timed; rows take turns. The shortest time is printed.
const ROUNDS: usize = 15;
const ROWS: usize = 8;

fn main() {
    let file = match std::env::var_os("NERF_BENCH_BLOB") {
        Some(path) => std::fs::read(path).expect("NERF_BENCH_BLOB: a file"),
        None => support::networks::file(),
    };
    let blob = Blob::open(&file).expect("a blob");
    let kernel = Kernel::detect();
    let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, kernel)];
    let renderer = Renderer::new(blob.clone(), kernel, &mut memory).expect("a renderer");
    let smoke = std::env::args().any(|argument| argument == "--smoke");
    let (rounds, most) = if smoke { (1, 64) } else { (ROUNDS, usize::MAX) };
    let sorted: Vec<RaySegment> = rays(&blob).into_iter().take(most).collect();
    let mut shuffled = sorted.clone();
    for i in (1..shuffled.len()).rev() {
        let noise = support::noise(1, i as u32)[0].abs();
        shuffled.swap(i, ((noise * i as f32) as usize).min(i));
    }
    let (to_world, at) =
        ([[0.0, 0.0, 1.0, 0.5], [0.0, 1.0, 0.0, -0.2], [-1.0, 0.0, 0.0, 0.1]], [0.5, -0.2, 0.1]);
    let placement = Placement::from_rows(to_world).expect("a quarter turn");
    let turned = [&sorted, &shuffled].map(|rays| {
        let turn = |segment: &RaySegment| {
            let [origin, dir] = [segment.ray.origin, segment.ray.dir].map(|v| placement.dir_in_world(v));
            RaySegment { ray: Ray { origin: origin + glam::Vec3::from(at), dir }, ..*segment }
        };
        rays.iter().map(turn).collect::<Vec<_>>()
    });
    for (what, outputs) in [("rgb and distance", Outputs::ALL), ("opacity", OPACITY)] {
        let plan = Plan::new(&blob, &Quality::default(), outputs, Batch::FULL).expect("a plan");
        let mut workspace = vec![Line::UNINIT; renderer.workspace_lines(&plan)];
        let mut worker = renderer.worker(&plan, &mut workspace).expect("a worker");
        let rows = [
            ("in tiles, one call", &sorted, sorted.len()),
            ("shuffled, one call", &shuffled, shuffled.len()),
            ("shuffled, 256 a call", &shuffled, 256),
            ("shuffled, 16 a call", &shuffled, 16),
            ("shuffled, 1 a call", &shuffled, 1),
            ("collisions, shuffled, 1 a call", &shuffled, 1),
            ("as an instance, in tiles", &turned[0], sorted.len()),
            ("as an instance, shuffled, 1 a call", &turned[1], 1),
        ];
        let placed = [Instance { renderer: &renderer, plan: &plan, placement }];
        let lines = Worker::instances_lines([&renderer].into_iter(), &plan);
        let mut memory = vec![Line::UNINIT; lines];
        let mut instance = Worker::of_instances(&placed, &mut memory).expect("a worker");
        let mut best = [f64::INFINITY; ROWS];
        for _ in 0..rounds {
            for ((name, rays, size), best) in rows.iter().zip(&mut best) {
                let worker = if name.starts_with("as an instance") { &mut instance } else { &mut worker };
                let start = Instant::now();
                for rays in rays.chunks(*size) {
                    let put = &mut |_: usize, pixel: &nerf_core::Pixel| {
                        black_box(pixel.opacity);
                    };
                    if name.starts_with("collisions") {
                        worker.sample_rays(rays, &[0.5], None, put).expect("rays");
                    } else {
                        worker.render_rays(rays, None, put).expect("rays");
                    }
                }
                *best = best.min(start.elapsed().as_secs_f64());
            }
        }
        for ((name, rays, _), time) in rows.iter().zip(best) {
            let each = 1e6 * time / rays.len() as f64;
            println!("{kernel}, {what}, {name:36} {each:8.2} µs a ray  {:5.2}x", time / best[0]);
        }
    }
}

const OPACITY: Outputs = Outputs { opacity: true, ..Outputs::NONE };

/// Returns the rays of four cameras, tile by tile. One of the cameras is near the middle of the scene.
fn rays(blob: &Blob<'_>) -> Vec<RaySegment> {
    let bounds = blob.scene_box().expect("a scene");
    let middle = 0.5 * (bounds.min + bounds.max);
    let radius = (bounds.max - bounds.min).length();
    let eyes = [[1.0, 0.2, 0.3], [-0.6, 0.7, 0.4], [0.1, -0.9, 0.5], [0.01, 0.0, 0.05]];
    let mut rays = Vec::new();
    for eye in eyes {
        let eye = middle + radius * glam::Vec3::from(eye);
        let pose = Pose::look_at(eye, middle, glam::Vec3::Z).expect("a view");
        let side = SIDE as f32;
        let intrinsics =
            Intrinsics { width: SIDE, height: SIDE, fx: side, fy: side, cx: 0.5 * side, cy: 0.5 * side };
        let camera = Camera::new(intrinsics, Lens::NONE, pose).expect("a camera");
        for tile in 0..(SIDE / 16) * (SIDE / 16) {
            let (left, top) = (tile % (SIDE / 16) * 16, tile / (SIDE / 16) * 16);
            for pixel in 0..256 {
                let (x, y) = (left + pixel % 16, top + pixel / 16);
                rays.push(RaySegment::from(camera.ray(x as f32 + 0.5, y as f32 + 0.5)));
            }
        }
    }
    rays
}
