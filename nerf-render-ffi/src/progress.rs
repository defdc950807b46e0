//! The progress of a render, and its cancellation.

use core::ffi::c_void;

/// A [`Progress`] callback in a build without std, where nothing unwinds.
#[cfg(not(feature = "std"))]
type Bare = unsafe extern "C" fn(user: *mut c_void, pixels_done: u64, pixels_all: u64) -> i32;

/// Called before the first tile and after each tile, on the rendering thread, with the number of pixels done so far,
/// which never decreases, and of all pixels; a return value other than 0 cancels.
///
/// It may call this library, but not with the worker of the render it is called from. It must not
/// let a C++ exception escape.
pub type Progress =
    Option<unsafe extern "C-unwind" fn(user: *mut c_void, pixels_done: u64, pixels_all: u64) -> i32>;

/// Calls the callback, if there is one; returns whether to continue.
///
/// # Safety
/// `progress` may be called with `user`.
pub(crate) unsafe fn call(progress: Progress, user: *mut c_void, done: u64, all: u64) -> bool {
    let Some(progress) = progress else { return true };
    // Without std nothing unwinds, and a call that might would link a panic for that case.
    #[cfg(not(feature = "std"))]
    // SAFETY: the two ABIs pass the same arguments in the same way, and there are no exceptions.
    let progress = unsafe {
        core::mem::transmute::<unsafe extern "C-unwind" fn(*mut c_void, u64, u64) -> i32, Bare>(progress)
    };
    // SAFETY: `user` and `done` are as this function's `# Safety` has it.
    unsafe { progress(user, done, all) == 0 }
}
