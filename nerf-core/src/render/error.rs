//! Why nothing was rendered.

use super::{MAX_RENDER_SIDE, Rect};
use crate::plan::Batch;

/// Why nothing was rendered.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum RenderError {
    /// The blob is a scene, not a 2D field.
    NotAPicture,
    /// A picture with a side of 0 or beyond [`MAX_RENDER_SIDE`].
    Size {
        /// Pixels to a row.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// A batch of nothing, of more than [`Batch::MOST_RAYS`] rays or of more than [`BLOCK`](crate::kernels::BLOCK)
    /// samples.
    Batch {
        /// What was asked for.
        found: Batch,
    },
    /// The rectangle is not inside the image.
    Rect {
        /// What was asked for.
        rect: Rect,
        /// Width of the image, pixels.
        width: u32,
        /// Height of the image, pixels.
        height: u32,
    },
    /// Too little memory, in lines of 64 bytes.
    Memory {
        /// Lines that are needed.
        expected: usize,
        /// Lines that were given.
        found: usize,
    },
    /// The slices of a query differ in length.
    Lengths {
        /// Length of `positions`.
        positions: usize,
        /// Length of `dirs`.
        dirs: usize,
        /// Length of `sigma`.
        sigma: usize,
        /// Length of `rgb`.
        rgb: usize,
    },
    /// A direction of a query for colour that is not of unit length.
    Direction {
        /// Which one.
        index: usize,
        /// What was given.
        found: [f32; 3],
    },
}

impl core::fmt::Display for RenderError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::NotAPicture => write!(f, "blob: expected a 2D field, found a scene"),
            Self::Size { width, height } => {
                write!(f, "size: expected sides of 1 to {MAX_RENDER_SIDE} pixels, found {width}x{height}")
            }
            Self::Batch { found } => found.write_refusal(f),
            Self::Rect { rect, width, height } => write!(
                f,
                "rectangle: expected it inside the {width}x{height} image, found {}x{} at ({}, {})",
                rect.width, rect.height, rect.x, rect.y
            ),
            Self::Memory { expected, found } => {
                write!(f, "workspace: expected {expected} lines of 64 bytes, found {found}")
            }
            Self::Lengths { positions, dirs, sigma, rgb } => write!(
                f,
                "query: expected slices of one length, found positions {positions}, dirs {dirs}, sigma {sigma}, \
                 rgb {rgb}"
            ),
            Self::Direction { index, found } => {
                write!(f, "dirs[{index}]: expected a vector of unit length, found {found:?}")
            }
        }
    }
}

impl core::error::Error for RenderError {}
