//! Median distance and normals through the C interface, also for callers whose header lacks these planes.

use nerf_core::Kernel;
use nerf_core::blob::Blob;
use nerf_core::memory::Line;
use nerf_core::plan::{Batch, Outputs, Plan, Quality};
use nerf_core::render::{Counters, Rect, Renderer};
use nerf_core::volume::Pixel;
use nerf_render as ffi;
use nerf_render::{PixelFormat, Status};
use nerf_testing::call::{self, Message, NO_PLANE, Opened, plane};
use nerf_testing::scenes::{Recipe, camera, kernels};
use std::mem::offset_of;
use std::ptr::{null, null_mut};

const SIDE: u32 = 24;
const COUNT: usize = (SIDE * SIDE) as usize;
const PLAIN: u32 = ffi::NERF_OUTPUT_RGB
    | ffi::NERF_OUTPUT_OPACITY
    | ffi::NERF_OUTPUT_RAY_DISTANCE
    | ffi::NERF_OUTPUT_Z_DEPTH;

/// A host's pixel, with a value of the host's own between the planes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C)]
struct Interleaved {
    normal: [f32; 3],
    between: u32,
    median_distance: f32,
}

/// Renders the camera's whole image, in exactly as much memory as `outputs` need.
fn render(
    opened: &Opened,
    options: Option<&ffi::RenderOptions>,
    outputs: u32,
    target: *const ffi::Target,
    counters: *mut ffi::Counters,
) -> (Status, String) {
    let mut workspace = opened.workspace(None, outputs);
    let (mut message, camera) = (Message::default(), call::camera(&camera(SIDE, SIDE)));
    let options = options.map_or(null(), |options| options as *const _);
    let (at, size, text) = (workspace.at(), workspace.size(), message.0.as_mut_ptr());
    let (rect, none) = (null(), null_mut());
    // SAFETY: everything lives until the call returns.
    let status = unsafe {
        call::render(opened.scene, &camera, options, rect, target, at, size, None, none, counters, text, 256)
    };
    assert!(workspace.surroundings_are_intact());
    (status, message.text())
}

/// Renders the same image with the Rust renderer.
fn reference(blob: &[u8], kernel: Kernel, outputs: Outputs) -> (Vec<Pixel>, Counters) {
    let blob = Blob::open(blob).expect("a blob");
    let plan = Plan::new(&blob, &Quality::default(), outputs, Batch::FULL).expect("a plan");
    let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, kernel)];
    let renderer = Renderer::new(blob, kernel, &mut memory).expect("a renderer");
    let mut lines = vec![Line::UNINIT; renderer.workspace_lines(&plan)];
    let mut pixels = vec![Pixel::BLANK; COUNT];
    let mut put = |x: u32, y: u32, pixel: &Pixel| pixels[(y * SIDE + x) as usize] = *pixel;
    let rect = Rect { x: 0, y: 0, width: SIDE, height: SIDE };
    let counters = renderer.render(&plan, &camera(SIDE, SIDE), rect, &mut lines, &mut put).expect("pixels");
    (pixels, counters)
}

#[test]
fn planes_of_medians_and_normals_are_the_rust_renderers() {
    let recipes = [Recipe::PLAIN, Recipe::DEFERRED, Recipe::DEFERRED_LAYER];
    for (kernel, recipe) in kernels().flat_map(|kernel| recipes.map(|recipe| (kernel, recipe))) {
        let opened = call::open(recipe.blob(), kernel);
        let blank = Interleaved { between: 77, ..Interleaved::default() };
        let mut pixels = vec![blank; COUNT];
        let first = pixels.as_mut_ptr().cast::<u8>();
        let at = |offset: usize, format| ffi::Plane {
            pixel_stride: size_of::<Interleaved>(),
            ..plane(first.wrapping_add(offset).cast(), format)
        };
        let target = ffi::Target {
            median_distance: at(offset_of!(Interleaved, median_distance), PixelFormat::F32),
            normals: at(offset_of!(Interleaved, normal), PixelFormat::Vec3F32),
            ..call::target(NO_PLANE)
        };
        let mut counters = call::counters();
        let outputs = ffi::NERF_OUTPUT_MEDIAN_DISTANCE | ffi::NERF_OUTPUT_NORMALS;
        let found = render(&opened, None, outputs, &target, &mut counters);
        assert_eq!(found, (Status::Ok, String::new()));

        let asked = Outputs { median_distance: true, normals: true, ..Outputs::NONE };
        let (expected, work) = reference(&opened.blob, kernel, asked);
        assert_eq!((counters.normal_evaluations, counters.macs), (work.normal_evaluations, work.macs));
        assert!(counters.normal_evaluations > 0 && counters.colour_evaluations == 0);
        let mut surfaces = 0;
        for (pixel, expected) in pixels.iter().zip(&expected) {
            assert_eq!(pixel.between, 77);
            assert_eq!(pixel.normal, expected.normal, "{}", kernel);
            assert_eq!(pixel.median_distance, expected.median_distance, "{}", kernel);
            surfaces += usize::from(pixel.normal != [0.0; 3] && pixel.median_distance < 6.0);
        }
        assert!(surfaces > COUNT / 10, "{surfaces} pixels with a surface prove nothing");
    }
}

