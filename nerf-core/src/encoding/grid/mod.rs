//! Multiresolution grid: at each level, features at the vertices of a regular grid, interpolated linearly.
//!
//! ```text
//! u = (x − min) / (max − min)      maps the box to 0..1 on each axis
//! per level: g = u · cells;  cell = min(⌊g⌋, cells − 1);  w = g − cell
//!            rows of corners: (y, z), (y+1, z), (y, z+1), (y+1, z+1), each at x and x + 1
//!            w_yz: a row's weight along y times its weight along z
//!            a_0 = Σ_rows w_yz · entry(x, row);  a_1 = Σ_rows w_yz · entry(x + 1, row)
//!            out = a_0 + w_x (a_1 − a_0)
//! ```

mod cell;
#[cfg(any(feature = "train", test))]
mod corners;
mod forward;
#[cfg(feature = "normals")]
mod gradient;
mod level;

#[cfg(test)]
mod tests;

#[cfg(any(feature = "train", test))]
pub use corners::{GridCorners, grid_corners_block};
pub use forward::encode_grid_block;
pub use level::{GridLevel, GridLevels};

#[cfg(feature = "normals")]
use self::gradient::Gradient;
use super::TableValues;
#[cfg(feature = "normals")]
use crate::memory::{head, head_mut};
use crate::simd::Isa;
use crate::space::SceneBox;
use serde::{Deserialize, Serialize};

/// Maximum number of levels of a multiresolution grid.
pub const MAX_GRID_LEVELS: usize = 32;
/// Maximum number of cells of a level along one axis, 2^14. Up to this number, an f32 position counted in cells has at
/// least ten bits after the binary point; these bits are the interpolation weight.
pub const MAX_GRID_RESOLUTION: u16 = 16_384;
/// Maximum of [`GridEncoding::log2_entries`], the binary logarithm of the size of a hash table.
pub const MAX_LOG2_ENTRIES: u8 = 24;
/// Maximum total number of table values of a grid. As f32, 2^27 values take 512 MiB, which a 32-bit host can address.
pub const MAX_GRID_VALUES: u64 = 1 << 27;

/// Evaluates `$body` with `$table` bound to a [`Table`](crate::simd::Table) of `$values`. Compiles `$body` once for
/// each format of values.
macro_rules! with_table {
    ($values:expr, $table:ident => $body:expr) => {
        match $values {
            TableValues::F16(bytes) => {
                let $table = crate::simd::Table::new(bytes.as_chunks::<2>().0, &[]);
                $body
            }
            TableValues::Int8 { values, scales } => {
                let $table = crate::simd::Table::new(values, scales);
                $body
            }
            TableValues::F32(values) => {
                let $table = crate::simd::Table::new(values, &[]);
                $body
            }
        }
    };
}
use with_table;

/// A multiresolution grid of features. A level is dense if all its vertices fit into `2^log2_entries` entries. All
/// other levels are hashed.
///
/// Encoded values are ordered by level, then by feature; table values (`TableValues`) by level, by entry, then by
/// feature. [`GridEncoding::levels`] gives the range of entries of each level.
///
/// # Source
/// Müller et al. 2022, "Instant Neural Graphics Primitives", section 3; levels that fit are dense, as in tiny-cuda-nn.
/// Deviation: only y and z are hashed, and x is added to the hash, so that the corners at x and x + 1 are neighbours in
/// memory.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct GridEncoding {
    /// Number of inputs: 3 for a position, 2 for a point of an image.
    pub inputs: u8,
    /// Number of features of a table entry: 1, 2 or 4.
    pub features: u8,
    /// Binary logarithm of the number of entries of a hash table, at most [`MAX_LOG2_ENTRIES`]. Levels with more
    /// vertices than this number are hashed.
    pub log2_entries: u8,
    /// Number of cells along x, y, z at each level, 1 to [`MAX_GRID_RESOLUTION`]; 0 along z with 2 inputs.
    pub resolutions: heapless::Vec<[u16; 3], MAX_GRID_LEVELS>,
}

impl GridEncoding {
    /// Number of input coordinates: 3 for a position, 2 for a point of an image.
    pub fn inputs(&self) -> u8 {
        self.inputs
    }

    /// Number of encoded values of a position.
    ///
    /// ```
    /// use nerf_core::encoding::GridEncoding;
    /// let resolutions = [[16, 16, 8], [64, 64, 32]].into_iter().collect();
    /// let grid = GridEncoding { inputs: 3, features: 2, log2_entries: 14, resolutions };
    /// assert_eq!(grid.outputs(), 4);
    /// // The 17·17·9 = 2601 vertices of level 0 fit. Level 1 has 65·65·33 vertices and is hashed: 2^14 entries,
    /// // and 64 more for a row of 64 cells that begins at the last entry.
    /// assert_eq!(grid.entries(), 2601 + 16_384 + 64);
    /// ```
    pub fn outputs(&self) -> usize {
        self.resolutions.len() * usize::from(self.features)
    }

