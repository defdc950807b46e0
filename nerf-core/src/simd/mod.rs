//! SIMD kernels: an [`Op`] is written once, generic over [`Lanes`]. A module per instruction set, called a leaf,
//! compiles it for that set, and [`Isa::run`] picks the leaf. Activations are laid out `[channel][BLOCK]`: a vector
//! holds one channel of neighbouring samples.
#![allow(unsafe_code, reason = "instructions that the compiler does not choose by itself")]

/// Declares methods of a leaf's vector by their intrinsics: in `name(a, b) = expression`, `a` and `b` are registers.
#[cfg(any(
    target_arch = "x86_64",
    all(target_arch = "aarch64", target_feature = "neon"),
    all(target_arch = "wasm32", target_feature = "simd128")
))]
macro_rules! instructions {
    ($($name:ident($a:ident $(, $b:ident)*) = $value:expr;)+) => {$(
        #[inline(always)]
        #[allow(unused_unsafe, reason = "WebAssembly's are safe")]
        fn $name(self $(, $b: Self)*) -> Self {
            let $a = self.0;
            $(let $b = $b.0;)*
            // SAFETY: a leaf's vectors exist only where its instructions do.
            Self(unsafe { $value })
        }
    )+};
}

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
#[cfg(any(
    target_arch = "x86_64",
    all(target_arch = "aarch64", target_feature = "neon"),
    all(target_arch = "wasm32", target_feature = "simd128")
))]
mod gather;
mod isa;
mod lanes;
#[cfg(all(target_arch = "aarch64", target_feature = "neon"))]
mod neon;
mod portable;
#[cfg(feature = "train")]
mod prefetch;
#[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
mod simd128;
#[cfg_attr(not(feature = "grid"), allow(dead_code, reason = "grids are what has tables"))]
mod table;

#[cfg(test)]
mod tests;

pub use isa::{Isa, VECTORS};
pub(crate) use lanes::LANES;
pub use lanes::{Indices, Lanes};
#[cfg(feature = "train")]
pub use prefetch::prefetch;
#[cfg(any(feature = "grid", feature = "train"))]
pub use table::{Table, Value};

/// Number of lanes of the widest vector of any instruction set.
pub const MAX_LANES: usize = 16;

/// Number of samples evaluated together, with every instruction set.
pub const BLOCK: usize = 64;

/// A loop that can be compiled for every instruction set.
pub trait Op {
    /// The loop's result.
    type Output;
    /// Runs the loop. Must be `#[inline(always)]`, or it is not compiled for the leaf's instruction set.
    fn run<V: Lanes>(self) -> Self::Output;
}
