//! Optimises a network on batches of rays; the only module that uses dfdx.
//!
//! `Batch` → encode → network → volume rendering → loss → gradients → Adam → parameters
//!
//! [`ReferenceEngine`] and, for grids, [`GridReferenceEngine`] differentiate by dfdx's tape: slow, simple oracles.
//! [`FusedEngine`] and [`GridEngine`] have explicit backward passes on `nerf_core::matrix::gemm`. All engines minimise
//!
//! `loss = mean over rays and channels of (C − rgb)² + empty_weight · mean over empty points of ln(1 + sigma)`
//!
//! `C = Σ_i w_i c_i + T_end · background`, `w_i = T_i · alpha_i`, `alpha_i = −expm1(−sigma_i · delta_i)`,
//! `T_i = exp(−Σ_{j<i} sigma_j · delta_j)`. Empty points lie in empty cells. With a grid, the loss has no term for
//! empty points, but may have the distortion loss, the smoothness loss and the depth loss of a [`Surface`].
//!
//! # One step, by the tape
//!
//! The example trains a small field in dfdx. The engines add viewing directions, occupancy grids and checkpoints.
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

pub use batch::{Batch, BatchError, BatchRay, LINE, RayGradient, RayQuestion, Surface};
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

/// Upper limit of sigma, per world unit, in training without a grid: opaque at any scene scale, finite in all products.
pub const SIGMA_LIMIT: f32 = 1e6;

/// Absolute value of a gradient at which training has diverged: the gradient's square, which Adam uses, could overflow.
const GRADIENT_LIMIT: f32 = 1e18;

/// Engine that computes the gradients of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum EngineKind {
    /// Explicit backward passes: fast, and bit-identical for any number of threads.
    #[default]
    Fused,
    /// Automatic differentiation and Adam of the crate dfdx: slow, but simple enough to be the reference.
    Dfdx,
}

/// Creates an engine of this kind that trains `model`. `bounds`: the box that the model's grid spans, if it has one.
/// Fails with [`EngineError::Model`] for an invalid model, with [`EngineError::NotPlain`] for a grid that the engines
/// for grids cannot train, with [`EngineError::NoDensity`] if [`EngineKind::Dfdx`] is to train a 2D field with a grid.
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

/// Engine that trains a [`Model`] on batches of rays.
pub trait Engine: Send {
    /// Runs forward pass, backward pass and one Adam step at learning rate `rate`; returns the loss before the step.
    /// Fails without a change: [`EngineError::Batch`] and [`EngineError::Rate`] for wrong input,
    /// [`EngineError::Diverged`] if the loss or a gradient is not finite.
    fn step(&mut self, batch: &Batch, rate: f64) -> Result<StepLoss, EngineError>;

    /// Does [`Engine::step`], and calls `prefetch` with the loss to prepare the next batch, unless the step fails. If
    /// the engine supports it, the call runs at the same time as the update of the parameters.
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

    /// Makes all later steps encode positions with tables that are rounded as in an int8 or coded file. The first call
    /// fixes the quantisation step of each level; further calls do nothing. No effect without a grid.
    fn round_tables(&mut self, _rounding: Rounding) {}

    /// Sets the weight decay of a grid's colour branch for all later steps. No effect without a grid.
    fn set_weight_decay(&mut self, _weight_decay: f64) {}

    /// Returns the quantisation step of each level of the rounded tables; empty while the tables are not rounded.
    fn table_scales(&self) -> &[f32] {
        &[]
    }

    /// Returns the last batch's gradient with respect to the log gain of each of `views` photographs; 0 without rays.
    fn gain_gradients(&self, views: usize) -> Vec<[f32; 3]> {
        vec![[0.0; 3]; views]
    }

    /// Computes loss and ray gradients of a batch, without a step. An engine without ray gradients returns a loss of 0.
    fn ask(&mut self, _batch: &Batch) -> Result<StepLoss, EngineError> {
        Ok(StepLoss::default())
    }

