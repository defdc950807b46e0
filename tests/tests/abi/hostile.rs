//! Invalid addresses, and addresses of other memory, in every argument of every function.

use nerf_core::Kernel;
use nerf_render as ffi;
use nerf_render::{PixelFormat, Status};
use nerf_testing::call::{self, Opened, plane};
use nerf_testing::memory::Guarded;
use nerf_testing::scenes::{Recipe, camera, kernels};
use std::ffi::c_void;
use std::ptr::{null, null_mut};

const SIDE: u32 = 8;

/// Renders a frame of `SIDE` x `SIDE` pixels into `target`.
fn draw(opened: &Opened, target: &ffi::Target, workspace: &mut Guarded) -> Status {
    let seen = call::camera(&camera(SIDE, SIDE));
    // SAFETY: everything lives until the call returns; planes that reach elsewhere must be refused unwritten.
    unsafe { call::frame(opened.scene, &seen, target, workspace.at(), workspace.size()) }
}

#[test]
fn null_in_each_argument_of_the_smaller_functions_is_refused() {
    let opened = call::open(Recipe::PROPOSAL.blob(), Kernel::IN_PLACE);
    let scene = opened.scene;
    let seen = call::camera(&camera(SIDE, SIDE));
    let (mut turned, mut options) = (seen, call::render_options());
    let (eye, target, up) = ([3.0f32, 0.0, 0.0], [0.0f32; 3], [0.0f32, 1.0, 0.0]);
    let (e, t, u) = (eye.as_ptr(), target.as_ptr(), up.as_ptr());
    let (mut origin, mut dir, mut sigma) = ([7.0f32; 3], [7.0f32; 3], 7.0f32);
    let (o, d, s) = (origin.as_mut_ptr(), dir.as_mut_ptr(), &raw mut sigma);
    let (mut size, mut align) = (7usize, 7usize);
    let (pace_size, pace_align) = (&raw mut size, &raw mut align);
    let mut workspace = opened.workspace(None, ffi::NERF_OUTPUT_RGB);
    let (at, room) = (workspace.at(), workspace.size());
    let (message, options_at): (*mut _, *mut _) = (null_mut(), &raw mut options);
    let turned_at = &raw mut turned;
    // SAFETY: zeros are numbers.
    let mut pace: ffi::Pace = unsafe { std::mem::zeroed() };
    pace.struct_size = size_of::<ffi::Pace>();
    let pace_at = &raw mut pace;
    let rgb = ffi::NERF_OUTPUT_RGB;
    let measure = |scene, seen, at, pace| {
        // SAFETY: every pointer is NULL or lives until the call returns.
        unsafe {
            call::pace_measure(scene, seen, null(), rgb, 9.0, None, null_mut(), at, room, pace, message, 0)
        }
    };
    // SAFETY: as above.
    let found = unsafe {
        [
            ffi::nerf_camera_look_at(null_mut(), e, t, u, message, 0),
            ffi::nerf_camera_look_at(turned_at, null(), t, u, message, 0),
            ffi::nerf_camera_look_at(turned_at, e, null(), u, message, 0),
            ffi::nerf_camera_look_at(turned_at, e, t, null(), message, 0),
            ffi::nerf_camera_ray(null(), 1.0, 1.0, o, d, s, message, 0),
            ffi::nerf_camera_ray(&seen, 1.0, 1.0, null_mut(), d, s, message, 0),
            ffi::nerf_camera_ray(&seen, 1.0, 1.0, o, null_mut(), s, message, 0),
            call::explain(null(), null(), rgb, null(), null_mut(), 0, null_mut(), message, 0),
            ffi::nerf_quality_within_loss(null(), 0.1, options_at, null_mut(), message, 0),
            ffi::nerf_quality_within_loss(scene, 0.1, null_mut(), null_mut(), message, 0),
            ffi::nerf_quality_within_cost(null(), 0.5, options_at, null_mut(), message, 0),
            ffi::nerf_quality_within_cost(scene, 0.5, null_mut(), null_mut(), message, 0),
            ffi::nerf_quality_within_time(null(), 9.0, pace_at, options_at, null_mut(), message, 0),
            ffi::nerf_quality_within_time(scene, 9.0, null(), options_at, null_mut(), message, 0),
            ffi::nerf_quality_within_time(scene, 9.0, pace_at, null_mut(), null_mut(), message, 0),
            ffi::nerf_quality_point(null(), 0, options_at, null_mut(), message, 0),
            ffi::nerf_quality_point(scene, 0, null_mut(), null_mut(), message, 0),
            ffi::nerf_quality_preset(null(), 0, options_at, message, 0),
            ffi::nerf_quality_preset(scene, 0, null_mut(), message, 0),
            call::pace_workspace_size(null(), null(), rgb, pace_size, pace_align, message, 0),
            call::pace_workspace_size(scene, null(), rgb, null_mut(), pace_align, message, 0),
            call::pace_workspace_size(scene, null(), rgb, pace_size, null_mut(), message, 0),
            measure(null(), &seen, at, pace_at),
            measure(scene, null(), at, pace_at),
            measure(scene, &seen, null_mut(), pace_at),
            measure(scene, &seen, at, null_mut()),
            call::query(null(), null(), 1, e, u, s, null_mut(), at, room, null_mut(), message, 0),
            call::query(scene, null(), 1, null(), u, s, null_mut(), at, room, null_mut(), message, 0),
            call::query(scene, null(), 1, e, null(), s, o, at, room, null_mut(), message, 0),
            call::query(scene, null(), 1, e, u, null_mut(), o, at, room, null_mut(), message, 0),
            call::query(scene, null(), 1, e, u, s, o, null_mut(), room, null_mut(), message, 0),
        ]
    };
    for (call, status) in found.into_iter().enumerate() {
        assert_eq!(status, Status::NullPointer, "call {call}");
    }
    assert_eq!((origin, dir, sigma, size, align), ([7.0; 3], [7.0; 3], 7.0, 7, 7));
    assert!(turned.c2w == seen.c2w);
    // No scene to close is no mistake.
    // SAFETY: NULL is allowed.
    unsafe { ffi::nerf_scene_close(null()) };
}

