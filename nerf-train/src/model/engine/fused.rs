//! The fast engine of sinusoidal networks: explicit forward and backward passes on the matrix product kernel.
//!
//! The result of a step is bit-identical for any number of threads: chunk `i` of the batch goes to accumulator
//! `i mod 16`, each accumulator adds its chunks in order, and the accumulators are summed in order.

use super::accumulate::reduce;
use super::batch::{Chunk, SAMPLES, cut};
use super::graph::Graph;
use super::optimiser::{Optimiser, usable};
use super::pass::{ChunkLoss, Job, Pass};
use super::{Adam, Batch, Engine, EngineError, Model, OptimiserState, StepLoss, check_step};
use nerf_core::simd::Isa;
use rayon::prelude::*;
use std::borrow::Cow;

/// Number of accumulators, and largest number of threads that a step uses.
const ACCUMULATORS: usize = 16;

/// Engine that trains a network with sinusoidal encodings by explicit forward and backward passes.
/// Memory: five values per parameter and, for each accumulator, one gradient and the activations of one chunk.
pub struct FusedEngine {
    graph: Graph,
    isa: Isa,
    optimiser: Optimiser,
    /// Contiguous copy of the optimiser's parameters.
    parameters: Vec<f32>,
    chunks: Vec<Chunk>,
    passes: Vec<Pass>,
}

impl FusedEngine {
    pub fn new(model: &Model, adam: Adam, seed: u64) -> Result<Self, EngineError> {
        model.check()?;
        Self::with_parameters(model, adam, &model.initial_parameters(seed))
    }

    /// Creates an engine that starts from `parameters`, in the order of [`Model::layers`].
    pub fn with_parameters(model: &Model, adam: Adam, parameters: &[f32]) -> Result<Self, EngineError> {
        let graph = Graph::new(model)?;
        let optimiser = Optimiser::new(&model.layers(), adam, parameters)?;
        let passes = (0..ACCUMULATORS).map(|_| Pass::new(&graph)).collect();
        let parameters = parameters.to_vec();
        Ok(Self { graph, isa: Isa::detect(), optimiser, parameters, chunks: Vec::new(), passes })
    }

    /// Sets the instruction set; [`Isa::detect`] is the default.
    pub fn set_isa(&mut self, isa: Isa) {
        self.isa = isa;
    }

    pub fn model(&self) -> &Model {
        &self.graph.model
    }

    /// Returns the loss of a valid batch ([`Batch::check`]); sets the optimiser's gradient. Fails if training diverged.
    fn differentiate(&mut self, batch: &Batch) -> Result<StepLoss, EngineError> {
        let Self { graph, isa, optimiser, parameters, chunks, passes } = self;
        cut(batch, SAMPLES, chunks);
        let job = Job { graph, isa: *isa, parameters };
        passes.par_iter_mut().with_max_len(1).enumerate().for_each(|(i, pass)| {
            pass.clear();
            chunks.iter().skip(i).step_by(ACCUMULATORS).for_each(|chunk| pass.run(job, batch, chunk));
        });
        let sum = passes.iter().fold(ChunkLoss::default(), |sum, pass| ChunkLoss {
            squared: sum.squared + pass.loss.squared,
            empty: sum.empty + pass.loss.empty,
            alive: sum.alive | pass.loss.alive,
        });
        let diverged = EngineError::Diverged { step: optimiser.next_step() };
        if !(sum.squared.is_finite() && sum.empty.is_finite()) {
            return Err(diverged);
        }
        let layers = optimiser.parameters_mut().par_iter_mut().zip(&graph.nodes).enumerate();
        layers.with_max_len(1).try_for_each(|(l, (parameter, node))| {
            let gradient = parameter.gradient_mut()?;
            reduce(node, passes.iter().map(|pass| &pass.sums[l]), gradient);
            if usable(gradient) { Ok(()) } else { Err(diverged) }
        })?;
        let mean = |sum: f64, count: usize| if count == 0 { 0.0 } else { sum / count as f64 };
        Ok(StepLoss {
            mse: mean(sum.squared, 3 * batch.rays.len()),
            empty: mean(sum.empty, batch.empty.len()),
            dead: !batch.positions.is_empty() && !sum.alive,
            evaluated: batch.positions.len(),
            kept: batch.positions.len(),
        })
    }

    /// Returns the loss of a batch and its gradient with respect to each parameter, without a step.
    #[cfg(test)]
    pub(super) fn gradients(&mut self, batch: &Batch) -> Result<(StepLoss, Vec<f32>), EngineError> {
        batch.check()?;
        let loss = self.differentiate(batch)?;
        let mut gradients = Vec::new();
        for parameter in self.optimiser.parameters_mut() {
            gradients.extend_from_slice(parameter.gradient_mut()?);
        }
        Ok((loss, gradients))
    }
}

impl Engine for FusedEngine {
    fn step(&mut self, batch: &Batch, rate: f64) -> Result<StepLoss, EngineError> {
        check_step(batch, rate)?;
        let loss = self.differentiate(batch)?;
        self.optimiser.apply(rate)?;
        self.optimiser.copy_into(&mut self.parameters);
        Ok(loss)
    }

    fn parameters(&self) -> Cow<'_, [f32]> {
        Cow::Borrowed(&self.parameters)
    }

    fn state(&self) -> OptimiserState {
        self.optimiser.state()
    }

    fn restore(&mut self, state: &OptimiserState) -> Result<(), EngineError> {
        self.optimiser.restore(state)?;
        self.optimiser.copy_into(&mut self.parameters);
        Ok(())
    }
}
