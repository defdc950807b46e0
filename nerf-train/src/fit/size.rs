//! Size of the exported file of a scene or 2D field, and settings that keep this file within a limit of bytes.

use crate::data::Dataset;
use crate::fit::finish::convention;
use crate::model::config::{Config, TableConfig};
use crate::model::picture_config::FieldConfig;
use crate::model::quantise::TableStorage;
use crate::train::candidate::MADE_BY;
use crate::train::field::MEASURED_ON;
use crate::train::occupancy::Occupancy;
use anyhow::bail;
use glam::Vec3;
use nerf_core::blob::{
    BlobError, Body, Content, FrontPoint, MAX_FRONT, MAX_SAMPLES, PictureFacts, Provenance, SceneFacts,
    SceneSampling, StoredOccupancy, StoredTables, Viewpoint, encoded_len,
};
use nerf_core::encoding::{GridEncoding, MAX_LOG2_ENTRIES};

/// Candidate resolutions of the occupancy grid: cells along the longest side of the scene box.
const RESOLUTIONS: [u16; 11] = [128, 112, 96, 80, 64, 56, 48, 40, 32, 24, 16];
/// Largest fraction of a file that the occupancy grid may take. A sixth allows 48 cells along a side in 128 KiB. On
/// lego, PSNR is 29.7 dB with 48 cells. With 32 cells, the learned grid has room for more levels, but PSNR is 29.2 dB.
const OCCUPANCY_SHARE: f64 = 1.0 / 6.0;
/// Number of adjacent resolutions of the occupancy grid that are compared. The resolution that leaves room for the most
/// table values is taken. Measured in 128 KiB, 15,000 steps, two seeds: 48 cells leave room for eight levels and give
/// 31.09 and 30.98 dB; 64 cells leave room for seven levels and give 30.87 and 30.95 dB.
const NEIGHBOURS: usize = 3;
/// Least binary logarithm of the number of entries of a level's table.
const LEAST_LOG2_ENTRIES: u8 = 4;
/// Largest number of levels that may be removed from a learned grid.
const FEWER_LEVELS: usize = 2;
/// Number of times that the configured number of entries may be doubled: only for entropy-coded tables, and if the file
/// has room. Measured on lego, 4,000 steps, 1 MiB: 32.66 dB with 2^17 entries, 32.40 dB with 2^16.
const MORE_LOG2_ENTRIES: u8 = 1;
/// Least numbers of bits per value of entropy-coded tables. Table settings are accepted only if the file has room for
/// the first number. The second number is used instead only if no settings are accepted with the first. With either
/// number, the quantisation steps are then made as fine as the file's limit allows.
///
/// PSNR on lego if the first number is 3.9 or 2.0, with every tenth training photograph held out:
///
/// | file, KiB | steps | 3.9 bits | 2.0 bits |
/// | ---: | ---: | ---: | ---: |
/// | 128 | 4,000 | 30.4 dB | 30.7 dB |
/// | 128 | 8,000 | 31.42 dB | 31.23 dB |
/// | 128 | 16,000 | 31.83 dB | 31.33 dB |
/// | 256 | 30,000 | 33.07 dB | 32.69 dB |
const LEAST_BITS: [f64; 2] = [3.9, 0.5];

/// Candidate resolutions of the coarsest level of a 2D field's grid, as multiples of the configured resolution. A finer
/// coarsest level can hold detail for which the fine levels have too few entries. fox.jpg in 128 KiB, 2,500 steps: 30.0
/// dB (104 KiB used) with the configured resolution alone, 30.6 dB (126 KiB) with all candidates.
const FINER_COARSEST: [f64; 7] = [1.0, 1.25, 1.5, 2.0, 2.5, 3.0, 4.0];

/// Flags for the settings that the user has set explicitly. A setting whose flag is true is not adapted.
#[derive(Clone, Copy, Debug, Default)]
pub struct Chosen {
    pub entries: bool,
    pub levels: bool,
    pub coarsest: bool,
    pub finest: bool,
    pub storage: bool,
    pub occupancy: bool,
    pub steps: bool,
}

