//! Settings of the multiresolution grid.

use crate::model::quantise::{ROUNDED_FROM, Rounding, TableStorage};
use crate::system::input::value_name;
use glam::Vec3;
use nerf_core::encoding::{GridEncoding, MAX_GRID_LEVELS};
use serde::{Deserialize, Serialize};

/// Settings of the multiresolution grid that encodes positions.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TableConfig {
    /// Number of levels; their resolutions grow from `coarsest` to `finest`.
    pub levels: usize,
    /// Number of features of a table entry: 1, 2 or 4.
    pub features: u8,
    /// Binary logarithm of the largest number of entries of a level; a level with more vertices is hashed.
    pub log2_entries: u8,
    /// Number of cells of the first level along the longest side of the scene box.
    pub coarsest: u16,
    /// Number of cells of the last level along the longest side of the scene box.
    pub finest: u16,
    /// Storage of the tables' values in the exported file; training keeps them in f32.
    pub storage: TableStorage,
    /// Largest size of coded tables, bytes. The quantisation steps are the finest with which the tables fit. If absent,
    /// the steps are a fixed fraction of the values' root mean square.
    #[serde(default)]
    pub most_bytes: Option<u64>,
}

impl TableConfig {
    /// Returns the settings as text, for example `8 levels of 16 to 320 cells, at most 2^16 entries a level as f16`.
    pub fn in_words(&self) -> String {
        let Self { levels, log2_entries, coarsest, finest, storage, .. } = self;
        let storage = value_name(storage);
        format!(
            "{levels} levels of {coarsest} to {finest} cells, at most 2^{log2_entries} entries a level as {storage}"
        )
    }

    /// Returns the grid over a box of this extent, world units. Resolutions grow geometrically from level to level;
    /// cells are cubes, up to rounding to whole cells.
    pub fn encoding(&self, extent: Vec3) -> GridEncoding {
        self.over(3, extent)
    }

    /// Returns the grid over an image of this size, pixels; cells are squares, up to rounding to whole cells.
    pub fn picture_encoding(&self, [width, height]: [u32; 2]) -> GridEncoding {
        self.over(2, Vec3::new(width as f32, height as f32, 0.0))
    }

    fn over(&self, inputs: u8, extent: Vec3) -> GridEncoding {
        let (first, last) = (f64::from(self.coarsest), f64::from(self.finest));
        let longest = extent.max_element();
        let level = |level: usize| {
            let share = if self.levels > 1 { level as f64 / (self.levels - 1) as f64 } else { 0.0 };
            let cells = (first * (last / first).powf(share)).round();
            let mut sides = [0; 3];
            for (axis, side) in sides.iter_mut().enumerate().take(usize::from(inputs)) {
                *side = ((f64::from(extent[axis] / longest) * cells).round() as u16).max(1);
            }
            sides
        };
        let resolutions = (0..self.levels.min(MAX_GRID_LEVELS)).map(level).collect();
        GridEncoding { inputs, features: self.features, log2_entries: self.log2_entries, resolutions }
    }

    /// Returns whether training rounds the tables to quantisation steps after the fraction `share` of the run. Tables
    /// stored as f16 are never rounded; all others are rounded from [`ROUNDED_FROM`] on.
    pub(crate) fn is_rounded(&self, share: f64) -> bool {
        self.storage != TableStorage::F16 && share >= ROUNDED_FROM
    }

    /// Returns the number format to which export rounds the tables, and the largest total size of the tables, bytes.
    pub(crate) fn rounding(&self) -> Rounding {
        let most_bytes = self.most_bytes.and_then(|most| usize::try_from(most).ok());
        Rounding { storage: self.storage, most_bytes }
    }
}
