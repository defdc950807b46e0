//! A blob's learned grid in words and as fields: `inspect` and `fit` say the same of it.

use crate::report::summary::Summary;
use nerf_core::blob::Blob;
use nerf_core::encoding::GridEncoding;

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

/// The same as fields; none without a grid.
pub fn summarise(blob: &Blob<'_>, summary: &mut Summary) {
    let Some(grid) = blob.architecture().position.grid() else { return };
    let [coarsest, finest] = cells(grid);
    summary
        .integer("grid_levels", grid.resolutions.len() as u64)
        .integer("grid_features", u64::from(grid.features))
        .integer("grid_log2_entries", u64::from(grid.log2_entries))
        .integer("grid_coarsest_cells", u64::from(coarsest))
        .integer("grid_finest_cells", u64::from(finest))
        .integer("grid_values", grid.values() as u64)
        .text("grid_storage", storage(blob))
        .integer("grid_bytes", table_bytes(blob) as u64);
}
