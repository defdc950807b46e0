//! Threads, callbacks and panics at the C interface, and formats and strides of images.

use nerf_core::Kernel;
use nerf_render as ffi;
use nerf_render::{PixelFormat, Status};
use nerf_testing::call::{self, NO_PLANE, Opened, plane};
use nerf_testing::scenes::{Recipe, camera, kernels};
use std::ffi::c_void;
use std::ptr::{null, null_mut};
use std::sync::atomic::{AtomicU32, Ordering};

const SIDE: u32 = 40;
const ALL: u32 = 15;
/// A colour that no renderer produces.
const UNTOUCHED: [f32; 4] = [-7.0; 4];

/// Instructions for a progress callback, and what the callback has seen.
struct Watcher<'a> {
    scene: &'a Opened,
    calls: u64,
    last: u64,
    cancel_at: u64,
    panics: bool,
    /// Workspace for a render from inside the callback.
    reenter: Option<(*mut c_void, usize)>,
}

impl<'a> Watcher<'a> {
    fn new(scene: &'a Opened) -> Self {
        Self { scene, calls: 0, last: 0, cancel_at: u64::MAX, panics: false, reenter: None }
    }
}

unsafe extern "C-unwind" fn watch(user: *mut c_void, done: u64, all: u64) -> i32 {
    // SAFETY: every render below passes a watcher.
    let watcher = unsafe { &mut *user.cast::<Watcher<'_>>() };
    assert!(done >= watcher.last && all == u64::from(SIDE * SIDE));
    (watcher.calls, watcher.last) = (watcher.calls + 1, done);
    if watcher.panics {
        panic!("injected");
    }
    if let Some((workspace, size)) = watcher.reenter {
        let rect = ffi::Rect { x: 3, y: 5, width: 9, height: 9 };
        let mut picture = vec![UNTOUCHED; 81];
        assert_eq!(
            render(watcher.scene, Some(rect), picture.as_mut_ptr(), 9, workspace, size, None),
            Status::Ok
        );
    }
    i32::from(done >= watcher.cancel_at)
}

/// Renders `rect` in RGBA f32 into `picture`, whose rows have `columns` pixels.
fn render(
    opened: &Opened,
    rect: Option<ffi::Rect>,
    picture: *mut [f32; 4],
    columns: u32,
    workspace: *mut c_void,
    size: usize,
    watcher: Option<&mut Watcher<'_>>,
) -> Status {
    let camera = call::camera(&camera(SIDE, SIDE));
    let rgb = ffi::Plane { row_stride: columns as isize * 16, ..plane(picture.cast(), PixelFormat::RgbaF32) };
    let target = call::target(rgb);
    let rect = rect.as_ref().map_or(null(), |rect| rect as *const ffi::Rect);
    let user = watcher.map_or(null_mut(), |watcher| (watcher as *mut Watcher<'_>).cast::<c_void>());
    let progress: ffi::Progress = if user.is_null() { None } else { Some(watch) };
    let (options, none, text) = (null(), null_mut(), null_mut());
    // SAFETY: everything lives until the call returns.
    unsafe {
        call::render(
            opened.scene,
            &camera,
            options,
            rect,
            &target,
            workspace,
            size,
            progress,
            user,
            none,
            text,
            0,
        )
    }
}

fn whole(opened: &Opened) -> Vec<[f32; 4]> {
    let mut workspace = opened.workspace(None, ffi::NERF_OUTPUT_RGB);
    let mut picture = vec![UNTOUCHED; (SIDE * SIDE) as usize];
    let (at, size) = (workspace.at(), workspace.size());
    assert_eq!(render(opened, None, picture.as_mut_ptr(), SIDE, at, size, None), Status::Ok);
    picture
}

/// A scene and an image that threads share.
struct Shared(Opened, *mut [f32; 4]);
// SAFETY: scenes never change (the contract under test), and threads write different pixels.
unsafe impl Sync for Shared {}

#[test]
fn threads_share_a_scene_and_a_picture() {
    for kernel in kernels() {
        let opened = call::open(Recipe::PLAIN.blob(), kernel);
        let expected = whole(&opened);
        let mut picture = vec![UNTOUCHED; (SIDE * SIDE) as usize];
        let shared = Shared(opened, picture.as_mut_ptr());
        let next = AtomicU32::new(0);
        std::thread::scope(|scope| {
            for _ in 0..4 {
                scope.spawn(|| {
                    let Shared(opened, pixels) = &shared;
                    let mut workspace = opened.workspace(None, ffi::NERF_OUTPUT_RGB);
                    let (at, size) = (workspace.at(), workspace.size());
                    // Odd rectangles: 8 columns by 5 rows.
                    for i in std::iter::repeat_with(|| next.fetch_add(1, Ordering::Relaxed))
                        .take_while(|i| *i < 40)
                    {
                        let (x, y) = (i % 5 * 8, i / 5 * 5);
                        let rect = ffi::Rect { x, y, width: 8, height: 5 };
                        let part = pixels.wrapping_add((y * SIDE + x) as usize);
                        assert_eq!(render(opened, Some(rect), part, SIDE, at, size, None), Status::Ok);
                    }
                });
            }
        });
        assert!(picture == expected, "{}", kernel);
    }
}

#[test]
fn cancelling_stops_within_one_tile_and_leaves_whole_tiles() {
    let opened = call::open(Recipe::PLAIN.blob(), Kernel::detect());
    let expected = whole(&opened);
    let mut workspace = opened.workspace(None, ffi::NERF_OUTPUT_RGB);
    let (at, size) = (workspace.at(), workspace.size());
    let mut calls = 0;
    // Pixels are counted up to multiples of 64, where a tile ends: between these, every `cancel_at` has the same answer.
    for cancel_at in (0..=u64::from(SIDE * SIDE)).filter(|at| (at + 1) % 64 <= 2) {
        let mut watcher = Watcher { cancel_at, ..Watcher::new(&opened) };
        let mut picture = vec![UNTOUCHED; (SIDE * SIDE) as usize];
        let status = render(&opened, None, picture.as_mut_ptr(), SIDE, at, size, Some(&mut watcher));
        assert_eq!(status, Status::Cancelled);
        assert!(watcher.last < cancel_at + 256, "more than a tile beyond {cancel_at}: {}", watcher.last);
        let mut written = 0;
        for (y, x) in
            (0..SIDE as usize).step_by(16).flat_map(|y| (0..SIDE as usize).step_by(16).map(move |x| (y, x)))
        {
            let tile = |picture: &[[f32; 4]]| -> Vec<[f32; 4]> {
                let rows = picture.chunks(SIDE as usize).skip(y).take(16);
                rows.flat_map(|row| row.iter().skip(x).take(16).copied()).collect()
            };
            let (found, finished) = (tile(&picture), tile(&expected));
            let untouched = found.iter().all(|pixel| *pixel == UNTOUCHED);
            assert!(untouched || found == finished, "half a tile at ({x}, {y})");
            written += if untouched { 0 } else { found.len() as u64 };
        }
        assert_eq!(written, watcher.last);
        calls = watcher.calls;
    }
    // 3 × 3 tiles of a 40 × 40 picture, and the call before the first.
    assert_eq!(calls, 10);
}

#[test]
fn panics_become_a_status_and_the_scene_lives_on() {
    let opened = call::open(Recipe::PLAIN.blob(), Kernel::detect());
    let expected = whole(&opened);
    let mut workspace = opened.workspace(None, ffi::NERF_OUTPUT_RGB);
    let (at, size) = (workspace.at(), workspace.size());
    let mut watcher = Watcher { panics: true, ..Watcher::new(&opened) };
    let mut picture = vec![UNTOUCHED; (SIDE * SIDE) as usize];
    assert_eq!(
        render(&opened, None, picture.as_mut_ptr(), SIDE, at, size, Some(&mut watcher)),
        Status::Panic
    );
    assert!(picture.iter().all(|pixel| *pixel == UNTOUCHED));
    assert!(whole(&opened) == expected);
}

#[test]
fn callbacks_may_render_in_the_same_workspace() {
    for kernel in kernels() {
        let opened = call::open(Recipe::PLAIN.blob(), kernel);
        let expected = whole(&opened);
        let mut workspace = opened.workspace(None, ffi::NERF_OUTPUT_RGB);
        let (at, size) = (workspace.at(), workspace.size());
        let mut watcher = Watcher { reenter: Some((at, size)), ..Watcher::new(&opened) };
        let mut picture = vec![UNTOUCHED; (SIDE * SIDE) as usize];
        assert_eq!(
            render(&opened, None, picture.as_mut_ptr(), SIDE, at, size, Some(&mut watcher)),
            Status::Ok
        );
        assert!(picture == expected && watcher.calls == 10, "{}", kernel);
    }
}

/// One pixel of an image with interleaved planes.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C)]
struct Interleaved {
    rgb: [f32; 3],
    before: u32,
    opacity: f32,
    ray_distance: f32,
    z_depth: f32,
    after: u32,
}

#[test]
fn formats_and_strides_agree() {
    let opened = call::open(Recipe::PLAIN.blob(), Kernel::detect());
    let premultiplied = whole(&opened);
    let (count, camera) = ((SIDE * SIDE) as usize, call::camera(&camera(SIDE, SIDE)));
    let mut workspace = opened.workspace(None, ALL);
    let (at, size) = (workspace.at(), workspace.size());
    let draw = |target: &ffi::Target| {
        // SAFETY: everything lives until the call returns.
        let status = unsafe { call::frame(opened.scene, &camera, target, at, size) };
        assert_eq!(status, Status::Ok);
    };

    let blank =
        Interleaved { rgb: [9.0; 3], before: 77, opacity: 9.0, ray_distance: 9.0, z_depth: 9.0, after: 78 };
    let mut mixed = vec![blank; count];
    let first = mixed.as_mut_ptr();
    let row = SIDE as usize * size_of::<Interleaved>();
    let channel = |offset: usize, format| ffi::Plane {
        pixel_stride: size_of::<Interleaved>(),
        row_stride: -(row as isize),
        ..plane(first.cast::<u8>().wrapping_add(offset + (SIDE as usize - 1) * row).cast(), format)
    };
    draw(&ffi::Target {
        opacity: channel(16, PixelFormat::F32),
        ray_distance: channel(20, PixelFormat::F32),
        z_depth: channel(24, PixelFormat::F32),
        ..call::target(channel(0, PixelFormat::RgbF32))
    });
    let mixed: Vec<Interleaved> = mixed.chunks(SIDE as usize).rev().flatten().copied().collect();

    let (mut rgb, mut rgba, mut opacity) = (vec![[0u8; 3]; count], vec![[0u8; 4]; count], vec![0f32; count]);
    draw(&call::target(plane(rgb.as_mut_ptr().cast(), PixelFormat::RgbU8)));
    draw(&call::target(plane(rgba.as_mut_ptr().cast(), PixelFormat::RgbaU8)));
    let alone = plane(opacity.as_mut_ptr().cast(), PixelFormat::F32);
    draw(&ffi::Target { opacity: alone, ..call::target(NO_PLANE) });

    let byte = |x: f32| (x.clamp(0.0, 1.0) * 255.0 + 0.5) as u8;
    let background = [1.0, 0.5, 0.25];
    let mut surfaces = 0;
    for i in 0..count {
        let (pixel, [r, g, b, a]) = (mixed[i], premultiplied[i]);
        assert_eq!((pixel.before, pixel.after), (77, 78), "bytes between channels");
        assert_eq!(rgb[i], pixel.rgb.map(byte));
        assert_eq!(rgba[i], [r, g, b, a].map(byte));
        assert_eq!((pixel.opacity, opacity[i]), (a, a));
        for (c, (colour, over)) in [r, g, b].into_iter().zip(background).enumerate() {
            assert!((colour + (1.0 - a) * over - pixel.rgb[c]).abs() < 1e-6);
        }
        if a > 1e-4 {
            surfaces += 1;
            assert!(pixel.z_depth <= pixel.ray_distance && (2.0..=6.0).contains(&pixel.ray_distance));
        } else {
            assert_eq!((pixel.z_depth, pixel.ray_distance), (6.0, 6.0));
        }
    }
    assert!(surfaces > count / 10 && surfaces < count, "{surfaces} pixels with a surface prove nothing");
}

#[test]
fn queries_are_what_the_rust_renderer_says() {
    use nerf_core::{blob::Blob, memory::Line, plan, render::Renderer};
    for (kernel, recipe) in
        kernels().flat_map(|kernel| [(kernel, Recipe::PLAIN), (kernel, Recipe::OCCUPANCY)])
    {
        let opened = call::open(recipe.blob(), kernel);
        let mut workspace = opened.workspace(None, ffi::NERF_OUTPUT_RGB);
        let (at, size, n) = (workspace.at(), workspace.size(), 150);
        let positions: Vec<[f32; 3]> =
            (0..n).map(|i| [0.017 * i as f32 - 1.2, 0.5 - 0.01 * i as f32, 0.009 * i as f32 - 0.3]).collect();
        let dirs: Vec<[f32; 3]> = (0..n).map(|i| [(i as f32).sin(), 0.0, (i as f32).cos()]).collect();
        let (mut sigma, mut rgb) = (vec![-1.0f32; n], vec![[-1.0f32; 3]; n]);
        let mut counters = call::counters();
        let mut ask = |dirs: *const f32, sigma: *mut f32, rgb: *mut f32, n| {
            let (positions, none) = (positions.as_ptr().cast(), null_mut());
            // SAFETY: everything lives until the call returns.
            unsafe {
                call::query(
                    opened.scene,
                    null(),
                    n,
                    positions,
                    dirs,
                    sigma,
                    rgb,
                    at,
                    size,
                    &mut counters,
                    none,
                    0,
                )
            }
        };
        let (d, s, c) = (dirs.as_ptr().cast(), sigma.as_mut_ptr(), rgb.as_mut_ptr().cast::<f32>());
        assert_eq!(ask(d, s, c, n), Status::Ok);
        let mut alone = vec![-1.0f32; n];
        assert_eq!(ask(null(), alone.as_mut_ptr(), null_mut(), n), Status::Ok);
        assert_eq!(ask(null(), null_mut(), null_mut(), 0), Status::Ok);
        assert_eq!(ask(null(), s, c, n), Status::NullPointer);
        assert_eq!(ask(d, null_mut(), c, n), Status::NullPointer);
        assert_eq!(ask(d, s, s, n), Status::Overlap);
        assert_eq!(ask(d, s, c, usize::MAX / 2), Status::Overflow);
        let crooked = [[2.0f32, 0.0, 0.0]; 150];
        assert_eq!(ask(crooked.as_ptr().cast(), s, c, n), Status::Direction);
        assert!(alone == sigma && counters.density_evaluations == 0, "the last good call was the empty one");

        let blob = Blob::open(&opened.blob).expect("a blob");
        let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, kernel)];
        let quality = plan::Quality::default();
        let plan = plan::Plan::new(&blob, &quality, plan::Outputs::RGB, plan::Batch::FULL).expect("a plan");
        let renderer = Renderer::new(blob, kernel, &mut memory).expect("a renderer");
        let mut lines = vec![Line::UNINIT; renderer.workspace_lines(&plan)];
        let (mut expected, mut colours) = (vec![0.0; n], vec![[0.0; 3]; n]);
        renderer.query(&plan, &positions, &dirs, &mut lines, &mut expected, &mut colours).expect("an answer");
        assert!(sigma == expected && rgb == colours, "{}", kernel);
    }
}
