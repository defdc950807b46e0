//! Overlap of planes: the planes of one target must not share a byte, but may be interleaved in any way.

use nerf_core::Kernel;
use nerf_render as ffi;
use nerf_render::{PixelFormat, Status};
use nerf_testing::call::{self, Message, Opened, plane};
use nerf_testing::memory::Guarded;
use nerf_testing::noise;
use nerf_testing::scenes::{self, Recipe};
use std::collections::BTreeSet;
use std::ptr::null_mut;

const COLUMNS: usize = 4;
const ROWS: usize = 3;
const OUTPUTS: u32 = ffi::NERF_OUTPUT_RGB | ffi::NERF_OUTPUT_OPACITY | ffi::NERF_OUTPUT_NORMALS;
/// Size of the memory in which planes lie, bytes.
const ROOM: usize = 4096;

struct Worker {
    handle: *mut ffi::Worker,
    _memory: Guarded,
    _opened: Opened,
}

fn worker() -> Worker {
    let (opened, mut options) = (call::open(Recipe::TINY.blob(), Kernel::IN_PLACE), call::render_options());
    options.samples = 4;
    let mut memory = opened.workspace(Some(&options), OUTPUTS);
    let (mut handle, request) = (null_mut(), call::request(opened.scene, &options, OUTPUTS));
    // SAFETY: everything lives until the call returns, scene and memory as long as the worker is used.
    let status =
        unsafe { ffi::nerf_worker_open(&request, memory.at(), memory.size(), &mut handle, null_mut(), 0) };
    assert_eq!(status, Status::Ok);
    Worker { handle, _memory: memory, _opened: opened }
}

fn render(worker: &Worker, target: &ffi::Target) -> (Status, String) {
    let camera = call::camera(&scenes::camera(COLUMNS as u32, ROWS as u32));
    let (frame, mut message) = (call::whole_frame(&camera, target), Message::default());
    // SAFETY: the worker is intact, and the planes lie in memory that lives until the call returns.
    let status = unsafe { ffi::nerf_render(worker.handle, &frame, null_mut(), message.0.as_mut_ptr(), 256) };
    (status, message.text())
}

/// Position of a plane in the memory, bytes: offset of the first pixel, strides, and size of a pixel.
#[derive(Clone, Copy, Debug)]
struct Place {
    first: usize,
    pixel_stride: usize,
    row_stride: isize,
    size: usize,
}

impl Place {
    /// Draws a plane in the middle of the memory; offset and strides are multiples of `align`.
    fn any(state: &mut u64, size: usize, align: usize) -> Self {
        let mut below = |n: u64| (noise::next(state) % n) as usize;
        let pixel_stride = size.next_multiple_of(align) + align * below(8);
        let row = pixel_stride * (COLUMNS - 1) + size;
        let row_stride = (row.next_multiple_of(align) + align * below(24)) as isize;
        let first = ROOM / 2 + align * below(40);
        Self { first, pixel_stride, row_stride: if below(3) == 0 { -row_stride } else { row_stride }, size }
    }

    fn plane(&self, room: &mut [u32], format: PixelFormat) -> ffi::Plane {
        let data = room.as_mut_ptr().wrapping_byte_add(self.first).cast();
        let (pixel_stride, row_stride) = (self.pixel_stride, self.row_stride);
        ffi::Plane { pixel_stride, row_stride, ..plane(data, format) }
    }

    fn bytes(&self) -> BTreeSet<usize> {
        let pixels = (0..ROWS * COLUMNS).map(|i| {
            let row = self.first.wrapping_add_signed(self.row_stride * (i / COLUMNS) as isize);
            row + self.pixel_stride * (i % COLUMNS)
        });
        pixels.flat_map(|pixel| pixel..pixel + self.size).collect()
    }
}

#[test]
fn planes_of_one_target_are_refused_where_they_share_a_byte_and_only_there() {
    let worker = worker();
    let (mut state, mut found) = (7, [0; 2]);
    for case in 0..3000 {
        let (mut colour, opacity) = (Place::any(&mut state, 3, 1), Place::any(&mut state, 4, 4));
        if case % 3 == 0 {
            // Channels of one structure, perhaps.
            (colour.pixel_stride, colour.row_stride) = (opacity.pixel_stride, opacity.row_stride);
            colour.first = opacity.first + case % 17;
        }
        let mut room = vec![0xa5a5_a5a5_u32; ROOM / 4];
        let target = ffi::Target {
            opacity: opacity.plane(&mut room, PixelFormat::F32),
            ..call::target(colour.plane(&mut room, PixelFormat::RgbU8))
        };
        let shared = colour.bytes().intersection(&opacity.bytes()).count();
        let (status, said) = render(&worker, &target);
        found[usize::from(shared > 0)] += 1;
        if shared > 0 {
            assert_eq!((status, said.as_str()), (Status::Overlap, "target.opacity: overlaps target.rgb"));
            assert!(room.iter().all(|&word| word == 0xa5a5_a5a5), "{colour:?} {opacity:?}");
        } else {
            assert_eq!(status, Status::Ok, "{said}: {colour:?} {opacity:?}");
        }
    }
    assert!(found.iter().all(|&count| count > 300), "{found:?} prove nothing");
}

#[test]
fn two_outputs_of_rays_at_one_float_are_refused() {
    let worker = worker();
    let (origins, dirs) = ([[0.0f32, 0.0, 4.0]; 5], [[0.0f32, 0.0, -1.0]; 5]);
    let at = |room: &mut [f32], float: usize, format| ffi::Plane {
        pixel_stride: 32,
        ..plane(room.as_mut_ptr().wrapping_add(float).cast(), format)
    };
    for (float, expected) in [
        (0, Status::Overlap),
        (2, Status::Overlap),
        (3, Status::Ok),
        (7, Status::Ok),
        // The first float of the next ray's.
        (8, Status::Overlap),
    ] {
        let mut room = [7.0f32; 48];
        let target = ffi::Target {
            normals: at(&mut room, 0, PixelFormat::Vec3F32),
            opacity: at(&mut room, float, PixelFormat::F32),
            ..call::target(call::NO_PLANE)
        };
        let floats = |data: &[[f32; 3]]| ffi::Floats { data: data.as_ptr().cast(), stride: 0 };
        // SAFETY: zeros are numbers and NULL.
        let mut rays: ffi::Rays = unsafe { std::mem::zeroed() };
        (rays.struct_size, rays.count) = (size_of::<ffi::Rays>(), 5);
        (rays.origins, rays.dirs, rays.target) = (floats(&origins), floats(&dirs), &target);
        let mut message = Message::default();
        // SAFETY: the worker is intact, and everything the rays point to lives until the call returns.
        let status =
            unsafe { ffi::nerf_render_rays(worker.handle, &rays, null_mut(), message.0.as_mut_ptr(), 256) };
        assert_eq!(status, expected, "{}", message.text());
        if status == Status::Overlap {
            assert!(room.iter().all(|&x| x == 7.0), "{room:?}");
            assert_eq!(message.text(), "target.normals: overlaps target.opacity");
        }
    }
}
