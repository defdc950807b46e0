//! Prefetching.

/// Prefetches the cache line of `values[index]`. Does nothing if the index is out of range, or on targets other than
/// x86_64.
///
/// For loops over data-dependent addresses, such as the entries of a hash table.
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
