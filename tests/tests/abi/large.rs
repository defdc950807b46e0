//! Images of more than 2^28 pixels and planes of more than 2^32 bytes, rendered with the workspace of one tile.
//!
//! CI renders columns, rows and corners of these images. `NERF_LONG=1` renders all 16,384×16,384 pixels, by one call
//! and tile by tile, which takes one minute or more and 1 GiB:
//! `NERF_LONG=1 cargo test --release -p nerf-tests --test abi large -- --nocapture`

use nerf_core::Kernel;
use nerf_core::camera::{Camera, Intrinsics, Lens, MAX_IMAGE_SIDE, Pose};
use nerf_render as ffi;
use nerf_render::{PixelFormat, Status};
use nerf_testing::call::{self, Message, NO_PLANE, Opened, plane};
use nerf_testing::fence::{Fenced, Flush};
use nerf_testing::memory::Guarded;
use nerf_testing::scenes::Recipe;
use nerf_testing::tools;
use std::ffi::c_void;
use std::ptr::null;
use std::sync::atomic::{AtomicU32, Ordering};

const SIDE: u32 = 16_384;
/// Side of a tile, pixels.
const TILE: u32 = 64;
/// Row stride of the whole frame's plane, bytes: the last row begins beyond 2^32.
const ROW: usize = 1 << 19;
const OUTPUTS: u32 = ffi::NERF_OUTPUT_RGB | ffi::NERF_OUTPUT_RAY_DISTANCE;

/// A scene and a camera with a large image, most of which shows only background.
struct Large {
    opened: Opened,
    camera: ffi::Camera,
    options: ffi::RenderOptions,
}

// SAFETY: a scene never changes, and the rest are numbers.
unsafe impl Sync for Large {}

/// Progress that a call has reported.
#[derive(Default)]
struct Told {
    done: u64,
    all: u64,
    stop: bool,
}

unsafe extern "C-unwind" fn watch(user: *mut c_void, done: u64, all: u64) -> i32 {
    // SAFETY: whoever passes this function passes such a place.
    let told = unsafe { &mut *user.cast::<Told>() };
    assert!(done >= told.done && done <= all, "{done} of {all} after {}", told.done);
    (told.done, told.all) = (done, all);
    told.stop.into()
}

impl Large {
    fn new(width: u32, height: u32) -> Self {
        let pose = Pose::look_at([1.5, 1.2, 3.4].into(), [0.0, 0.0, 0.1].into(), [0.0, 1.0, 0.0].into());
        let intrinsics = Intrinsics::centred(width, height, 0.4 * width.max(height) as f32);
        let camera = Camera::new(intrinsics, Lens::NONE, pose.expect("a pose")).expect("a camera");
        let mut options = call::render_options();
        options.samples = 8;
        let opened = call::open(Recipe::TINY.blob(), Kernel::detect());
        Self { opened, camera: call::camera(&camera), options }
    }

    fn workspace(&self) -> Guarded {
        self.opened.workspace(Some(&self.options), OUTPUTS)
    }

    /// Renders `rect`. Returns status, counters and message.
    fn draw(
        &self,
        rect: Option<ffi::Rect>,
        (rgb, ray_distance): (ffi::Plane, ffi::Plane),
        workspace: &mut Guarded,
        told: &mut Told,
    ) -> (Status, ffi::Counters, String) {
        let target = ffi::Target { ray_distance, ..call::target(rgb) };
        let rect = rect.as_ref().map_or(null(), |rect| rect as *const _);
        let (mut counters, mut message) = (call::counters(), Message::default());
        let (at, size) = (workspace.at(), workspace.size());
        // SAFETY: everything lives until the call returns.
        let status = unsafe {
            call::render(
                self.opened.scene,
                &self.camera,
                &self.options,
                rect,
                &target,
                at,
                size,
                Some(watch),
                (told as *mut Told).cast(),
                &mut counters,
                message.0.as_mut_ptr(),
                256,
            )
        };
        (status, counters, message.text())
    }

    /// Renders `rect` into `tile`, and verifies that every pixel is written. Returns the number of rays.
    fn tile(&self, rect: ffi::Rect, tile: &mut Tile) -> u64 {
        tile.0[..(rect.width * rect.height) as usize].fill([f32::NAN; 5]);
        let first = tile.0.as_mut_ptr().cast::<f32>();
        let channel = |at: usize, format| {
            let pixel_stride = size_of::<[f32; 5]>();
            ffi::Plane { pixel_stride, ..plane(first.wrapping_add(at).cast(), format) }
        };
        let planes = (channel(0, PixelFormat::RgbaF32), channel(4, PixelFormat::F32));
        let (status, counters, said) = self.draw(Some(rect), planes, &mut tile.1, &mut Told::default());
        assert_eq!(status, Status::Ok, "{said}");
        let pixels = &tile.0[..(rect.width * rect.height) as usize];
        assert!(pixels.iter().flatten().all(|x| x.is_finite()), "a pixel of the tile was left out");
        counters.rays
    }

