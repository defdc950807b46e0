//! The network in its training form. Export folds some of its layers together.

use nerf_core::encoding::GridEncoding;
use nerf_core::network::{Architecture, ArchitectureError, Role};
use nerf_core::sampling::{Purpose, uniform_u32};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;

/// An [`Architecture`] with the parts that exist only in training.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Model {
    pub architecture: Architecture,
    /// Whether there is a linear layer, as wide as the trunk, between trunk and first colour layer.
    pub feature: bool,
    /// Factor on raw density, `sigma = activation(density_scale · raw)`: sets the speed at which density learns.
    pub density_scale: f32,
    /// Initial value added to `density_scale · raw`: the density head's bias gets `density_bias / density_scale`.
    pub density_bias: f32,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    Trunk(u8),
    /// Density head: from the trunk's output to raw density.
    Density,
    /// Linear layer before the colour branch; export merges it with the layer after it.
    Feature,
    /// Hidden layer of the colour branch; the number is its index in the branch.
    Colour(u8),
    /// Output layer: three colour channels, sigmoid.
    Rgb,
}

/// One dense layer: `y = W [main, extra] + b`. Its parameters are `W`, row-major `[outputs][main + extra]`, then `b`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Dense {
    pub part: Part,
    pub main: usize,
    /// Number of extra inputs: an encoded position or direction, which follows the main inputs.
    pub extra: usize,
    pub outputs: usize,
    /// Index of `W[0][0]` in the model's parameters.
    pub weights: usize,
    /// Index of `b[0]` in the model's parameters.
    pub bias: usize,
}

impl Dense {
    /// Returns the number of inputs, `main + extra`: the length of a row of `W`.
    pub fn inputs(&self) -> usize {
        self.main + self.extra
    }

    pub fn parameters(&self) -> usize {
        (self.inputs() + 1) * self.outputs
    }
}

#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ModelError {
    #[error("{0}")]
    Architecture(ArchitectureError),
    #[error("expected sinusoidal encodings")]
    NotSinusoidal,
    #[error("{field}: expected a finite number (a scale above 0), found {found}")]
    Density { field: &'static str, found: f32 },
}

impl Model {
    /// Returns a model that is trained and exported in the same form: no feature layer, density scale 1.
    pub fn plain(architecture: Architecture) -> Self {
        Self { architecture, feature: false, density_scale: 1.0, density_bias: 0.0 }
    }

    /// Checks the architecture, and that `density_scale` is finite and above 0 and `density_bias` finite.
    pub fn check(&self) -> Result<(), ModelError> {
        self.architecture.check().map_err(ModelError::Architecture)?;
        let scale = self.density_scale;
        if !(scale.is_finite() && scale > 0.0) {
            return Err(ModelError::Density { field: "density_scale", found: scale });
        }
        let bias = self.density_bias;
        if !(bias / scale).is_finite() {
            return Err(ModelError::Density { field: "density_bias", found: bias });
        }
        Ok(())
    }

    /// Returns the layers in the order of their parameters: trunk, density, feature, colour, rgb.
    pub fn layers(&self) -> Vec<Dense> {
        let mut layers = Vec::new();
        let mut offset = 0;
        let mut push = |part, main: usize, extra: usize, outputs: usize| {
            let bias = offset + (main + extra) * outputs;
            layers.push(Dense { part, main, extra, outputs, weights: offset, bias });
            offset = bias + outputs;
        };
        let mut feature = self.feature;
        for layer in &self.architecture.layers() {
            let part = match layer.role {
                Role::Trunk(index) => Part::Trunk(index),
                Role::Density => Part::Density,
                Role::Colour(index) => Part::Colour(index),
                Role::Rgb => Part::Rgb,
            };
            if feature && matches!(part, Part::Colour(_) | Part::Rgb) {
                push(Part::Feature, layer.main, 0, layer.main);
                feature = false;
            }
            push(part, layer.main, layer.extra, layer.outputs);
        }
        layers
    }

    /// Returns the number of parameters: layer parameters plus values of the grid's tables.
    pub fn parameters(&self) -> usize {
        self.layer_parameters() + self.table_values()
    }

    pub fn layer_parameters(&self) -> usize {
        self.layers().iter().map(Dense::parameters).sum()
    }

    /// Returns the number of values of the grid's tables; 0 for a sinusoidal encoding.
    pub fn table_values(&self) -> usize {
        self.architecture.position.grid().map_or(0, GridEncoding::values)
    }

