//! How large the file of a run gets, and settings with which it is no larger than a wish.

use crate::config::{Config, TableConfig};
use crate::dataset::Dataset;
use crate::occupancy::Occupancy;
use crate::quantise::TableStorage;
use crate::train::candidate::MADE_BY;
use crate::train::finish::convention;
use glam::Vec3;
use nerf_core::blob::{
    BlobError, Body, Content, FrontPoint, MAX_FRONT, MAX_SAMPLES, Provenance, SceneFacts, SceneSampling,
    StoredOccupancy, StoredTables, encoded_len,
};

/// What the occupancy grid's resolution is chosen from, cells along the longest side of the scene box.
const RESOLUTIONS: [u16; 11] = [128, 112, 96, 80, 64, 56, 48, 40, 32, 24, 16];
/// Share of a file that the occupancy grid may take. On lego, 128 KiB: 29.2 dB with 32 cells, 29.7 with 48 and fewer
/// levels of the grid.
const OCCUPANCY_SHARE: f64 = 1.0 / 6.0;
/// Least binary logarithm of the entries of a level.
const LEAST_LOG2_ENTRIES: u8 = 4;
/// Levels that a grid may have fewer than its settings say.
const FEWER_LEVELS: usize = 2;

/// Settings that somebody has chosen, and that stay as they are.
#[derive(Clone, Copy, Debug, Default)]
pub struct Chosen {
    /// The most entries of a level.
    pub entries: bool,
    /// The levels.
    pub levels: bool,
    /// Cells of the coarsest level.
    pub coarsest: bool,
    /// Cells of the finest level.
    pub finest: bool,
    /// What values are stored in.
    pub storage: bool,
    /// The occupancy grid's resolution.
    pub occupancy: bool,
}

/// Why no settings fit.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SizeError {
    /// Even the smallest file is larger.
    #[error(
        "--max-bytes: expected at least {least}, bytes of the smallest file of these settings, found {found}"
    )]
    TooSmall {
        /// Bytes of the smallest file.
        least: u64,
        /// The wish.
        found: u64,
    },
    /// Settings that make no file.
    #[error("{0}")]
    Blob(#[from] BlobError),
}

/// `config` with the settings of a grid, over a box of this extent, whose file is no larger than `max_bytes` whatever
/// the run does and with room for a front; `None` without a grid.
///
/// Nothing is larger than `config` says. As many values as fit: in f16 if that makes none fewer, else in int8, which
/// loses some hundredths of a decibel where half the entries lose half of one.
///
/// # Errors
/// [`SizeError`] if even the smallest file is larger.
pub fn within(
    config: &Config,
    chosen: Chosen,
    extent: Vec3,
    dataset: &Dataset,
    max_bytes: u64,
) -> Result<Option<Config>, SizeError> {
    let Some(own) = &config.network.grid else { return Ok(None) };
    let bytes_of = |table: &TableConfig| table.encoding(extent).values() * table.storage.bytes_per_value();
    let with = |table: &TableConfig, resolution: u16| {
        let mut fitted = config.clone();
        fitted.network.grid = Some(table.clone());
        fitted.occupancy.resolution = resolution;
        fitted
    };
    let mut tables = tables(own, chosen);
    // Stable: of as many values, those that come first.
    tables.sort_by_key(|table| std::cmp::Reverse(table.encoding(extent).values()));
    let resolutions = resolutions(config, chosen, extent, max_bytes);
    for &resolution in &resolutions {
        for table in tables.iter().filter(|table| bytes_of(table) as u64 <= max_bytes) {
            let fitted = with(table, resolution);
            if most_bytes(&fitted, extent, dataset)? <= max_bytes {
                return Ok(Some(fitted));
            }
        }
    }
    let smallest = tables.iter().min_by_key(|table| bytes_of(table)).zip(resolutions.last());
    let least = smallest.map(|(table, &resolution)| most_bytes(&with(table, resolution), extent, dataset));
    Err(SizeError::TooSmall { least: least.unwrap_or(Ok(u64::MAX))?, found: max_bytes })
}

/// Resolutions of the occupancy grid to choose from, finest first: none finer than what `config` says.
fn resolutions(config: &Config, chosen: Chosen, extent: Vec3, max_bytes: u64) -> Vec<u16> {
    let own = config.occupancy_resolution(extent);
    let share = (max_bytes as f64 * OCCUPANCY_SHARE) as usize;
    let coarsest = RESOLUTIONS[RESOLUTIONS.len() - 1];
    let fits = |&resolution: &u16| {
        resolution == coarsest || StoredOccupancy::bytes(most_sides(extent, resolution)) <= share
    };
    match chosen.occupancy {
        true => vec![own],
        false => RESOLUTIONS
            .into_iter()
            .filter(|&resolution| resolution <= own.max(coarsest))
            .filter(fits)
            .collect(),
    }
}