#[test]
fn structures_at_odd_addresses_are_refused_unread() {
    let opened = call::open(Recipe::OCCUPANCY.blob(), Kernel::IN_PLACE);
    let mut picture = Guarded::new((3 * SIDE * SIDE) as usize, 0);
    let mut workspace = opened.workspace(None, ffi::NERF_OUTPUT_RGB);
    let (seen, options) = (call::camera(&camera(SIDE, SIDE)), call::render_options());
    let target = call::target(plane(picture.at(), PixelFormat::RgbU8));
    let rect = ffi::Rect { x: 0, y: 0, width: SIDE, height: SIDE };
    let mut counters = call::counters();
    let (at, size) = (workspace.at(), workspace.size());
    // Half of the structures' alignment is refused as well as a single byte.
    for (argument, odd) in (0..5).flat_map(|argument| [1, 2, 4].map(|odd| (argument, odd))) {
        // A rectangle has numbers of four bytes.
        if (argument, odd) == (2, 4) {
            continue;
        }
        let off = |i: usize| if i == argument { odd } else { 0 };
        let (seen, options) =
            ((&raw const seen).wrapping_byte_add(off(0)), (&raw const options).wrapping_byte_add(off(1)));
        let (rect, target) =
            ((&raw const rect).wrapping_byte_add(off(2)), (&raw const target).wrapping_byte_add(off(3)));
        let counters = (&raw mut counters).wrapping_byte_add(off(4));
        let none = null_mut();
        // SAFETY: everything lives until the call returns, and what is misaligned must not be read.
        let found = unsafe {
            call::render(
                opened.scene,
                seen,
                options,
                rect,
                target,
                at,
                size,
                None,
                none,
                counters,
                null_mut(),
                0,
            )
        };
        assert_eq!(found, Status::Alignment, "argument {argument}, off by {odd}");
    }
    assert!(picture.is_untouched() && counters.rays == 0);
}

/// Returns start addresses of a plane near the `size` bytes at `start`, each with whether the plane overlaps these
/// bytes. Some planes overlap by one pixel; others end or begin right beside the bytes. The plane has `length` bytes
/// and pixels of four bytes.
fn edges(start: usize, size: usize, length: usize) -> [(usize, bool); 6] {
    let end = start + size;
    [
        (start - length, false),
        (start - length + 4, true),
        (start, true),
        (start + size / 8 * 4, true),
        ((end - 1) / 4 * 4, true),
        (end.next_multiple_of(4), false),
    ]
}

#[test]
fn overlap_is_found_to_the_last_pixel() {
    let (blob, kernel) = (Recipe::OCCUPANCY.blob(), kernels().last().expect("a kernel"));
    let apart = call::open(blob.clone(), kernel);
    let (length, row) = ((4 * SIDE * SIDE) as usize, 4 * SIDE as isize);
    let sizes = [apart.workspace(None, ffi::NERF_OUTPUT_OPACITY).size(), blob.len(), apart.memory.size()];
    // Workspace, blob and scene in one piece of memory, with room for a plane between them.
    let mut starts = [0; 3];
    let mut end = 0;
    for (start, size) in starts.iter_mut().zip(sizes) {
        *start = (end + length).next_multiple_of(64);
        end = *start + size;
    }
    let mut memory = Guarded::new(end.next_multiple_of(4) + length, 0);
    let base = memory.at().cast::<u8>();
    let [workspace, bytes, scene_memory] = starts.map(|start| base.wrapping_add(start));
    let (options, mut scene, none) = (call::open_options(kernel), null(), null_mut());
    // SAFETY: all within `memory`, apart from each other, and alive until the end.
    let status = unsafe {
        bytes.copy_from_nonoverlapping(blob.as_ptr(), blob.len());
        let memory = scene_memory.cast::<c_void>();
        ffi::nerf_scene_open(bytes.cast(), blob.len(), &options, memory, sizes[2], &mut scene, none, 0)
    };
    assert_eq!(status, Status::Ok);
    let seen = call::camera(&camera(SIDE, SIDE));
    let drawn = |target: &ffi::Target| {
        // SAFETY: as above; planes that reach where they must not are refused unwritten.
        unsafe { call::frame(scene, &seen, target, workspace.cast(), sizes[0]) }
    };
    for (start, size) in starts.into_iter().zip(sizes) {
        for (at, overlaps) in edges(start, size, length) {
            for upwards in [false, true] {
                let first = if upwards { at + length - row as usize } else { at };
                let mut target = call::target(call::NO_PLANE);
                target.opacity = plane(base.wrapping_add(first).cast(), PixelFormat::F32);
                target.opacity.row_stride = if upwards { -row } else { row };
                let expected = if overlaps { Status::Overlap } else { Status::Ok };
                assert_eq!(
                    drawn(&target),
                    expected,
                    "{} bytes from {size} bytes",
                    at as isize - start as isize
                );
            }
        }
    }
    assert_eq!(memory.bytes()[starts[1]..][..blob.len()], blob);
    assert!(memory.surroundings_are_intact());
}

