//! How a render tells how far it is, and is told to stop.

use core::ffi::c_void;

/// Called before the first tile and after each tile, on the thread that renders, with the pixels
/// done so far, which only grow, of all; a return value other than 0 cancels.
///
/// It may call this library, also with the workspace of the render it is called from. It must not
/// let a C++ exception escape.
pub type Progress =
    Option<unsafe extern "C-unwind" fn(user: *mut c_void, pixels_done: u64, pixels_all: u64) -> i32>;
