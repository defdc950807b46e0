//! The inner loops; the only room with `unsafe`.
#![allow(unsafe_code)]

mod gemm;

pub use gemm::{Gemm, Init, gemm};

/// Samples that go through the network together, on every tier.
pub const BLOCK: usize = 64;

/// A kernel tier: which instructions the inner loops use.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Tier {
    /// Plain, unfused f32: the oracle, the same on every target.
    Scalar,
    /// AVX2, FMA and F16C.
    Avx2,
    /// AVX-512 F.
    Avx512,
}

impl Tier {
    /// The fastest tier this machine has.
    pub fn detect() -> Self {
        Self::Scalar
    }
}
