//! Contraction of unbounded space into a ball, and the distances of samples along rays through this space.

/// Contracts space around `centre`: returns `p` unchanged within `radius`, else the point in the same direction at `2 −
/// 1/r` radii, where `r` is the distance of `p` from the centre in radii.
pub fn contract(centre: [f64; 3], radius: f64, p: [f64; 3]) -> [f64; 3] {
    let r = radii(centre, radius, p);
    let share = if r <= 1.0 { 1.0 } else { (2.0 - 1.0 / r) / r };
    [0, 1, 2].map(|axis| centre[axis] + share * (p[axis] - centre[axis]))
}

/// Returns the distance, in radii, of the sample at `s` from the ray's point nearest to the centre.
pub fn distance(power: u8, s: f64) -> f64 {
    let p = f64::from(power);
    let size = if s.abs() <= 1.0 { s.abs() } else { (1.0 - (s.abs() - 1.0) / p).powf(-p) };
    size.copysign(s)
}

fn radii(centre: [f64; 3], radius: f64, p: [f64; 3]) -> f64 {
    [0, 1, 2].map(|axis| (p[axis] - centre[axis]) / radius).iter().map(|x| x * x).sum::<f64>().sqrt()
}