/// Adapts the settings of the learned grid and the occupancy grid so that the exported file has at most `max_bytes`
/// bytes, whatever the run learns, even with a full Pareto front of rendering settings. `extent`: sides of the scene
/// box, world units. Returns `None` without a learned grid.
///
/// If the file of `config` is too large, f16 tables become entropy-coded, unless the user chose the format.
/// Entropy-coded tables get the largest number of values that fits, and then the finest quantisation steps that fit.
/// The number of their entries may double, with slightly finer levels; no other setting grows. Fails if even the
/// smallest file is too large.
pub fn within(
    config: &Config,
    chosen: Chosen,
    extent: Vec3,
    dataset: &Dataset,
    max_bytes: u64,
) -> anyhow::Result<Option<Config>> {
    let Some(own) = &config.network.grid else { return Ok(None) };
    let with = |table: &TableConfig, resolution: u16| {
        let mut fitted = config.clone();
        fitted.network.grid = Some(table.clone());
        fitted.occupancy.resolution = resolution;
        fitted
    };
    // Fewer entries call for coarser levels, in which fewer vertices share an entry.
    let cells = |fewer: f64| {
        let cells = |cells: u16, fixed: bool, halved_by: f64| match fixed {
            true => cells,
            false => (f64::from(cells) * (-fewer / halved_by).exp2()).round().max(1.0) as u16,
        };
        let coarsest = cells(own.coarsest, chosen.coarsest, 5.0);
        vec![[coarsest, cells(own.finest, chosen.finest, 6.0).max(coarsest)]]
    };
    let whole = most_bytes(&with(own, config.occupancy_resolution(extent)), extent, dataset)?;
    let more = if whole <= max_bytes { 0 } else { MORE_LOG2_ENTRIES };
    let (table, resolution) = most_values(
        tables(own, chosen, more, cells),
        &resolutions(config, chosen, extent, max_bytes),
        |table| table.encoding(extent),
        |table, resolution| most_bytes(&with(table, resolution), extent, dataset),
        max_bytes,
    )?;
    Ok(Some(with(&table, resolution)))
}

/// Adapts the learned grid's settings for a 2D field so that the exported file has at most `max_bytes` bytes, whatever
/// the run learns. `size`, `name`: size and name of the fitted picture. Returns `None` without a learned grid.
///
/// Chooses the number of values as [`within`] does, without doubling entries. The finest level keeps its resolution,
/// because it holds the picture's detail. Returns an error if even the smallest file is too large.
pub fn picture_within(
    config: &FieldConfig,
    chosen: Chosen,
    size: [u32; 2],
    name: &str,
    max_bytes: u64,
) -> anyhow::Result<Option<FieldConfig>> {
    let Some(own) = &config.grid else { return Ok(None) };
    let with = |table: &TableConfig| FieldConfig { grid: Some(table.clone()), ..config.clone() };
    let finer = if chosen.coarsest { &FINER_COARSEST[..1] } else { &FINER_COARSEST };
    let coarsest = |&times: &f64| (f64::from(own.coarsest) * times).min(own.finest.into()) as u16;
    let cells = |_| finer.iter().map(|times| [coarsest(times), own.finest]).collect();
    let (table, _) = most_values(
        tables(own, chosen, 0, cells),
        &[0],
        |table| table.picture_encoding(size),
        |table, _| most_picture_bytes(&with(table), size, name),
        max_bytes,
    )?;
    Ok(Some(with(&table)))
}

/// Chooses the table settings with the most values that fit into a file of `max_bytes` bytes, and the finest occupancy
/// grid that fits with them. `most_bytes`: returns the size of the largest file for given settings.
///
/// Resolutions are tried in groups of [`NEIGHBOURS`] adjacent ones, the finest group first. The first group with which
/// any table fits is used. Entropy-coded tables also get the remaining bytes, which allow finer quantisation steps.
fn most_values(
    mut tables: Vec<TableConfig>,
    resolutions: &[u16],
    encoding: impl Fn(&TableConfig) -> GridEncoding,
    most_bytes: impl Fn(&TableConfig, u16) -> Result<u64, BlobError>,
    max_bytes: u64,
) -> anyhow::Result<(TableConfig, u16)> {
    let least_bytes = |table: &TableConfig, bits| least_bytes(&encoding(table), table.storage, bits);
    // The sort is stable: tables with equally many values keep their order.
    tables.sort_by_key(|table| std::cmp::Reverse(encoding(table).values()));
    for bits in LEAST_BITS {
        for neighbours in resolutions.chunks(NEIGHBOURS) {
            for table in tables.iter().filter(|table| least_bytes(table, bits) <= max_bytes) {
                for &resolution in neighbours {
                    let table = TableConfig { most_bytes: Some(least_bytes(table, bits)), ..table.clone() };
                    let bytes = most_bytes(&table, resolution)?;
                    if bytes <= max_bytes {
                        let left = table.most_bytes.map(|least| least + max_bytes - bytes);
                        let most_bytes = left.filter(|_| table.storage == TableStorage::Coded);
                        return Ok((TableConfig { most_bytes, ..table }, resolution));
                    }
                }
            }
        }
    }
    let bits = LEAST_BITS[LEAST_BITS.len() - 1];
    let smallest = tables.iter().min_by_key(|table| least_bytes(table, bits)).zip(resolutions.last());
    let least = smallest.map(|(table, &resolution)| {
        let most = Some(least_bytes(table, bits));
        most_bytes(&TableConfig { most_bytes: most, ..table.clone() }, resolution)
    });
    let least = least.unwrap_or(Ok(u64::MAX))?;
    bail!(
        "--max-bytes: expected at least {least}, bytes of the smallest file of these settings, found {max_bytes}"
    )
}

