//! Flags for the settings of a learned grid.

use crate::fit::size::Chosen;
use crate::model::config::TableConfig;
use crate::model::quantise::TableStorage;
use crate::system::input::value_name;
use crate::system::memory;
use clap::{Args, ValueEnum};
use nerf_core::encoding::GridEncoding;

pub const HEADING: &str = "Hash grid (--preset grid, whose values are the defaults)";

/// Flags for the settings of a learned grid.
#[derive(Debug, Args)]
#[command(next_help_heading = HEADING)]
pub struct TableSettings {
    /// Binary logarithm of the hash table size: at most 2^K entries per level.
    #[arg(long, value_name = "K")]
    pub table: Option<u8>,
    /// Number of grid levels, from the coarsest to the finest resolution.
    #[arg(long, value_name = "N")]
    pub grid_levels: Option<usize>,
    /// Features per level: 1, 2 or 4.
    #[arg(long, value_name = "F")]
    pub features: Option<u8>,
    /// Base resolution: cells along the longest side of the scene box or image, at the coarsest level.
    #[arg(long, value_name = "N")]
    pub coarsest: Option<u16>,
    /// Maximum resolution: cells along the longest side of the scene box or image, at the finest level.
    #[arg(long, value_name = "N")]
    pub finest: Option<u16>,
    /// Storage of the tables in the file; coded: entropy-coded bytes, quantised like int8 or more coarsely.
    #[arg(long, value_enum, value_name = "STORAGE")]
    pub export: Option<TableStorage>,
}

/// Parses a number of bytes: `131072`, `128k` or `1m`.
pub fn parse_bytes(text: &str) -> Result<u64, String> {
    let (digits, unit) = match text.char_indices().last() {
        Some((at, 'k')) => (&text[..at], 1 << 10),
        Some((at, 'm')) => (&text[..at], 1 << 20),
        _ => (text, 1),
    };
    let bytes = digits.parse().ok().and_then(|count: u64| count.checked_mul(unit)).filter(|&bytes| bytes > 0);
    bytes.ok_or_else(|| "expected a number of bytes above 0, such as 131072, 128k or 1m".into())
}

/// Sets `to` to the value of the flag `from`, if the flag is given.
pub fn set<T: Clone>(to: &mut T, from: &Option<T>) {
    if let Some(value) = from {
        *to = value.clone();
    }
}

/// Returns the name of the first flag that is given, `None` if none is. `flags`: name, and whether the flag is given.
pub fn given<const N: usize>(flags: [(&'static str, bool); N]) -> Option<&'static str> {
    flags.into_iter().find(|flag| flag.1).map(|flag| flag.0)
}

impl TableSettings {
    /// Overrides the settings of `grid` by these flags. Fails if `grid` is `None` and a flag that needs a grid is
    /// given. `more`: another given flag that needs a grid, if any. `preset`: preset to name in the error.
    pub fn apply(
        &self,
        grid: Option<&mut TableConfig>,
        more: Option<&'static str>,
        preset: &impl ValueEnum,
    ) -> anyhow::Result<()> {
        let flags = [
            ("--table", self.table.is_some()),
            ("--grid-levels", self.grid_levels.is_some()),
            ("--features", self.features.is_some()),
            ("--coarsest", self.coarsest.is_some()),
            ("--finest", self.finest.is_some()),
            ("--export", self.export.is_some()),
        ];
        let Some(grid) = grid else {
            let Some(flag) = given(flags).or(more) else { return Ok(()) };
            anyhow::bail!(
                "{flag}: the preset `{}` has no learned grid, which this is a setting of; --preset grid has",
                value_name(preset)
            );
        };
        set(&mut grid.log2_entries, &self.table);
        set(&mut grid.levels, &self.grid_levels);
        set(&mut grid.features, &self.features);
        set(&mut grid.coarsest, &self.coarsest);
        set(&mut grid.finest, &self.finest);
        set(&mut grid.storage, &self.export);
        Ok(())
    }

    pub fn chosen(&self) -> Chosen {
        Chosen {
            entries: self.table.is_some(),
            levels: self.grid_levels.is_some(),
            coarsest: self.coarsest.is_some(),
            finest: self.finest.is_some(),
            storage: self.export.is_some(),
            occupancy: false,
            steps: false,
        }
    }
}

/// Memory per feature of a grid's tables, bytes. Training takes 22: five f32 values (feature, gradient, two moments of
/// Adam, average) and an f16 copy for export. A checkpoint takes 60 more: a copy of the five values (20), and two
/// serialised copies (40).
const BYTES_PER_VALUE: u64 = 82;

pub fn check_memory(grid: &GridEncoding) -> anyhow::Result<()> {
    let values = grid.values() as u64;
    memory::check(format!("tables of {values} values"), values, BYTES_PER_VALUE, "lower --table")
}
