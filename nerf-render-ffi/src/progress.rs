//! Progress callback of a render, which can also cancel the render.

use core::ffi::c_void;

/// Callback of `nerf_render` and `nerf_render_picture`: called before the first tile and after each tile, on the thread
/// that renders. `pixels_done`: number of finished pixels, never decreasing; `pixels_all`: number of pixels to render.
/// A return value other than 0 cancels the render.
///
/// The callback may call this library, but not with the worker that is rendering. No C++ exception may escape.
pub type Progress =
    Option<unsafe extern "C-unwind" fn(user: *mut c_void, pixels_done: u64, pixels_all: u64) -> i32>;

/// Calls the callback, if there is one. Returns whether to continue the render: false if the callback cancels it.
///
/// # Safety
/// `progress` may be called with `user`.
pub(crate) unsafe fn call(progress: Progress, user: *mut c_void, done: u64, all: u64) -> bool {
    let Some(progress) = progress else { return true };
    // Nothing unwinds without std. The ABI "C" says so to the compiler, which then links no panic code for the call.
    #[cfg(not(feature = "std"))]
    // SAFETY: the ABIs "C" and "C-unwind" pass arguments in the same way, and nothing unwinds.
    let progress: unsafe extern "C" fn(*mut c_void, u64, u64) -> i32 =
        unsafe { core::mem::transmute(progress) };
    // SAFETY: `progress` and `user` are valid, as this function's `# Safety` requires.
    unsafe { progress(user, done, all) == 0 }
}
