//! Encoding of viewing directions by spherical harmonics or sinusoids, and the gradient of the harmonics.

use super::pass::{Job, grow};
use super::vector::to_rows;
use crate::model::engine::graph::padded;
use glam::Vec3;
use nerf_core::encoding::{DirectionEncoding, encode_block, encode_harmonics_block};
use nerf_core::math::MathBackend;

#[derive(Default)]
pub(super) struct Directions {
    /// Encoded directions, `[directions][padded outputs of the encoding]`.
    pub rows: Vec<f32>,
    dirs: Vec<f32>,
    channels: Vec<f32>,
}

impl Directions {
    /// Encodes unit directions into `rows`; does nothing if the field's colour does not depend on the direction.
    pub fn encode(&mut self, job: &Job<'_>, dirs: impl ExactSizeIterator<Item = [f32; 3]>) {
        let Some(direction) = &job.model.architecture.direction else { return };
        let (count, outputs) = (dirs.len(), direction.outputs());
        let (stride, width) = (padded(count), padded(outputs));
        grow(&mut self.dirs, 3 * stride);
        for (i, dir) in dirs.enumerate() {
            for (axis, value) in dir.into_iter().enumerate() {
                self.dirs[axis * stride + i] = value;
            }
        }
        grow(&mut self.channels, outputs * stride);
        let (dirs, channels) = (&self.dirs[..3 * stride], &mut self.channels[..outputs * stride]);
        match direction {
            DirectionEncoding::Sinusoidal(encoding) => {
                encode_block(job.isa, MathBackend::Polynomial, encoding, stride, dirs, channels);
            }
            DirectionEncoding::SphericalHarmonics { degree } => {
                encode_harmonics_block(job.isa, *degree, stride, dirs, channels);
            }
        }
        grow(&mut self.rows, count * width);
        to_rows(channels, stride, count, &mut self.rows[..count * width], width);
    }
}

/// Returns the gradient of the loss with respect to the direction: `Jᵀ of_encoded`, with `J` the derivative of the
/// spherical harmonics' polynomials. `of_encoded`: gradient of the loss with respect to each polynomial's value.
///
/// Only the component perpendicular to the direction is meaningful: the polynomials are defined on the sphere.
pub(super) fn harmonics_gradient([x, y, z]: [f32; 3], of_encoded: &[f32]) -> Vec3 {
    let band3 = 0.457_045_8 * (1.0 - 5.0 * z * z);
    let by_dir = [
        [0.0; 3],
        [0.0, -0.488_602_52, 0.0],
        [0.0, 0.0, 0.488_602_52],
        [-0.488_602_52, 0.0, 0.0],
        [y, x, 0.0].map(|g| 1.092_548_5 * g),
        [0.0, z, y].map(|g| -1.092_548_5 * g),
        [0.0, 0.0, 2.0 * 0.946_174_7 * z],
        [z, 0.0, x].map(|g| -1.092_548_5 * g),
        [x, -y, 0.0].map(|g| 2.0 * 0.546_274_24 * g),
        [-2.0 * x * y, y * y - x * x, 0.0].map(|g| 3.0 * 0.590_043_6 * g),
        [y * z, x * z, x * y].map(|g| 2.890_611_4 * g),
        [0.0, band3, -10.0 * 0.457_045_8 * y * z],
        [0.0, 0.0, 0.373_176_34 * (15.0 * z * z - 3.0)],
        [band3, 0.0, -10.0 * 0.457_045_8 * x * z],
        [2.0 * x * z, -2.0 * y * z, x * x - y * y].map(|g| 1.445_305_7 * g),
        [y * y - x * x, 2.0 * x * y, 0.0].map(|g| 3.0 * 0.590_043_6 * g),
    ];
    of_encoded.iter().zip(by_dir).map(|(&of, by_dir)| of * Vec3::from(by_dir)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::engine::graph::VECTOR;
    use nerf_core::simd::Isa;

    #[test]
    fn gradients_of_harmonics_are_finite_differences() {
        let of_encoded: [f32; 16] = std::array::from_fn(|i| 0.5 + (0.7 * i as f32).sin());
        let dir = Vec3::new(0.48, -0.6, 0.64);
        let sum = |dir: Vec3| {
            let (mut dirs, mut encoded) = ([0.0; 3 * VECTOR], [0.0; 16 * VECTOR]);
            (0..3).for_each(|axis| dirs[axis * VECTOR..][..VECTOR].fill(dir[axis]));
            encode_harmonics_block(Isa::detect(), 4, VECTOR, &dirs, &mut encoded);
            (0..16).map(|i| of_encoded[i] * encoded[i * VECTOR]).sum::<f32>()
        };
        let found = harmonics_gradient(dir.to_array(), &of_encoded);
        for axis in [Vec3::X, Vec3::Y, Vec3::Z] {
            let expected = (sum(dir + 1e-2 * axis) - sum(dir - 1e-2 * axis)) / 2e-2;
            assert!((found.dot(axis) - expected).abs() < 1e-3, "{found}, {expected} along {axis}");
        }
    }
}
