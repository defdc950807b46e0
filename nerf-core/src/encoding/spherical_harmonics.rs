//! Real spherical harmonics of a direction.

use crate::memory::{head, head_mut, tail, tail_mut};
use crate::simd::{Isa, Lanes, Op};

#[cfg(all(test, feature = "grid"))]
mod tests;

/// Whether this build supports spherical harmonics.
pub(crate) const BUILT: bool = cfg!(feature = "grid");

/// Maximum number of bands of spherical harmonics.
pub const MAX_HARMONICS_DEGREE: u8 = 4;

/// Encodes a block of directions by the `degree²` real spherical harmonics of bands `l < degree`. Does nothing in
/// a build without the feature `grid`, which refuses networks with spherical harmonics.
///
/// `dirs`: `[3][stride]`, unit length. `out`: `[degree²][stride]`. Row `l² + l + m` of `out` is `Y_l^m`, orthonormal
/// over the sphere, with the Condon–Shortley phase. Rows 0 to 3: `½ √(1/π)`, `−√(3/4π) y`, `√(3/4π) z`, `−√(3/4π) x`.
/// `stride`: number of directions. If `stride` is not a multiple of [`Isa::columns`], directions are encoded one by
/// one.
///
/// # Accuracy
/// Absolute error of at most 5e-7, for directions of unit length.
///
/// # Source
/// Sloan 2013, "Efficient Spherical Harmonic Evaluation"; the order and signs are tiny-cuda-nn's.
///
/// # Panics
/// With debug assertions, if a slice is too short.
pub fn encode_harmonics_block(isa: Isa, degree: u8, stride: usize, dirs: &[f32], out: &mut [f32]) {
    if !BUILT {
        return;
    }
    let dirs = head(dirs, 3 * stride);
    let count = usize::from(degree) * usize::from(degree);
    let out = head_mut(out, count * stride);
    isa.run_columns(stride, Harmonics { count, stride, dirs, out });
}

struct Harmonics<'a> {
    count: usize,
    stride: usize,
    dirs: &'a [f32],
    out: &'a mut [f32],
}

impl Op for Harmonics<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: Lanes>(self) {
        let stride = self.stride;
        for column in (0..stride).step_by(V::COUNT) {
            let axis = |axis: usize| V::load(tail(self.dirs, axis * stride + column));
            let values = harmonics(axis(0), axis(1), axis(2));
            for (channel, value) in values.into_iter().enumerate().take(self.count) {
                value.store(tail_mut(self.out, channel * stride + column));
            }
        }
    }
}

#[inline(always)]
fn harmonics<V: Lanes>(x: V, y: V, z: V) -> [V; 16] {
    let c = V::splat;
    let (xy, xz, yz) = (x.mul(y), x.mul(z), y.mul(z));
    let (xx, yy, zz) = (x.mul(x), y.mul(y), z.mul(z));
    let band3 = zz.mul_add(c(-5.0), c(1.0));
    [
        c(0.282_094_8),
        y.mul(c(-0.488_602_52)),
        z.mul(c(0.488_602_52)),
        x.mul(c(-0.488_602_52)),
        xy.mul(c(1.092_548_5)),
        yz.mul(c(-1.092_548_5)),
        zz.mul_add(c(0.946_174_7), c(-0.315_391_57)),
        xz.mul(c(-1.092_548_5)),
        xx.sub(yy).mul(c(0.546_274_24)),
        xx.mul_add(c(-3.0), yy).mul(y).mul(c(0.590_043_6)),
        xy.mul(z).mul(c(2.890_611_4)),
        band3.mul(y).mul(c(0.457_045_8)),
        zz.mul_add(c(5.0), c(-3.0)).mul(z).mul(c(0.373_176_34)),
        band3.mul(x).mul(c(0.457_045_8)),
        xx.sub(yy).mul(z).mul(c(1.445_305_7)),
        yy.mul_add(c(3.0), xx.neg()).mul(x).mul(c(0.590_043_6)),
    ]
}
