//! The engine of grid fields: small layers on rows of samples, tables whose gradient is scattered level by level.
//!
//! A step cuts its batch into chunks of rays, and adds each chunk's gradients to one of 16 accumulators. Only kept
//! samples get a colour and a backward pass: the samples whose compositing weight is above a threshold, the gate.
//! Russian roulette also keeps a random choice of the samples of smaller weight.
//!
//! ```text
//! Forward pass, 8 samples of each ray at a time; a ray ends when its transmittance is below T_MIN:
//!     encode ──► trunk ──► density ──► transmittance
//! Colour of each ray, from its kept samples:
//!     weighted mean of their features ──► colour branch ──► pixel ──► loss
//! Backward pass over the kept samples; an accumulator sums the gradients of the layers' weights:
//!     d colour ──► d trunk ──► d encoded
//! Update of the layers:
//!     Adam
//! Update of the tables, level by level; Adam only on levels that the step updates:
//!     d encoded ──► d table entries, summed in the order of the samples ──► Adam ──► f16 copies of the entries
//! ```
//!
//! A 2D field has no density: only the first sample of a ray is seen.
//!
//! As in the fused engine, the result of a step is bit-identical for any number of threads: chunk `i` of the rays is
//! added to accumulator `i mod 16`, and one thread sums a level of the tables, accumulator after accumulator.
//!
//! # Source
//! Müller et al. 2022 (instant-ngp); deviation: samples are evaluated eight per ray at a time, and only kept samples
//! are trained. This was measured to be faster on a CPU.

mod adam;
mod directions;
mod evaluate;
mod kept;
mod layers;
mod pass;
mod rays;
mod reference;
mod samples;
mod scatter;
mod shade;
mod smoothness;
mod vector;

#[cfg(test)]
mod tests;

pub use reference::GridReferenceEngine;

use super::optimiser::{check_values, usable};
use super::{
    Adam, Batch, Engine, EngineError, LINE, Model, OptimiserState, Phases, RayGradient, StepLoss, check_step,
};
use crate::model::quantise::{Rounding, scales};
use crate::system::lock;
use adam::{AdamStep, Apply, decay_weights, moves, waiting_entries};
use layers::{LayerSums, Layers};
use nerf_core::encoding::{GridEncoding, GridLevel, GridTables, TableValues};
use nerf_core::network::{DensityActivation, Shading};
use nerf_core::simd::Isa;
use nerf_core::space::SceneBox;
use pass::{Job, Pass, Scratch, Totals};
use rayon::prelude::*;
use scatter::{Halve, Kept, LevelScratch, LevelState, LevelSum};
use std::borrow::Cow;
use std::sync::{Mutex, MutexGuard};

/// Number of accumulators, and largest number of threads of the forward and backward passes.
const ACCUMULATORS: usize = 16;
/// Largest number of rays of a chunk. All activations of their samples then fit the second-level cache.
const CHUNK_RAYS: usize = 32;
/// Approximate smallest number of chunks of a batch, so that every thread has work. A small batch has fewer chunks, of
/// `FEWEST_RAYS` rays each.
const FEWEST_CHUNKS: usize = 6;
const FEWEST_RAYS: usize = 8;
/// Number of rays of a chunk of a 2D field, whose rays have one sample.
const CHUNK_PIXELS: usize = 512;

/// Engine that trains a grid field. The result of a step is bit-identical for any number of threads.
pub struct GridEngine {
    model: Model,
    grid: GridEncoding,
    bounds: SceneBox,
    isa: Isa,
    adam: Adam,
    /// Parameters, moments, step count and quantisation steps; gradients accumulated for hashed levels are in `sums`.
    state: OptimiserState,
    layers: Layers,
    passes: Vec<Pass>,
    scratch: Vec<Mutex<Scratch>>,
    /// Copy of the tables in f16, which training reads: half the memory traffic of f32, and the values of an f16 file.
    halves: Vec<u8>,
    level_scratch: Vec<Mutex<LevelScratch>>,
    /// For each level: gradient summed since the level's last update, or `None` if every step updates the level.
    sums: Vec<Option<LevelSum>>,
    gradient: Vec<f32>,
}

