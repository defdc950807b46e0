//! Render time and PSNR of a data set's validation views.
//!
//! `NERF_BENCH_BLOB=scene.nerf NERF_BENCH_DATA=data cargo bench -p nerf-train --bench views` prints milliseconds per
//! view: on one and on two threads, with all outputs and with colour alone, at the views' size (fastest of five rounds
//! over all views) and with four times as many pixels along each side (one round). Also prints the PSNR of the default
//! and of the exact quality against the photographs. `NERF_BENCH_KERNEL=avx2` names a kernel; without it the
//! fastest is used. Needs an otherwise idle machine.

use nerf_core::Kernel;
use nerf_core::blob::Blob;
use nerf_core::camera::{Camera, Intrinsics};
use nerf_core::memory::Line;
use nerf_core::plan::{Batch, Outputs, Plan, Quality};
use nerf_core::render::Renderer;
use nerf_train::data;
use nerf_train::data::ReadOptions;
use nerf_train::data::View;
use nerf_train::measure::frame::Frame;
use nerf_train::measure::frame::render;
use nerf_train::measure::metrics::psnr_db;
use std::path::Path;
use std::time::Instant;

/// Number of rounds over all views at their own size; the fastest round counts.
const ROUNDS: usize = 5;

fn main() {
    let (Some(file), Some(data)) = (std::env::var_os("NERF_BENCH_BLOB"), std::env::var_os("NERF_BENCH_DATA"))
    else {
        // Nothing to measure is nothing wrong: all benchmarks may be run at once.
        println!("NERF_BENCH_BLOB and NERF_BENCH_DATA: a scene and its photographs");
        return;
    };
    let bytes = std::fs::read(file).expect("NERF_BENCH_BLOB: a file");
    let blob = Blob::open(&bytes).expect("a blob");
    let data = data::read(Path::new(&data), &ReadOptions::default()).expect("NERF_BENCH_DATA: a data set");
    let kernel = std::env::var("NERF_BENCH_KERNEL")
        .map_or(Kernel::detect(), |name| Kernel::by_name(&name).expect("NERF_BENCH_KERNEL: a kernel"));
    let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, kernel)];
    let renderer = Renderer::new(blob.clone(), kernel, &mut memory).expect("a renderer");
    let plan = |quality: &Quality, outputs| {
        Plan::new(&blob, quality, outputs, Batch::FULL).expect("a plan").with_own_bins()
    };
    let (default, exact) =
        (plan(&Quality::default(), Outputs::ALL), plan(&Quality::exact(&blob), Outputs::ALL));
    let colour = plan(&Quality::default(), Outputs::RGB);
    println!("| size | outputs | threads | ms a view |");
    println!("| --- | --- | ---: | ---: |");
    for (plan, outputs) in [(&default, "all"), (&colour, "rgb")] {
        for scale in [1, 4] {
            for threads in [1, 2] {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
                let round = || {
                    let begun = Instant::now();
                    for view in &data.val {
                        render(&renderer, plan, &enlarged(&view.camera, scale)).expect("a frame");
                    }
                    1e3 * begun.elapsed().as_secs_f64() / data.val.len() as f64
                };
                let rounds = if scale == 1 { ROUNDS } else { 1 };
                let best = pool.install(|| (0..rounds).map(|_| round()).fold(f64::INFINITY, f64::min));
                println!("| {scale}× | {outputs} | {threads} | {best:.1} |");
            }
        }
    }
    let mean = |of: &dyn Fn(&View) -> f64| data.val.iter().map(of).sum::<f64>() / data.val.len() as f64;
    let frame =
        |plan: &Plan<'_>, view: &View| -> Frame { render(&renderer, plan, &view.camera).expect("a frame") };
    let black = |view: &View| view.composite_over([0.0; 3]);
    let of_default = mean(&|view| psnr_db(&frame(&default, view).rgb, &black(view)));
    let of_exact = mean(&|view| psnr_db(&frame(&exact, view).rgb, &black(view)));
    println!(
        "\ndefault {of_default:.3} dB, exact {of_exact:.3} dB: PSNR over {} views on black",
        data.val.len()
    );
}

/// Returns a camera of the same view as `camera`, with `scale` times as many pixels along each side.
fn enlarged(camera: &Camera, scale: u32) -> Camera {
    let i = camera.intrinsics();
    let by = scale as f32;
    let intrinsics = Intrinsics {
        width: i.width * scale,
        height: i.height * scale,
        fx: i.fx * by,
        fy: i.fy * by,
        cx: i.cx * by,
        cy: i.cy * by,
    };
    Camera::new(intrinsics, *camera.lens(), *camera.pose()).expect("a camera")
}
