//! Encodes blocks of points by the sinusoidal encoding.

use nerf_core::encoding::{SinusoidalEncoding, encode_block};
use nerf_core::math::MathBackend;
use nerf_core::simd::{BLOCK, Isa};

/// Encodes up to [`BLOCK`] points into `out`, `[outputs][BLOCK]`; missing points are zeros.
///
/// Only the first `encoding.inputs` coordinates of each point are used.
pub(super) fn encode_points<'a>(
    isa: Isa,
    encoding: &SinusoidalEncoding,
    points: impl Iterator<Item = &'a [f32; 3]>,
    out: &mut [f32],
) {
    let mut x = [0.0; 3 * BLOCK];
    let inputs = usize::from(encoding.inputs);
    for (lane, point) in points.take(BLOCK).enumerate() {
        for (axis, &coordinate) in point.iter().take(inputs).enumerate() {
            x[axis * BLOCK + lane] = coordinate;
        }
    }
    encode_block(isa, MathBackend::Polynomial, encoding, BLOCK, &x[..inputs * BLOCK], out);
}
