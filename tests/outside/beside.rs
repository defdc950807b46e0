//! Another library in Rust, with the whole of std: a panic that is caught.

/// 1, by way of a panic.
#[unsafe(no_mangle)]
pub extern "C" fn beside() -> i32 {
    i32::from(std::panic::catch_unwind(|| panic!("beside")).is_err())
}
