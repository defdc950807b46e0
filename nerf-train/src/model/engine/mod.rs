//! Optimises a network on batches of rays; the only module that uses dfdx.
//!
//! `Batch` → encode → network → volume rendering → loss → gradients → Adam → parameters
//!
//! [`ReferenceEngine`] and, for grids, [`GridReferenceEngine`] leave the derivatives to dfdx's tape: slow and
//! obvious, they are the oracles (`fit --engine dfdx`). [`FusedEngine`] and [`GridEngine`] compute them with explicit
//! backward passes on `nerf_core::matrix::gemm`. [`FusedEngine`] takes parameters, gradients and Adam from dfdx. All
//! use the same [`Batch`] and minimise
//!
//! `loss = mean over rays and channels of (C − rgb)² + empty_weight · mean over empty of ln(1 + sigma)`
//!
//! `C = Σ_i w_i c_i + T_end · background`, `w_i = T_i · alpha_i`, `alpha_i = −expm1(−sigma_i · delta_i)`,
//! `T_i = exp(−Σ_{j<i} sigma_j · delta_j)`; with a grid without the term of empty points.
//!
//! # One step, by the tape
//!
//! A complete step in dfdx: rays, positional encoding, network, volume rendering, loss, Adam. The engines add what a
//! scene needs: views, directions, empty space that is skipped, and checkpoints.
//!
//! ```
//! use dfdx::optim::{Adam, AdamConfig};
//! use dfdx::prelude::*;
//! use std::f32::consts::PI;
//!
//! const RAYS: usize = 64;
//! const SAMPLES: usize = 24;
//! // x, y, z, and sine and cosine of each at four frequencies.
//! const CHANNELS: usize = 27;
//! // Two hidden layers, then a density and three channels of colour.
//! type Heads = SplitInto<(Linear<64, 1>, Linear<64, 3>)>;
//! type Field = ((Linear<CHANNELS, 64>, ReLU), (Linear<64, 64>, ReLU), Heads);
//!
//! let cpu = Cpu::seed_from_u64(0);
//! let mut field = cpu.build_module::<Field, f32>();
//! let mut adam = Adam::new(&field, AdamConfig { lr: 5e-3, ..AdamConfig::default() });
//! let delta = 2.0 / SAMPLES as f32;
//! let mut losses = Vec::new();
//! for _ in 0..100 {
//!     // Rays along x, y or z through the cube from -1 to 1, at (u, v) from its centre, where a red ball is.
//!     let (mut encoded, mut seen) = (Vec::new(), Vec::new());
//!     let places: Tensor<Rank2<RAYS, 2>, f32, _> = cpu.sample_uniform();
//!     for (ray, at) in places.as_vec().chunks(2).enumerate() {
//!         let [u, v] = [2.0 * at[0] - 1.0, 2.0 * at[1] - 1.0];
//!         seen.extend(if u * u + v * v < 0.4 { [0.9, 0.2, 0.1] } else { [0.0; 3] });
//!         for i in 0..SAMPLES {
//!             let mut x = [(i as f32 + 0.5) * delta - 1.0, u, v];
//!             x.rotate_right(ray % 3);
//!             // Positional encoding: x, sin(2^l pi x), cos(2^l pi x).
//!             encoded.extend(x);
//!             for angle in (0..4).flat_map(|l| x.map(|x| 2f32.powi(l) * PI * x)) {
//!                 encoded.extend([angle.sin(), angle.cos()]);
//!             }
//!         }
//!     }
//!     // The network, on a tape that remembers how to differentiate it.
//!     let encoded = cpu.tensor_from_vec(encoded, (Const::<{ RAYS * SAMPLES }>, Const::<CHANNELS>));
//!     let (raw, colour) = field.forward(encoded.leaky_trace());
//!     let tau = raw.exp().reshape::<Rank2<RAYS, SAMPLES>>() * delta;
//!     let colour = colour.sigmoid().reshape::<Rank3<RAYS, SAMPLES, 3>>();
//!     // Volume rendering: T_i = exp(-sum of tau_j in front), weight_i = T_i (1 - exp(-tau_i)).
//!     let in_front = cpu.upper_tri::<Rank2<SAMPLES, SAMPLES>>(1.0, 1);
//!     let transmittance = tau.with_empty_tape().matmul(in_front).negate().exp();
//!     let weights = transmittance * (tau.negate().exp().negate() + 1.0);
//!     let shown = (weights.broadcast::<_, Axis<2>>() * colour).sum::<Rank2<RAYS, 3>, _>();
//!     // Loss, backward along the tape, Adam.
//!     let loss = mse_loss(shown, cpu.tensor_from_vec(seen, (Const::<RAYS>, Const::<3>)));
//!     losses.push(loss.array());
//!     adam.update(&mut field, &loss.backward()).expect("each parameter has a gradient");
//! }
//! assert!(losses[90..].iter().sum::<f32>() < losses[0], "ten losses are less than the first one");
//! ```

