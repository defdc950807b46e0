//! Image of a 2D field: each pixel is one evaluation of the network, without compositing.

use super::{Counters, Rect};
use crate::camera::MAX_IMAGE_SIDE;
use crate::math::MathBackend;
use crate::memory::{Arena, Layout, Line, column, put_column};
use crate::network::{Network, Scratch};
use crate::plan::Batch;
use crate::simd::BLOCK;

#[cfg(test)]
mod tests;

/// Longest side of an image of a 2D field, pixels; the same limit as for a camera's image.
///
/// Up to this size, neighbouring pixels have different f32 coordinates, and no pixel's coordinate is rounded to 1.
pub const MAX_RENDER_SIDE: u32 = MAX_IMAGE_SIDE;

/// Workspace for an image of a 2D field: one block of pixels.
pub(super) struct Buffers<'w> {
    /// Coordinates of the pixels' centres, in `[0, 1]`: a row of x and a row of y, `[2][stride]`.
    positions: &'w mut [f32],
    /// Colours of the pixels: `[3][stride]`.
    rgb: &'w mut [f32],
    scratch: Scratch<'w>,
}

impl<'w> Buffers<'w> {
    pub fn lay_out(layout: &mut impl Layout<'w>, network: &Network<'_>, batch: Batch) -> Self {
        let stride = if network.whole_blocks() { BLOCK } else { batch.samples };
        let (encoded, activation) = (network.encoded_rows(), network.activation_rows());
        let mut rows = |count: usize| layout.slice(stride.saturating_mul(count), 0.0);
        Self {
            positions: rows(2),
            rgb: rows(3),
            scratch: Scratch {
                stride,
                encoded: rows(encoded),
                front: rows(activation),
                back: rows(activation),
            },
        }
    }
}

/// Renders part `rect` of an image of `size` (width, height) pixels; passes x, y and colour of each pixel to `target`.
pub(super) fn render(
    network: &Network<'_>,
    math: MathBackend,
    batch: Batch,
    (size, rect): ([u32; 2], Rect),
    workspace: &mut [Line],
    target: &mut impl FnMut(u32, u32, [f32; 3]),
) -> Counters {
    let Buffers { positions, rgb, mut scratch } =
        Buffers::lay_out(&mut Arena::new(workspace), network, batch);
    let architecture = network.architecture();
    let macs = (architecture.density_macs() + architecture.colour_macs()) as u64;
    let [width, height] = size.map(|side| side as f32);
    let (stride, mut counters) = (scratch.stride, Counters::default());
    // A block may hold pixels of several rows; only the last block may be short.
    let mut pixels = rect.pixels();
    loop {
        let mut n = 0;
        for (x, y) in pixels.clone().take(stride) {
            put_column(positions, stride, n, [(x as f32 + 0.5) / width, (y as f32 + 0.5) / height]);
            n += 1;
        }
        if n == 0 {
            return counters;
        }
        network.trunk(math, &mut scratch, positions);
        network.colour(math, &mut scratch, |_, _| {}, rgb);
        counters.colour_evaluations += n as u64;
        counters.macs += n as u64 * macs;
        for (i, (x, y)) in pixels.by_ref().take(n).enumerate() {
            target(x, y, counters.or_black(column(rgb, stride, i)));
        }
    }
}