#[test]
fn planes_that_are_not_asked_for_take_no_workspace() {
    for kernel in kernels() {
        let opened = call::open(Recipe::PLAIN.blob(), kernel);
        let bytes = |outputs| opened.workspace(None, outputs).size();
        let (plain, line) = (bytes(PLAIN), 64);
        // A tile's and the renderer's 256 floats.
        let median = 2 * (256 * 4usize).next_multiple_of(line);
        assert_eq!(bytes(PLAIN | ffi::NERF_OUTPUT_MEDIAN_DISTANCE), plain + median, "{}", kernel);
        assert!(bytes(PLAIN | ffi::NERF_OUTPUT_NORMALS) > plain);
        // What a pixel of a tile had before either existed.
        let blob = Blob::open(&opened.blob).expect("a blob");
        let plan = Plan::new(&blob, &Quality::default(), Outputs::ALL, Batch::FULL).expect("a plan");
        let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, kernel)];
        let renderer = Renderer::new(blob, kernel, &mut memory).expect("a renderer");
        let worker = plain - 64 * renderer.workspace_lines(&plan) - 256 * 24;
        assert!((1..=2048).contains(&worker), "{worker} bytes of a worker's own");
    }
}

#[test]
fn the_blur_of_normals_is_the_caller_s() {
    let opened = call::open(Recipe::PLAIN.blob(), Kernel::detect());
    let draw = |options: Option<&ffi::RenderOptions>| {
        let mut normals = vec![[9.0f32; 3]; COUNT];
        let to = plane(normals.as_mut_ptr().cast(), PixelFormat::Vec3F32);
        let target = ffi::Target { normals: to, ..call::target(NO_PLANE) };
        let (status, message) = render(&opened, options, ffi::NERF_OUTPUT_NORMALS, &target, null_mut());
        (status, message, normals)
    };
    let mut options = call::render_options();
    options.transmittance_cut = ffi::NERF_TRANSMITTANCE_CUT_DEFAULT;
    options.colour_cut = ffi::NERF_COLOUR_CUT_DEFAULT;
    let sharp = draw(Some(&options)).2;
    options.normal_blur = ffi::NERF_NORMAL_BLUR_DEFAULT;
    assert_eq!(draw(Some(&options)), draw(None));
    assert!(draw(None).2 != sharp, "ten levels have ripples");
    options.normal_blur = f32::NAN;
    let (status, message, untouched) = draw(Some(&options));
    assert_eq!(status, Status::Options);
    assert!(message.contains("normal_blur") && untouched.iter().all(|n| *n == [9.0; 3]), "{message}");
}

#[test]
fn a_median_behind_the_cut_is_refused_by_name() {
    let opened = call::open(Recipe::PLAIN.blob(), Kernel::IN_PLACE);
    let mut median = vec![9.0f32; COUNT];
    let mut options = call::render_options();
    options.transmittance_cut = 0.6;
    let target = ffi::Target {
        median_distance: plane(median.as_mut_ptr().cast(), PixelFormat::F32),
        ..call::target(NO_PLANE)
    };
    let outputs = ffi::NERF_OUTPUT_MEDIAN_DISTANCE;
    let (status, message) = render(&opened, Some(&options), outputs, &target, null_mut());
    assert_eq!(status, Status::Options);
    assert!(message.contains("transmittance_cut") && message.contains("0.6"), "{message}");
    assert!(median.iter().all(|&t| t == 9.0));
}
