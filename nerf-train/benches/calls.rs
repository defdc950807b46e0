//! Benchmark of small calls: queries of single points, and renderings of single rays, of a scene with a grid.
//!
//! `NERF_BENCH_BLOB=demo.nerf cargo bench -p nerf-train --bench calls`, with the file that `demo` writes, prints
//! nanoseconds per call on one thread: the fastest of twenty rounds. One column is for a worker that is made once, the
//! other for a new worker in each call. The ray goes through the middle of the demo's first held-out view. Needs an
//! otherwise idle machine.

use nerf_core::Kernel;
use nerf_core::blob::Blob;
use nerf_core::camera::{Camera, Intrinsics};
use nerf_core::memory::Line;
use nerf_core::plan::{Batch, Outputs, Plan, Quality};
use nerf_core::render::{Rect, Renderer};
use nerf_core::volume::Pixel;
use nerf_train::data::demo;
use nerf_train::data::demo::DemoSpec;
use std::hint::black_box;
use std::time::Instant;

const ROUNDS: usize = 20;
const CALLS: u32 = 2000;

fn main() {
    let Some(file) = std::env::var_os("NERF_BENCH_BLOB") else {
        // Nothing to measure is nothing wrong: all benchmarks may be run at once.
        println!("NERF_BENCH_BLOB: the demo's scene");
        return;
    };
    let bytes = std::fs::read(file).expect("NERF_BENCH_BLOB: a file");
    let blob = Blob::open(&bytes).expect("a blob");
    let kernel = Kernel::detect();
    let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, kernel)];
    let renderer = Renderer::new(blob.clone(), kernel, &mut memory).expect("a renderer");
    let plan = Plan::new(&blob, &Quality::default(), Outputs::ALL, Batch::FULL).expect("a plan");
    let mut workspace = vec![Line::UNINIT; renderer.workspace_lines(&plan)];

    let data = demo::dataset(&DemoSpec::default()).expect("the built-in scene");
    let middle = middle_of(&data.val.first().expect("a held-out view").camera);
    let one = Rect::full(&middle);
    let mut seen = Pixel::BLANK;
    let mut put = |_: u32, _: u32, pixel: &Pixel| seen = *pixel;
    let work = renderer.render(&plan, &middle, one, &mut workspace, &mut put).expect("a pixel");
    let ray = middle.ray(0.5, 0.5);
    let (surface, nothing) = (ray.at(seen.ray_distance).to_array(), [1e6; 3]);
    println!(
        "{}; the ray: opacity {:.3}, {} densities, {} colours",
        kernel, seen.opacity, work.density_evaluations, work.colour_evaluations
    );
    println!("| call | a worker made once, ns | a worker a call, ns |");
    println!("| --- | ---: | ---: |");
    let dir = [ray.dir.to_array()];
    for (name, point) in [("a point in empty space", nothing), ("a point of the surface", surface)] {
        let (mut sigma, mut rgb) = ([0.0], [[0.0; 3]]);
        let each = least(|| {
            let found = renderer.query(&plan, &[point], &dir, &mut workspace, &mut sigma, &mut rgb);
            black_box(found.expect("an answer"));
        });
        let mut worker = renderer.worker(&plan, &mut workspace).expect("a worker");
        let once = least(|| {
            black_box(worker.query(&[point], &dir, &mut sigma, &mut rgb).expect("an answer"));
        });
        println!("| {name} | {once:.0} | {each:.0} |");
    }
    let mut put = |_: u32, _: u32, pixel: &Pixel| {
        black_box(pixel);
    };
    let each = least(|| {
        let found = renderer.render(&plan, &middle, one, &mut workspace, &mut put);
        black_box(found.expect("a pixel"));
    });
    let mut worker = renderer.worker(&plan, &mut workspace).expect("a worker");
    let once = least(|| {
        black_box(worker.render(&middle, one, &mut put).expect("a pixel"));
    });
    println!("| a camera of one pixel | {once:.0} | {each:.0} |");
    let mut take = |_: usize, pixel: &Pixel| {
        black_box(pixel);
    };
    let once = least(|| {
        black_box(worker.render_rays(&[ray.into()], None, &mut take).expect("a ray"));
    });
    println!("| the same as a ray | {once:.0} | |");
}

/// Returns the time of a call, nanoseconds: the mean over [`CALLS`] calls, in the fastest of [`ROUNDS`] rounds.
fn least(mut call: impl FnMut()) -> f64 {
    let round = |_| {
        let begun = Instant::now();
        (0..CALLS).for_each(|_| call());
        1e9 * begun.elapsed().as_secs_f64() / f64::from(CALLS)
    };
    (0..ROUNDS).map(round).fold(f64::INFINITY, f64::min)
}

/// Returns a camera whose only pixel is the middle one of `camera`.
fn middle_of(camera: &Camera) -> Camera {
    let i = camera.intrinsics();
    let (x, y) = ((i.width / 2) as f32, (i.height / 2) as f32);
    let intrinsics = Intrinsics { width: 1, height: 1, cx: i.cx - x, cy: i.cy - y, ..*i };
    Camera::new(intrinsics, *camera.lens(), *camera.pose()).expect("a pixel of a camera")
}