    fn new_tile(&self) -> Tile {
        Tile(vec![[0.0; 5]; (TILE * TILE) as usize], self.workspace())
    }
}

/// Pixels of a tile (r, g, b, a, ray_distance), and a workspace that is used for all tiles.
struct Tile(Vec<[f32; 5]>, Guarded);

fn bits(pixels: &[[f32; 5]]) -> Vec<[u32; 5]> {
    pixels.iter().map(|pixel| pixel.map(f32::to_bits)).collect()
}

/// Returns the bits of the distance that begins at byte `at` of a plane.
fn distance(bytes: &[u8], at: usize) -> u32 {
    u32::from_ne_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]])
}

#[test]
fn planes_of_more_than_2_32_bytes_have_each_pixel_in_its_place() {
    let large = Large::new(SIDE, SIDE);
    let mut tile = large.new_tile();
    let mut workspace = large.workspace();
    let last = (SIDE - 1) as usize;
    // A column, rows downwards and upwards; and a row of pixels that are as far apart.
    for (across, up) in [(false, false), (false, true), (true, false)] {
        let mut bytes = Fenced::zeros(last * ROW + 4, Flush::End);
        let first = bytes.first().wrapping_byte_add(if up { last * ROW } else { 0 });
        let to = plane(first.cast(), PixelFormat::F32);
        let to = match across {
            true => ffi::Plane { pixel_stride: ROW, ..to },
            false => ffi::Plane { row_stride: if up { -(ROW as isize) } else { ROW as isize }, ..to },
        };
        let line = |from: u32, length: u32| match across {
            true => ffi::Rect { x: from, y: SIDE / 2, width: length, height: 1 },
            false => ffi::Rect { x: SIDE / 2, y: from, width: 1, height: length },
        };
        let mut told = Told::default();
        let (status, counters, said) =
            large.draw(Some(line(0, SIDE)), (NO_PLANE, to), &mut workspace, &mut told);
        assert_eq!((status, counters.rays, told.done), (Status::Ok, SIDE.into(), SIDE.into()), "{said}");
        let (mut different, mut surfaces) = (std::collections::BTreeSet::new(), 0);
        for from in (0..SIDE).step_by(TILE as usize) {
            large.tile(line(from, TILE), &mut tile);
            for (i, pixel) in tile.0[..TILE as usize].iter().enumerate() {
                let place = from as usize + i;
                let at = if up { last - place } else { place } * ROW;
                assert_eq!(distance(&bytes, at), pixel[4].to_bits(), "pixel {place}, {across}, {up}");
                different.insert(pixel[4].to_bits());
                surfaces += usize::from(pixel[3] > 1e-4);
            }
        }
        assert!(
            different.len() > 1000 && surfaces > 1000,
            "{} different, {surfaces} surfaces",
            different.len()
        );
    }
    assert!(workspace.surroundings_are_intact() && tile.1.surroundings_are_intact());
}

#[test]
fn tiles_of_a_frame_of_2_28_pixels_are_its_pixels_one_by_one() {
    let large = Large::new(SIDE, SIDE);
    let (mut tile, mut alone) = (large.new_tile(), large.new_tile());
    let far = SIDE - TILE;
    for (x, y) in [(0, 0), (far, 0), (0, far), (far, far), (8_000, 8_100), (9_001, 7_777)] {
        large.tile(ffi::Rect { x, y, width: TILE, height: TILE }, &mut tile);
        let tile = bits(&tile.0);
        for i in (0..TILE * TILE).step_by(61) {
            let (column, row) = (i % TILE, i / TILE);
            let rect = ffi::Rect { x: x + column, y: y + row, width: 1, height: 1 };
            assert_eq!(large.tile(rect, &mut alone), 1);
            assert_eq!(bits(&alone.0[..1])[0], tile[i as usize], "pixel {rect:?}");
        }
    }
    if tools::long() {
        whole(&large);
    }
}

