//! Writable memory that overlaps other memory of the same call: the call is refused, and nothing is written.

use nerf_core::Kernel;
use nerf_render as ffi;
use nerf_render::Status;
use nerf_testing::call::{self, Message};
use nerf_testing::memory::Guarded;
use nerf_testing::scenes::Recipe;
use std::ffi::{CStr, c_void};
use std::ptr::{null, null_mut};

const RGB: u32 = ffi::NERF_OUTPUT_RGB;

fn instances(scene: *const ffi::Scene) -> [ffi::Instance; 2] {
    [ffi::Instance { struct_size: size_of::<ffi::Instance>(), scene, to_world: [0.0; 12] }; 2]
}

fn size_of_worker(request: &ffi::Request) -> usize {
    let (mut size, mut align) = (0, 0);
    // SAFETY: everything lives until the call returns.
    let status = unsafe { ffi::nerf_worker_size(request, &mut size, &mut align, null_mut(), 0) };
    assert_eq!(status, Status::Ok);
    size
}

/// Copies `value` to an address in lent memory.
fn put<T>(at: *mut c_void, value: T) -> *mut T {
    // SAFETY: each test has so much memory there, aligned.
    unsafe { at.cast::<T>().write(value) };
    at.cast()
}

#[test]
fn memory_of_a_worker_over_anything_else_it_is_opened_with_is_refused() {
    let mut opened = call::open(Recipe::TINY.blob(), Kernel::IN_PLACE);
    let (two, options) = (instances(opened.scene), call::render_options());
    let (instances, instance_count) = (two.as_ptr(), two.len());
    let request = ffi::Request { instances, instance_count, ..call::request(null(), &options, RGB) };
    let size = size_of_worker(&request);
    let mut lent = Guarded::new(size, 0);
    let memory = lent.at();
    let (mut handle, mut message) = (null_mut(), Message::default());
    let (out, text) = (&raw mut handle, message.0.as_mut_ptr());
    let refused = |request: *const ffi::Request, out: *mut *mut ffi::Worker, text, expected: &str| {
        let before = lent.bytes().to_vec();
        // SAFETY: everything lives until the call returns.
        let status = unsafe { ffi::nerf_worker_open(request, memory, size, out, text, 64) };
        assert_eq!(status, Status::Overlap, "{expected}");
        // A message over the memory is written there.
        if expected.is_empty() {
            return;
        }
        assert!(lent.bytes() == before && lent.surroundings_are_intact(), "{expected}");
        // SAFETY: `text` holds a message and its NUL.
        let said = unsafe { CStr::from_ptr(text) }.to_string_lossy();
        assert_eq!(said, expected);
    };
    // At the end, where the workspace is, and behind the worker itself, where the scenes are listed.
    for place in [size - 256, 1024].map(|offset| memory.wrapping_byte_add(offset)) {
        let of = ffi::Request { instances: put(place, two).cast(), ..request };
        refused(&of, out, text, "request.instances: overlaps the worker's memory");
        let of = ffi::Request { options: put(place, options), ..request };
        refused(&of, out, text, "request.options: overlaps the worker's memory");
        refused(put(place, request), out, text, "request: overlaps the worker's memory");
        refused(&request, place.cast(), text, "worker: overlaps the worker's memory");
        refused(&request, out, place.cast(), "");
    }
    refused(&request, opened.memory.at().cast(), text, "worker: overlaps the scene's memory");
    let blob = opened.blob.as_mut_ptr();
    let blob = blob.wrapping_add(blob.align_offset(8));
    refused(&request, blob.cast(), text, "worker: overlaps the blob");
    assert!(handle.is_null());
    // SAFETY: as above.
    let status = unsafe { ffi::nerf_worker_open(&request, memory, size, out, text, 64) };
    assert_eq!(status, Status::Ok);
}

#[test]
fn a_scene_is_not_opened_over_its_own_handle_or_message() {
    let mut blob = Recipe::TINY.blob();
    let (bytes, length) = (blob.as_mut_ptr(), blob.len());
    let (mut size, mut align, none) = (0, 0, null_mut());
    // SAFETY: everything lives until the calls return.
    let status =
        unsafe { ffi::nerf_scene_memory(bytes.cast(), length, null(), &mut size, &mut align, none, 0) };
    assert_eq!(status, Status::Ok);
    let mut lent = Guarded::new(size, 0);
    let memory = lent.at();
    let (mut scene, mut message) = (null(), Message::default());
    let (out, text) = (&raw mut scene, message.0.as_mut_ptr());
    let open = |out: *mut *const ffi::Scene, text| {
        // SAFETY: as above.
        unsafe { ffi::nerf_scene_open(bytes.cast(), length, null(), memory, size, out, text, 64) }
    };
    let in_blob = bytes.wrapping_add(bytes.align_offset(8));
    for (place, expected) in [
        (memory, "scene: overlaps the scene's memory"),
        (memory.wrapping_byte_add(size - 8), "scene: overlaps the scene's memory"),
        (in_blob.cast(), "scene: overlaps the blob"),
    ] {
        assert_eq!(open(place.cast(), text), Status::Overlap, "{expected}");
        // SAFETY: `text` holds a message and its NUL.
        assert_eq!(unsafe { CStr::from_ptr(text) }.to_string_lossy(), expected);
    }
    assert!(lent.is_untouched() && blob == Recipe::TINY.blob());
    assert_eq!(open(out, memory.cast()), Status::Overlap);
    assert!(scene.is_null());
    assert_eq!(open(out, text), Status::Ok);
}
