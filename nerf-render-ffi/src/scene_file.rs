//! Opening of a scene from a file, for hosts with a heap and a file system. Only this module allocates memory.

use crate::boundary::{Message, Reason, call, call_with_reason, check_out};
use crate::failure::Failure;
use crate::open_options::{OpenOptions, read_kernel};
use crate::scene::{Scene, memory_lines, open_in};
use crate::span::check_aligned;
use crate::status::Status;
use core::ffi::{CStr, c_char};
use core::fmt;
use core::ptr::NonNull;
use nerf_core::blob::{Blob, BlobError, HEADER_LEN};
use nerf_core::memory::Line;
use std::fs::File;
use std::io::{self, Read};

/// Memory of a scene that was opened from a file; freed by `nerf_scene_close`. The fields are pointers instead of
/// boxes, since the scene borrows `blob` and `memory`, and itself lies in `memory`.
pub(crate) struct Owned {
    blob: NonNull<[u8]>,
    memory: NonNull<[Line]>,
}

// SAFETY: plain memory, never written to between opening and closing.
unsafe impl Send for Owned {}
// SAFETY: plain memory, never written to between opening and closing.
unsafe impl Sync for Owned {}

impl Owned {
    fn new(blob: Vec<u8>, memory: Vec<Line>) -> Self {
        let (blob, memory) = (Box::leak(blob.into_boxed_slice()), Box::leak(memory.into_boxed_slice()));
        Self { blob: NonNull::from(blob), memory: NonNull::from(memory) }
    }

    /// Frees `blob` and `memory`.
    /// # Safety
    /// Nothing uses `blob` and `memory` any more.
    unsafe fn free(self) {
        // SAFETY: both pointers come from boxes (`new`). The boxes are freed only once, since `self` is not `Copy`.
        drop(unsafe { (Box::from_raw(self.blob.as_ptr()), Box::from_raw(self.memory.as_ptr())) });
    }
}

struct FileFailure<'a> {
    path: &'a CStr,
    cause: Cause,
}

enum Cause {
    Read(io::Error),
    NotRegular,
    OutOfMemory { bytes: usize },
    Scene(Failure),
}

impl Reason for FileFailure<'_> {
    fn panic() -> Self {
        Self { path: c"", cause: Cause::Scene(Failure::Panic) }
    }

    fn status(&self) -> Status {
        match &self.cause {
            Cause::Read(_) | Cause::NotRegular => Status::File,
            Cause::OutOfMemory { .. } => Status::OutOfMemory,
            Cause::Scene(failure) => failure.status(),
        }
    }
}

impl fmt::Display for FileFailure<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if !self.path.is_empty() {
            write!(f, "{}: ", self.path.to_string_lossy())?;
        }
        match &self.cause {
            Cause::Read(error) => write!(f, "expected a file that can be read, found: {error}"),
            Cause::NotRegular => write!(f, "expected a file, found a folder, a device or a pipe"),
            Cause::OutOfMemory { bytes } => write!(f, "expected {bytes} bytes of free memory, found less"),
            Cause::Scene(failure) => failure.fmt(f),
        }
    }
}

impl<T: Into<Failure>> From<T> for Cause {
    fn from(failure: T) -> Self {
        Self::Scene(failure.into())
    }
}

impl From<io::Error> for Cause {
    fn from(error: io::Error) -> Self {
        Self::Read(error)
    }
}