#[test]
fn a_scene_s_memory_is_apart_from_its_blob_to_the_last_byte() {
    let (blob, options) = (Recipe::OCCUPANCY.blob(), call::open_options(Kernel::IN_PLACE));
    let size = call::open(blob.clone(), Kernel::IN_PLACE).memory.size();
    let mut memory = Guarded::new(2 * size + blob.len(), 0);
    let base = memory.at().cast::<u8>();
    // The blob behind the memory, from where it touches nothing down to where it begins with it.
    for at in [size, size - 1, size / 2, 1, 0] {
        let bytes = base.wrapping_add(at);
        let (mut scene, none) = (null(), null_mut());
        // SAFETY: all within `memory`, and what overlaps must be refused unwritten.
        let found = unsafe {
            bytes.copy_from_nonoverlapping(blob.as_ptr(), blob.len());
            ffi::nerf_scene_open(bytes.cast(), blob.len(), &options, base.cast(), size, &mut scene, none, 0)
        };
        assert_eq!(found, if at == size { Status::Ok } else { Status::Overlap }, "{at}");
        assert_eq!(scene.is_null(), at != size);
        assert_eq!(memory.bytes()[at..][..blob.len()], blob, "{at}");
    }
}

#[test]
fn lengths_that_no_memory_has_are_refused_unread() {
    let opened = call::open(Recipe::OCCUPANCY.blob(), Kernel::IN_PLACE);
    let blob = opened.blob.as_ptr().cast::<c_void>();
    let mut memory = Guarded::new(opened.memory.size(), 0);
    let mut workspace = opened.workspace(None, ffi::NERF_OUTPUT_OPACITY);
    let mut picture = Guarded::new((4 * SIDE * SIDE) as usize, 0);
    let mut target = call::target(call::NO_PLANE);
    target.opacity = plane(picture.at(), PixelFormat::F32);
    let seen = call::camera(&camera(SIDE, SIDE));
    let (mut size, mut align, mut scene, none) = (7, 7, null(), null_mut());
    for length in [usize::MAX, usize::MAX - 63, isize::MAX as usize + 1] {
        let (at, room, lines) = (memory.at(), memory.size(), workspace.at());
        // SAFETY: what is as long as this must be refused before anything is read or written.
        let found = unsafe {
            [
                ffi::nerf_scene_memory(blob, length, null(), &mut size, &mut align, none, 0),
                ffi::nerf_scene_open(blob, length, null(), at, room, &mut scene, none, 0),
                ffi::nerf_scene_open(blob, opened.blob.len(), null(), at, length, &mut scene, none, 0),
                call::frame(opened.scene, &seen, &target, lines, length),
            ]
        };
        assert_eq!(found, [Status::Overflow; 4], "{length}");
    }
    assert!((size, align) == (7, 7) && scene.is_null());
    assert!(memory.is_untouched() && workspace.is_untouched() && picture.is_untouched());
}

#[test]
fn planes_over_each_other_are_refused_and_nothing_is_written() {
    let opened = call::open(Recipe::OCCUPANCY.blob(), Kernel::IN_PLACE);
    let count = (SIDE * SIDE) as usize;
    let mut workspace = opened.workspace(None, 15);
    let mut target = call::target(call::NO_PLANE);
    // All three over each other, shifted by none, by one pixel or by all but one.
    for shift in [0, 1, count - 1, count] {
        let mut shared = Guarded::new(4 * (count + 2 * shift), 0);
        let at = |k: usize, memory: &mut Guarded| memory.at().wrapping_byte_add(4 * shift * k);
        target.opacity = plane(at(0, &mut shared), PixelFormat::F32);
        target.ray_distance = plane(at(1, &mut shared), PixelFormat::F32);
        target.z_depth = plane(at(2, &mut shared), PixelFormat::F32);
        let expected = if shift < count { Status::Overlap } else { Status::Ok };
        assert_eq!(draw(&opened, &target, &mut workspace), expected, "{shift}");
        assert!(shift == count || shared.is_untouched());
        assert!(shared.surroundings_are_intact() && workspace.surroundings_are_intact());
    }
}