impl GridEngine {
    /// Creates an engine with the initial parameters of `seed`. `bounds`: box of the grid; a 2D field uses its x and y.
    /// Fails if the model is invalid or has no grid, or if the grid engines cannot train it.
    pub fn new(model: &Model, bounds: SceneBox, adam: Adam, seed: u64) -> Result<Self, EngineError> {
        let grid = check_plain(model)?;
        let parameters = model.initial_parameters(seed);
        let layers = Layers::new(model);
        let features = usize::from(grid.features);
        let sum_of = |level: GridLevel| match waiting_entries(&adam, &level) {
            0 => None,
            entries => Some(LevelSum::new(entries * features)),
        };
        let mut engine = Self {
            model: model.clone(),
            bounds,
            isa: Isa::detect(),
            adam,
            passes: (0..ACCUMULATORS).map(|_| Pass::new(&layers)).collect(),
            scratch: Vec::new(),
            halves: vec![0; 2 * (parameters.len() - layers.parameters())],
            level_scratch: Vec::new(),
            sums: grid.levels().map(sum_of).collect(),
            gradient: vec![0.0; layers.parameters()],
            state: OptimiserState::at(parameters),
            grid,
            layers,
        };
        engine.copy_tables();
        Ok(engine)
    }

    fn copy_tables(&mut self) {
        let features = usize::from(self.grid.features);
        let OptimiserState { parameters, scales, .. } = &self.state;
        let tables = &parameters[self.layers.parameters()..];
        for (i, level) in self.grid.levels().enumerate() {
            let (first, length) = (level.first * features, level.entries * features);
            let (values, scale) = (&tables[first..][..length], scales.get(i).copied());
            self.isa.run(Halve { values, scale, halves: &mut self.halves[2 * first..][..2 * length] });
        }
    }

    /// Sets the instruction set; [`Isa::detect`] is the default.
    pub fn set_isa(&mut self, isa: Isa) {
        self.isa = isa;
    }

    /// Returns the loss of a valid batch ([`Batch::check`]); sets `gradient` and `passes`. Fails if training diverged.
    fn differentiate(&mut self, batch: &Batch) -> Result<StepLoss, EngineError> {
        self.layers.load(&self.state.parameters[..self.layers.parameters()]);
        let tables = GridTables::new(TableValues::F16(&self.halves), Some(&self.bounds));
        let job = Job { isa: self.isa, model: &self.model, grid: &self.grid, tables, layers: &self.layers };
        let chunk_rays = match &self.layers.density {
            Some(_) => {
                (batch.rays.len() / FEWEST_CHUNKS).next_multiple_of(LINE).clamp(FEWEST_RAYS, CHUNK_RAYS)
            }
            None => CHUNK_PIXELS,
        };
        let mut firsts = Vec::with_capacity(batch.rays.len().div_ceil(chunk_rays) + 1);
        let mut first = 0;
        for chunk in batch.rays.chunks(chunk_rays) {
            firsts.push(first);
            first += chunk.iter().map(|ray| ray.samples as usize).sum::<usize>();
        }
        let layers = &self.layers;
        self.scratch.resize_with(rayon::current_num_threads(), || Mutex::new(Scratch::new(layers)));
        let scratch = &self.scratch;
        self.passes.par_iter_mut().with_max_len(1).enumerate().for_each(|(i, pass)| {
            let mut scratch = own(scratch);
            pass.clear();
            for (chunk, &first) in firsts.iter().enumerate().skip(i).step_by(ACCUMULATORS) {
                let rays = chunk * chunk_rays..batch.rays.len().min((chunk + 1) * chunk_rays);
                scratch.run(&job, batch, rays, first, pass);
            }
        });
        let mut totals = Totals::default();
        for Pass { totals: part, .. } in &self.passes {
            totals.squared += part.squared;
            totals.evaluated += part.evaluated;
            totals.kept += part.kept;
        }
        let diverged = EngineError::Diverged { step: self.state.steps + 1 };
        if !totals.squared.is_finite() {
            return Err(diverged);
        }
        LayerSums::reduce(&self.layers, self.passes.iter().map(|pass| &pass.sums), &mut self.gradient);
        if !(usable(&self.gradient) && Kept::usable(self.passes.iter().map(|pass| &pass.kept))) {
            return Err(diverged);
        }
        let rays = batch.rays.len();
        Ok(StepLoss {
            mse: if rays == 0 { 0.0 } else { totals.squared / (3 * rays) as f64 },
            empty: 0.0,
            dead: totals.evaluated > 0 && totals.kept == 0,
            evaluated: totals.evaluated,
            kept: totals.kept,
        })
    }
}

