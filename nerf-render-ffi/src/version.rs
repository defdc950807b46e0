//! Versions of the ABI and of the library.

use core::ffi::{CStr, c_char};

/// Version of the ABI this header describes; the library's own is `nerf_abi_version()`.
///
/// It changes only when a program built against the old header would break.
pub const NERF_ABI_VERSION: u32 = 2;

const TEXT: &CStr = match CStr::from_bytes_with_nul(concat!(env!("CARGO_PKG_VERSION"), "\0").as_bytes()) {
    Ok(text) => text,
    Err(_) => c"",
};

/// Version of the ABI the library was built with; compare with `NERF_ABI_VERSION`.
#[unsafe(no_mangle)]
pub extern "C" fn nerf_abi_version() -> u32 {
    NERF_ABI_VERSION
}

/// Version of the library as text, "0.1.0"; static.
#[unsafe(no_mangle)]
pub extern "C" fn nerf_version_text() -> *const c_char {
    TEXT.as_ptr()
}
