//! The inner loops; the only room with `unsafe`.
//!
//! An [`Op`] is written once, generic over [`Lanes`]; a leaf per instruction set
//! compiles it for that set, and [`Tier::run`] picks the leaf. Activations are laid out
//! `[channel][BLOCK]`: a vector holds one channel of neighbouring samples.
#![allow(unsafe_code)]

mod arena;
#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
mod bf16;
#[cfg(feature = "normals")]
mod bf16_transposed;
#[cfg(any(
    target_arch = "x86_64",
    all(target_arch = "aarch64", target_feature = "neon"),
    all(target_arch = "wasm32", target_feature = "simd128")
))]
mod gather;
mod gemm;
mod half;
#[cfg(all(target_arch = "aarch64", target_feature = "neon"))]
mod neon;
mod portable;
#[cfg(feature = "train")]
mod prefetch;
mod select;
#[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
mod simd128;
mod slices;

#[cfg(test)]
mod tests;

pub use arena::{Arena, Layout, Line, Measure, lines_for};
pub use bf16::{PairedInput, PairedOutput, dense_bf16, pair, pair_rows, pairs};
pub use gemm::{Gemm, Init, gemm};
pub use half::{HalfInit, f16_at, gemm_f16};
#[cfg(feature = "train")]
pub use prefetch::prefetch;
pub use select::{Tier, VECTORS};
pub(crate) use slices::{at, column, head, head_mut, put, put_column, tail, tail_mut};
#[cfg(feature = "normals")]
pub use {bf16::unpair, bf16_transposed::transposed_bf16};

use crate::math::lanes::Lanes;

/// Samples that go through the network together, on every tier.
pub const BLOCK: usize = 64;

/// A loop that can be compiled for every tier.
pub trait Op {
    /// What it returns.
    type Output;
    /// The loop; must be `#[inline(always)]`, or it loses the leaf's instructions.
    fn run<V: Lanes>(self) -> Self::Output;
}
