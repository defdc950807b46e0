//! Volume rendering by quadrature (Max 1995; Mildenhall et al. 2020, eq. 3), the last bin finite.

/// One ray's pixel.
#[derive(Clone, Debug)]
pub struct Pixel {
    /// Over the background.
    pub rgb: [f64; 3],
    /// Σ weights.
    pub opacity: f64,
    /// Σ weights · t; divided by the opacity it is the mean distance.
    pub distance_sum: f64,
    /// What is left behind the last sample.
    pub transmittance: f64,
    /// Of each sample.
    pub weights: Vec<f64>,
}

/// Composites samples: `sigma`, `rgb`, `t` and `delta` are each `[n]`, front to back.
///
/// A density of +inf is a wall; a NaN density makes the sample empty, and 0 · inf is nothing.
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