    /// Returns initial parameters; a seed gives the same values on every machine. Weights and biases are U(±1/√fan_in),
    /// as in PyTorch's `nn.Linear`. To the density's bias, `density_bias / density_scale` is added.
    ///
    /// With a grid, tables are U(±1e-4). Weights before a ReLU are U(±√(6 / fan_in)); all other weights are U(±√(6 /
    /// (fan_in + 16))). The density's bias is `density_bias`; all other biases are 0. Without a trunk, raw density
    /// begins as the sum of the levels' first features and the bias.
    pub fn initial_parameters(&self, seed: u64) -> Vec<f32> {
        if self.architecture.position.grid().is_some() {
            return self.initial_grid_parameters(seed);
        }
        let mut parameters = vec![0.0; self.parameters()];
        for layer in self.layers() {
            let root = (layer.inputs() as f64).sqrt();
            for index in layer.weights..layer.weights + layer.parameters() {
                parameters[index] = ((2.0 * uniform(seed, 2 * index as u64) - 1.0) / root) as f32;
            }
            if layer.part == Part::Density {
                parameters[layer.bias] += self.density_bias / self.density_scale;
            }
        }
        parameters
    }

    fn initial_grid_parameters(&self, seed: u64) -> Vec<f32> {
        const TABLE: f64 = 1e-4;
        let features = self.architecture.position.grid().map_or(1, |grid| usize::from(grid.features));
        let mut parameters = vec![0.0; self.layer_parameters()];
        for layer in self.layers() {
            let fan = match layer.part {
                Part::Density | Part::Feature | Part::Rgb => layer.inputs() + 16,
                Part::Trunk(_) | Part::Colour(_) => layer.inputs(),
            };
            let reach = (6.0 / fan as f64).sqrt();
            for (i, weight) in parameters[layer.weights..layer.bias].iter_mut().enumerate() {
                let index = (layer.weights + i) as u64;
                *weight = (reach * (2.0 * uniform(seed, 2 * index) - 1.0)) as f32;
            }
            if layer.part == Part::Density {
                parameters[layer.bias] = self.density_bias;
                if self.architecture.trunk.is_empty() {
                    let weights = parameters[layer.weights..layer.bias].chunks_exact_mut(features);
                    weights.for_each(|level| {
                        level.fill(0.0);
                        level[0] = 1.0;
                    });
                }
            }
        }
        let first = parameters.len() as u64;
        let value = |index: u64| (TABLE * (2.0 * uniform(seed, 2 * (first + index)) - 1.0)) as f32;
        parameters.extend((0..self.table_values() as u64).map(value));
        parameters
    }

    /// Returns the exported network's parameters in the order of [`Model::architecture`], then the tables' values.
    /// The feature layer is multiplied into the layer after it (in f64), and `density_scale` into the density head.
    /// Panics if the length of `parameters` is not [`Model::parameters`].
    pub fn fold<'p>(&self, parameters: Cow<'p, [f32]>) -> Cow<'p, [f32]> {
        assert_eq!(parameters.len(), self.parameters(), "parameters of another model");
        if !self.feature && self.density_scale == 1.0 {
            return parameters;
        }
        let mut folded = Vec::with_capacity(self.architecture.parameters());
        let mut feature = None;
        for layer in self.layers() {
            let values = &parameters[layer.weights..][..layer.parameters()];
            match (layer.part, feature.take()) {
                (Part::Feature, _) => feature = Some((layer, values)),
                (Part::Density, _) => folded.extend(values.iter().map(|v| v * self.density_scale)),
                (_, Some((inner, inner_values))) => {
                    fold_into(&mut folded, &layer, values, &inner, inner_values);
                }
                (_, None) => folded.extend_from_slice(values),
            }
        }
        folded.extend_from_slice(&parameters[self.layer_parameters()..]);
        folded.into()
    }
}

/// Appends the parameters of one layer that replaces `inner` (weights `F`, bias `f`) followed by `outer` (`W`, `b`).
/// For main inputs `h` and extra inputs `e`: `W [F h + f, e] + b = [W_main F, W_extra] [h, e] + (W_main f + b)`.
fn fold_into(out: &mut Vec<f32>, outer: &Dense, values: &[f32], inner: &Dense, inner_values: &[f32]) {
    let (weights, bias) = values.split_at(outer.inputs() * outer.outputs);
    let (inner_weights, inner_bias) = inner_values.split_at(inner.inputs() * inner.outputs);
    let dot = |row: &[f32], column: &mut dyn Iterator<Item = &f32>| -> f64 {
        row.iter().zip(column).map(|(&a, &b)| f64::from(a) * f64::from(b)).sum()
    };
    for row in weights.chunks_exact(outer.inputs()) {
        let (main, extra) = row.split_at(outer.main);
        for column in 0..inner.inputs() {
            let mut column = inner_weights[column..].iter().step_by(inner.inputs());
            out.push(dot(main, &mut column) as f32);
        }
        out.extend_from_slice(extra);
    }
    for (row, &bias) in weights.chunks_exact(outer.inputs()).zip(bias) {
        out.push((dot(&row[..outer.main], &mut inner_bias.iter()) + f64::from(bias)) as f32);
    }
}

/// Returns the pseudorandom number of `seed` and `counter`, uniformly distributed in [0, 1).
pub(super) fn uniform(seed: u64, counter: u64) -> f64 {
    f64::from(uniform_u32(seed, Purpose::Parameters, 0, counter)) / 4_294_967_296.0
}
