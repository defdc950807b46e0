//! The shape of a network, and the index of each layer's parameters in the network's parameter vector.

use crate::encoding::{
    DirectionEncoding, GridEncoding, HARMONICS_BUILT, MAX_HARMONICS_DEGREE, MAX_LEVELS, PositionEncoding,
    SinusoidalEncoding,
};
#[cfg(feature = "grid")]
use crate::encoding::{MAX_GRID_RESOLUTION, MAX_GRID_VALUES, MAX_LOG2_ENTRIES};
use crate::errors::{ensure, errors};
use serde::{Deserialize, Serialize};

/// Maximum number of trunk layers.
pub const MAX_TRUNK: usize = 16;
/// Maximum number of hidden layers of the colour branch.
pub const MAX_COLOUR: usize = 4;
/// Maximum number of layers of a network: trunk, density head, hidden colour layers, colour head.
pub const MAX_LAYERS: usize = MAX_TRUNK + MAX_COLOUR + 2;
/// Maximum number of outputs of a layer.
pub const MAX_WIDTH: usize = 512;

/// One dense+ReLU layer of the trunk.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TrunkLayer {
    /// Number of outputs.
    pub width: u16,
    /// Whether the encoded position `PE(x)` is appended to the previous layer's output `h`: input `[h, PE(x)]`.
    pub skip: bool,
}

/// The activation that maps the density head's raw output to the density sigma, per world unit.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum DensityActivation {
    /// `sigma = max(0, raw)`; `raw`: output of the density head.
    Relu,
    /// `sigma = ln(1 + exp(raw − 1))`; `raw`: output of the density head.
    ShiftedSoftplus,
    /// `sigma = exp(min(raw, 20))`; `raw`: output of the density head. The limit 20 is [`EXPONENTIAL_LIMIT`]. For
    /// larger `raw` the derivative is 0.
    Exponential,
}

/// Raw density at which the [exponential](DensityActivation::Exponential) activation is clamped. The largest density is
/// therefore e^20 per world unit, which is opaque within 1e-7 world units.
pub const EXPONENTIAL_LIMIT: f32 = 20.0;

/// Frequency at which the colour branch of a network is evaluated: once per sample or once per ray.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Shading {
    /// The colour branch is evaluated for each sample that [`Quality::colour_cut`](crate::plan::Quality::colour_cut)
    /// selects. The branch takes the sample's trunk output `h`, and the resulting colours are composited.
    PerSample,
    /// The colour branch is evaluated once per ray (deferred shading). The trunk's outputs `h` of the ray's samples are
    /// composited, and the branch takes the weighted mean of `h`.
    ///
    /// ```text
    /// A = Σ w_i;  P = Σ w_i h_i / A;  colour = A · sigmoid(branch [P, PE(d)]) + T_end · background
    /// w_i, h_i: weight and trunk output of sample i;  A: opacity;  P: weighted mean of h_i;
    /// T_end: transmittance at the end of the ray;  PE(d): encoded direction
    /// ```
    ///
    /// If the position encoding is a grid, the trunk may be empty: `h` is then the encoded position itself.
    PerRay,
}

/// A network's shape, from which [`Architecture::layers`] derives all layers.
///
/// The original NeRF has a linear feature layer between trunk and colour branch. This type has none: since no
/// activation follows the feature layer, the export of a network merges the feature layer into the layer after it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Architecture {
    /// Encoding of the position: 3 inputs in a scene, 2 in a 2D field (a point of the image).
    pub position: PositionEncoding,
    /// Encoding of the viewing direction; `None` if colour does not depend on the direction.
    pub direction: Option<DirectionEncoding>,
    /// The trunk's layers, in order. The first takes the encoded position and has no skip input. The trunk may be empty
    /// only if the position encoding is a grid and the shading is [`Shading::PerRay`].
    pub trunk: heapless::Vec<TrunkLayer, MAX_TRUNK>,
    /// Activation of the density head; `None` in a 2D field, which has no density.
    pub density: Option<DensityActivation>,
    /// Widths of the colour branch's hidden dense+ReLU layers. The first layer takes `[h, PE(d)]`: the trunk's output
    /// and the encoded direction.
    pub colour: heapless::Vec<u16, MAX_COLOUR>,
    /// Frequency at which the colour branch is evaluated: once per sample or once per ray.
    pub shading: Shading,
}

