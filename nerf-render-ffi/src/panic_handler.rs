//! Panic handler of builds without std for C hosts: calls the host's `nerf_panicked`.

use core::panic::PanicInfo;

#[cfg_attr(target_arch = "wasm32", link(wasm_import_module = "env"))]
unsafe extern "C" {
    /// Function of the host that a panic calls; must not return. The host need not define the function if the compiler
    /// removes every panic.
    fn nerf_panicked() -> !;
}

#[panic_handler]
fn panicked(_: &PanicInfo<'_>) -> ! {
    // SAFETY: the host defines `nerf_panicked` with this signature.
    unsafe { nerf_panicked() }
}
