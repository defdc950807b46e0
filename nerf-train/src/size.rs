//! How large the file of a run gets, and settings with which it is no larger than a wish.

use crate::config::{Config, OCCUPANCY_RESOLUTIONS};
use crate::dataset::Dataset;
use crate::occupancy::Occupancy;
use crate::quantise::TableStorage;
use crate::train::finish::convention;
use crate::train::candidate::made_by;
use glam::Vec3;
use nerf_core::blob::{
    BlobError, Body, Content, FrontPoint, MAX_FRONT, MAX_SAMPLES, Provenance, SceneFacts, SceneSampling,
    StoredOccupancy, StoredTables, encoded_len,
};

/// What of a grid's settings may be chosen; the rest stays as it is.
#[derive(Clone, Copy, Debug)]
pub struct Choice {
    /// The most entries of a level, and the cells of the coarsest and the finest level.
    pub table: bool,
    /// What values are stored in.
    pub storage: bool,
    /// The occupancy grid's resolution.
    pub occupancy: bool,
}

/// Why no settings fit.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum SizeError {
    /// Even the smallest file is larger.
    #[error("--max-bytes: expected at least {least} bytes, the smallest file that these settings can have, found {found}")]
    TooSmall {
        /// Bytes of the smallest file.
        least: usize,
        /// The wish.
        found: usize,
    },
    /// Settings that make no file.
    #[error("{0}")]
    Blob(#[from] BlobError),
}

/// Bytes of the largest file that a run over a box of this extent can end in: with a full front of settings, and
/// numbers as long as they get.
///
/// # Errors
/// [`BlobError`] on settings that make no file.
pub fn most_bytes(config: &Config, extent: Vec3, dataset: &Dataset) -> Result<usize, BlobError> {
    let architecture = config.model_of(extent).architecture;
    let (grid, table) = (architecture.position.grid(), config.network.grid.as_ref());
    let (values, levels) = grid.map_or((0, 0), |grid| (grid.values(), grid.resolutions.len()));
    let storage = table.map_or(TableStorage::F16, |table| table.storage);
    let entries = vec![0; values * storage.bytes_per_value()];
    let scales = 1f32.to_le_bytes().repeat(levels);
    let resolution = Occupancy::most_sides(extent, config.occupancy_resolution(extent));
    let bits = vec![0; StoredOccupancy::bytes(resolution)];
    let (samples, longest) = (config.sampling.samples, extent.max_element());
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
            max: extent.into(),
            near: 0.0,
            far: 1.0,
            sampling: match table {
                Some(_) => SceneSampling::March(longest / f32::from(config.sampling.steps_across)),
                None => SceneSampling::Bins(samples),
            },
            background: [0.0; 3],
            occupancy_required: true,
        }),
        occupancy: Some(StoredOccupancy { resolution, bits: &bits }),
        front: (0..MAX_FRONT).map(point).collect(),
        proposal: None,
        provenance: Provenance {
            data: &dataset.name,
            made_by: &made_by(),
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
    encoded_len(&body)
}