/// Part of a network that a layer belongs to: trunk, density head, colour branch or colour head.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// Hidden layer of the trunk; the value is the layer's index in the trunk, from 0.
    Trunk(u8),
    /// Density head: maps the trunk's output `h` to raw_sigma, the density before its activation.
    Density,
    /// Hidden layer of the colour branch; the value is the layer's index in the branch, from 0.
    Colour(u8),
    /// Colour head: three channels, sigmoid.
    Rgb,
}

/// One dense layer, `y = W x + b`: `x` has `main + extra` values, `W` is stored row-major, `[outputs][main + extra]`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Layer {
    /// Part of the network that the layer belongs to; for a hidden layer, also the layer's index in this part.
    pub role: Role,
    /// Number of main inputs: the encoded position (first trunk layer), the trunk's output `h` (density head and first
    /// layer of the colour branch), or the outputs of the previous layer (every other layer).
    pub main: usize,
    /// Number of appended inputs: encoded position (skip layer), encoded direction (first colour layer), else 0.
    pub extra: usize,
    /// Number of outputs.
    pub outputs: usize,
    /// Index of the layer's first weight, `W[0][0]`, in the network's parameter vector.
    pub weights: usize,
    /// Index of the layer's first bias, `b[0]`, in the network's parameter vector.
    pub bias: usize,
}

impl Layer {
    /// Number of inputs: the row length of `W`.
    pub fn inputs(&self) -> usize {
        self.main + self.extra
    }

    /// Multiply-adds of one evaluation of the layer.
    pub fn macs(&self) -> usize {
        self.inputs() * self.outputs
    }
}

/// The layers of a network, in the order of their parameters: trunk, density head, hidden colour layers, colour head.
pub type Layers = heapless::Vec<Layer, MAX_LAYERS>;

impl Architecture {
    /// Checks that all fields are within their limits and consistent, and that this build supports the architecture.
    ///
    /// # Errors
    /// An [`ArchitectureError`] that names the first field that fails a check.
    pub fn check(&self) -> Result<(), ArchitectureError> {
        use ArchitectureError as E;
        let position_inputs = if self.density.is_some() { 3 } else { 2 };
        check_inputs("position", self.position.inputs(), position_inputs)?;
        match &self.position {
            PositionEncoding::Sinusoidal(encoding) => check_levels("position", encoding)?,
            PositionEncoding::Grid(grid) => {
                check_grid(grid)?;
                if let Some(layer) = self.trunk.iter().position(|layer| layer.skip) {
                    return Err(E::SkipBesideGrid { layer });
                }
            }
        }
        if let Some(direction) = &self.direction {
            match direction {
                DirectionEncoding::Sinusoidal(encoding) => {
                    check_inputs("direction", encoding.inputs, 3)?;
                    check_levels("direction", encoding)?;
                }
                DirectionEncoding::SphericalHarmonics { degree } => {
                    ensure!(HARMONICS_BUILT, E::HarmonicsNotBuilt);
                    let fits = (1..=MAX_HARMONICS_DEGREE).contains(degree);
                    ensure!(fits, E::HarmonicsDegree { found: *degree });
                }
            }
            ensure!(self.density.is_some(), E::DirectionWithoutDensity);
        }
        let per_ray = self.shading == Shading::PerRay;
        ensure!(!per_ray || self.density.is_some(), E::PerRayWithoutDensity);
        ensure!(!per_ray || PER_RAY_BUILT, E::PerRayNotBuilt);
        match self.trunk.first() {
            None if per_ray && self.position.grid().is_some() => {}
            None => return Err(E::NoTrunk),
            Some(first) if first.skip => return Err(E::SkipAtFirstLayer),
            Some(_) => {}
        }
        for (index, layer) in self.trunk.iter().enumerate() {
            check_width("trunk", index, layer.width)?;
        }
        for (index, &width) in self.colour.iter().enumerate() {
            check_width("colour", index, width)?;
        }
        Ok(())
    }