mod accumulate;
mod batch;
mod fused;
mod graph;
mod grid;
mod model;
mod optimiser;
mod pass;
mod phases;
mod reference;
mod tape;
mod volume_grad;

#[cfg(test)]
mod tests;

pub use batch::{Batch, BatchError, BatchRay, RayGradient, RayQuestion, Surface};
pub use fused::FusedEngine;
pub use grid::{GridEngine, GridReferenceEngine};
pub use model::{Dense, Model, ModelError, Part};
pub use phases::{Phase, Phases};
pub use reference::ReferenceEngine;

use crate::model::quantise::Rounding;
use nerf_core::simd::Isa;
use nerf_core::space::SceneBox;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;

/// Largest sigma in training, per world unit: an opaque wall at any scale, and no overflow behind it.
pub const SIGMA_LIMIT: f32 = 1e6;

/// Size from which a gradient counts as divergence: its square, which Adam keeps, would overflow.
const GRADIENT_LIMIT: f32 = 1e18;

/// Engine that computes the gradients of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum EngineKind {
    /// Explicit backward passes: fast, and the same bits for any number of threads.
    #[default]
    Fused,
    /// dfdx's tape and dfdx's Adam, from loss to update: slow, but a reference that can be read.
    Dfdx,
}

/// Creates an engine of this kind that trains `model`; `bounds`: the box that its grid spans, if it has one.
///
/// # Errors
/// [`EngineError::Model`] and [`EngineError::NotPlain`] if the model is out of bounds, [`EngineError::NoDensity`] for
/// the grid of a 2D field by [`EngineKind::Dfdx`].
pub fn engine_for(
    kind: EngineKind,
    model: &Model,
    bounds: SceneBox,
    adam: Adam,
    seed: u64,
    isa: Isa,
) -> Result<Box<dyn Engine>, EngineError> {
    Ok(match (kind, model.architecture.position.grid()) {
        (EngineKind::Fused, Some(_)) => {
            let mut engine = GridEngine::new(model, bounds, adam, seed)?;
            engine.set_isa(isa);
            Box::new(engine)
        }
        (EngineKind::Fused, None) => {
            let mut engine = FusedEngine::new(model, adam, seed)?;
            engine.set_isa(isa);
            Box::new(engine)
        }
        (EngineKind::Dfdx, Some(_)) => Box::new(GridReferenceEngine::new(model, bounds, adam, seed)?),
        (EngineKind::Dfdx, None) => Box::new(ReferenceEngine::new(model, adam, seed)?),
    })
}

/// Trains a [`Model`] on batches.
pub trait Engine: Send {
    /// Runs forward pass, backward pass and one Adam step at learning rate `rate`; returns the loss before the step.
    ///
    /// # Errors
    /// [`EngineError::Batch`] and [`EngineError::Rate`] for wrong input, [`EngineError::Diverged`]
    /// if the loss or a gradient is not finite. Parameters, moments and step count are then as
    /// before the call.
    fn step(&mut self, batch: &Batch, rate: f64) -> Result<StepLoss, EngineError>;

    /// Does [`Engine::step`], and calls `prefetch` once the loss is known: in parallel with the rest of the step, if
    /// the engine can.
    ///
    /// # Errors
    /// The errors of [`Engine::step`]; `prefetch` is then not called.
    fn step_with_prefetch(
        &mut self,
        batch: &Batch,
        rate: f64,
        prefetch: &mut (dyn FnMut(&StepLoss) + Send),
    ) -> Result<StepLoss, EngineError> {
        let loss = self.step(batch, rate)?;
        prefetch(&loss);
        Ok(loss)
    }

    /// From now on encodes with a grid's tables rounded as in an int8 or coded file; the first call fixes the step
    /// size of each level. No effect without a grid.
    fn round_tables(&mut self, _rounding: Rounding) {}

    /// From now on decays the weights of a grid's colour branch by `weight_decay`. No effect without a grid.
    fn set_weight_decay(&mut self, _weight_decay: f64) {}

    /// Step size of each level of the rounded tables; empty while nothing is rounded.
    fn table_scales(&self) -> &[f32] {
        &[]
    }

    /// Gradient of the last step's loss with respect to the log gain of each of `views` photographs; 0 without gains.
    fn gain_gradients(&self, views: usize) -> Vec<[f32; 3]> {
        vec![[0.0; 3]; views]
    }

    /// Computes the loss of a batch and, if requested, its gradients with respect to the rays; the parameters do not
    /// change. An engine without ray gradients returns a loss of 0.
    fn ask(&mut self, _batch: &Batch) -> Result<StepLoss, EngineError> {
        Ok(StepLoss::default())
    }