/// Locks and returns the entry of `scratch` that only the current thread uses.
fn own<T>(scratch: &[Mutex<T>]) -> MutexGuard<'_, T> {
    lock(&scratch[rayon::current_thread_index().unwrap_or(0) % scratch.len()])
}

/// Returns the gradient with respect to the log gain of each of `views` photographs, summed over its rays.
fn gain_sums<'g>(gains: impl IntoIterator<Item = &'g (u32, [f32; 3])>, views: usize) -> Vec<[f32; 3]> {
    let mut sums = vec![[0.0f32; 3]; views];
    for (view, gradient) in gains {
        if let Some(sum) = sums.get_mut(*view as usize) {
            sum.iter_mut().zip(gradient).for_each(|(sum, g)| *sum += g);
        }
    }
    sums
}

impl Engine for GridEngine {
    fn step(&mut self, batch: &Batch, rate: f64) -> Result<StepLoss, EngineError> {
        self.step_with_prefetch(batch, rate, &mut |_| ())
    }

    fn step_with_prefetch(
        &mut self,
        batch: &Batch,
        rate: f64,
        prefetch: &mut (dyn FnMut(&StepLoss) + Send),
    ) -> Result<StepLoss, EngineError> {
        check_step(batch, rate)?;
        let loss = self.differentiate(batch)?;
        let OptimiserState { parameters, moment1, moment2, steps, scales, .. } = &mut self.state;
        *steps += 1;
        decay_weights(&self.adam, rate, &self.model, parameters);
        let (mut parameters, mut moment1, mut moment2) =
            (&mut parameters[..], &mut moment1[..], &mut moment2[..]);
        let (mut halves, dense) = (&mut self.halves[..], self.layers.parameters());
        self.isa.run(Apply {
            step: AdamStep::new(&self.adam, rate, *steps),
            values: front(&mut parameters, dense),
            moment1: front(&mut moment1, dense),
            moment2: front(&mut moment2, dense),
            gradient: &self.gradient,
        });
        let features = usize::from(self.grid.features);
        let mut levels = Vec::new();
        for ((i, level), sum) in self.grid.levels().enumerate().zip(&mut self.sums) {
            let length = level.entries * features;
            let moves = moves(&self.adam, &level, *steps);
            levels.push(LevelState {
                level,
                values: front(&mut parameters, length),
                moment1: front(&mut moment1, length),
                moment2: front(&mut moment2, length),
                halves: front(&mut halves, 2 * length),
                scale: scales.get(i).copied(),
                sum: sum.as_mut(),
                adam: moves.map(|moves| AdamStep::new(&self.adam, rate, moves)),
            });
        }
        let (isa, grid, passes) = (self.isa, &self.grid, &self.passes);
        self.level_scratch.resize_with(rayon::current_num_threads(), || Mutex::new(LevelScratch::new(grid)));
        let scratch = &self.level_scratch;
        // `tables` provides only the box.
        let tables = GridTables::new(TableValues::F16(&[]), Some(&self.bounds));
        // In reverse order, so that the largest levels, which are the last, begin first.
        let update = || {
            levels.into_par_iter().rev().with_max_len(1).for_each(|mut level| {
                own(scratch).step(isa, grid, &tables, passes.iter().map(|pass| &pass.kept), &mut level);
            });
        };
        rayon::join(|| prefetch(&loss), update);
        Ok(loss)
    }

    fn gain_gradients(&self, views: usize) -> Vec<[f32; 3]> {
        gain_sums(self.passes.iter().flat_map(|pass| &pass.gains), views)
    }

    fn ask(&mut self, batch: &Batch) -> Result<StepLoss, EngineError> {
        batch.check()?;
        self.differentiate(batch)
    }

