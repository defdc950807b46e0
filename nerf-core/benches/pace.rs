//! Benchmark of [`Pace`]: compares the frame time predicted by `Pace::measure`, for the settings chosen by
//! `Pace::within`, with the measured frame time.
//!
//! Environment variables: `NERF_BENCH_BLOB=scene.nerf` selects another scene, with a Pareto front measured by
//! `nerf-train study -o`; `NERF_BENCH_SIDE=200` selects another image side in pixels. Runs on one thread, with the
//! fastest kernel of the machine that does not round weights.

mod support;

use nerf_core::Kernel;
use nerf_core::memory::Line;
use nerf_core::render::Pace;
use nerf_core::{Batch, Blob, Camera, Outputs, Pixel, Plan, Quality, Rect, Renderer};
use std::hint::black_box;
use std::time::Instant;
use support::networks;

/// Default side of the image, pixels.
const SIDE: u32 = 64;
/// Number of timed frames per point of the Pareto front. The median of their times is printed.
const FRAMES: usize = 5;

fn main() {
    let file = match std::env::var_os("NERF_BENCH_BLOB") {
        Some(path) => std::fs::read(path).expect("NERF_BENCH_BLOB: a file"),
        None => networks::file(),
    };
    let side =
        std::env::var("NERF_BENCH_SIDE").map_or(SIDE, |side| side.parse().expect("NERF_BENCH_SIDE: pixels"));
    let smoke = std::env::args().any(|word| word == "--smoke");
    let blob = Blob::open(&file).expect("a blob");
    let kernel = Kernel::detect();
    let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, kernel)];
    let renderer = Renderer::new(blob.clone(), kernel, &mut memory).expect("a renderer");
    let batch = Batch::FULL;
    let plan = Plan::new(&blob, &Quality::default(), Outputs::ALL, batch).expect("a plan");
    let camera = networks::camera(side);
    let mut workspace =
        vec![Line::UNINIT; Pace::lines(&renderer, &plan).max(renderer.workspace_lines(&plan))];
    let start = Instant::now();
    let mut clock = || start.elapsed().as_micros() as u64;
    let limit = if smoke { 0.0 } else { f32::INFINITY };
    let pace =
        Pace::measure(&renderer, &plan, &camera, limit, &mut workspace, &mut clock).expect("enough memory");
    println!(
        "calibration: {:.0} ms, {} pixels, {}",
        start.elapsed().as_secs_f64() * 1e3,
        side * side,
        kernel
    );
    println!("| asked for, ms | settings | foreseen, ms | measured, ms | measured / foreseen |");
    println!("| ---: | --- | ---: | ---: | ---: |");
    for (index, choice) in Quality::front(&blob) {
        let foreseen = pace.milliseconds[index];
        if foreseen.is_infinite() {
            continue;
        }
        // The limit is exactly the point's predicted time.
        let (chosen, _) = pace.within(&blob, foreseen).expect("a point within its own time");
        let plan = plan.at(&blob, &chosen.quality).expect("a plan");
        let mut frames: Vec<f64> = (0..if smoke { 1 } else { FRAMES })
            .map(|_| frame(&renderer, &plan, &camera, &mut workspace))
            .collect();
        frames.sort_by(f64::total_cmp);
        let median = frames[frames.len() / 2];
        let q = choice.quality;
        println!(
            "| {foreseen:.1} | {} samples, cuts {} and {}, {:.2} dB lost | {foreseen:.1} | {median:.1} | {:.2} |",
            q.samples,
            q.transmittance_cut,
            q.colour_cut,
            choice.loss_db,
            median / f64::from(foreseen),
        );
    }
}

/// Renders a frame and returns its time, ms.
fn frame(renderer: &Renderer<'_>, plan: &Plan<'_>, camera: &Camera, workspace: &mut [Line]) -> f64 {
    let mut put = |_: u32, _: u32, pixel: &Pixel| {
        black_box(pixel);
    };
    let start = Instant::now();
    renderer.render(plan, camera, Rect::full(camera), workspace, &mut put).expect("a frame");
    start.elapsed().as_secs_f64() * 1e3
}
