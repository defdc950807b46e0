//! Encoded viewing directions, a row each.

use super::layers::padded;
use super::pass::{Job, grow};
use super::vector::to_rows;
use nerf_core::encoding::{DirectionEncoding, encode_block, encode_harmonics_block};
use nerf_core::math::MathBackend;

/// A thread's buffers.
#[derive(Default)]
pub(super) struct Directions {
    /// `[directions][padded outputs]`.
    pub rows: Vec<f32>,
    dirs: Vec<f32>,
    channels: Vec<f32>,
}

impl Directions {
    /// Encodes unit directions; nothing of a field whose colour does not depend on them.
    pub fn encode(&mut self, job: &Job<'_>, dirs: impl ExactSizeIterator<Item = [f32; 3]>) {
        let Some(direction) = &job.model.architecture.direction else { return };
        let (count, outputs) = (dirs.len(), direction.outputs());
        let (stride, width) = (padded(count), padded(outputs));
        grow(&mut self.dirs, 3 * stride);
        for (i, dir) in dirs.enumerate() {
            for axis in 0..3 {
                self.dirs[axis * stride + i] = dir[axis];
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
