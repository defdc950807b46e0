//! Compositing of one ray's samples, for trainers and tests.

use super::{Accumulator, Pixel};
use crate::errors::errors;
use crate::math::MathBackend;

/// Composites samples along one ray into colour, opacity and distance, as in a frame with the maths backend `math`.
///
/// `sigma`: `[n]`, densities, 1/world unit, >= 0. `rgb`: `[n]`, colours. `t_edges`: `[n + 1]`, edges of the bins, world
/// units along the ray, ascending. A sample lies at the middle of its bin, and is empty if its density is NaN or its
/// colour is not finite. `z_depth` equals `ray_distance`: no view axis is given. Median distance and normal stay 0.
///
/// # Errors
/// [`VolumeError`] if the lengths are not `n`, `n` and `n + 1`, or if the edges are not finite and ascending.
/// # Examples
/// ```
/// use nerf_core::{MathBackend, volume::composite};
/// // A half-transparent red bin in front of an opaque green one.
/// let sigma = [core::f32::consts::LN_2, 1e30, 0.0];
/// let rgb = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0; 3]];
/// let pixel = composite(MathBackend::Polynomial, &sigma, &rgb, &[2.0, 3.0, 4.0, 5.0], [0.0; 3])?;
/// assert!((pixel.rgb[0] - 0.5).abs() < 1e-6 && (pixel.rgb[1] - 0.5).abs() < 1e-6);
/// assert!((pixel.opacity - 1.0).abs() < 1e-6);
/// assert!((pixel.ray_distance - (0.5 * 2.5 + 0.5 * 3.5)).abs() < 1e-5);
/// # Ok::<(), nerf_core::volume::VolumeError>(())
/// ```
pub fn composite(
    math: MathBackend,
    sigma: &[f32],
    rgb: &[[f32; 3]],
    t_edges: &[f32],
    background: [f32; 3],
) -> Result<Pixel, VolumeError> {
    let n = sigma.len();
    if rgb.len() != n || t_edges.len() != n + 1 {
        return Err(VolumeError::Lengths { sigma: n, rgb: rgb.len(), t_edges: t_edges.len() });
    }
    if let Some(bin) = t_edges.windows(2).position(|edge| !(edge[0] <= edge[1] && edge[1].is_finite())) {
        return Err(VolumeError::Edges { bin });
    }
    if !t_edges[0].is_finite() {
        return Err(VolumeError::Edges { bin: 0 });
    }
    let mut ray = Accumulator::NONE;
    let bins = t_edges.iter().zip(t_edges.iter().skip(1));
    for ((&sigma, &rgb), (start, end)) in sigma.iter().zip(rgb).zip(bins) {
        if !sigma.is_nan() && rgb.iter().all(|c| c.is_finite()) {
            ray.add(math, sigma, rgb, 0.5 * start + 0.5 * end, end - start);
        }
    }
    Ok(ray.finish_from(0.0, false, background, t_edges[n], 1.0))
}

errors! {
    /// Reason why a ray's samples cannot be composited.
    #[derive(Eq)]
    VolumeError:
    Lengths { sigma: usize, rgb: usize, t_edges: usize } =>
        "samples: expected n sigma, n rgb, n + 1 t_edges, found {sigma}, {rgb}, {t_edges}";
    Edges { bin: usize } => "t_edges: expected finite ascending values, bin {bin} has none";
}
