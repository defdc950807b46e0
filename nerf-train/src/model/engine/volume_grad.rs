//! Volume rendering of rays, and the squared error of the rays' colours with its gradients.

use super::BatchRay;
use nerf_core::simd::BLOCK;

/// Samples of several rays, ray after ray: `colour` is `[blocks][3][BLOCK]`, `deltas` and `sigma` are `[samples]`.
pub(super) struct Samples<'a> {
    pub(super) deltas: &'a [f32],
    /// Density per world unit; `None` in a 2D field, where every sample is opaque.
    pub(super) sigma: Option<&'a [f32]>,
    pub(super) colour: &'a [f32],
}

/// Values at each sample that the forward pass stores for the backward pass.
#[derive(Default)]
pub(super) struct Scratch {
    weights: Vec<f64>,
    transmittance_after: Vec<f64>,
}

/// Returns the index of a sample's red value in `[blocks][3][BLOCK]`.
fn colour_index(sample: usize) -> usize {
    sample / BLOCK * 3 * BLOCK + sample % BLOCK
}

/// Returns the sum over rays and channels of (C − rgb)², for rendered colours C and target colours rgb. Writes the
/// gradients of the loss L, which is `scale` times the sum.
///
/// For sample `i` and channel `k`, with `g_k = 2 scale (C_k − rgb_k)` and tau = sigma · delta: `dL/dc_ik = g_k w_i`,
/// `dL/dtau_i = Σ_k g_k (c_ik T_{i+1} − Σ_{j>i} w_j c_jk − T_end bg_k)`, where `bg` is the background.
///
/// The transmittance T is the exponential of the optical depth summed in f64, since a product of factors could
/// underflow. `d_sigma`, `[samples]`, and `d_colour`, `[blocks][3][BLOCK]`, are overwritten at the rays' samples.
pub(super) fn squared_error(
    rays: &[BatchRay],
    samples: &Samples<'_>,
    scale: f64,
    scratch: &mut Scratch,
    d_sigma: &mut [f32],
    d_colour: &mut [f32],
) -> f64 {
    let Scratch { weights, transmittance_after } = scratch;
    weights.resize(samples.deltas.len(), 0.0);
    transmittance_after.resize(samples.deltas.len(), 0.0);
    let colour_of = |i: usize| {
        let at = colour_index(i);
        [0, 1, 2].map(|k| f64::from(samples.colour[at + k * BLOCK]))
    };
    let mut sum = 0.0;
    let mut first = 0;
    for ray in rays {
        let range = first..first + ray.samples as usize;
        first = range.end;

        let mut depth = 0.0;
        let mut transmittance = 1.0;
        let mut rendered = [0.0; 3];
        for i in range.clone() {
            let tau = samples
                .sigma
                .map_or(f64::INFINITY, |sigma| f64::from(sigma[i]) * f64::from(samples.deltas[i]));
            // Many samples of a ray are empty or hidden and need no exponential.
            let mut weight = 0.0;
            if tau != 0.0 && transmittance > 0.0 {
                depth += tau;
                weight = transmittance * -(-tau).exp_m1();
                transmittance = (-depth).exp();
            }
            (weights[i], transmittance_after[i]) = (weight, transmittance);
            if weight != 0.0 {
                let colour = colour_of(i);
                for k in 0..3 {
                    rendered[k] += weight * colour[k];
                }
            }
        }

        let mut behind = ray.background.map(|b| transmittance * f64::from(b));
        let mut gradient = [0.0; 3];
        for k in 0..3 {
            let error = rendered[k] + behind[k] - f64::from(ray.rgb[k]);
            sum += error * error;
            gradient[k] = 2.0 * scale * error;
        }

        for i in range.rev() {
            let (weight, after) = (weights[i], transmittance_after[i]);
            let colour = colour_of(i);
            let at = colour_index(i);
            let mut d_tau = 0.0;
            for k in 0..3 {
                d_tau += gradient[k] * (colour[k] * after - behind[k]);
                behind[k] += weight * colour[k];
                d_colour[at + k * BLOCK] = (gradient[k] * weight) as f32;
            }
            d_sigma[i] = (d_tau * f64::from(samples.deltas[i])) as f32;
        }
    }
    sum
}
