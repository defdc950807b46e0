//! `C = init + A B`, the one product behind every dense layer, forward and backward.

use super::Tier;

/// Sizes and strides of one product, in elements.
#[derive(Clone, Copy, Debug)]
pub struct Gemm {
    /// Rows of A and C.
    pub m: usize,
    /// Columns of B and C.
    pub n: usize,
    /// Columns of A, rows of B.
    pub k: usize,
    /// Distance from `A[i][p]` to `A[i+1][p]`.
    pub a_row: usize,
    /// Distance from `A[i][p]` to `A[i][p+1]`: so a transposed A costs nothing.
    pub a_col: usize,
    /// Distance from `B[p]` to `B[p+1]`; columns of B are contiguous.
    pub b_row: usize,
    /// Distance from `C[i]` to `C[i+1]`; columns of C are contiguous.
    pub c_row: usize,
}

/// What a product starts from.
#[derive(Clone, Copy, Debug)]
pub enum Init<'a> {
    /// 0.
    Zero,
    /// `bias[i]` in the whole row `i`; `[m]`.
    Bias(&'a [f32]),
    /// What C holds.
    Accumulate,
}

/// `C[i][j] = act(init + Σ_p A[i][p] B[p][j])`, summed in ascending `p`; `act` is ReLU or nothing.
///
/// Every element is summed by itself in the same order whatever the sizes, so that a result does
/// not depend on how work is cut into products; tiers differ in whether each step is fused.
///
/// # Panics
/// If a slice is shorter than sizes and strides say.
pub fn gemm(tier: Tier, g: Gemm, a: &[f32], b: &[f32], c: &mut [f32], init: Init<'_>, relu: bool) {
    let _ = tier;
    for i in 0..g.m {
        for j in 0..g.n {
            let mut sum = match init {
                Init::Zero => 0.0,
                Init::Bias(bias) => bias[i],
                Init::Accumulate => c[i * g.c_row + j],
            };
            for p in 0..g.k {
                sum += a[i * g.a_row + p * g.a_col] * b[p * g.b_row + j];
            }
            c[i * g.c_row + j] = if relu && 0.0 > sum { 0.0 } else { sum };
        }
    }
}
