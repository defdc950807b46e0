//! Reads the original f32 weights of an imported network, to compare them with the rounded weights of its scene file.

use crate::measure::import::{AngleFactor, Order, RawDensity, Settings, Tensors, network};
use half::f16;
use nerf_core::blob::Blob;
use nerf_core::encoding::AngleScale;
use nerf_core::network::{Architecture, unpack};
use std::fmt::Display;
use std::path::Path;

/// Orders of an encoding's channels that are tried in turn. Checkpoints and imported blobs do not record the order.
const ORDERS: [Order; 5] = [Order::Level, Order::Pairs, Order::Input, Order::Halves, Order::HalvesByInput];
/// Density activations that are tried in turn. A checkpoint does not record the activation.
const DENSITIES: [RawDensity; 3] = [RawDensity::Relu, RawDensity::Softplus, RawDensity::ShiftedSoftplus];

/// Reads the f32 weights that `blob` was imported from, in the blob's order. Tries combinations of channel orders and
/// density activations: only the right combination gives exactly the blob's weights when rounded.
pub fn unrounded(file: &Path, blob: &Blob<'_>) -> anyhow::Result<Vec<f32>> {
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
                Err(error) => Err(error.context("--source")),
            };
            match found {
                Ok(parameters) => return Ok(parameters),
                // The first attempt has the usual order and activation: its error is the most useful.
                Err(error) => fault = fault.or(Some(error)),
            }
        }
    }
    Err(fault.unwrap_or_else(|| other_source("none")))
}

pub(super) fn other_source(found: impl Display) -> anyhow::Error {
    anyhow::anyhow!("--source: expected the network that the blob was rounded from, found another: {found}")
}

/// Returns `parameters` if they are exactly the blob's weights after rounding to f16, else an error.
fn same(blob: &Blob<'_>, architecture: &Architecture, parameters: Vec<f32>) -> anyhow::Result<Vec<f32>> {
    if architecture != blob.architecture() {
        return Err(other_source("layers or encodings of other sizes"));
    }
    let mut rounded = vec![0.0; parameters.len()];
    unpack(blob.weights(), &mut rounded);
    let differs = |(own, rounded): (&f32, &f32)| f16::from_f32(*own).to_f32() != *rounded;
    match parameters.iter().zip(&rounded).position(differs) {
        None => Ok(parameters),
        Some(index) => {
            let (own, rounded) = (parameters[index], rounded[index]);
            Err(other_source(format_args!("parameter {index} is {own}, and {rounded} in the blob")))
        }
    }
}
