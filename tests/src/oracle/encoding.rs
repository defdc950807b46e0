//! Sinusoidal positional encoding (Mildenhall et al. 2020, eq. 4).

use std::f64::consts::PI;

/// Returns `(sin πu, cos πu)`.
///
/// The remainder `u mod 2` is exact in binary, and so is the distance to the nearest multiple of ½. The multiplication
/// by π comes last, when the angle is at most π/4.
pub fn sin_cos_pi(u: f64) -> (f64, f64) {
    let turn = u % 2.0;
    let quarters = (2.0 * turn).round();
    let (s, c) = (PI * (turn - 0.5 * quarters)).sin_cos();
    match quarters.rem_euclid(4.0) as u8 {
        0 => (s, c),
        1 => (c, -s),
        2 => (-s, -c),
        _ => (-c, s),
    }
}

/// Returns sine and cosine of level `k`: `(sin 2^k s x, cos 2^k s x)` with `s` = π or 1.
pub fn level(x: f64, k: i32, pi: bool) -> (f64, f64) {
    let u = x * 2f64.powi(k);
    if pi { sin_cos_pi(u) } else { u.sin_cos() }
}

/// Returns the encoding `[x,] sin 2^0 s x, cos 2^0 s x, sin 2^1 s x, …`; each term is given for all inputs before the
/// next term.
pub fn encode(x: &[f64], levels: u8, pi: bool, identity: bool) -> Vec<f64> {
    let mut out = if identity { x.to_vec() } else { Vec::new() };
    for k in 0..i32::from(levels) {
        out.extend(x.iter().map(|&x| level(x, k, pi).0));
        out.extend(x.iter().map(|&x| level(x, k, pi).1));
    }
    out
}

/// Returns the largest absolute error of `found`, `[outputs][n]`, against `truth`, `[n][outputs]`, and the indices of its
/// output and its point. NaN is the largest error.
pub fn furthest(found: &[f32], truth: &[Vec<f64>]) -> (f64, usize, usize) {
    let mut furthest = (0.0f64, 0, 0);
    for (output, values) in found.chunks_exact(truth.len()).enumerate() {
        for (point, &value) in values.iter().enumerate() {
            let error = (f64::from(value) - truth[point][output]).abs();
            if error > furthest.0 || (error.is_nan() && !furthest.0.is_nan()) {
                furthest = (error, output, point);
            }
        }
    }
    furthest
}
