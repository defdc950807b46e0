//! Positions of samples on a ray.

/// Returns the middles of `n` equal bins of `near..far`.
pub fn middles(near: f64, far: f64, n: usize) -> Vec<f64> {
    (0..n).map(|i| near + (far - near) * (i as f64 + 0.5) / n as f64).collect()
}

/// Draws `drawn` samples from a density that is constant in each of the equal bins of `near..far`. Sample `k` lies
/// where the distribution function is `(k + ½)/drawn`. Weights are clamped to `[0, 1]`, a NaN counts as 0, and 1e-5 is
/// added to each weight.
pub fn inverse_cdf(near: f64, far: f64, weights: &[f64], drawn: usize) -> Vec<f64> {
    inverse_cdf_at(near, far, weights, drawn, |_| 0.5)
}

/// Draws samples as [`inverse_cdf`] does, but sample `k` lies where the distribution function is `(k +
/// within(k))/drawn`.
pub fn inverse_cdf_at(
    near: f64,
    far: f64,
    weights: &[f64],
    drawn: usize,
    within: impl Fn(usize) -> f64,
) -> Vec<f64> {
    let weight = |w: f64| if w.is_nan() { 0.0 } else { w.clamp(0.0, 1.0) } + 1e-5;
    let total: f64 = weights.iter().map(|&w| weight(w)).sum();
    let width = (far - near) / weights.len() as f64;
    (0..drawn)
        .map(|k| {
            let mut left = (k as f64 + within(k)) / drawn as f64 * total;
            for (bin, &w) in weights.iter().enumerate() {
                if left < weight(w) {
                    return near + width * (bin as f64 + left / weight(w));
                }
                left -= weight(w);
            }
            far
        })
        .collect()
}

/// Returns the part of a ray inside a closed box: the smallest and largest `t` in `near..far`, found by intersecting
/// each face. `None` if the ray misses the box.
pub fn clip(
    origin: [f64; 3],
    dir: [f64; 3],
    min: [f64; 3],
    max: [f64; 3],
    near: f64,
    far: f64,
) -> Option<(f64, f64)> {
    let (mut enter, mut exit) = (near, far);
    for axis in 0..3 {
        if dir[axis] == 0.0 {
            if origin[axis] < min[axis] || origin[axis] > max[axis] {
                return None;
            }
            continue;
        }
        let (a, b) = ((min[axis] - origin[axis]) / dir[axis], (max[axis] - origin[axis]) / dir[axis]);
        (enter, exit) = (enter.max(a.min(b)), exit.min(a.max(b)));
    }
    (enter <= exit).then_some((enter, exit))
}
