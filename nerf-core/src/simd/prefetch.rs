//! Memory that is needed soon.

/// Asks for the cache line of `values[index]`; nothing beyond the slice, and where a target has no such instruction.
///
/// For loops over places that only the data knows, such as the entries of a hashed table.
#[inline(always)]
pub fn prefetch(values: &[f32], index: usize) {
    #[cfg(target_arch = "x86_64")]
    if let Some(value) = values.get(index) {
        use core::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        // SAFETY: every x86_64 has SSE; the address is a value's own, and nothing is read from it.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(core::ptr::from_ref(value).cast()) }
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (values, index);
}
