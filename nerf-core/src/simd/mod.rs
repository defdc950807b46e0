//! SIMD kernels: an [`Op`] is written once, generic over [`Lanes`]. Each instruction set has a module with the vector
//! types for which the [`Op`] is compiled; [`Isa::run`] picks the module. Activations are laid out `[channel][BLOCK]`:
//! a vector holds one channel of neighbouring samples.
#![allow(unsafe_code, reason = "instructions that the compiler does not choose by itself")]

/// Declares `#[inline(always)]` methods, each with one expression as its body.
macro_rules! methods {
    ($(fn $name:ident ($($arguments:tt)*) $(-> $type:ty)? = $value:expr;)+) => {$(
        #[inline(always)]
        fn $name($($arguments)*) $(-> $type)? {
            $value
        }
    )+};
}

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
mod isa;
mod lanes;
#[cfg(any(
    target_arch = "x86_64",
    all(target_arch = "aarch64", target_feature = "neon"),
    all(target_arch = "wasm32", target_feature = "simd128")
))]
mod leaf;
#[cfg(all(target_arch = "aarch64", target_feature = "neon"))]
mod neon;
mod portable;
#[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
mod simd128;
#[cfg_attr(not(feature = "grid"), allow(dead_code, reason = "grids are what has tables"))]
mod table;

#[cfg(test)]
mod tests;

pub use isa::{Isa, VECTORS};
pub(crate) use lanes::LANES;
pub use lanes::{Indices, Lanes};
#[cfg(any(feature = "grid", feature = "train"))]
pub use table::{Table, Value};

/// Number of lanes of the widest vector of any instruction set.
pub const MAX_LANES: usize = 16;

/// Number of samples or rays in a block. A block is processed as a whole. Equal for every instruction set.
pub const BLOCK: usize = 64;

/// A loop that can be compiled for every instruction set.
pub trait Op {
    /// The loop's result.
    type Output;
    /// Runs the loop in vectors `V`. Must be `#[inline(always)]` to be compiled for the instruction set of `V`.
    fn run<V: Lanes>(self) -> Self::Output;
}

/// Restricts [`Lanes`] and table values to the types of this module.
mod sealed {
    pub trait Sealed {}
    impl Sealed for f32 {}
    impl Sealed for u8 {}
    impl Sealed for [u8; 2] {}
}

/// Prefetches the cache line of `values[index]`. Does nothing if `index` is out of range, or the target is not x86_64.
///
/// Useful in loops that read data-dependent addresses, such as the entries of a hash table.
#[cfg(feature = "train")]
#[inline(always)]
pub fn prefetch(values: &[f32], index: usize) {
    #[cfg(target_arch = "x86_64")]
    if let Some(value) = values.get(index) {
        use core::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        // SAFETY: every x86_64 has SSE; the address is that of `value`, and nothing is read from it.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(core::ptr::from_ref(value).cast()) }
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (values, index);
}