    /// Returns all layers, with the indices of their parameters. The parameter vector holds, for each layer in turn,
    /// `W` row-major and then `b`.
    ///
    /// Correct only for an architecture that passes [`Architecture::check`].
    pub fn layers(&self) -> Layers {
        let mut layers = Layers::new();
        let mut offset = 0;
        let mut push = |role, main: usize, extra: usize, outputs: usize| {
            let weights = offset;
            let bias = weights + (main + extra) * outputs;
            offset = bias + outputs;
            // Cannot overflow: MAX_LAYERS is the sum of the parts' capacities.
            let _ = layers.push(Layer { role, main, extra, outputs, weights, bias });
        };
        let encoded = self.position.outputs();
        let mut width = encoded;
        for (index, layer) in self.trunk.iter().enumerate() {
            let extra = if layer.skip { encoded } else { 0 };
            push(Role::Trunk(index as u8), width, extra, usize::from(layer.width));
            width = usize::from(layer.width);
        }
        if self.density.is_some() {
            push(Role::Density, width, 0, 1);
        }
        let mut extra = self.direction.map_or(0, |direction| direction.outputs());
        for (index, &hidden) in self.colour.iter().enumerate() {
            push(Role::Colour(index as u8), width, extra, usize::from(hidden));
            width = usize::from(hidden);
            extra = 0;
        }
        push(Role::Rgb, width, extra, 3);
        layers
    }

    /// Number of parameters: weights and biases of all layers.
    pub fn parameters(&self) -> usize {
        self.layers().last().map_or(0, |rgb| rgb.bias + rgb.outputs)
    }

    /// Number of parameters of trunk and density head, which come first in the parameter vector.
    pub fn density_parameters(&self) -> usize {
        let colour = |layer: &&Layer| matches!(layer.role, Role::Colour(_) | Role::Rgb);
        self.layers().iter().find(colour).map_or(0, |layer| layer.weights)
    }

    /// Multiply-adds of one density evaluation (trunk and density head).
    pub fn density_macs(&self) -> usize {
        density_macs(&self.layers())
    }

    /// Multiply-adds of one colour evaluation: hidden colour layers and colour head. The trunk is not counted.
    pub fn colour_macs(&self) -> usize {
        colour_macs(&self.layers())
    }

    /// Multiply-adds of one gradient of the raw density: forward and backward pass through the trunk.
    ///
    /// The density head needs no multiply-adds: the backward pass begins with a copy of the head's weights.
    pub fn gradient_macs(&self) -> usize {
        gradient_macs(&self.layers())
    }

    /// Number of table entries that one evaluation of the grid encoding reads: the corners of one cell per level. 0 for
    /// a sinusoidal encoding. [`Architecture::density_macs`] does not count the interpolation of the entries.
    pub fn table_reads(&self) -> usize {
        self.position.grid().map_or(0, |grid| grid.reads())
    }

    /// Number of values of the trunk's output `h`. If the trunk is empty, `h` is the output of the position encoding.
    pub fn h_rows(&self) -> usize {
        let empty = || if PER_RAY_BUILT { self.position.outputs() } else { 0 };
        self.trunk.last().map_or_else(empty, |layer| usize::from(layer.width))
    }

    /// Number of outputs of the widest trunk layer; 0 if the trunk is empty.
    pub fn trunk_width(&self) -> usize {
        self.trunk.iter().map(|layer| usize::from(layer.width)).max().unwrap_or(0)
    }
}

/// [`Architecture::density_macs`] of the network with these layers.
pub(super) fn density_macs(layers: &Layers) -> usize {
    macs(layers, |role| matches!(role, Role::Trunk(_) | Role::Density))
}

/// [`Architecture::colour_macs`] of the network with these layers.
pub(super) fn colour_macs(layers: &Layers) -> usize {
    macs(layers, |role| matches!(role, Role::Colour(_) | Role::Rgb))
}

/// [`Architecture::gradient_macs`] of the network with these layers.
pub(super) fn gradient_macs(layers: &Layers) -> usize {
    2 * macs(layers, |role| matches!(role, Role::Trunk(_)))
}

fn macs(layers: &Layers, of: impl Fn(Role) -> bool) -> usize {
    layers.iter().filter(|layer| of(layer.role)).map(Layer::macs).sum()
}

fn check_inputs(field: &'static str, found: u8, expected: u8) -> Result<(), ArchitectureError> {
    if found == expected { Ok(()) } else { Err(ArchitectureError::EncodingInputs { field, expected, found }) }
}

