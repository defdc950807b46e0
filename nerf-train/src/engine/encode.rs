//! Encodes blocks of points. The only place of the engine that evaluates an encoding.

use nerf_core::encoding::{AngleScale, Encoding};
use nerf_core::kernels::{BLOCK, Tier};

/// Encodes up to [`BLOCK`] points into `out`, `[outputs][BLOCK]`; missing points are zeros.
///
/// Of each point the first `encoding.inputs` coordinates are used.
pub(super) fn encode_points<'a>(
    tier: Tier,
    encoding: &Encoding,
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
    encode_block(tier, encoding, &x[..inputs * BLOCK], out);
}

/// Stand-in for `nerf_core::encoding::encode_block`, to be replaced by it.
///
/// `x`: `[inputs][BLOCK]`, `out`: `[outputs][BLOCK]`.
fn encode_block(_tier: Tier, encoding: &Encoding, x: &[f32], out: &mut [f32]) {
    let mut rows = out.chunks_exact_mut(BLOCK);
    let inputs = || x.chunks_exact(BLOCK);
    if encoding.identity {
        for (x, row) in inputs().zip(rows.by_ref()) {
            row.copy_from_slice(x);
        }
    }
    for level in 0..encoding.levels {
        for function in [f64::sin, f64::cos] {
            for x in inputs() {
                let Some(row) = rows.next() else { return };
                for (y, &x) in row.iter_mut().zip(x) {
                    *y = function(angle(encoding.scale, level, x)) as f32;
                }
            }
        }
    }
}

fn angle(scale: AngleScale, level: u8, x: f32) -> f64 {
    let u = f64::from(x) * f64::from(1u32 << level);
    match scale {
        AngleScale::One => u,
        AngleScale::Pi => (u - 2.0 * (0.5 * u).round()) * std::f64::consts::PI,
    }
}
