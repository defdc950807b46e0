//! The panic handler of a static library without std.

use core::panic::PanicInfo;

/// Does not exist: a program in which a panic can be reached does not link.
#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    unsafe extern "C" {
        safe fn a_panic_can_be_reached() -> !;
    }
    a_panic_can_be_reached()
}
