//! The renderer allocates nothing once its memory is lent: not when opening a scene, not in a frame, not on errors.
//!
//! `tests/c/no_allocation.c` is the same test in C. `long` verifies that closing a scene frees all memory that opening
//! a file allocates.
#![allow(unsafe_code, reason = "a global allocator is unsafe to implement, and tests call the C interface")]

mod long;

use nerf_core::blob::Blob;
use nerf_core::math::MathBackend;
use nerf_core::memory::Line;
use nerf_core::plan::{Batch, Effects, Jitter, Outputs, Plan, Quality, ThinLens, Tone, ToneMap};
use nerf_core::render::{Rect, Renderer};
use nerf_core::volume::Pixel;
use nerf_testing::scenes::{Recipe, camera, kernels};
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::sync::atomic::{AtomicIsize, Ordering};

/// The system's allocator, with a count of each thread's allocations.
struct Counting;

thread_local! {
    static ALLOCATIONS: Cell<usize> = const { Cell::new(0) };
}

/// Bytes that are allocated and not freed, in all threads.
static LIVE: AtomicIsize = AtomicIsize::new(0);

#[global_allocator]
static COUNTING: Counting = Counting;

impl Counting {
    fn count(bytes: usize) {
        // A thread that is ending has no counter any more, and no test either.
        let _ = ALLOCATIONS.try_with(|count| count.set(count.get() + 1));
        LIVE.fetch_add(bytes.cast_signed(), Ordering::Relaxed);
    }

    fn uncount(bytes: usize) {
        LIVE.fetch_sub(bytes.cast_signed(), Ordering::Relaxed);
    }
}

// SAFETY: everything is the system allocator's; counting neither allocates nor unwinds.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        Self::count(layout.size());
        // SAFETY: the caller's promise.
        unsafe { System.alloc(layout) }
    }
    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        Self::count(layout.size());
        // SAFETY: the caller's promise.
        unsafe { System.alloc_zeroed(layout) }
    }
    unsafe fn realloc(&self, at: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        Self::uncount(layout.size());
        Self::count(size);
        // SAFETY: the caller's promise.
        unsafe { System.realloc(at, layout, size) }
    }
    unsafe fn dealloc(&self, at: *mut u8, layout: Layout) {
        Self::uncount(layout.size());
        // SAFETY: the caller's promise.
        unsafe { System.dealloc(at, layout) }
    }
}

/// All outputs, including those that some builds lack.
const EVERYTHING: Outputs = Outputs { median_distance: true, normals: true, ..Outputs::ALL };

/// Returns the number of allocations that this thread makes during `work`.
fn allocations(work: impl FnOnce()) -> usize {
    let before = ALLOCATIONS.get();
    work();
    ALLOCATIONS.get() - before
}

#[test]
fn the_counter_counts() {
    assert_eq!(allocations(|| drop(std::hint::black_box(Box::new(1)))), 1);
    assert_eq!(allocations(|| ()), 0);
}

/// All effects.
const EFFECTS: Effects = Effects {
    jitter: Some(Jitter { seed: 1 }),
    anti_aliasing: 2,
    depth_of_field: Some(ThinLens { aperture_radius: 0.1, focus_distance: 4.0 }),
    tone: Tone { exposure: 0.5, map: ToneMap::Filmic, linear: false },
};

#[test]
fn a_scene_is_opened_rendered_and_queried_without_allocating() {
    let camera = camera(24, 16);
    let full = Rect::full(&camera);
    for recipe in [Recipe::PLAIN, Recipe::SKIP, Recipe::OCCUPANCY_REQUIRED, Recipe::PROPOSAL] {
        let file = recipe.blob();
        for kernel in kernels() {
            let blob = Blob::open(&file).expect("a blob");
            let quality = Quality { samples: 16, ..Quality::default() };
            let plan = Plan::new(&blob, &quality, EVERYTHING, Batch::FULL).expect("a plan");
            let plan = plan.with_effects(EFFECTS).expect("effects in range");
            let mut prepared = vec![Line::UNINIT; Renderer::prepared_lines(&blob, kernel)];
            let mut again = prepared.clone();
            let renderer = Renderer::new(blob, kernel, &mut prepared).expect("a renderer");
            // To the line what the query says: one less is refused.
            let mut workspace = vec![Line::UNINIT; renderer.workspace_lines(&plan)];
            let lines = workspace.len();
            let mut picture = vec![[0.0; 3]; 24 * 16];
            let (positions, dirs) = ([[0.1, 0.2, 0.3]; 100], [[0.0, 0.0, -1.0]; 100]);
            let (mut sigma, mut rgb) = ([0.0; 100], [[0.0; 3]; 100]);
            let counted = allocations(|| {
                let blob = Blob::open(&file).expect("a blob");
                let plan = Plan::new(&blob, &quality, EVERYTHING, Batch::FULL).expect("a plan");
                let plan = plan.with_effects(EFFECTS).expect("effects in range");
                let renderer = Renderer::new(blob, kernel, &mut again).expect("a renderer");
                assert_eq!(renderer.workspace_lines(&plan), lines);
                let mut put = |x: u32, y: u32, pixel: &Pixel| picture[(y * 24 + x) as usize] = pixel.rgb;
                renderer.render(&plan, &camera, full, &mut workspace, &mut put).expect("a picture");
                let short = &mut workspace[..lines - 1];
                assert!(renderer.render(&plan, &camera, full, short, &mut put).is_err());
                let answer = renderer.query(&plan, &positions, &dirs, &mut workspace, &mut sigma, &mut rgb);
                assert!(answer.is_ok());
                assert!(Blob::open(&file[1..]).is_err());
            });
            assert_eq!(counted, 0, "{recipe:?}, {}", kernel);
            assert!(picture.iter().any(|pixel| *pixel != picture[0]), "a flat picture proves nothing");
        }
    }
}

#[test]
fn a_picture_is_opened_and_rendered_without_allocating() {
    let file = Recipe::PICTURE.blob();
    for kernel in kernels() {
        let (batch, size) = (Batch::FULL, [40, 30]);
        let rect = Rect { x: 0, y: 0, width: 40, height: 30 };
        let blob = Blob::open(&file).expect("a blob");
        let mut prepared = vec![Line::UNINIT; Renderer::prepared_lines(&blob, kernel)];
        let mut again = prepared.clone();
        let renderer = Renderer::new(blob, kernel, &mut prepared).expect("a renderer");
        let mut workspace = vec![Line::UNINIT; renderer.picture_workspace_lines(batch)];
        let lines = workspace.len();
        let mut pixels = 0;
        let counted = allocations(|| {
            let renderer =
                Renderer::new(Blob::open(&file).expect("a blob"), kernel, &mut again).expect("a renderer");
            let math = MathBackend::Polynomial;
            let mut put = |_: u32, _: u32, _: [f32; 3]| pixels += 1;
            let drawn = renderer.render_picture(math, batch, size, rect, &mut workspace, &mut put);
            assert!(drawn.is_ok());
            let short = &mut workspace[..lines - 1];
            assert!(renderer.render_picture(math, batch, size, rect, short, &mut put).is_err());
        });
        assert_eq!((counted, pixels), (0, 40 * 30), "{}", kernel);
    }
}
