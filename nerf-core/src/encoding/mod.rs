//! Encodings of a position, for the network's first layer, and of a viewing direction, for the colour branch.

#[cfg(feature = "grid")]
mod grid;
#[cfg(not(feature = "grid"))]
#[path = "grid_off.rs"]
mod grid;
mod sinusoidal;
mod spherical_harmonics;

pub use grid::GridEncoding;
#[cfg(all(feature = "grid", feature = "train"))]
pub use grid::{GridCorners, encode_grid_block, grid_corners_block};
#[cfg(feature = "grid")]
pub use grid::{
    GridLevel, GridLevels, MAX_GRID_LEVELS, MAX_GRID_RESOLUTION, MAX_GRID_VALUES, MAX_LOG2_ENTRIES,
};
#[cfg(feature = "normals")]
pub(crate) use sinusoidal::encode_gradient_block;
pub use sinusoidal::{AngleScale, MAX_LEVELS, SinusoidalEncoding};
pub(crate) use spherical_harmonics::BUILT as HARMONICS_BUILT;
pub use spherical_harmonics::MAX_HARMONICS_DEGREE;
#[cfg(not(feature = "train"))]
pub(crate) use {grid::GridTables, sinusoidal::encode_block, spherical_harmonics::encode_harmonics_block};
#[cfg(feature = "train")]
pub use {grid::GridTables, sinusoidal::encode_block, spherical_harmonics::encode_harmonics_block};

use serde::{Deserialize, Serialize};

/// Encoding of a position: computes the inputs of the network's first layer.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[allow(clippy::large_enum_variant, reason = "there is one for each network, and no heap to put it on")]
pub enum PositionEncoding {
    /// Sines and cosines of each coordinate at several frequencies.
    Sinusoidal(SinusoidalEncoding),
    /// A multiresolution grid: interpolated entries of learned tables. In builds without the feature `grid`, this
    /// variant cannot be constructed.
    Grid(GridEncoding),
}

impl PositionEncoding {
    /// Number of coordinates: 3, or 2 for a point of an image.
    pub fn inputs(&self) -> u8 {
        match self {
            Self::Sinusoidal(encoding) => encoding.inputs,
            Self::Grid(grid) => grid.inputs(),
        }
    }

    /// Number of encoded values of a position.
    pub fn outputs(&self) -> usize {
        match self {
            Self::Sinusoidal(encoding) => encoding.outputs(),
            Self::Grid(grid) => grid.outputs(),
        }
    }

    /// The sinusoidal encoding; `None` for any other encoding.
    pub fn sinusoidal(&self) -> Option<&SinusoidalEncoding> {
        match self {
            Self::Sinusoidal(encoding) => Some(encoding),
            Self::Grid(_) => None,
        }
    }

    /// The grid encoding; `None` for a sinusoidal encoding.
    pub fn grid(&self) -> Option<&GridEncoding> {
        match self {
            Self::Sinusoidal(_) => None,
            Self::Grid(grid) => Some(grid),
        }
    }
}

impl From<SinusoidalEncoding> for PositionEncoding {
    fn from(encoding: SinusoidalEncoding) -> Self {
        Self::Sinusoidal(encoding)
    }
}

/// Encoding of a viewing direction: computes inputs of the colour branch.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum DirectionEncoding {
    /// Sines and cosines of each coordinate at several frequencies.
    Sinusoidal(SinusoidalEncoding),
    /// Real spherical harmonics. Builds without the feature `grid` refuse networks with this encoding.
    SphericalHarmonics {
        /// Number of bands, 1 to [`MAX_HARMONICS_DEGREE`]; together the bands have `degree²` functions.
        degree: u8,
    },
}

impl DirectionEncoding {
    /// Number of encoded values of a direction.
    pub const fn outputs(&self) -> usize {
        match self {
            Self::Sinusoidal(encoding) => encoding.outputs(),
            Self::SphericalHarmonics { degree } => *degree as usize * *degree as usize,
        }
    }

    /// The sinusoidal encoding; `None` for any other encoding.
    pub const fn sinusoidal(&self) -> Option<&SinusoidalEncoding> {
        match self {
            Self::Sinusoidal(encoding) => Some(encoding),
            Self::SphericalHarmonics { .. } => None,
        }
    }
}

impl From<SinusoidalEncoding> for DirectionEncoding {
    fn from(encoding: SinusoidalEncoding) -> Self {
        Self::Sinusoidal(encoding)
    }
}

/// The values of a grid's tables, borrowed in one of three formats.
#[derive(Clone, Copy, Debug)]
#[non_exhaustive]
pub enum TableValues<'a> {
    /// One little-endian f16 per table value, as stored in a file: finite, at any alignment.
    F16(&'a [u8]),
    /// Signed 8-bit integers, as stored in a file. Each table value is an integer times the scale of its level.
    Int8 {
        /// One byte per table value: a signed 8-bit integer.
        values: &'a [u8],
        /// Scale of each level, little-endian f32 at any alignment: above 0, and finite if multiplied by 128.
        scales: &'a [u8],
    },
    /// One f32 per table value, as used in training.
    F32(&'a [f32]),
}
