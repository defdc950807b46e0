//! Volume rendering by quadrature (Max 1995; Mildenhall et al. 2020, eq. 3), with a finite last bin.

/// Result of one ray.
#[derive(Clone, Debug)]
pub struct Pixel {
    /// Colour, composited over the background.
    pub rgb: [f64; 3],
    /// Sum of the weights.
    pub opacity: f64,
    /// Sum of weight times `t` over the samples; divided by the opacity, this is the mean distance.
    pub distance_sum: f64,
    /// Transmittance behind the last sample.
    pub transmittance: f64,
    /// Weight of each sample.
    pub weights: Vec<f64>,
}

/// Composites the samples of a ray: `sigma`, `rgb`, `t` and `delta` are each `[n]`, front to back.
///
/// A density of +inf is an opaque wall. A sample is empty if its density is NaN, or if its `delta` is 0, even with a
/// density of +inf.
pub fn composite(sigma: &[f64], rgb: &[[f64; 3]], t: &[f64], delta: &[f64], background: [f64; 3]) -> Pixel {
    let mut transmittance = 1.0;
    let mut weights = Vec::new();
    for (&sigma, &delta) in sigma.iter().zip(delta) {
        let empty = sigma.is_nan() || sigma <= 0.0 || delta <= 0.0;
        let tau = if empty { 0.0 } else { sigma * delta };
        let alpha = -(-tau).exp_m1();
        weights.push(transmittance * alpha);
        transmittance *= (-tau).exp();
    }
    let opacity: f64 = weights.iter().sum();
    let mut colour = background.map(|c| c * (1.0 - opacity));
    for (w, rgb) in weights.iter().zip(rgb) {
        for (sum, c) in colour.iter_mut().zip(rgb) {
            *sum += w * c;
        }
    }
    let distance_sum = weights.iter().zip(t).map(|(w, t)| w * t).sum();
    Pixel { rgb: colour, opacity, distance_sum, transmittance, weights }
}
