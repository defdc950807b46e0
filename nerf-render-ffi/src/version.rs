//! Versions of the ABI and of the library.

use core::ffi::{CStr, c_char};

/// Version of the ABI that this header describes; `nerf_abi_version()` returns the version that the library has.
///
/// The version changes only when a program built against the old header would break.
pub const NERF_ABI_VERSION: u32 = 2;

const TEXT: &CStr = match CStr::from_bytes_with_nul(concat!(env!("CARGO_PKG_VERSION"), "\0").as_bytes()) {
    Ok(text) => text,
    Err(_) => c"",
};

/// Returns the version of the ABI that the library was built with, to be compared with `NERF_ABI_VERSION`.
#[unsafe(no_mangle)]
pub extern "C" fn nerf_abi_version() -> u32 {
    NERF_ABI_VERSION
}

/// Returns the version of the library as text, such as "0.1.0"; the text is static and never freed.
#[unsafe(no_mangle)]
pub extern "C" fn nerf_version_text() -> *const c_char {
    TEXT.as_ptr()
}