    /// Gradients of the last batch's loss with respect to its rays; none if not requested, or if the engine has none.
    fn ray_gradients(&self) -> Box<dyn Iterator<Item = &RayGradient> + '_> {
        Box::new(std::iter::empty())
    }

    /// Index and colour error, shown minus photographed, of each ray of the last batch whose photograph is known; none
    /// if the engine does not report them.
    fn errors(&self) -> Box<dyn Iterator<Item = &(u32, [f32; 3])> + '_> {
        Box::new(std::iter::empty())
    }

    /// Position and weight of the samples that the last step trained; none if the engine does not report them.
    fn weighted(&self) -> Box<dyn Iterator<Item = ([f32; 3], f32)> + '_> {
        Box::new(std::iter::empty())
    }

    /// Parameters in the [`Model`]'s order.
    fn parameters(&self) -> Cow<'_, [f32]>;

    /// Time of all steps by phase; 0 if the engine does not measure it.
    fn phases(&self) -> Phases {
        Phases::default()
    }

    /// State for a checkpoint: a run resumed from it gives the same bits as one that never stopped.
    fn state(&self) -> OptimiserState;

    /// Resumes from the state of a checkpoint.
    ///
    /// # Errors
    /// [`EngineError::Parameters`] if the state is of a model of another size, [`EngineError::NonFinite`] if a value of
    /// the state is not finite; the engine is then unchanged.
    fn restore(&mut self, state: &OptimiserState) -> Result<(), EngineError>;
}

/// Adam's constants; each step is given its learning rate.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Adam {
    /// Decay of the first and the second moment.
    pub betas: [f64; 2],
    /// Added to the square root of the second moment.
    pub epsilon: f64,
    /// Decoupled weight decay: each step multiplies a weight by 1 − learning rate · decay. With a grid, only weights
    /// of the colour branch decay.
    pub weight_decay: f64,
    /// Steps between two updates of a hashed level of a grid, each by the sum of the gradients meanwhile; at least 1.
    pub hashed_every: u32,
}

impl Default for Adam {
    /// The constants that fitted best on a CPU budget: a short second moment and a negligible epsilon.
    fn default() -> Self {
        Self { betas: [0.9, 0.99], epsilon: 1e-15, weight_decay: 0.0, hashed_every: 1 }
    }
}

#[derive(Clone, Debug, PartialEq, Default, Serialize, Deserialize)]
pub struct OptimiserState {
    /// Parameters in the [`Model`]'s order.
    pub parameters: Vec<f32>,
    /// First moments, in the order of `parameters`.
    pub moment1: Vec<f32>,
    /// Second moments, in the order of `parameters`, none negative.
    pub moment2: Vec<f32>,
    pub steps: u64,
    /// Step size of each level of a grid whose tables are rounded; else empty.
    pub scales: Vec<f32>,
    /// Gradients of a grid's hashed levels, accumulated since each level's last update; empty if every step updates
    /// all levels.
    pub waiting: Vec<f32>,
}

impl OptimiserState {
    /// State before the first step.
    fn at(parameters: Vec<f32>) -> Self {
        let zeros = vec![0.0; parameters.len()];
        Self { parameters, moment1: zeros.clone(), moment2: zeros, ..Self::default() }
    }
}

/// Loss of a batch before its step.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct StepLoss {
    /// Mean over rays and channels of the squared error; 0 without rays.
    pub mse: f64,
    /// Mean of ln(1 + sigma) over the batch's `empty` points, not yet weighted; 0 without points.
    pub empty: f64,
    /// Whether the rays have samples and every sample's sigma is 0: no gradient reaches the network.
    pub dead: bool,
    pub evaluated: usize,
    /// Number of samples with a colour and a backward pass.
    pub kept: usize,
}

/// Why a step or a restore did not happen.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum EngineError {
    #[error("model: {0}")]
    Model(#[from] ModelError),
    #[error("model: expected a position encoded by a grid, found a sinusoidal encoding")]
    NoGrid,
    #[error("model: expected a density, found a picture: the engine dfdx trains grids of scenes alone")]
    NoDensity,
    #[error(
        "model: expected a colour a ray and an exponential density of scale 1, or none, and no feature layer beside a grid"
    )]
    NotPlain,
    #[error("batch: {0}")]
    Batch(#[from] BatchError),
    #[error("learning rate: expected a finite rate of at least 0, found {found}")]
    Rate { found: f64 },
    #[error("training diverged at step {step}: lower the learning rate or take another seed")]
    Diverged { step: u64 },
    #[error("{field}: expected {expected} values, found {found}")]
    Parameters { field: &'static str, expected: usize, found: usize },
    #[error("{field}[{index}] is not finite or has the wrong sign")]
    NonFinite { field: &'static str, index: usize },
    #[error("step count: expected at most {limit}, found {found}", limit = i32::MAX)]
    Steps { found: u64 },
    #[error("out of memory for parameters")]
    OutOfMemory,
}

fn check_step(batch: &Batch, rate: f64) -> Result<(), EngineError> {
    if !(rate.is_finite() && rate >= 0.0) {
        return Err(EngineError::Rate { found: rate });
    }
    Ok(batch.check()?)
}
