//! Benchmark of whole frames, and of the time from opening a file to the first rendered tile. The scene is the seed
//! network of `support/networks.rs`, with the file's number of samples per ray (64).
//!
//! Environment variables: `NERF_BENCH_BLOB=scene.nerf` selects another scene, `NERF_BENCH_SIDE=200` another image side
//! in pixels.

mod support;

use nerf_core::memory::Line;
use nerf_core::{Batch, Blob, Outputs, Pixel, Plan, Quality, Rect, Renderer};
use nerf_core::{Isa, Kernel};
use std::hint::black_box;
use std::process::Command;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use support::{Table, kernels, networks};

/// Default side of the image, pixels.
const SIDE: u32 = 32;
/// Side of the tiles that are distributed to threads, pixels.
const TILE: u32 = 16;
/// Argument with which this program starts itself as a new process; followed by the path of a blob.
const FIRST_TILE: &str = "--first-tile";

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    if let [_, flag, path] = &arguments[..]
        && flag == FIRST_TILE
    {
        let file = std::fs::read(path).expect("the file");
        first_tile(&file, Kernel::detect());
        return;
    }
    let file = match std::env::var_os("NERF_BENCH_BLOB") {
        Some(path) => std::fs::read(path).expect("NERF_BENCH_BLOB: a file"),
        None => networks::file(),
    };
    let side =
        std::env::var("NERF_BENCH_SIDE").map_or(SIDE, |side| side.parse().expect("NERF_BENCH_SIDE: pixels"));
    let mut table = Table::new();
    let blob = Blob::open(&file).expect("a blob");
    for kernel in kernels() {
        let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, kernel)];
        let renderer = Renderer::new(blob.clone(), kernel, &mut memory).expect("a renderer");
        for (what, quality) in
            [("dense", Quality::exact(&blob)), ("occupancy grid and cut", Quality::default())]
        {
            // A dense frame with portable instructions takes minutes, and shows nothing that the benchmark of kernels
            // does not.
            if kernel.isa == Isa::Portable && what == "dense" {
                continue;
            }
            let plan = Plan::new(&blob, &quality, Outputs::ALL, Batch::FULL).expect("a plan");
            let name = |threads: usize| {
                let plural = if threads == 1 { "" } else { "s" };
                format!("frame {side}×{side}, {what}, {}, {threads} thread{plural}", kernel)
            };
            // The work is counted by an extra frame, which takes seconds if dense. It is skipped for lines that are not
            // requested.
            if ![1, 2].into_iter().any(|threads| table.wants(&name(threads))) {
                continue;
            }
            let flop = 2.0 * frame(&renderer, &plan, side, 1) as f64;
            for threads in [1, 2] {
                let name = name(threads);
                table.line(&name, kernel, threads, flop, || {
                    black_box(frame(&renderer, &plan, side, threads));
                });
            }
        }
    }
    for kernel in kernels().filter(|&kernel| kernel != Kernel::IN_PLACE) {
        let name = format!("open to first tile, same process, {}", kernel);
        let flop = 2.0 * first_tile(&file, kernel) as f64;
        table.line(&name, kernel, 1, flop, || {
            black_box(first_tile(&file, kernel));
        });
    }
    let path = std::env::temp_dir().join(format!("nerf-bench-{}.nerf", std::process::id()));
    std::fs::write(&path, &file).expect("a temporary file");
    let program = std::env::current_exe().expect("this program");
    let kernel = Kernel::detect();
    let flop = 2.0 * first_tile(&file, kernel) as f64;
    table.line("open to first tile, fresh process", kernel, 1, flop, || {
        let status = Command::new(&program).arg(FIRST_TILE).arg(&path).status().expect("a process");
        assert!(status.success());
    });
    std::fs::remove_file(&path).expect("the temporary file");
}

/// Renders a frame on `threads` threads, each of which takes the next tile when it is free. Returns the number of
/// multiply-adds.
fn frame(renderer: &Renderer<'_>, plan: &Plan<'_>, side: u32, threads: usize) -> u64 {
    let camera = networks::camera(side);
    let tiles: Vec<Rect> = Rect::full(&camera).tiles(TILE, TILE).collect();
    let (next, macs) = (AtomicUsize::new(0), Mutex::new(0));
    let work = || {
        let mut workspace = vec![Line::UNINIT; renderer.workspace_lines(plan)];
        let mut worker = renderer.worker(plan, &mut workspace).expect("a worker");
        let mut put = |_: u32, _: u32, pixel: &Pixel| {
            black_box(pixel);
        };
        while let Some(&tile) = tiles.get(next.fetch_add(1, Ordering::Relaxed)) {
            let counters = worker.render(&camera, tile, &mut put);
            *macs.lock().expect("no panic") += counters.expect("a tile").macs;
        }
    };
    if threads == 1 {
        work();
    } else {
        std::thread::scope(|scope| (0..threads).for_each(|_| drop(scope.spawn(work))));
    }
    macs.into_inner().expect("no panic")
}

/// Opens `file` and renders the 16×16 pixels in the middle of a 200×200 image. Returns the number of multiply-adds.
fn first_tile(file: &[u8], kernel: Kernel) -> u64 {
    let blob = Blob::open_undecoded(file).expect("a blob");
    let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, kernel)];
    let batch = Batch::FULL;
    let plan = Plan::new(&blob, &Quality::default(), Outputs::ALL, batch).expect("a plan");
    let renderer = Renderer::new(blob.clone(), kernel, &mut memory).expect("a renderer");
    let mut workspace = vec![Line::UNINIT; renderer.workspace_lines(&plan)];
    let tile = Rect { x: 92, y: 92, width: TILE, height: TILE };
    let mut put = |_: u32, _: u32, pixel: &Pixel| {
        black_box(pixel);
    };
    renderer.render(&plan, &networks::camera(200), tile, &mut workspace, &mut put).expect("a tile").macs
}
