//! 2D fields at the C interface: images, and refused arguments, after which nothing is written.

use nerf_core::Kernel;
use nerf_core::math::MathBackend;
use nerf_core::render::MAX_RENDER_SIDE;
use nerf_render as ffi;
use nerf_render::{PixelFormat, Status};
use nerf_testing::call::{self, Message, NO_PLANE, Opened, plane};
use nerf_testing::memory::Guarded;
use nerf_testing::scenes::{self, Recipe, camera, kernels};
use std::ffi::c_void;
use std::ptr::{null, null_mut};
use std::sync::atomic::{AtomicU32, Ordering};

const WIDTH: u32 = 37;
const HEIGHT: u32 = 29;
const PIXELS: usize = (WIDTH * HEIGHT) as usize;

/// Valid arguments of a call, of which a test makes one invalid.
struct Case {
    opened: Opened,
    size: (u32, u32),
    options: ffi::RenderOptions,
    rect: Option<ffi::Rect>,
    target: ffi::Target,
    counters: ffi::Counters,
    workspace: Guarded,
    picture: Guarded,
    message: Message,
}

impl Case {
    fn new(kernel: Kernel) -> Self {
        Self::with(kernel, call::render_options())
    }

    fn with(kernel: Kernel, options: ffi::RenderOptions) -> Self {
        Self::of(Recipe::PICTURE, kernel, options)
    }

    fn of(recipe: Recipe, kernel: Kernel, options: ffi::RenderOptions) -> Self {
        let opened = call::open(recipe.blob(), kernel);
        let workspace = opened.picture_workspace(Some(&options));
        let mut picture = Guarded::new(12 * PIXELS, 0);
        Self {
            size: (WIDTH, HEIGHT),
            rect: None,
            target: call::target(plane(picture.at(), PixelFormat::RgbF32)),
            counters: call::counters(),
            message: Message::default(),
            opened,
            options,
            workspace,
            picture,
        }
    }

    fn render(&mut self) -> Status {
        let (at, size) = (self.workspace.at(), self.workspace.size());
        self.render_in(at, size, None, null_mut())
    }

    fn render_in(
        &mut self,
        workspace: *mut c_void,
        size: usize,
        progress: ffi::Progress,
        user: *mut c_void,
    ) -> Status {
        let rect = self.rect.as_ref().map_or(null(), |rect| rect as *const ffi::Rect);
        let text = self.message.0.as_mut_ptr();
        // SAFETY: every pointer is NULL or lives in `self`; wrong ones must be refused unread.
        unsafe {
            call::render_picture(
                self.opened.scene,
                self.size.0,
                self.size.1,
                &self.options,
                rect,
                &self.target,
                workspace,
                size,
                progress,
                user,
                &mut self.counters,
                text,
                256,
            )
        }
    }

    fn colours(&self) -> Vec<[f32; 3]> {
        let channel = |bytes: &[u8]| f32::from_ne_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]);
        let pixel = |bytes: &[u8]| [0, 4, 8].map(|at| channel(&bytes[at..]));
        self.picture.bytes().chunks_exact(12).map(pixel).collect()
    }

    fn describe(&self) -> ffi::SceneInfo {
        // SAFETY: numbers and pointers have no invalid bytes.
        let mut info: ffi::SceneInfo = unsafe { std::mem::zeroed() };
        info.struct_size = size_of::<ffi::SceneInfo>();
        // SAFETY: the scene is intact, and `info` is as long as it says.
        assert_eq!(unsafe { ffi::nerf_scene_describe(self.opened.scene, &mut info) }, Status::Ok);
        info
    }

    fn macs(&self) -> u64 {
        let info = self.describe();
        info.density_macs + info.colour_macs
    }

    fn refused(&self, found: Status, expected: Status, text: &str) {
        let said = self.message.text();
        assert_eq!(found, expected, "{text}: {said}");
        assert!(said.contains(text), "{text}: {said}");
        assert!(self.picture.is_untouched(), "{text}: something was written");
        assert_eq!(self.counters.colour_evaluations, 0, "{text}: counters were written");
    }
}

/// Renders with one argument made invalid by `spoil`. Verifies the status, and that the message contains `text`.
fn refuses(expected: Status, text: &str, spoil: impl FnOnce(&mut Case)) {
    let mut case = Case::new(Kernel::IN_PLACE);
    spoil(&mut case);
    let found = case.render();
    case.refused(found, expected, text);
}

