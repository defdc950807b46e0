//! Export of trained parameters as a blob, which is the file that the renderer reads.

use crate::model::coded::without_unread;
use crate::model::config::TableConfig;
use crate::model::quantise::{Quantised, Rounding, TableStorage};
use half::f16;
use nerf_core::blob::{self, BlobError, Body, Content, Proposal, Provenance, StoredOccupancy, StoredTables};
use nerf_core::network::{Architecture, DensityActivation, Layer, Role};
use std::borrow::Cow;

/// Input of [`export`]: network, tables, kind of content, occupancy grid and provenance.
#[derive(Clone, Debug)]
pub struct Contents<'a> {
    pub architecture: &'a Architecture,
    pub parameters: &'a [f32],
    pub tables: Tables<'a>,
    pub content: Content,
    /// Occupancy grid: number of cells along x, y, z, and one bit per cell, ordered as in [`StoredOccupancy::bits`].
    pub occupancy: Option<([u16; 3], &'a [u8])>,
    pub provenance: Provenance<'a>,
}

#[derive(Clone, Copy, Debug)]
pub enum Tables<'a> {
    None,
    Values {
        values: &'a [f32],
        rounding: Rounding,
        /// Quantisation step of each level, if known; else empty.
        scales: &'a [f32],
    },
    Stored(StoredTables<'a>),
}

impl<'a> Tables<'a> {
    /// Returns [`Tables::Values`] with the trained `values` of `grid`; [`Tables::None`] without a grid. `scales`:
    /// quantisation step of each level; empty if not known.
    pub fn of(grid: Option<&TableConfig>, values: &'a [f32], scales: &'a [f32]) -> Self {
        grid.map_or(Self::None, |grid| Self::Values { values, rounding: grid.rounding(), scales })
    }
}

/// Coarse network of a scene, exported as its proposal network.
#[derive(Clone, Copy, Debug)]
pub struct Coarse<'a> {
    /// Architecture; its trunk and density head are exported, its colour branch is not.
    pub architecture: &'a Architecture,
    pub parameters: &'a [f32],
    pub samples: u16,
}

/// Exported file, and the number of weights that lost precision.
#[derive(Clone, Debug)]
pub struct Exported {
    pub bytes: Vec<u8>,
    /// Number of weights that became f16 subnormals, which have fewer significant digits.
    pub subnormal_weights: usize,
}

#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ExportError {
    #[error("layer {role:?}, parameter {index}: expected a finite number within ±65504 (f16), found {found}")]
    Weight { role: Role, index: usize, found: f32 },
    #[error("grid: value {index} of its tables: expected a finite number within ±65504 (f16), found {found}")]
    Table { index: usize, found: f32 },
    #[error(
        "coarse network: layer {role:?}, parameter {index}: expected a finite number within ±65504 (f16), found \
         {found}"
    )]
    CoarseWeight { role: Role, index: usize, found: f32 },
    #[error("{0}")]
    Blob(BlobError),
}

/// Rounds the parameters to f16 and the tables to their storage, and returns the bytes of the exported file. Fails for
/// a weight or table value beyond f16's range, and for contents that the format refuses.
pub fn export(contents: &Contents<'_>) -> Result<Exported, ExportError> {
    export_with(contents, None)
}

/// Does [`export`], with a coarse network as the scene's proposal network.
pub fn export_with(contents: &Contents<'_>, coarse: Option<&Coarse<'_>>) -> Result<Exported, ExportError> {
    let layers = contents.architecture.layers();
    let mut rounded = Rounded::default();
    let beyond = |(role, index, found)| ExportError::Weight { role, index, found };
    rounded.round(&layers, contents.parameters).map_err(beyond)?;
    let mut coarse_rounded = Rounded::default();
    if let Some(Coarse { architecture, parameters, .. }) = coarse {
        let layers = architecture.layers();
        let heads = layers.iter().position(|layer| matches!(layer.role, Role::Colour(_) | Role::Rgb));
        coarse_rounded
            .round(&layers[..heads.unwrap_or(layers.len())], parameters)
            .map_err(|(role, index, found)| ExportError::CoarseWeight { role, index, found })?;
    }
    let proposal = coarse.map(|coarse| Proposal {
        position: *coarse.architecture.position.sinusoidal().expect("coarse networks are imported"),
        trunk: coarse.architecture.trunk.clone(),
        density: coarse.architecture.density.unwrap_or(DensityActivation::Relu),
        samples: coarse.samples,
        weights: &coarse_rounded.weights,
    });
    let quantised = match (contents.architecture.position.grid(), contents.tables) {
        (Some(grid), Tables::Values { values, rounding, scales }) => {
            let values = match contents.occupancy {
                // Entries that no sample reads become 0, which takes few bytes.
                Some((resolution, bits)) if rounding.storage == TableStorage::Coded => {
                    Cow::Owned(without_unread(grid, values, resolution, bits))
                }
                _ => Cow::Borrowed(values),
            };
            let quantised = Quantised::new(grid, &values, rounding, scales);
            Some(quantised.map_err(|(index, found)| ExportError::Table { index, found })?)
        }
        _ => None,
    };
    let body = Body {
        architecture: contents.architecture.clone(),
        content: contents.content.clone(),
        occupancy: contents.occupancy.map(|(resolution, bits)| StoredOccupancy { resolution, bits }),
        front: Default::default(),
        proposal,
        provenance: contents.provenance.clone(),
        weights: &rounded.weights,
        tables: match contents.tables {
            Tables::Stored(tables) => Some(tables),
            _ => quantised.as_ref().map(Quantised::stored),
        },
    };
    let mut bytes = vec![0; blob::encoded_len(&body).map_err(ExportError::Blob)?];
    blob::write(&body, &mut bytes).map_err(ExportError::Blob)?;
    Ok(Exported { bytes, subnormal_weights: rounded.subnormal + coarse_rounded.subnormal })
}

#[derive(Default)]
struct Rounded {
    weights: Vec<u8>,
    subnormal: usize,
}

impl Rounded {
    /// Appends the layers' parameters as f16. The error names layer, index and value of the first parameter beyond f16.
    fn round(&mut self, layers: &[Layer], parameters: &[f32]) -> Result<(), (Role, usize, f32)> {
        self.weights.reserve(2 * parameters.len());
        for layer in layers {
            let values = &parameters[layer.weights..layer.bias + layer.outputs];
            for (index, &found) in values.iter().enumerate() {
                // A value just beyond f16's range would be rounded to f16's largest. The comparison is false for NaN.
                let fits = found.abs() <= f16::MAX.to_f32();
                if !fits {
                    return Err((layer.role, index, found));
                }
                let rounded = f16::from_f32(found);
                self.subnormal += usize::from(rounded.classify() == std::num::FpCategory::Subnormal);
                self.weights.extend(rounded.to_le_bytes());
            }
        }
        Ok(())
    }
}
