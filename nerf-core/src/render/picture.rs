//! A picture of a 2D field: every pixel is one question to the network, and nothing is added up.

use super::{Counters, Rect, RenderError, Renderer};
use crate::camera::MAX_IMAGE_SIDE;
use crate::math::MathBackend;
use crate::memory::{Arena, Layout, Line, Measure, column, put_column};
use crate::network::{Network, Scratch};
use crate::plan::Batch;
use crate::simd::BLOCK;

#[cfg(test)]
mod tests;

/// Longest side of a rendered picture, pixels: that of an image.
///
/// Up to it no two pixels ask for the same point, and none asks for 1.
pub const MAX_RENDER_SIDE: u32 = MAX_IMAGE_SIDE;

/// The memory a picture is worked out in.
struct Buffers<'w> {
    /// `[2][stride]`.
    positions: &'w mut [f32],
    /// `[3][stride]`.
    rgb: &'w mut [f32],
    scratch: Scratch<'w>,
}

impl<'w> Buffers<'w> {
    fn lay_out(layout: &mut impl Layout<'w>, network: &Network<'_>, batch: Batch) -> Self {
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

impl Renderer<'_> {
    /// Lines of workspace one [`Renderer::render_picture`] call needs.
    ///
    /// Of `batch` only the samples matter, and only to portable instructions over weights read in place: others always take
    /// whole blocks.
    pub fn picture_workspace_lines(&self, batch: Batch) -> usize {
        let mut measure = Measure::default();
        Buffers::lay_out(&mut measure, &self.network, batch);
        measure.lines
    }

    /// Renders the pixels of `rect` of the 2D field, drawn in `size[0]` × `size[1]` pixels.
    ///
    /// Pixel (x, y) is the field's colour at its centre, ((x + ½) / width, (y + ½) / height) with
    /// x to the right and y down: 0 to 1 over the picture whatever its aspect. So any size shows the
    /// whole picture, [`PictureFacts`](crate::blob::PictureFacts) has the one without distortion, and
    /// a `rect` of a larger size is a detail of it.
    ///
    /// `target` takes x, y and the display-encoded colour, in `[0, 1]`; each pixel comes once, row by
    /// row. Within one kernel and maths backend it does not depend on `rect` or `batch` or on who else
    /// renders at the same time, bit for bit. A colour that is NaN becomes black and is counted
    /// ([`Counters::invalid_samples`]).
    ///
    /// # Errors
    /// [`RenderError`] on a scene, a size of 0 or beyond [`MAX_RENDER_SIDE`], a rectangle outside
    /// `size`, a batch that no [`Plan`](crate::plan::Plan) would take and on too little workspace;
    /// nothing has been written then.
    pub fn render_picture(
        &self,
        math: MathBackend,
        batch: Batch,
        size: [u32; 2],
        rect: Rect,
        workspace: &mut [Line],
        target: &mut impl FnMut(u32, u32, [f32; 3]),
    ) -> Result<Counters, RenderError> {
        self.check_picture(batch, size, rect)?;
        let network = &self.network;
        let (expected, found) = (self.picture_workspace_lines(batch), workspace.len());
        if found < expected {
            return Err(RenderError::Memory { expected, found });
        }
        let Buffers { positions, rgb, mut scratch } =
            Buffers::lay_out(&mut Arena::new(workspace), network, batch);
        let stride = scratch.stride;

        let architecture = network.architecture();
        let macs = (architecture.density_macs() + architecture.colour_macs()) as u64;
        let [width, height] = size.map(|side| side as f32);
        let mut counters = Counters::default();
        // Blocks run on across the ends of rows; only the last one may be short.
        let mut pixels = row_by_row(rect);
        loop {
            let mut n = 0;
            for (x, y) in pixels.clone().take(stride) {
                put_column(positions, stride, n, [(x as f32 + 0.5) / width, (y as f32 + 0.5) / height]);
                n += 1;
            }
            if n == 0 {
                return Ok(counters);
            }
            network.trunk(math, &mut scratch, positions);
            network.colour(math, &mut scratch, |_| {}, rgb);
            counters.colour_evaluations += n as u64;
            counters.macs += n as u64 * macs;
            for (i, (x, y)) in pixels.by_ref().take(n).enumerate() {
                let mut colour: [f32; 3] = column(rgb, stride, i);
                if colour.iter().any(|c| c.is_nan()) {
                    counters.invalid_samples += 1;
                    colour = [0.0; 3];
                }
                target(x, y, colour);
            }
        }
    }

    /// Whether [`Renderer::render_picture`] takes these arguments; its workspace is another matter.
    ///
    /// # Errors
    /// As [`Renderer::render_picture`], but for the workspace.
    pub fn check_picture(&self, batch: Batch, size: [u32; 2], rect: Rect) -> Result<(), RenderError> {
        let [width, height] = size;
        if self.blob.picture().is_none() {
            return Err(RenderError::NotAPicture);
        }
        if !size.iter().all(|side| (1..=MAX_RENDER_SIDE).contains(side)) {
            return Err(RenderError::Size { width, height });
        }
        if !rect.fits(width, height) {
            return Err(RenderError::Rect { rect, width, height });
        }
        if !batch.is_valid() {
            return Err(RenderError::Batch { found: batch });
        }
        Ok(())
    }
}

/// The pixels of a rectangle that reaches to no more than the last `u32`.
fn row_by_row(rect: Rect) -> impl Iterator<Item = (u32, u32)> + Clone {
    let columns = rect.x..rect.x + rect.width;
    (rect.y..rect.y + rect.height).flat_map(move |y| columns.clone().map(move |x| (x, y)))
}