#[test]
fn c_draws_what_rust_draws_in_exactly_the_memory_it_asked_for() {
    for (kernel, recipe) in
        kernels().flat_map(|kernel| [Recipe::PICTURE, Recipe::LEARNED_PICTURE].map(|recipe| (kernel, recipe)))
    {
        for (maths, math) in [(0, MathBackend::Polynomial), (1, MathBackend::Libm)] {
            for (batch_rays, batch_samples) in [(0, 0), (1, 1), (7, 64), (100, 5)] {
                let options =
                    ffi::RenderOptions { maths, batch_rays, batch_samples, ..call::render_options() };
                let mut case = Case::of(recipe, kernel, options);
                let expected = scenes::picture(&case.opened.blob, kernel, math, [WIDTH, HEIGHT]);
                assert_eq!(case.render(), Status::Ok, "{}", case.message.text());
                assert_eq!(case.message.text(), "");
                let what = format!("{recipe:?}, {}, {math:?}, {batch_rays}, {batch_samples}", kernel);
                assert!(case.colours() == expected, "{what}");
                let (c, macs) = (case.counters, case.macs());
                let work = (c.colour_evaluations, c.macs, c.rays, c.samples_kept, c.density_evaluations);
                assert_eq!(work, (PIXELS as u64, PIXELS as u64 * macs, 0, 0, 0));
                for memory in [&case.picture, &case.workspace, &case.opened.memory] {
                    assert!(memory.surroundings_are_intact(), "{what}");
                }
                let mut case = Case::of(recipe, kernel, options);
                let (at, size) = (case.workspace.at(), case.workspace.size());
                let found = case.render_in(at, size - 1, None, null_mut());
                case.refused(found, Status::Memory, "memory: expected at least");
            }
        }
    }
}

#[test]
fn a_picture_says_how_large_it_was_and_a_scene_says_nothing_of_that() {
    let mut case = Case::new(Kernel::IN_PLACE);
    let info = case.describe();
    assert_eq!((info.kind, info.picture_width, info.picture_height), (ffi::Kind::Picture as u32, 33, 21));
    assert_eq!((info.near_distance, info.far_distance, info.samples), (0.0, 0.0, 0));
    case.opened = call::open(Recipe::OCCUPANCY.blob(), Kernel::IN_PLACE);
    let info = case.describe();
    assert_eq!((info.kind, info.picture_width, info.picture_height), (ffi::Kind::Scene as u32, 0, 0));
}

#[test]
fn scenes_and_pictures_are_not_taken_for_each_other() {
    refuses(Status::NotAPicture, "expected a 2D field, found a scene", |case| {
        case.opened = call::open(Recipe::OCCUPANCY.blob(), Kernel::IN_PLACE);
        case.workspace = case.opened.workspace(Some(&case.options), ffi::NERF_OUTPUT_RGB);
    });

    let mut case = Case::new(Kernel::IN_PLACE);
    let camera = call::camera(&camera(WIDTH, HEIGHT));
    let (at, room) = (case.workspace.at(), case.workspace.size());
    let (none, text) = (null_mut(), case.message.0.as_mut_ptr());
    // SAFETY: as above.
    let found = unsafe {
        call::render(
            case.opened.scene,
            &camera,
            &case.options,
            null(),
            &case.target,
            at,
            room,
            None,
            none,
            &mut case.counters,
            text,
            256,
        )
    };
    case.refused(found, Status::NotAScene, "expected a scene, found a 2D field");
    let (position, dir, mut sigma, mut rgb) = ([0.5f32; 3], [0.0f32, 0.0, 1.0], -1.0f32, [-1.0f32; 3]);
    // SAFETY: as above.
    let found = unsafe {
        call::query(
            case.opened.scene,
            null(),
            1,
            position.as_ptr(),
            dir.as_ptr(),
            &mut sigma,
            rgb.as_mut_ptr(),
            at,
            room,
            &mut case.counters,
            text,
            256,
        )
    };
    case.refused(found, Status::NotAScene, "expected a scene, found a 2D field");
    assert_eq!((sigma, rgb), (-1.0, [-1.0; 3]));
}

