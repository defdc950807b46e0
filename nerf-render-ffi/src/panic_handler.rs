//! Panic handler of a library built without std for a host that is not a Rust program.

use core::panic::PanicInfo;

#[cfg_attr(target_arch = "wasm32", link(wasm_import_module = "env"))]
unsafe extern "C" {
    /// Function that the host defines. A panic calls the function, which must not return. A library that cannot panic
    /// does not need the function: no `nerf_panicked` is among its undefined symbols or WebAssembly imports.
    fn nerf_panicked() -> !;
}

#[panic_handler]
fn panicked(_: &PanicInfo<'_>) -> ! {
    // SAFETY: the host defines it with this signature.
    unsafe { nerf_panicked() }
}