/// Opens a scene from a file, in memory that the library allocates and `nerf_scene_close` frees.
///
/// For hosts with a heap; only in a library with the feature `std`. `path`: NUL-terminated; any bytes on Unix, UTF-8 on
/// other systems. `options`: NULL for all zeros. `scene` receives the handle on success only; on failure nothing stays
/// allocated. `message`: NULL, or a buffer for an error message, which begins with the path.
///
/// # Safety
/// Pointers are NULL or point to what is described here.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn nerf_scene_open_file(
    path: *const c_char,
    options: *const OpenOptions,
    scene: *mut *const Scene,
    message: *mut c_char,
    message_capacity: usize,
) -> Status {
    call_with_reason(Message { text: message, capacity: message_capacity }, || {
        let unnamed = |failure| FileFailure { path: c"", cause: Cause::Scene(failure) };
        check_out("scene", scene).map_err(unnamed)?;
        // SAFETY: `options` is valid, as this function's `# Safety` requires.
        let kernel = unsafe { read_kernel(options) }.map_err(unnamed)?;
        if path.is_null() {
            return Err(unnamed(Failure::Null("path")));
        }
        // SAFETY: `path` is not NULL, and is NUL-terminated, as this function's `# Safety` requires.
        let path = unsafe { CStr::from_ptr(path) };
        let named = |cause| FileFailure { path, cause };
        let blob = read(path).map_err(named)?;
        let lines = {
            let blob = Blob::open_undecoded(&blob).map_err(|error| named(error.into()))?;
            memory_lines(&blob, kernel)
        };
        let size = lines.saturating_mul(size_of::<Line>());
        let mut memory = Vec::new();
        memory.try_reserve_exact(lines).map_err(|_| named(Cause::OutOfMemory { bytes: size }))?;
        memory.resize(lines, Line::UNINIT);
        let owned = Owned::new(blob, memory);
        let memory = owned.memory.as_ptr().cast();
        // SAFETY: the file's bytes and the memory do not overlap, and the scene owns these until `nerf_scene_close`.
        let opened = unsafe { open_in(owned.blob.as_ptr(), memory, size, kernel) };
        match opened {
            Ok(handle) => {
                // SAFETY: `open_in` has just written the scene, and no one else has its handle yet.
                unsafe { (*handle).owned = Some(owned) };
                // SAFETY: the pointers were checked above, and are writable, as this function's `# Safety` requires.
                unsafe { scene.write(handle) };
                Ok(())
            }
            Err(failure) => {
                // SAFETY: opening failed, so no scene uses the memory.
                unsafe { owned.free() };
                Err(named(Cause::Scene(failure)))
            }
        }
    })
}

/// Frees a scene that `nerf_scene_open_file` opened. Does nothing for NULL and for a scene in the caller's memory.
///
/// Only in a library with the feature `std`.
///
/// # Safety
/// `scene` is NULL or the handle of an opened scene that was not closed before, and that no thread uses now or later.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn nerf_scene_close(scene: *const Scene) {
    call(Message::NONE, || {
        if !scene.is_null() {
            check_aligned("scene", scene as usize, align_of::<Scene>())?;
            // SAFETY: `scene` is intact, and not used elsewhere any more, as this function's `# Safety` requires.
            let owned = unsafe { (*scene.cast_mut()).owned.take() };
            if let Some(owned) = owned {
                // SAFETY: the scene, which borrows the file's bytes and the memory, is not used any more.
                unsafe { owned.free() };
            }
        }
        Ok(())
    });
}

/// Returns the bytes of a scene file. Returns an error if `path` is no regular file, if the file cannot be read, if the
/// header is invalid or gives a length other than the file's, or if there is not enough memory.
fn read(path: &CStr) -> Result<Vec<u8>, Cause> {
    let path = as_path(path)?;
    // Checked before opening, since opening a pipe blocks until something writes to it.
    if !std::fs::metadata(path)?.is_file() {
        return Err(Cause::NotRegular);
    }
    let mut file = File::open(path)?;
    let about = file.metadata()?;
    if !about.is_file() {
        return Err(Cause::NotRegular);
    }
    let found = about.len();
    let mut bytes = Vec::new();
    (&mut file).take(HEADER_LEN as u64).read_to_end(&mut bytes)?;
    match Blob::open(&bytes) {
        Err(BlobError::Truncated { expected, .. }) if expected > found => {
            return Err(BlobError::Truncated { expected, found }.into());
        }
        Err(BlobError::Truncated { expected, .. }) if expected < found => {
            return Err(BlobError::TrailingBytes { expected, found }.into());
        }
        Ok(_) | Err(BlobError::Truncated { .. }) => {}
        Err(error) => return Err(error.into()),
    }
    let whole = usize::try_from(found).map_err(|_| Failure::Overflow("path"))?;
    bytes.try_reserve_exact(whole - bytes.len()).map_err(|_| Cause::OutOfMemory { bytes: whole })?;
    // Reads at most the length that the file had when it was opened, even if the file grows meanwhile.
    file.take(found - bytes.len() as u64).read_to_end(&mut bytes)?;
    Ok(bytes)
}

#[cfg(unix)]
fn as_path(path: &CStr) -> Result<&std::ffi::OsStr, Cause> {
    Ok(std::os::unix::ffi::OsStrExt::from_bytes(path.to_bytes()))
}

#[cfg(not(unix))]
fn as_path(path: &CStr) -> Result<&str, Cause> {
    path.to_str().map_err(|error| io::Error::new(io::ErrorKind::InvalidInput, error).into())
}