#[test]
fn null_misaligned_and_overlapping_memory_is_refused() {
    refuses(Status::NullPointer, "scene", |case| case.opened.scene = null());
    refuses(Status::Target, "at least one plane", |case| case.target.rgb.data = null_mut());
    refuses(Status::Alignment, "target.rgb", |case| {
        case.target.rgb.data = case.picture.at().wrapping_byte_add(1)
    });
    refuses(Status::Overlap, "the worker's memory", |case| case.target.rgb.data = case.workspace.at());
    refuses(Status::Overlap, "the scene's memory", |case| case.target.rgb.data = case.opened.memory.at());
    let mut case = Case::new(Kernel::IN_PLACE);
    let found = case.render_in(null_mut(), 1 << 20, None, null_mut());
    case.refused(found, Status::NullPointer, "memory");
    for offset in 1..64 {
        let mut elsewhere = Guarded::new(case.workspace.size(), offset);
        let found = case.render_in(elsewhere.at(), elsewhere.size(), None, null_mut());
        case.refused(found, Status::Alignment, "memory");
        assert!(elsewhere.is_untouched());
    }
    let (scene, mut size, mut align, none) = (case.opened.scene, 0usize, 0usize, null_mut());
    let (at, room) = (case.workspace.at(), case.workspace.size());
    // SAFETY: every pointer is NULL or lives until the calls return.
    let found = unsafe {
        let (target, user, text) = (null(), null_mut(), null_mut());
        [
            call::worker_size(null(), null(), ffi::NERF_OUTPUT_RGB, &mut size, &mut align, none, 0),
            call::worker_size(scene, null(), ffi::NERF_OUTPUT_RGB, null_mut(), &mut align, none, 0),
            call::worker_size(scene, null(), ffi::NERF_OUTPUT_RGB, &mut size, null_mut(), none, 0),
            call::render_picture(
                scene,
                4,
                4,
                null(),
                null(),
                target,
                at,
                room,
                None,
                user,
                null_mut(),
                text,
                0,
            ),
        ]
    };
    assert_eq!((found, size, align), ([Status::NullPointer; 4], 0, 0));
}

#[test]
fn sizes_settings_and_rectangles_outside_their_range_are_refused() {
    for size in [(0, 1), (1, 0), (MAX_RENDER_SIDE + 1, 1), (1, u32::MAX)] {
        refuses(Status::Options, "size: expected sides of 1 to 8388608", |case| case.size = size);
        // Also where nothing would be drawn.
        refuses(Status::Options, "size", |case| {
            (case.size, case.rect) = (size, Some(ffi::Rect { x: 0, y: 0, width: 0, height: 0 }));
        });
    }
    refuses(Status::Options, "options.maths", |case| case.options.maths = 4);
    refuses(Status::Options, "options.batch_samples", |case| case.options.batch_samples = 65);
    refuses(Status::Reserved, "options.reserved", |case| case.options.reserved = 1);
    for wrong in [0, usize::MAX] {
        refuses(Status::StructSize, "options", |case| case.options.struct_size = wrong);
        refuses(Status::StructSize, "target", |case| case.target.struct_size = wrong);
        refuses(Status::StructSize, "counters", |case| case.counters.struct_size = wrong);
    }
    let outside = [(0, 0, WIDTH + 1, 1), (1, 0, WIDTH, 1), (0, HEIGHT, 1, 1), (u32::MAX, 0, 2, 1)];
    for (x, y, width, height) in outside {
        refuses(Status::Rect, "inside the 37x29 image", |case| {
            case.rect = Some(ffi::Rect { x, y, width, height })
        });
    }
    for (width, height) in [(0, 0), (0, 5), (5, 0)] {
        let mut case = Case::new(Kernel::IN_PLACE);
        case.rect = Some(ffi::Rect { x: 3, y: 3, width, height });
        assert_eq!(case.render(), Status::Ok);
        assert!(case.picture.is_untouched() && case.counters.colour_evaluations == 0);
    }
}

#[test]
fn only_colour_has_a_plane_and_it_is_opaque() {
    refuses(Status::Target, "target.opacity: expected NULL", |case| {
        case.target.opacity = plane(case.picture.at(), PixelFormat::F32);
    });
    refuses(Status::Target, "target.ray_distance", |case| {
        let elsewhere = plane(case.picture.at(), PixelFormat::F32);
        (case.target.rgb, case.target.ray_distance) = (NO_PLANE, elsewhere);
    });
    refuses(Status::Target, "target.median_distance", |case| {
        case.target.median_distance = plane(case.picture.at(), PixelFormat::F32);
    });
    refuses(Status::Target, "target.normals", |case| {
        case.target.normals = plane(case.picture.at(), PixelFormat::Vec3F32);
    });
    refuses(Status::Target, "target.z_depth", |case| {
        case.target.z_depth = plane(case.picture.at(), PixelFormat::F32);
    });
    refuses(Status::Target, "NERF_FORMAT_RGB_U8", |case| case.target.rgb.format = PixelFormat::F32 as u32);

    let mut case = Case::new(Kernel::detect());
    // A background, which must not show.
    (case.options.background_set, case.options.background) = (1, [0.0, 1.0, 0.0]);
    assert_eq!(case.render(), Status::Ok);
    let expected = case.colours();
    let byte = |x: f32| (x * 255.0 + 0.5) as u8;
    // Rows upwards, with a gap of one pixel.
    let row = 4 * (WIDTH as usize + 1);
    let mut bytes = vec![0x77; row * HEIGHT as usize];
    let first = bytes[row * (HEIGHT as usize - 1)..].as_mut_ptr();
    let rgba = plane(first.cast(), PixelFormat::RgbaU8);
    case.target.rgb = ffi::Plane { row_stride: -(row as isize), ..rgba };
    assert_eq!(case.render(), Status::Ok);
    for (y, line) in bytes.chunks(row).rev().enumerate() {
        let (pixels, gap) = line.split_at(row - 4);
        assert_eq!(gap, [0x77; 4]);
        for (x, pixel) in pixels.chunks(4).enumerate() {
            let [r, g, b] = expected[y * WIDTH as usize + x].map(byte);
            assert_eq!(pixel, [r, g, b, 255]);
        }
    }
}

