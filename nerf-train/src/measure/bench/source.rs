//! The weights a blob was rounded from, where their file is at hand.

use crate::measure::error::StudyError;
use crate::measure::import::{AngleFactor, Order, RawDensity, Settings, Tensors, network};
use half::f16;
use nerf_core::blob::Blob;
use nerf_core::encoding::AngleScale;
use nerf_core::network::{Architecture, unpack};
use std::path::Path;

/// What neither a checkpoint nor its blob says: the order of its columns.
const ORDERS: [Order; 5] = [Order::Level, Order::Pairs, Order::Input, Order::Halves, Order::HalvesByInput];
/// And which softplus it was.
const DENSITIES: [RawDensity; 3] = [RawDensity::Relu, RawDensity::Softplus, RawDensity::ShiftedSoftplus];

/// Reads the network that `blob` was imported from, in the blob's order, before rounding.
///
/// Whatever reading of the file gives exactly the blob's weights when rounded is the right one.
///
/// # Errors
/// [`StudyError::Source`] on a file that holds no network, [`StudyError::OtherSource`] if no reading of it
/// gives the blob's weights.
pub fn unrounded(file: &Path, blob: &Blob<'_>) -> Result<Vec<f32>, StudyError> {
    let tensors = Tensors::read(file, None)?;
    let angle = match blob.architecture().position.sinusoidal().map(|encoding| encoding.scale) {
        Some(AngleScale::One) => AngleFactor::One,
        Some(AngleScale::Pi) | None => AngleFactor::Pi,
    };
    let mut fault = None;
    for order in ORDERS {
        for density in DENSITIES {
            let settings = Settings { angle_scale: angle, order, density, ..Settings::default() };
            let found = match network(&tensors, &settings) {
                Ok(imported) => same(blob, &imported.model.architecture, imported.folded()),
                Err(error) => Err(StudyError::Source(error)),
            };
            match found {
                Ok(parameters) => return Ok(parameters),
                // The first reading is the usual one: its fault says most.
                Err(error) => fault = fault.or(Some(error)),
            }
        }
    }
    Err(fault.unwrap_or_else(|| StudyError::OtherSource { found: "none".into() }))
}

/// `parameters`, if they are the blob's before rounding.
fn same(blob: &Blob<'_>, architecture: &Architecture, parameters: Vec<f32>) -> Result<Vec<f32>, StudyError> {
    if architecture != blob.architecture() {
        let found = "layers or encodings of other sizes".into();
        return Err(StudyError::OtherSource { found });
    }
    let mut rounded = vec![0.0; parameters.len()];
    unpack(blob.weights(), &mut rounded);
    let differs = |(own, rounded): (&f32, &f32)| f16::from_f32(*own).to_f32() != *rounded;
    match parameters.iter().zip(&rounded).position(differs) {
        None => Ok(parameters),
        Some(index) => {
            let (own, rounded) = (parameters[index], rounded[index]);
            let found = format!("parameter {index} is {own}, and {rounded} in the blob");
            Err(StudyError::OtherSource { found })
        }
    }
}
