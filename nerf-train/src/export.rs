//! From parameters to a blob.

use half::f16;
use nerf_core::blob::{self, BlobError, Body, Content, Grid, Provenance};
use nerf_core::network::{Architecture, Role};

/// What a blob is made of besides its network.
#[derive(Clone, Debug)]
pub struct Contents<'a> {
    /// The network's shape.
    pub architecture: &'a Architecture,
    /// Its parameters in export order.
    pub parameters: &'a [f32],
    /// What the network is a field of.
    pub content: Content,
    /// Resolution and bits of the skip grid.
    pub grid: Option<([u16; 3], &'a [u8])>,
    /// Where it comes from.
    pub provenance: Provenance<'a>,
}

/// A blob, and what rounding did to its weights.
#[derive(Clone, Debug)]
pub struct Exported {
    /// The file.
    pub bytes: Vec<u8>,
    /// Weights that became f16 subnormals: they keep fewer digits.
    pub subnormal_weights: usize,
}

/// Why parameters make no blob.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ExportError {
    /// A weight does not fit f16.
    #[error("layer {role:?}, parameter {index}: expected a finite number within ±65504 (f16), found {found}")]
    Weight {
        /// Layer.
        role: Role,
        /// Index among the layer's parameters, weights first.
        index: usize,
        /// The weight.
        found: f32,
    },
    /// Something else the format refuses.
    #[error("{0}")]
    Blob(BlobError),
}

/// Rounds the parameters to f16 and writes the blob.
///
/// # Errors
/// [`ExportError`] on a weight beyond f16, and on whatever the format refuses.
pub fn export(contents: &Contents<'_>) -> Result<Exported, ExportError> {
    let mut weights = Vec::with_capacity(2 * contents.parameters.len());
    let mut subnormal_weights = 0;
    for layer in &contents.architecture.layers() {
        let end = layer.bias + layer.outputs;
        for (index, &found) in contents.parameters[layer.weights..end].iter().enumerate() {
            // What lies just beyond would round to the largest; NaN compares false.
            let fits = found.abs() <= f16::MAX.to_f32();
            if !fits {
                return Err(ExportError::Weight { role: layer.role, index, found });
            }
            let rounded = f16::from_f32(found);
            subnormal_weights += usize::from(rounded.classify() == std::num::FpCategory::Subnormal);
            weights.extend(rounded.to_le_bytes());
        }
    }
    let body = Body {
        architecture: contents.architecture.clone(),
        content: contents.content.clone(),
        grid: contents.grid.map(|(resolution, bits)| Grid { resolution, bits }),
        front: Default::default(),
        proposal: None,
        provenance: contents.provenance.clone(),
        weights: &weights,
    };
    let mut bytes = vec![0; blob::encoded_len(&body).map_err(ExportError::Blob)?];
    blob::write(&body, &mut bytes).map_err(ExportError::Blob)?;
    Ok(Exported { bytes, subnormal_weights })
}