    /// Returns an iterator over the grid's levels, in the order of [`GridEncoding::resolutions`].
    pub fn levels(&self) -> GridLevels<'_> {
        GridLevels::of(self)
    }

    /// Total number of table entries of all levels.
    ///
    /// Correct only for a grid that passes [`Architecture::check`](crate::network::Architecture::check).
    pub fn entries(&self) -> usize {
        self.levels().last().map_or(0, |level| level.first + level.entries)
    }

    /// Total number of table values of all levels: entries times features.
    pub fn values(&self) -> usize {
        self.entries().saturating_mul(usize::from(self.features))
    }

    /// Number of table entries that are read to encode one sample: one per corner of a cell at each level.
    pub fn reads(&self) -> usize {
        self.resolutions.len() << self.inputs.min(3)
    }

    /// Total number of table entries of all levels, computed without overflow even for a grid that was not checked.
    pub(crate) fn entries_of_any(&self) -> u64 {
        self.resolutions.iter().map(|resolution| level::entries(*resolution, self.log2_entries).0).sum()
    }

    /// Whether `tables` have enough values for this grid, and a scale for each level if the values are int8.
    pub(crate) fn fits(&self, tables: &GridTables<'_>) -> bool {
        let found = match tables.values {
            TableValues::F16(bytes) => bytes.len() / 2,
            TableValues::Int8 { scales, .. } if scales.len() < 4 * self.resolutions.len() => return false,
            TableValues::Int8 { values, .. } => values.len(),
            TableValues::F32(values) => values.len(),
        };
        found >= self.values()
    }

    #[inline]
    pub(crate) fn encode(
        &self,
        tables: &GridTables<'_>,
        isa: Isa,
        stride: usize,
        x: &[f32],
        out: &mut [f32],
    ) {
        encode_grid_block(isa, self, tables, stride, x, out);
    }

    /// Computes the backward pass through the grid encoding of a block of samples: the gradient of a function `f` with
    /// respect to the positions, from the gradient of `f` with respect to the encoded values.
    ///
    /// `x`: `[inputs][stride]`, world units. `of_encoded`: `[outputs][stride]`, ∂f/∂encoded. `of_x`, set to ∂f/∂x:
    /// `[inputs][stride]`. Unless `stride` is a multiple of [`Isa::columns`], all samples are computed one by one.
    ///
    /// The interpolation is differentiated inside the sample's cell. A face between two cells belongs to the cell with
    /// the larger index.
    ///
    /// `blur`: standard deviation, world units, of a Gaussian around each sample. The gradient is averaged over this
    /// Gaussian: a level with cells of width `c` is weighted by `erf(c / (√8 blur))`. If `blur` is 0, the weight is 1.
    ///
    /// # Source
    /// Barron et al. 2023 (Zip-NeRF), section 2: down-weighting of levels finer than the sample.
    #[cfg(feature = "normals")]
    #[allow(clippy::too_many_arguments, reason = "those of the sinusoidal encoding's gradient")]
    pub fn gradient(
        &self,
        tables: &GridTables<'_>,
        isa: Isa,
        stride: usize,
        x: &[f32],
        of_encoded: &[f32],
        blur: f32,
        of_x: &mut [f32],
    ) {
        let inputs = usize::from(self.inputs);
        let (x, of_encoded) = (head(x, inputs * stride), head(of_encoded, self.outputs() * stride));
        let of_x = head_mut(of_x, inputs * stride);
        with_table!(tables.values, table => {
            isa.run_columns(stride, Gradient { grid: self, tables, table, stride, x, of_encoded, blur, of_x });
        });
    }
}

/// The tables of a grid, and the box that the grid spans.
#[derive(Clone, Copy, Debug)]
pub struct GridTables<'a> {
    values: TableValues<'a>,
    /// Smallest corner (`min`) and side lengths (`sides`) of the box that the grid spans.
    min: [f32; 3],
    sides: [f32; 3],
}

impl<'a> GridTables<'a> {
    /// Empty tables, for a network without a grid.
    pub const NONE: Self = Self { values: TableValues::F32(&[]), min: [0.0; 3], sides: [1.0; 3] };

    /// Tables of a grid that spans the scene box `bounds`. If `bounds` is `None`, as in a 2D field, the grid spans 0..1
    /// on each axis.
    pub fn new(values: TableValues<'a>, bounds: Option<&SceneBox>) -> Self {
        match bounds {
            Some(b) => Self { values, min: b.min.to_array(), sides: (b.max - b.min).to_array() },
            None => Self { values, ..Self::NONE },
        }
    }
}
