//! The panic handler of a library without std whose host is no Rust program.

use core::panic::PanicInfo;

#[cfg_attr(target_arch = "wasm32", link(wasm_import_module = "env"))]
unsafe extern "C" {
    /// Function of the host that a panic calls, and that must not return. Only a library that can panic refers to
    /// `nerf_panicked`: as an undefined symbol at link time, or as an import of a WebAssembly module.
    fn nerf_panicked() -> !;
}

#[panic_handler]
fn panicked(_: &PanicInfo<'_>) -> ! {
    // SAFETY: the host defines it with this signature.
    unsafe { nerf_panicked() }
}
