//! The parameters of a network, in the memory format that a [`Storage`] names.

use super::architecture::{Architecture, Layer, Role, Shading};
use crate::matrix::{Storage, f16_at, pair};

/// The parameters of a network, borrowed in one of four formats.
#[derive(Clone, Copy, Debug)]
pub enum Weights<'a> {
    /// Little-endian f16, read directly from the scene file's bytes, without memory for unpacked weights.
    InPlace(&'a [u8]),
    /// f32: for each layer the weights, `[outputs][inputs]`, then the biases. For builds with vector instructions.
    Prepared(&'a [f32]),
    /// f32 as in [`Weights::Prepared`], but the weights of hidden colour layers are transposed: `[inputs][outputs]`.
    /// Used if the colour branch is evaluated once per ray ([`Shading::PerRay`]). For a single ray, each SIMD vector
    /// then holds several outputs of a layer.
    Transposed(&'a [f32]),
    /// bf16 weights and f32 biases, made by [`Weights::prepare`]. The bits of one f32 hold an output's weights for two
    /// consecutive inputs. Main and appended inputs of a layer are paired separately; an odd last weight is paired
    /// with 0. The weights and the biases of a layer begin at the same indices as in [`Weights::Prepared`]. Values
    /// between the last pair of a layer and the first bias of that layer are unused.
    Paired(&'a [f32]),
}

impl<'a> Weights<'a> {
    /// Returns the parameters of a network in the format of `storage`. If weights are read directly from the scene
    /// file's bytes, returns `bytes`. Otherwise unpacks the f16 `bytes` into `memory` and returns `memory`.
    ///
    /// `memory`: one value per parameter of the `architecture`. If colours are not evaluated, the parameters of trunk
    /// and density head suffice ([`Architecture::density_parameters`]). May be empty if `bytes` are read directly.
    ///
    /// # Panics
    /// If `bytes` or `memory` is too short.
    #[cfg(feature = "train")]
    pub fn prepare(
        architecture: &Architecture,
        storage: Storage,
        bytes: &'a [u8],
        memory: &'a mut [f32],
    ) -> Self {
        if !storage.in_place() {
            Self::unpack(architecture, storage, bytes, memory);
        }
        Self::view(architecture, storage, bytes, memory)
    }

    /// Returns a view of the parameters in the format of `storage`. If kernels of this format read the blob in place, the
    /// view borrows `bytes`. Else it borrows `unpacked`, which [`Weights::unpack`] must have filled.
    pub(crate) fn view(
        architecture: &Architecture,
        storage: Storage,
        bytes: &'a [u8],
        unpacked: &'a [f32],
    ) -> Self {
        match (storage, architecture.shading) {
            _ if storage.in_place() => Self::InPlace(bytes),
            (Storage::Bf16, _) => Self::Paired(unpacked),
            (_, Shading::PerRay) => Self::Transposed(unpacked),
            (_, Shading::PerSample) => Self::Prepared(unpacked),
        }
    }

    /// Unpacks little-endian f16 `bytes` to `memory` in the format of `storage`, which must be f32 or bf16.
    pub(crate) fn unpack(architecture: &Architecture, storage: Storage, bytes: &[u8], memory: &mut [f32]) {
        unpack(bytes, memory);
        if storage != Storage::Bf16 {
            if architecture.shading == Shading::PerRay {
                transpose_colour(architecture, bytes, memory);
            }
            return;
        }
        let parameters = memory.len();
        for layer in architecture.layers().iter().filter(|layer| layer.bias + layer.outputs <= parameters) {
            // A row of pairs is no longer than the row of f32 that it replaces, so that no value is overwritten before
            // it is read.
            let mut to = layer.weights;
            for row in 0..layer.outputs {
                let row = layer.weights + row * layer.inputs();
                for part in [row..row + layer.main, row + layer.main..row + layer.inputs()] {
                    for from in part.clone().step_by(2) {
                        let odd = if from + 1 < part.end { memory[from + 1] } else { 0.0 };
                        memory[to] = pair(memory[from], odd);
                        to += 1;
                    }
                }
            }
        }
    }
}

/// Writes to `memory` the transposed weight matrix of each hidden colour layer, read from the f16 `bytes`. A layer's
/// weights begin at the same index in `memory` as in the network's parameter vector.
fn transpose_colour(architecture: &Architecture, bytes: &[u8], memory: &mut [f32]) {
    let parameters = memory.len();
    let hidden =
        |layer: &&Layer| matches!(layer.role, Role::Colour(_)) && layer.bias + layer.outputs <= parameters;
    for layer in architecture.layers().iter().filter(hidden) {
        for (output, input) in (0..layer.outputs).flat_map(|o| (0..layer.inputs()).map(move |i| (o, i))) {
            let weight = f16_at(bytes, layer.weights + output * layer.inputs() + input);
            memory[layer.weights + input * layer.outputs + output] = weight;
        }
    }
}

/// Unpacks little-endian f16 from `bytes` to fill `parameters`; `bytes` must hold at least two bytes per parameter.
pub fn unpack(bytes: &[u8], parameters: &mut [f32]) {
    for (i, parameter) in parameters.iter_mut().enumerate() {
        *parameter = f16_at(bytes, i);
    }
}
