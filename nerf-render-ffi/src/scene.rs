//! An opened scene, in the caller's memory.

use crate::boundary::{Message, call, call_for_size, check_out};
use crate::failure::Failure;
use crate::open_options::{OpenOptions, read_kernel};
use crate::span::{Span, check_aligned};
use crate::status::Status;
use core::ffi::{c_char, c_void};
use nerf_core::Kernel;
use nerf_core::blob::Blob;
use nerf_core::memory::{Line, lines_for};
use nerf_core::render::Renderer;

/// An opened scene. The scene lies at the beginning of its memory and borrows the bytes of the scene file.
///
/// A scene owns nothing and never changes: threads may share a scene, and there is nothing to close. A scene is valid
/// until the caller reuses the scene's memory or the memory of the file's bytes. (A scene from `nerf_scene_open_file`
/// lies in the library's own memory and is valid until `nerf_scene_close`.)
#[repr(align(64))]
pub struct Scene {
    renderer: Renderer<'static>,
    blob: Span,
    memory: Span,
    #[cfg(feature = "std")]
    pub(crate) owned: Option<crate::scene_file::Owned>,
}

/// Compile-time check: threads may share a scene without a lock.
const _: () = {
    const fn shared<T: Send + Sync>() {}
    shared::<Scene>();
};

impl Scene {
    /// Returns the scene of a handle; an error if `scene` is NULL or misaligned.
    /// # Safety
    /// `scene` is NULL or an opened scene's handle. During `'a`, nobody frees, moves or changes the scene's memory or
    /// the scene file's bytes.
    pub(crate) unsafe fn of<'a>(scene: *const Self) -> Result<&'a Self, Failure> {
        if scene.is_null() {
            return Err(Failure::Null("scene"));
        }
        check_aligned("scene", scene as usize, align_of::<Self>())?;
        // SAFETY: `scene` is not NULL, is aligned, and is valid (`# Safety`). Scenes are never written to.
        Ok(unsafe { &*scene })
    }

    pub(crate) fn renderer(&self) -> &Renderer<'static> {
        &self.renderer
    }

    pub(crate) fn check_apart(&self, name: &'static str, span: Span) -> Result<(), Failure> {
        span.check_apart(name, self.blob, "the blob")?;
        span.check_apart(name, self.memory, "the scene's memory")
    }
}

/// Returns the number of [`Line`]s (64 bytes each) that an opened scene takes in the caller's memory.
pub(crate) fn memory_lines(blob: &Blob<'_>, kernel: Kernel) -> usize {
    lines_for::<Scene>(1) + Renderer::prepared_lines(blob, kernel)
}

/// Parses and checks a scene file. Entropy-coded tables are not yet checked: `nerf_scene_open` decodes and checks them.
///
/// # Safety
/// `blob` is NULL or points to `blob_size` bytes that do not change during `'a`.
unsafe fn open_blob<'a>(blob: *const c_void, blob_size: usize) -> Result<Blob<'a>, Failure> {
    Span::of("blob", blob.cast::<u8>(), blob_size)?;
    // SAFETY: `blob` is not NULL, is no longer than a slice may be, and is readable (`# Safety`).
    let bytes = unsafe { core::slice::from_raw_parts(blob.cast::<u8>(), blob_size) };
    Ok(Blob::open_undecoded(bytes)?)
}

/// Computes the size and alignment of the memory that `nerf_scene_open` needs for a scene file.
///
/// `blob`: the scene file's `blob_size` bytes, at any alignment. `options`: NULL for all zeros. `size` and `align`,
/// bytes, are written on success only. `message`: NULL, or a buffer of `message_capacity` bytes that receives a
/// sentence about what was expected and found; empty on success.
///
/// # Safety
/// Pointers are NULL or point to what is described here.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn nerf_scene_memory(
    blob: *const c_void,
    blob_size: usize,
    options: *const OpenOptions,
    size: *mut usize,
    align: *mut usize,
    message: *mut c_char,
    message_capacity: usize,
) -> Status {
    let body = || {
        // SAFETY: `options` is valid, as this function's `# Safety` requires.
        let kernel = unsafe { read_kernel(options)? };
        // SAFETY: `blob` is valid, as this function's `# Safety` requires; the borrow ends with this call.
        let blob = unsafe { open_blob(blob, blob_size)? };
        memory_lines(&blob, kernel).checked_mul(size_of::<Line>()).ok_or(Failure::Overflow("size"))
    };
    let message = Message { text: message, capacity: message_capacity };
    // SAFETY: `size` and `align` are valid, as this function's `# Safety` requires.
    unsafe { call_for_size((size, align), message, body) }
}