    /// Returns the gradients of the last batch's loss with respect to rays; empty if not requested or not supported.
    fn ray_gradients(&self) -> Box<dyn Iterator<Item = &RayGradient> + '_> {
        Box::new(std::iter::empty())
    }

    /// Returns index in the last batch, and rendered minus photographed colour, of each ray of a known photograph.
    fn errors(&self) -> Box<dyn Iterator<Item = &(u32, [f32; 3])> + '_> {
        Box::new(std::iter::empty())
    }

    /// Returns position and compositing weight of each sample that the last step trained; empty if not supported.
    fn weighted(&self) -> Box<dyn Iterator<Item = ([f32; 3], f32)> + '_> {
        Box::new(std::iter::empty())
    }

    /// Returns the parameters of all layers, in the order of [`Model::layers`], then the values of the grid's tables.
    fn parameters(&self) -> Cow<'_, [f32]>;

    /// Returns the time of all steps so far by phase, summed over threads; 0 if the engine does not measure it.
    fn phases(&self) -> Phases {
        Phases::default()
    }

    /// Returns the state for a checkpoint. A run resumed from it is bit-identical to a run that never stopped.
    fn state(&self) -> OptimiserState;

    /// Resumes from the state of a checkpoint. Fails without a change: with [`EngineError::Parameters`] for a model of
    /// another size, with [`EngineError::NonFinite`] if a value is not finite or has the wrong sign, with
    /// [`EngineError::Steps`] for too many steps.
    fn restore(&mut self, state: &OptimiserState) -> Result<(), EngineError>;
}

/// Constants of Adam. The learning rate is not among them: each step takes it as an argument.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Adam {
    /// Decay per step of the first and of the second moment.
    pub betas: [f64; 2],
    /// Term added to the square root of the second moment, so that no division is by 0.
    pub epsilon: f64,
    /// Decoupled weight decay: a step multiplies a weight by 1 − rate · decay. With a grid, in the colour branch only.
    pub weight_decay: f64,
    /// Number of steps per update of a hashed level, at least 1. Adam gets the sum of gradients since the last update.
    pub hashed_every: u32,
}

impl Default for Adam {
    /// Returns constants for short training on a CPU: the second moment averages few steps, and epsilon is negligible.
    fn default() -> Self {
        Self { betas: [0.9, 0.99], epsilon: 1e-15, weight_decay: 0.0, hashed_every: 1 }
    }
}

#[derive(Clone, Debug, PartialEq, Default, Serialize, Deserialize)]
pub struct OptimiserState {
    /// Parameters in the order of [`Engine::parameters`].
    pub parameters: Vec<f32>,
    /// First moments, in the order of `parameters`.
    pub moment1: Vec<f32>,
    /// Second moments, in the order of `parameters`, none negative.
    pub moment2: Vec<f32>,
    pub steps: u64,
    /// Quantisation step of each level of a grid; empty if the tables are not rounded.
    pub scales: Vec<f32>,
    /// Gradients accumulated for hashed levels since their last update; empty if every step updates all levels.
    pub waiting: Vec<f32>,
}

impl OptimiserState {
    /// Returns the state before the first step of training from `parameters`.
    fn at(parameters: Vec<f32>) -> Self {
        let zeros = vec![0.0; parameters.len()];
        Self { parameters, moment1: zeros.clone(), moment2: zeros, ..Self::default() }
    }
}

/// Loss of a batch before the update of the parameters, and the number of samples evaluated and kept.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct StepLoss {
    /// Mean over rays and channels of the squared error; 0 without rays.
    pub mse: f64,
    /// Mean of ln(1 + sigma) over the batch's `empty` points, not yet multiplied by `empty_weight`; 0 without points.
    pub empty: f64,
    /// Whether the batch has samples but none gets a gradient: all sigmas are 0 or, with a grid, all compositing
    /// weights are too small.
    pub dead: bool,
    pub evaluated: usize,
    /// Number of samples that got a colour and a backward pass.
    pub kept: usize,
}

/// Reason why an engine refused a model, a batch or a state, or why a step failed.
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
