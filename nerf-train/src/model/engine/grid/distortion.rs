//! The distortion loss: it draws the weights of a ray together, against fog and against surfaces in several places.
//!
//! ```text
//! L = Σ_ij w_i w_j |s_i − s_j|     s: length of the way through the samples, in the space that the grid spans
//! dL/dw_i = 2 Σ_j w_j |s_i − s_j|
//! ```
//!
//! # Source
//! Barron et al. 2022 (mip-NeRF 360), section 4. Deviation: without the term of each bin's own width: widths are given.

/// Puts dL/dw of each sample of a ray into `gradient`.
///
/// `weights`, `gaps`: `[samples]`, front to back: of each its weight, and how far behind the one in front it lies (of the
/// first: any finite number). `gradient`: `[samples]`.
pub(super) fn distortion_gradient(weights: &[f32], gaps: &[f32], gradient: &mut [f32]) {
    // Of the samples in front: the sum of their weights, and of weights times distances.
    let (mut sum, mut moment) = (0.0, 0.0);
    for ((g, w), gap) in gradient.iter_mut().zip(weights).zip(gaps) {
        moment += sum * gap;
        sum += w;
        *g = 2.0 * moment;
    }
    // The same of those behind.
    let (mut sum, mut moment) = (0.0, 0.0);
    for ((g, w), gap) in gradient.iter_mut().zip(weights).zip(gaps).rev() {
        *g += 2.0 * moment;
        sum += w;
        moment += sum * gap;
    }
}
