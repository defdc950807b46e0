//! The learned grid of a blob.

use nerf_core::blob::Blob;
use nerf_core::encoding::GridEncoding;
use serde::Serialize;

/// What the tables are stored in.
fn storage(blob: &Blob<'_>) -> &'static str {
    blob.tables().map_or("", |tables| tables.name())
}

/// Bytes of the tables in the file.
fn table_bytes(blob: &Blob<'_>) -> usize {
    blob.tables().map_or(0, |tables| tables.bytes().len() + tables.scales().map_or(0, <[u8]>::len))
}

/// Cells of the coarsest and of the finest level along the longest side.
fn cells(grid: &GridEncoding) -> [u16; 2] {
    let longest = |level: Option<&[u16; 3]>| level.and_then(|level| level.iter().max().copied()).unwrap_or(0);
    [longest(grid.resolutions.first()), longest(grid.resolutions.last())]
}

/// `8 levels of 16 to 320 cells, 2 features an entry, at most 2^16 entries a level: 787456 values as f16 (1574912 bytes)`.
pub fn describe(blob: &Blob<'_>) -> Option<String> {
    let grid = blob.architecture().position.grid()?;
    let [coarsest, finest] = cells(grid);
    let count = |n: usize, what: &str| if n == 1 { format!("1 {what}") } else { format!("{n} {what}s") };
    Some(format!(
        "{} of {coarsest} to {finest} cells, {} an entry, at most 2^{} entries a level: {} values as {} ({} bytes)",
        count(grid.resolutions.len(), "level"),
        count(usize::from(grid.features), "feature"),
        grid.log2_entries,
        grid.values(),
        storage(blob),
        table_bytes(blob)
    ))
}

/// The same for scripts.
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
        let [grid_coarsest_cells, grid_finest_cells] = cells(grid);
        Some(Self {
            grid_levels: grid.resolutions.len(),
            grid_features: grid.features,
            grid_log2_entries: grid.log2_entries,
            grid_coarsest_cells,
            grid_finest_cells,
            grid_values: grid.values(),
            grid_storage: storage(blob),
            grid_bytes: table_bytes(blob),
        })
    }
}