/// Returns the least size, bytes, of a grid's table values in format `storage`; `bits`: bits per entropy-coded value.
fn least_bytes(grid: &GridEncoding, storage: TableStorage, bits: f64) -> u64 {
    let values = grid.values();
    match storage {
        TableStorage::F16 => 2 * values as u64,
        TableStorage::Int8 => values as u64,
        // 64 bytes for each level are the cost of the adaptive entropy models.
        TableStorage::Coded => (values as f64 * bits / 8.0) as u64 + 64 * grid.resolutions.len() as u64,
    }
}

/// Returns the candidate resolutions of the occupancy grid, finest first, none finer than configured. A resolution that
/// the user set is the only candidate.
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

/// Returns the candidate table settings, most entries first, then most levels, then f16. No candidate has more levels
/// than `own`, the configured table. Only entropy-coded candidates have more entries, by up to `more` doublings.
///
/// `cells(h)`: candidate resolutions `[coarsest, finest]` of the levels if the number of entries is halved `h` times. A
/// negative `h` means that the number is doubled `-h` times.
fn tables(
    own: &TableConfig,
    chosen: Chosen,
    more: u8,
    cells: impl Fn(f64) -> Vec<[u16; 2]>,
) -> Vec<TableConfig> {
    let least = if chosen.entries { own.log2_entries } else { own.log2_entries.min(LEAST_LOG2_ENTRIES) };
    let fewest = if chosen.levels { own.levels } else { own.levels.saturating_sub(FEWER_LEVELS).max(1) };
    let storages = match (chosen.storage, own.storage) {
        (false, TableStorage::F16) => vec![TableStorage::F16, TableStorage::Coded],
        (_, storage) => vec![storage],
    };
    let mut all = Vec::new();
    let most =
        if chosen.entries { own.log2_entries } else { (own.log2_entries + more).min(MAX_LOG2_ENTRIES) };
    for log2_entries in (least..=most).rev() {
        for [coarsest, finest] in cells(f64::from(own.log2_entries) - f64::from(log2_entries)) {
            for levels in (fewest..=own.levels).rev() {
                let of = |&storage: &TableStorage| TableConfig {
                    levels,
                    features: own.features,
                    log2_entries,
                    coarsest,
                    finest,
                    storage,
                    most_bytes: None,
                };
                let larger = log2_entries > own.log2_entries;
                let fits = |storage: &&TableStorage| !larger || **storage == TableStorage::Coded;
                all.extend(storages.iter().filter(fits).map(of));
            }
        }
    }
    all
}

/// Returns the largest number of cells along x, y, z that an occupancy grid of this `resolution` can have. A run builds
/// the grid at full resolution, or at half the resolution with each cell then divided into eight. Because of rounding,
/// the two ways can give different numbers of cells.
fn most_sides(extent: Vec3, resolution: u16) -> [u16; 3] {
    let [whole, half] =
        [resolution, resolution.div_ceil(2)].map(|resolution| Occupancy::sides(extent, resolution));
    std::array::from_fn(|axis| whole[axis].max(2 * half[axis]))
}