unsafe extern "C-unwind" fn stop_at(user: *mut c_void, done: u64, all: u64) -> i32 {
    // SAFETY: the only render that is watched passes this pair.
    let (last, limit) = unsafe { &mut *user.cast::<(u64, u64)>() };
    assert!(done >= *last && all == PIXELS as u64);
    *last = done;
    i32::from(done >= *limit)
}

#[test]
fn cancelling_stops_within_one_tile_and_the_rest_is_untouched() {
    let mut case = Case::new(Kernel::detect());
    assert_eq!(case.render(), Status::Ok);
    let expected = case.colours();
    for limit in [0, 1, 256, 257, 700, PIXELS as u64] {
        let mut case = Case::new(Kernel::detect());
        let mut state = (0u64, limit);
        let (at, size) = (case.workspace.at(), case.workspace.size());
        let found = case.render_in(at, size, Some(stop_at), (&raw mut state).cast());
        assert_eq!(found, Status::Cancelled);
        assert!(state.0 >= limit && state.0 < limit + 256);
        let untouched = f32::from_ne_bytes([0xc5; 4]);
        let written = case.colours().iter().filter(|pixel| **pixel != [untouched; 3]).count();
        assert_eq!(written as u64, state.0);
        let pairs = case.colours().into_iter().zip(&expected);
        assert!(pairs.filter(|(found, _)| *found != [untouched; 3]).all(|(found, pixel)| found == *pixel));
    }
}

/// A 2D field and an image that threads share.
struct Shared(Opened, *mut c_void);
// SAFETY: scenes never change (the contract under test), and threads write different pixels.
unsafe impl Sync for Shared {}

#[test]
fn threads_share_a_picture() {
    for kernel in kernels() {
        let mut case = Case::new(kernel);
        assert_eq!(case.render(), Status::Ok);
        let expected = case.colours();
        let mut picture = Guarded::new(12 * PIXELS, 0);
        let shared = Shared(call::open(Recipe::PICTURE.blob(), kernel), picture.at());
        let next = AtomicU32::new(0);
        std::thread::scope(|scope| {
            for _ in 0..4 {
                scope.spawn(|| {
                    let (Shared(opened, pixels), mut workspace) = (&shared, shared.0.picture_workspace(None));
                    // One column each: rows end inside a block.
                    for x in std::iter::repeat_with(|| next.fetch_add(1, Ordering::Relaxed))
                        .take_while(|x| *x < WIDTH)
                    {
                        let rect = ffi::Rect { x, y: 0, width: 1, height: HEIGHT };
                        let part = plane(pixels.wrapping_byte_add(12 * x as usize), PixelFormat::RgbF32);
                        let target = call::target(ffi::Plane { row_stride: 12 * WIDTH as isize, ..part });
                        let (at, size, none) = (workspace.at(), workspace.size(), null_mut());
                        // SAFETY: everything lives until the call returns.
                        let status = unsafe {
                            call::render_picture(
                                opened.scene,
                                WIDTH,
                                HEIGHT,
                                null(),
                                &rect,
                                &target,
                                at,
                                size,
                                None,
                                none,
                                null_mut(),
                                null_mut(),
                                0,
                            )
                        };
                        assert_eq!(status, Status::Ok);
                    }
                });
            }
        });
        case.picture = picture;
        assert!(case.colours() == expected, "{}", kernel);
        assert!(case.picture.surroundings_are_intact());
    }
}