/// Tables to choose from, none larger than `own`; f16 comes before int8, and many levels before few.
fn tables(own: &TableConfig, chosen: Chosen) -> Vec<TableConfig> {
    let least = if chosen.entries { own.log2_entries } else { own.log2_entries.min(LEAST_LOG2_ENTRIES) };
    let fewest = if chosen.levels { own.levels } else { own.levels.saturating_sub(FEWER_LEVELS).max(1) };
    let storages = match (chosen.storage, own.storage) {
        (false, TableStorage::F16) => vec![TableStorage::F16, TableStorage::Int8],
        (_, storage) => vec![storage],
    };
    let mut all = Vec::new();
    for log2_entries in (least..=own.log2_entries).rev() {
        // Fewer entries are worth coarser levels: fewer vertices share one.
        let fewer = f64::from(own.log2_entries - log2_entries);
        let cells = |cells: u16, fixed: bool, halved_by: f64| match fixed {
            true => cells,
            false => (f64::from(cells) * (-fewer / halved_by).exp2()).round().max(1.0) as u16,
        };
        let coarsest = cells(own.coarsest, chosen.coarsest, 5.0);
        let finest = cells(own.finest, chosen.finest, 6.0).max(coarsest);
        for levels in (fewest..=own.levels).rev() {
            let of = |&storage: &TableStorage| TableConfig {
                levels,
                features: own.features,
                log2_entries,
                coarsest,
                finest,
                storage,
            };
            all.extend(storages.iter().map(of));
        }
    }
    all
}

/// Cells of an occupancy grid along each side at most: of one that was carved at half the resolution, too.
fn most_sides(extent: Vec3, resolution: u16) -> [u16; 3] {
    let [whole, half] =
        [resolution, resolution.div_ceil(2)].map(|resolution| Occupancy::sides(extent, resolution));
    std::array::from_fn(|axis| whole[axis].max(2 * half[axis]))
}

/// Bytes of the largest file that a run over a box of this extent can end in: with a full front of settings, and
/// numbers as long as they get.
///
/// # Errors
/// [`BlobError`] on settings that make no file.
pub fn most_bytes(config: &Config, extent: Vec3, dataset: &Dataset) -> Result<u64, BlobError> {
    let architecture = config.model_of(extent).architecture;
    let (grid, table) = (architecture.position.grid(), config.network.grid.as_ref());
    let (values, levels) = grid.map_or((0, 0), |grid| (grid.values(), grid.resolutions.len()));
    let storage = table.map_or(TableStorage::F16, |table| table.storage);
    let entries = vec![0; values * storage.bytes_per_value()];
    let scales = 1f32.to_le_bytes().repeat(levels);
    let resolution = most_sides(extent, config.occupancy_resolution(extent));
    let bits = vec![0; StoredOccupancy::bytes(resolution)];
    let (samples, longest) = (config.sampling.samples, extent.max_element());
    let (across, power) = (f32::from(config.sampling.steps_across), config.sampling.contraction);
    let point = |i: usize| FrontPoint {
        samples: MAX_SAMPLES,
        transmittance_cut: 0.0,
        colour_cut: 0.0,
        occupancy: true,
        math: 0,
        proposal: false,
        loss_db: 0.0,
        cost: (MAX_FRONT - i) as f32,
    };
    let body = Body {
        content: Content::Scene(SceneFacts {
            min: [0.0; 3],
            // Of a cube that is far from the origin, its corners are rounded.
            max: if power.is_some() { [longest; 3] } else { extent.into() },
            near: 0.0,
            far: 1.0,
            sampling: match (table, power) {
                (Some(_), Some(power)) => SceneSampling::Contracted { step: 2.0 / across, power },
                (Some(_), None) => SceneSampling::March(longest / across),
                (None, _) => SceneSampling::Bins(samples),
            },
            background: [0.0; 3],
            occupancy_required: true,
        }),
        occupancy: Some(StoredOccupancy { resolution, bits: &bits }),
        front: (0..MAX_FRONT).map(point).collect(),
        proposal: None,
        provenance: Provenance {
            data: &dataset.name,
            made_by: MADE_BY,
            steps: u32::MAX,
            seed: config.seed,
            psnr_db: Some(0.0),
            psnr_convention: &convention(dataset.val.len(), u32::MAX, [1.0; 3], MAX_SAMPLES),
            quantisation_loss_db: Some(0.0),
            trained_parameters: u32::MAX,
        },
        weights: &vec![0; 2 * architecture.parameters()],
        tables: grid.map(|_| match storage {
            TableStorage::F16 => StoredTables::F16(&entries),
            TableStorage::Int8 => StoredTables::Int8 { scales: &scales, bytes: &entries },
        }),
        architecture: architecture.clone(),
    };
    Ok(encoded_len(&body)? as u64)
}
