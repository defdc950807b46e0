//! The levels of a grid, and the table entry of each vertex.

use super::{GridEncoding, MAX_LOG2_ENTRIES};

/// Factor of y in the hash: Müller et al.'s second prime.
pub(super) const HASH_Y: u32 = 2_654_435_761;
/// Factor of z in the hash: Müller et al.'s third prime.
pub(super) const HASH_Z: u32 = 805_459_861;

/// One level of a [`GridEncoding`]: its numbers of cells, and its range of entries in the tables.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GridLevel {
    /// Index of the level among the grid's levels, from 0.
    pub index: usize,
    /// Number of cells along x, y, z. An axis with n cells has n + 1 vertices.
    pub cells: [u32; 3],
    /// Index of the level's first entry among the entries of all levels.
    pub first: usize,
    /// Number of entries: one per vertex in a dense level, `2^log2_entries + cells[0]` in a hashed level.
    pub entries: usize,
    /// Bit mask that reduces the hash of (y, z) to an index of an entry, `2^log2_entries − 1`. `None` in a dense level,
    /// where each vertex has its own entry.
    pub mask: Option<u32>,
}

impl GridLevel {
    /// Index of the entry of vertex `(0, y, z)`, counted from [`GridLevel::first`]. The entry of `(x, y, z)` is `x`
    /// entries further.
    ///
    /// Dense level of nx · ny · nz cells: `(z (ny + 1) + y) (nx + 1)`. Hashed level: `(h ⊕ (h >> 15)) & mask` with
    /// `h = (y · 2654435761) ⊕ (z · 805459861)`, where the products are modulo 2^32.
    #[inline(always)]
    pub fn row(&self, y: u32, z: u32) -> u32 {
        match self.mask {
            Some(mask) => {
                let h = y.wrapping_mul(HASH_Y) ^ z.wrapping_mul(HASH_Z);
                (h ^ h >> 15) & mask
            }
            None => {
                let [nx, ny, _] = self.cells;
                z.wrapping_mul(ny.wrapping_add(1)).wrapping_add(y).wrapping_mul(nx.wrapping_add(1))
            }
        }
    }
}

/// Number of entries of a level with `resolution` cells along x, y, z, and whether the level is hashed.
pub(super) fn entries(resolution: [u16; 3], log2_entries: u8) -> (u64, bool) {
    let vertices: u64 = resolution.iter().map(|&cells| u64::from(cells) + 1).product();
    let most = 1 << log2_entries.min(MAX_LOG2_ENTRIES);
    // A row of vertices may begin at the last hashed entry, and then extends beyond that entry.
    if vertices > most { (most + u64::from(resolution[0]), true) } else { (vertices, false) }
}

/// Iterator over the levels of a grid, in order; returned by [`GridEncoding::levels`].
#[derive(Clone, Debug)]
pub struct GridLevels<'g> {
    grid: &'g GridEncoding,
    index: usize,
    first: usize,
}

impl<'g> GridLevels<'g> {
    pub(super) fn of(grid: &'g GridEncoding) -> Self {
        Self { grid, index: 0, first: 0 }
    }
}

impl Iterator for GridLevels<'_> {
    type Item = GridLevel;

    #[inline]
    fn next(&mut self) -> Option<GridLevel> {
        let &resolution = self.grid.resolutions.get(self.index)?;
        let (entries, hashed) = entries(resolution, self.grid.log2_entries);
        // The cast is lossless for a grid that passes `check_grid`.
        let entries = entries as usize;
        let mask = hashed.then(|| (1 << self.grid.log2_entries.min(MAX_LOG2_ENTRIES)) - 1);
        let level = GridLevel {
            index: self.index,
            cells: resolution.map(u32::from),
            first: self.first,
            entries,
            mask,
        };
        self.index += 1;
        self.first = self.first.saturating_add(entries);
        Some(level)
    }
}