    fn ray_gradients(&self) -> Box<dyn Iterator<Item = &RayGradient> + '_> {
        Box::new(self.passes.iter().flat_map(|pass| &pass.rays))
    }

    fn errors(&self) -> Box<dyn Iterator<Item = &(u32, [f32; 3])> + '_> {
        Box::new(self.passes.iter().flat_map(|pass| &pass.errors))
    }

    fn weighted(&self) -> Box<dyn Iterator<Item = ([f32; 3], f32)> + '_> {
        Box::new(self.passes.iter().flat_map(|pass| {
            let Kept { positions: [x, y, z], weights, .. } = &pass.kept;
            x.iter().zip(y).zip(z).zip(weights).map(|(((&x, &y), &z), &weight)| ([x, y, z], weight))
        }))
    }

    fn set_weight_decay(&mut self, weight_decay: f64) {
        self.adam.weight_decay = weight_decay;
    }

    fn round_tables(&mut self, rounding: Rounding) {
        if self.state.scales.is_empty() {
            let tables = &self.state.parameters[self.layers.parameters()..];
            self.state.scales = scales(&self.grid, tables, rounding);
            self.copy_tables();
        }
    }

    fn table_scales(&self) -> &[f32] {
        &self.state.scales
    }

    fn parameters(&self) -> Cow<'_, [f32]> {
        Cow::Borrowed(&self.state.parameters)
    }

    fn phases(&self) -> Phases {
        let mut sum = Phases::default();
        self.scratch.iter().for_each(|scratch| sum += lock(scratch).phases);
        self.level_scratch.iter().for_each(|scratch| sum += lock(scratch).phases);
        sum
    }

    fn state(&self) -> OptimiserState {
        let features = usize::from(self.grid.features);
        let sums = self.grid.levels().zip(&self.sums);
        let waiting = sums
            .flat_map(|(level, sum)| sum.iter().flat_map(move |sum| sum.values(level.entries * features)));
        OptimiserState { waiting: waiting.copied().collect(), ..self.state.clone() }
    }

    fn restore(&mut self, state: &OptimiserState) -> Result<(), EngineError> {
        check_state(state, self.state.parameters.len(), &self.grid, &self.adam)?;
        self.state = OptimiserState { waiting: Vec::new(), ..state.clone() };
        let mut waiting = &state.waiting[..];
        let features = usize::from(self.grid.features);
        for (level, sum) in self.grid.levels().zip(&mut self.sums) {
            let Some(sum) = sum else { continue };
            let (values, rest) = waiting.split_at(level.entries * features);
            sum.restore(values);
            waiting = rest;
        }
        self.copy_tables();
        Ok(())
    }
}

/// Splits off and returns the first `length` values.
fn front<'a, T>(values: &mut &'a mut [T], length: usize) -> &'a mut [T] {
    values.split_off_mut(..length).expect("values for all layers and levels")
}

/// Returns the model's grid, or an error for a model that the grid engines cannot train.
fn check_plain(model: &Model) -> Result<GridEncoding, EngineError> {
    model.check()?;
    let grid = model.architecture.position.grid().cloned().ok_or(EngineError::NoGrid)?;
    let density = matches!(model.architecture.density, None | Some(DensityActivation::Exponential));
    let shading = model.architecture.shading == Shading::PerRay || model.architecture.density.is_none();
    if model.feature || model.density_scale != 1.0 || !density || !shading {
        return Err(EngineError::NotPlain);
    }
    Ok(grid)
}

/// Returns the number of table values whose gradient is accumulated over several steps.
fn waiting_values(grid: &GridEncoding, adam: &Adam) -> usize {
    grid.levels().map(|level| waiting_entries(adam, &level) * usize::from(grid.features)).sum()
}

/// Checks that `state` fits a model with this number of parameters and this grid, and that its values are valid.
fn check_state(
    state: &OptimiserState,
    parameters: usize,
    grid: &GridEncoding,
    adam: &Adam,
) -> Result<(), EngineError> {
    check_values("parameters", &state.parameters, parameters, |_| true)?;
    check_values("moment1", &state.moment1, parameters, |_| true)?;
    check_values("moment2", &state.moment2, parameters, |v| v >= 0.0)?;
    check_values("waiting", &state.waiting, waiting_values(grid, adam), |_| true)?;
    let levels = if state.scales.is_empty() { 0 } else { grid.resolutions.len() };
    check_values("scales", &state.scales, levels, |scale| scale > 0.0)?;
    if state.steps > i32::MAX as u64 {
        return Err(EngineError::Steps { found: state.steps });
    }
    Ok(())
}