fn check_levels(field: &'static str, e: &SinusoidalEncoding) -> Result<(), ArchitectureError> {
    ensure!(
        e.levels <= MAX_LEVELS && e.outputs() > 0,
        ArchitectureError::EncodingLevels { field, found: e.levels }
    );
    Ok(())
}

fn check_width(field: &'static str, index: usize, width: u16) -> Result<(), ArchitectureError> {
    ensure!(
        (1..=MAX_WIDTH).contains(&usize::from(width)),
        ArchitectureError::Width { field, index, found: width }
    );
    Ok(())
}

#[cfg(feature = "grid")]
pub(crate) fn check_grid(grid: &GridEncoding) -> Result<(), ArchitectureError> {
    use ArchitectureError as E;
    ensure!(matches!(grid.features, 1 | 2 | 4), E::GridFeatures { found: grid.features });
    ensure!(grid.log2_entries <= MAX_LOG2_ENTRIES, E::GridEntries { found: grid.log2_entries });
    ensure!(!grid.resolutions.is_empty(), E::GridLevels);
    for (level, resolution) in grid.resolutions.iter().enumerate() {
        for (axis, &found) in resolution.iter().enumerate() {
            let inside = axis < usize::from(grid.inputs);
            let fits = if inside { (1..=MAX_GRID_RESOLUTION).contains(&found) } else { found == 0 };
            ensure!(fits, E::GridResolution { level, axis, found });
        }
    }
    let found = grid.entries_of_any() * u64::from(grid.features);
    if found > MAX_GRID_VALUES { Err(E::GridValues { found }) } else { Ok(()) }
}

/// Replaces the check of a grid encoding in builds without grids. Never called, since no grid exists.
#[cfg(not(feature = "grid"))]
fn check_grid(grid: &GridEncoding) -> Result<(), ArchitectureError> {
    match *grid {}
}

/// Whether this build supports [`Shading::PerRay`], which needs the feature `grid`.
pub(crate) const PER_RAY_BUILT: bool = cfg!(feature = "grid");

errors! {
    /// An architecture that is outside the limits of the file format, or that needs a feature this build lacks.
    #[derive(Eq)]
    ArchitectureError:
    EncodingInputs { field: &'static str, expected: u8, found: u8 } =>
        "{field} encoding: expected {expected} inputs, found {found}";
    EncodingLevels { field: &'static str, found: u8 } =>
        "{field} encoding: expected 1 to {MAX_LEVELS} levels (0 with identity), found {found}";
    GridFeatures { found: u8 } => "position grid: expected 1, 2 or 4 features an entry, found {found}";
    GridEntries { found: u8 } => "position grid: expected at most 2^24 entries a level, found 2^{found}";
    GridLevels => "position grid: expected 1 to 32 levels, found none";
    GridResolution { level: usize, axis: usize, found: u16 } =>
        "position grid level {level}: expected 1 to 16384 cells along an axis (along z none in a 2D field), \
         found {found} along axis {axis}";
    GridValues { found: u64 } =>
        "position grid: expected tables of at most 2^27 values together, found {found}";
    SkipBesideGrid { layer: usize } =>
        "trunk layer {layer}: expected no skip beside a position grid, found one";
    HarmonicsDegree { found: u8 } =>
        "direction encoding: expected spherical harmonics of degree 1 to {MAX_HARMONICS_DEGREE}, \
         found {found}";
    HarmonicsNotBuilt =>
        "direction encoding: expected a build with the feature `grid` for spherical harmonics, found one without";
    DirectionWithoutDensity => "direction encoding: expected none in a 2D field, found one";
    PerRayWithoutDensity => "shading: expected once a sample in a 2D field, found once a ray";
    PerRayNotBuilt =>
        "shading: expected a build with the feature `grid` for shading once a ray, found one without";
    NoTrunk =>
        "trunk: expected 1 to {MAX_TRUNK} layers, or none behind a position grid shaded once a ray, found none";
    SkipAtFirstLayer => "trunk layer 0: expected no skip, found one";
    Width { field: &'static str, index: usize, found: u16 } =>
        "{field} layer {index}: expected a width of 1 to {MAX_WIDTH}, found {found}";
}
