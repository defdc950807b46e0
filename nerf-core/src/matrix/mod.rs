//! Dense products of weights and a block of samples. Weights are f32, pairs of bf16, or f16 read directly from the
//! scene file's bytes.

#[allow(unsafe_code, reason = "a leaf of AVX-512 BF16, and reads by address")]
mod bf16;
#[cfg(feature = "normals")]
mod bf16_transposed;
#[allow(unsafe_code, reason = "tiles are read by address, checked once a product")]
mod gemm;
mod half;
mod kernel;

#[cfg(test)]
mod tests;

pub use bf16::{PairedInput, PairedOutput, dense_bf16, pair, pair_rows, pairs, unpair};
#[cfg(feature = "normals")]
pub use bf16_transposed::transposed_bf16;
pub use gemm::{Gemm, Init, gemm};
pub use half::{f16_at, gemm_f16};
pub use kernel::{Kernel, Storage};
