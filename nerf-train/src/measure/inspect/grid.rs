//! The learned grid of a blob.

use nerf_core::blob::{Blob, StoredTables};
use serde::Serialize;

/// The learned grid of a blob.
#[derive(Debug, Serialize)]
#[allow(missing_docs, reason = "the names say what they are, and in which unit")]
pub struct GridSummary {
    pub grid_levels: usize,
    pub grid_features: u8,
    pub grid_log2_entries: u8,
    pub grid_coarsest_cells: u16,
    pub grid_finest_cells: u16,
    pub grid_values: usize,
    pub grid_storage: &'static str,
    pub grid_bytes: usize,
}

impl GridSummary {
    /// Of a blob's grid, if it has one.
    pub fn of(blob: &Blob<'_>) -> Option<Self> {
        let grid = blob.architecture().position.grid()?;
        // Along the longest side.
        let cells =
            |level: Option<&[u16; 3]>| level.and_then(|level| level.iter().max().copied()).unwrap_or(0);
        let tables = blob.tables();
        let bytes = |tables: &StoredTables<'_>| tables.bytes().len() + tables.scales().map_or(0, <[u8]>::len);
        Some(Self {
            grid_levels: grid.resolutions.len(),
            grid_features: grid.features,
            grid_log2_entries: grid.log2_entries,
            grid_coarsest_cells: cells(grid.resolutions.first()),
            grid_finest_cells: cells(grid.resolutions.last()),
            grid_values: grid.values(),
            grid_storage: tables.as_ref().map_or("", |tables| tables.name()),
            grid_bytes: tables.as_ref().map_or(0, bytes),
        })
    }
}
