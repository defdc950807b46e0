//! Derivatives by finite differences.

/// Returns the derivative of `f` at `x` from two central differences (Richardson extrapolation). The error is of order
/// `step⁴`.
pub fn derivative(f: impl Fn(f64) -> f64, x: f64, step: f64) -> f64 {
    let central = |h: f64| (f(x + h) - f(x - h)) / (2.0 * h);
    (4.0 * central(step / 2.0) - central(step)) / 3.0
}

/// Returns all partial derivatives of `f` at `x`.
pub fn gradient(f: impl Fn(&[f64]) -> f64, x: &[f64], step: f64) -> Vec<f64> {
    (0..x.len())
        .map(|i| {
            let along = |value: f64| {
                let mut moved = x.to_vec();
                moved[i] = value;
                f(&moved)
            };
            derivative(along, x[i], step)
        })
        .collect()
}