/// Returns an upper bound on the size of a run's exported file, bytes. It assumes as many stored render settings (the
/// Pareto front) as possible, and the longest encoding of every number. `extent`: sides of the scene box, world units.
pub fn most_bytes(config: &Config, extent: Vec3, dataset: &Dataset) -> Result<u64, BlobError> {
    let resolution = most_sides(extent, config.occupancy_resolution(extent));
    let bits = vec![0; StoredOccupancy::bytes(resolution)];
    let (samples, longest) = (config.sampling.samples, extent.max_element());
    let (across, power) = (f32::from(config.sampling.steps_across), config.sampling.contraction);
    let content = Content::Scene(SceneFacts {
        min: [0.0; 3],
        // The box of an unbounded scene is a cube. Its sides are exactly equal here; corners far from the origin would
        // be rounded.
        max: if power.is_some() { [longest; 3] } else { extent.into() },
        near: 0.0,
        far: 1.0,
        sampling: match (&config.network.grid, power) {
            (Some(_), Some(power)) => SceneSampling::Contracted { step: 2.0 / across, power },
            (Some(_), None) => SceneSampling::March(longest / across),
            (None, _) => SceneSampling::Bins(samples),
        },
        background: [0.0; 3],
        occupancy_required: true,
        viewpoint: Some(Viewpoint { eye: [1.0; 3], target: [0.0; 3], up: Vec3::X.into(), arc: 0.0 }),
    });
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
    let convention = convention(dataset.val.len(), u32::MAX, [1.0; 3], config);
    let provenance = Provenance {
        psnr_convention: &convention,
        quantisation_loss_db: Some(0.0),
        ..provenance(&dataset.name, config.seed)
    };
    let body = Body {
        architecture: config.model_of(extent).architecture,
        content,
        occupancy: Some(StoredOccupancy { resolution, bits: &bits }),
        front: (0..MAX_FRONT).map(point).collect(),
        proposal: None,
        provenance,
        weights: &[],
        tables: None,
    };
    length(body, config.network.grid.as_ref())
}

/// Returns the size of the largest file that a fit of a 2D field can export, bytes. `size`: width and height of the
/// picture, pixels. `name`: name of the picture.
pub fn most_picture_bytes(config: &FieldConfig, size: [u32; 2], name: &str) -> Result<u64, BlobError> {
    let [width, height] = size;
    let body = Body {
        architecture: config.model(size).architecture,
        content: Content::Picture(PictureFacts { width, height }),
        occupancy: None,
        front: [].into_iter().collect(),
        proposal: None,
        provenance: Provenance { psnr_convention: MEASURED_ON, ..provenance(name, config.seed) },
        weights: &[],
        tables: None,
    };
    length(body, config.grid.as_ref())
}

/// Returns the provenance of the largest file: every number is present and takes the most bytes.
fn provenance(data: &str, seed: u64) -> Provenance<'_> {
    Provenance {
        data,
        made_by: MADE_BY,
        steps: u32::MAX,
        seed,
        psnr_db: Some(0.0),
        trained_parameters: u32::MAX,
        ..Provenance::NONE
    }
}

/// Returns the size of a file, bytes: of `body` without weights, of the weights, and of the tables of a learned grid
/// with the settings `table`. Entropy-coded tables are counted with their largest size.
fn length(body: Body<'_>, table: Option<&TableConfig>) -> Result<u64, BlobError> {
    let weights = vec![0; 2 * body.architecture.parameters()];
    let grid = body.architecture.position.grid().cloned();
    let body = Body { weights: &weights, ..body };
    let (Some(grid), Some(table)) = (grid, table) else { return Ok(encoded_len(&body)? as u64) };
    let values = grid.values();
    let scales = 1f32.to_le_bytes().repeat(grid.resolutions.len());
    let of = |tables| -> Result<u64, BlobError> {
        Ok(encoded_len(&Body { tables: Some(tables), ..body.clone() })? as u64)
    };
    match table.storage {
        TableStorage::F16 => of(StoredTables::F16(&vec![0; 2 * values])),
        TableStorage::Int8 => of(StoredTables::Int8 { scales: &scales, bytes: &vec![0; values] }),
        TableStorage::Coded => {
            let int8 = of(StoredTables::Int8 { scales: &scales, bytes: &vec![0; values] })?;
            // Each symbol takes at most 15 bits, whatever the values; a longer length field at most two bytes more.
            let most = table.most_bytes.unwrap_or(4 * values as u64 + 4);
            Ok(int8 - values as u64 + 2 + most)
        }
    }
}