/// Renders the whole frame by one call, and by tiles on threads; compares the results.
fn whole(large: &Large) {
    let mut bytes = Fenced::zeros((SIDE as usize - 1) * ROW + 4 * SIDE as usize, Flush::End);
    let to = ffi::Plane { row_stride: ROW as isize, ..plane(bytes.first().cast(), PixelFormat::F32) };
    let (mut told, mut workspace) = (Told::default(), large.workspace());
    let (status, counters, said) = large.draw(None, (NO_PLANE, to), &mut workspace, &mut told);
    let all = u64::from(SIDE) * u64::from(SIDE);
    assert_eq!((status, told.done, told.all, counters.rays), (Status::Ok, all, all, all), "{said}");
    let samples = counters.samples_kept + counters.samples_skipped;
    assert_eq!(samples, 8 * all, "every ray's samples are counted");
    let (next, across) = (AtomicU32::new(0), SIDE / TILE);
    let bytes = &bytes[..];
    let rays: u64 = std::thread::scope(|scope| {
        let work = || {
            let (mut tile, mut rays) = (large.new_tile(), 0);
            let numbers = std::iter::repeat_with(|| next.fetch_add(1, Ordering::Relaxed));
            for number in numbers.take_while(|number| *number < across * across) {
                let (x, y) = (number % across * TILE, number / across * TILE);
                rays += large.tile(ffi::Rect { x, y, width: TILE, height: TILE }, &mut tile);
                for (i, pixel) in (0..TILE * TILE).zip(&tile.0) {
                    let at = (y + i / TILE) as usize * ROW + 4 * (x + i % TILE) as usize;
                    assert_eq!(distance(bytes, at), pixel[4].to_bits(), "({x}, {y}), {i}");
                }
            }
            assert!(tile.1.surroundings_are_intact());
            rays
        };
        let workers = [scope.spawn(work), scope.spawn(work)];
        workers.into_iter().map(|worker| worker.join().expect("a worker")).sum()
    });
    assert_eq!(rays, all, "every pixel is in one tile");
    println!("{rays} pixels, workspace of {} bytes; in one call: {counters:?}", workspace.size());
}

#[test]
fn images_one_pixel_high_or_wide_are_their_parts() {
    for (width, height) in [(65_535, 1), (1, 65_535)] {
        let large = Large::new(width, height);
        let (mut tile, mut workspace) = (large.new_tile(), large.workspace());
        let mut row = vec![0.0f32; 65_535];
        let to = plane(row.as_mut_ptr().cast(), PixelFormat::F32);
        let mut told = Told::default();
        let (status, counters, said) = large.draw(None, (NO_PLANE, to), &mut workspace, &mut told);
        assert_eq!((status, counters.rays, told.all), (Status::Ok, 65_535, 65_535), "{said}");
        // Some of its parts, the last among them.
        for from in (0..=16u32).map(|part| (part * 4_095).min(65_535 - TILE)) {
            let rect = match height {
                1 => ffi::Rect { x: from, y: 0, width: TILE, height: 1 },
                _ => ffi::Rect { x: 0, y: from, width: 1, height: TILE },
            };
            large.tile(rect, &mut tile);
            let found: Vec<f32> = tile.0[..TILE as usize].iter().map(|pixel| pixel[4]).collect();
            assert_eq!(found, row[from as usize..][..TILE as usize], "{rect:?}");
        }
    }
}

#[test]
fn frames_beyond_any_memory_are_refused_and_the_longest_row_can_be_begun() {
    let side = MAX_IMAGE_SIDE;
    let large = Large::new(side, side);
    let (mut tile, mut workspace) = (large.new_tile(), large.workspace());
    let all = |width, height| ffi::Rect { x: 0, y: 0, width, height };
    let mut byte = [0u8; 4];
    // Rows 2^41 bytes apart; pixels 2^41 bytes apart.
    for (row_stride, pixel_stride) in [(1 << 41, 0), (0, 1 << 41)] {
        let tight = plane(byte.as_mut_ptr().cast(), PixelFormat::RgbU8);
        let (rgb, rect) = (ffi::Plane { row_stride, pixel_stride, ..tight }, None);
        let mut told = Told::default();
        let (status, _, said) = large.draw(rect, (rgb, NO_PLANE), &mut workspace, &mut told);
        assert_eq!((status, byte, told.all), (Status::Overflow, [0; 4], 0), "{said}");
        assert!(said.contains("target.rgb"), "{said}");
    }
    // Promised, and never touched: the caller stops before the first tile.
    let mut row = Fenced::zeros(3 * side as usize, Flush::End);
    let rgb = plane(row.first().cast(), PixelFormat::RgbU8);
    let mut told = Told { stop: true, ..Told::default() };
    let (status, ..) = large.draw(Some(all(side, 1)), (rgb, NO_PLANE), &mut workspace, &mut told);
    assert_eq!((status, told.done, told.all), (Status::Cancelled, 0, side.into()));
    // The far corner, and one pixel beyond.
    let corner = side - TILE;
    let rect = ffi::Rect { x: corner, y: corner, width: TILE, height: TILE };
    assert_eq!(large.tile(rect, &mut tile), u64::from(TILE * TILE));
    let beyond = ffi::Rect { x: corner + 1, ..rect };
    let (status, ..) = large.draw(Some(beyond), (rgb, NO_PLANE), &mut workspace, &mut Told::default());
    assert_eq!(status, Status::Rect);
}