/// Opens a scene in the caller's memory; allocates nothing and owns nothing.
///
/// The scene borrows `blob` (the scene file's bytes) and `memory`: the caller must not move or change these while the
/// scene is used. `memory` must have at least the size and alignment from `nerf_scene_memory` for the same `options`
/// (NULL for all zeros). `blob` and `memory` must not overlap each other, `scene` or `message`. `scene` receives the
/// handle on success only; there is nothing to close. `message`: NULL, or a buffer for an error message.
///
/// # Safety
/// Pointers are NULL or point to what is described here.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn nerf_scene_open(
    blob: *const c_void,
    blob_size: usize,
    options: *const OpenOptions,
    memory: *mut c_void,
    memory_size: usize,
    scene: *mut *const Scene,
    message: *mut c_char,
    message_capacity: usize,
) -> Status {
    let message = Message { text: message, capacity: message_capacity };
    call(message, || {
        check_out("scene", scene)?;
        // SAFETY: `options` is valid, as this function's `# Safety` requires.
        let kernel = unsafe { read_kernel(options)? };
        let blob_span = Span::of("blob", blob.cast::<u8>(), blob_size)?;
        Span::of("memory", memory.cast::<Line>().cast_const(), 0)?;
        let memory_span = Span::new("memory", memory, memory_size)?;
        for (name, written) in [("scene", Span::of("scene", scene, 1)?), ("message", message.first()?)] {
            written.check_apart(name, blob_span, "the blob")?;
            written.check_apart(name, memory_span, "the scene's memory")?;
        }
        let bytes = core::ptr::slice_from_raw_parts(blob.cast::<u8>(), blob_size);
        // SAFETY: neither pointer is NULL, and `memory` is aligned (checked above). The caller lends both regions.
        let handle = unsafe { open_in(bytes, memory, memory_size, kernel)? };
        // SAFETY: the pointers were checked above, and are writable, as this function's `# Safety` requires.
        unsafe { scene.write(handle) };
        Ok(())
    })
}

/// Opens a scene in `memory`; the returned handle points to the beginning of `memory`.
///
/// # Safety
/// `memory` is aligned for a [`Line`], `memory_size` bytes long, and does not overlap `blob`. The caller lends `blob`
/// and `memory` while the scene is used.
// Inlined, so that a microcontroller's stack has one frame less.
#[inline(always)]
pub(crate) unsafe fn open_in(
    blob: *const [u8],
    memory: *mut c_void,
    memory_size: usize,
    kernel: Kernel,
) -> Result<*mut Scene, Failure> {
    let blob_span = Span::new("blob", blob.cast(), blob.len())?;
    let memory_span = Span::new("memory", memory, memory_size)?;
    memory_span.check_apart("memory", blob_span, "the blob")?;
    // SAFETY: `blob` is readable and stays as it is, as this function's `# Safety` requires.
    let blob = Blob::open_undecoded(unsafe { &*blob })?;
    let lines = memory_lines(&blob, kernel);
    if memory_size / size_of::<Line>() < lines {
        let expected = lines.saturating_mul(size_of::<Line>());
        return Err(Failure::Memory { name: "memory", expected, found: memory_size });
    }
    let (own, memory) = (lines_for::<Scene>(1), memory.cast::<Line>());
    // SAFETY: `memory` is aligned, has `lines` lines, does not overlap `blob`, and is lent; any bytes are valid lines.
    let prepared = unsafe { core::slice::from_raw_parts_mut(memory.add(own), lines - own) };
    let renderer = Renderer::new(blob, kernel, prepared)?;
    let handle = memory.cast::<Scene>();
    let scene = Scene {
        renderer,
        blob: blob_span,
        memory: memory_span,
        #[cfg(feature = "std")]
        owned: None,
    };
    // SAFETY: the first `own` lines hold a scene, are aligned for it, and are not in `prepared`.
    unsafe { handle.write(scene) };
    Ok(handle)
}
