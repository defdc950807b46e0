//! Lens distortion (OpenCV's model: radial k1, k2, tangential p1, p2).

/// Returns the distorted point of the undistorted point `(u, v)`, both at depth 1, and the determinant of the model's
/// Jacobian there.
pub fn distort([k1, k2, p1, p2]: [f64; 4], u: f64, v: f64) -> ([f64; 2], f64) {
    let r2 = u * u + v * v;
    let (radial, slope) = (1.0 + k1 * r2 + k2 * r2 * r2, 2.0 * k1 + 4.0 * k2 * r2);
    let seen = [
        u * radial + 2.0 * p1 * u * v + p2 * (r2 + 2.0 * u * u),
        v * radial + p1 * (r2 + 2.0 * v * v) + 2.0 * p2 * u * v,
    ];
    let cross = u * v * slope + 2.0 * p1 * u + 2.0 * p2 * v;
    let right = radial + u * u * slope + 2.0 * p1 * v + 6.0 * p2 * u;
    let down = radial + v * v * slope + 6.0 * p1 * v + 2.0 * p2 * u;
    (seen, right * down - cross * cross)
}

/// Whether the distortion folds between the optical axis and the undistorted point: whether the determinant is 0 or
/// negative at one of 256 points between them.
pub fn folds_before(lens: [f64; 4], [u, v]: [f64; 2]) -> bool {
    (1..=256).any(|step| {
        let share = f64::from(step) / 256.0;
        distort(lens, share * u, share * v).1 <= 0.0
    })
}
