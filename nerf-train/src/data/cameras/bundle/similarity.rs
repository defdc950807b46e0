//! Position, rotation and scale of the world, which observations leave open.

use super::Bundle;
use glam::{DMat3, DQuat, DVec3};

/// Number of iterations, each of which turns by the remaining angle.
const TURNS: usize = 20;

/// Rotates, scales and shifts everything so that the cameras lie as near as possible to their positions in `anchor`.
///
/// With fewer than two distinct positions nothing is moved.
pub(super) fn align(bundle: &mut Bundle, anchor: &[DVec3]) {
    let centres: Vec<DVec3> = bundle.photographs.iter().map(super::Photograph::centre).collect();
    let mean = |places: &[DVec3]| places.iter().sum::<DVec3>() / places.len().max(1) as f64;
    let (from, to) = (mean(&centres), mean(anchor));
    let pairs: Vec<(DVec3, DVec3)> = centres.iter().zip(anchor).map(|(a, b)| (*a - from, *b - to)).collect();
    let mut turn = DQuat::IDENTITY;
    for _ in 0..TURNS {
        let (mut matrix, mut right) = (DMat3::ZERO, DVec3::ZERO);
        for (a, b) in pairs.iter().map(|(a, b)| (turn * *a, *b)) {
            matrix += a.length_squared() * DMat3::IDENTITY - DMat3::from_cols(a * a.x, a * a.y, a * a.z);
            right += a.cross(b);
        }
        let step = matrix.inverse() * right;
        if step.is_finite() {
            turn = (DQuat::from_scaled_axis(step) * turn).normalize();
        }
    }
    let (along, square) =
        pairs.iter().fold((0.0, 0.0), |(s, q), (a, b)| (s + (turn * *a).dot(*b), q + a.length_squared()));
    let scale = along / square;
    if !(scale.is_finite() && scale > 0.0) {
        return;
    }
    let moved = |place: DVec3| to + scale * (turn * (place - from));
    bundle.points.iter_mut().for_each(|point| *point = moved(*point));
    for (photograph, centre) in bundle.photographs.iter_mut().zip(centres) {
        photograph.rotation = (photograph.rotation * turn.inverse()).normalize();
        photograph.translation = -(photograph.rotation * moved(centre));
    }
}
