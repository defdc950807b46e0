//! The reference engine of sinusoidal networks: dfdx tensors compute the loss, and dfdx's tape its gradient.

use super::batch::{Chunk, cut};
use super::graph::{DIRECTION, Graph, POSITION, encode_points};
use super::optimiser::{Optimiser, usable};
use super::tape::{
    Matrix, Rows, Scalar, TAPE_SAMPLES, Taped, Vector, Weights, alpha, over, squared_error, with_tape,
};
use super::{
    Adam, Batch, BatchRay, Engine, EngineError, Model, OptimiserState, SIGMA_LIMIT, StepLoss, check_step,
};
use dfdx::prelude::*;
use nerf_core::encoding::SinusoidalEncoding;
use nerf_core::network::{DensityActivation, EXPONENTIAL_LIMIT};
use nerf_core::simd::{BLOCK, Isa};
use std::borrow::Cow;
use std::ops::Range;

/// Engine that trains sinusoidal networks by dfdx's tape: `--engine dfdx`; oracle in tests of [`super::FusedEngine`].
pub struct ReferenceEngine {
    graph: Graph,
    device: Cpu,
    optimiser: Optimiser,
}

impl ReferenceEngine {
    pub fn new(model: &Model, adam: Adam, seed: u64) -> Result<Self, EngineError> {
        model.check()?;
        Self::with_parameters(model, adam, &model.initial_parameters(seed))
    }

    /// Creates an engine that starts from `parameters`, in the order of [`Model::layers`]. Parameters of an exported
    /// network need a `model` made by [`Model::plain`].
    pub fn with_parameters(model: &Model, adam: Adam, parameters: &[f32]) -> Result<Self, EngineError> {
        let graph = Graph::new(model)?;
        let optimiser = Optimiser::new(&model.layers(), adam, parameters)?;
        Ok(Self { graph, device: Cpu::default(), optimiser })
    }

    /// Returns sigma, 1/world unit (empty for a 2D field), and colour at `positions`, seen along `dirs`.
    pub fn forward(
        &self,
        positions: &[[f32; 3]],
        dirs: &[[f32; 3]],
    ) -> Result<(Vec<f32>, Vec<[f32; 3]>), EngineError> {
        let (expected, found) = (positions.len(), dirs.len());
        if expected != found {
            return Err(EngineError::Parameters { field: "dirs", expected, found });
        }
        if positions.is_empty() {
            return Ok(Default::default());
        }
        let weights = self.weights()?;
        let h = self.trunk::<NoneTape>(&weights, self.encode(POSITION, positions)?)?;
        let sigma = self.density(&weights, &h)?.map_or(Vec::new(), |sigma| sigma.as_vec());
        let rgb = self.colour(&weights, &h, dirs)?.as_vec();
        Ok((sigma, rgb.chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect()))
    }

    fn weights(&self) -> Result<Vec<Weights>, EngineError> {
        let values = self.optimiser.values();
        self.graph.nodes.iter().map(|node| Weights::of(&self.device, &node.dense, &values)).collect()
    }

    /// Encodes positions (`slot` is `POSITION`) or directions; returns `[points][channels]`.
    fn encode(&self, slot: usize, points: &[[f32; 3]]) -> Result<Matrix, EngineError> {
        let architecture = &self.graph.model.architecture;
        let position = *architecture.position.sinusoidal().expect("checked by the graph");
        let no_encoding = SinusoidalEncoding { levels: 0, identity: false, ..position };
        let encoding = match slot {
            POSITION => position,
            _ => architecture.direction.and_then(|d| d.sinusoidal().copied()).unwrap_or(no_encoding),
        };
        let channels = encoding.outputs();
        let mut block = vec![0.0; channels * BLOCK];
        let mut values = Vec::with_capacity(points.len() * channels);
        for points in points.chunks(BLOCK) {
            encode_points(Isa::Portable, &encoding, points.iter(), &mut block);
            for lane in 0..points.len() {
                values.extend(block.iter().skip(lane).step_by(BLOCK));
            }
        }
        Ok(self.device.try_tensor_from_vec(values, (points.len(), channels))?)
    }

    fn dense<T: Tape<f32, Cpu>>(
        &self,
        layer: usize,
        weights: &[Weights],
        main: Matrix<T>,
        extra: Option<&Matrix>,
    ) -> Result<Matrix<T>, EngineError> {
        let y = weights[layer].apply(main, extra)?;
        Ok(if self.graph.nodes[layer].relu { y.try_relu()? } else { y })
    }

    fn trunk<T: Tape<f32, Cpu>>(&self, weights: &[Weights], px: Matrix) -> Result<Matrix<T>, EngineError> {
        let mut h = px.retaped::<T>();
        for layer in self.graph.trunk.clone() {
            h = self.dense(layer, weights, h, Some(&px))?;
        }
        Ok(h)
    }

    /// Returns sigma of each point from the trunk's output `h`, recorded on a new tape; `None` in a 2D field.
    fn density<T: Tape<f32, Cpu>>(
        &self,
        weights: &[Weights],
        h: &Matrix<T>,
    ) -> Result<Option<Vector<T>>, EngineError> {
        let model = &self.graph.model;
        let (Some(layer), Some(activation)) = (self.graph.density, model.architecture.density) else {
            return Ok(None);
        };
        let raw = self.dense(layer, weights, h.with_empty_tape(), None)?;
        let points = raw.shape().0;
        let raw = raw.try_reshape_like(&(points,))?.try_mul(model.density_scale)?;
        let sigma = match activation {
            DensityActivation::Relu => raw.try_relu()?,
            DensityActivation::Exponential => raw.try_clamp(f32::MIN, EXPONENTIAL_LIMIT)?.try_exp()?,
            DensityActivation::ShiftedSoftplus => {
                // ln(1 + e^y) = max(0, y) + ln(1 + e^−|y|)
                let y = raw.try_sub(1.0)?;
                let tail = y.with_empty_tape().try_abs()?.try_negate()?.try_exp()?;
                y.try_relu()?.try_add(tail.try_add(1.0)?.try_ln()?)?
            }
        };
        Ok(Some(sigma.try_clamp(0.0, SIGMA_LIMIT)?))
    }

    /// Returns the colour of each point, `[points][3]`, from the trunk's output `h`, recorded on a new tape.
    fn colour<T: Tape<f32, Cpu>>(
        &self,
        weights: &[Weights],
        h: &Matrix<T>,
        dirs: &[[f32; 3]],
    ) -> Result<Matrix<T>, EngineError> {
        let pd = self.encode(DIRECTION, dirs)?;
        let mut h = h.with_empty_tape();
        for layer in self.graph.colour.clone() {
            h = self.dense(layer, weights, h, Some(&pd))?;
        }
        Ok(h.try_sigmoid()?)
    }

    /// Returns the contribution of `rays` to the batch's mean squared error, and whether any sigma is above 0.
    /// `samples`: range of the rays' samples in the batch.
    fn render(
        &self,
        weights: &[Weights],
        batch: &Batch,
        rays: &[BatchRay],
        samples: Range<usize>,
    ) -> Result<(Scalar, bool), EngineError> {
        let matrix = |of: fn(&BatchRay) -> [f32; 3]| {
            self.device.try_tensor_from_vec(rays.iter().flat_map(of).collect(), (rays.len(), 3))
        };
        let counts: Vec<usize> = rays.iter().map(|ray| ray.samples as usize).collect();
        let rows = Rows::new(&self.device, &counts)?;
        let dirs: Vec<_> =
            rays.iter().flat_map(|ray| std::iter::repeat_n(ray.dir, ray.samples as usize)).collect();
        let h = self.trunk::<Taped>(weights, self.encode(POSITION, &batch.positions[samples.clone()])?)?;
        let colour = self.colour(weights, &h, &dirs)?;
        let (tau, alive) = match self.density(weights, &h)? {
            Some(sigma) => {
                let alive = sigma.as_vec().iter().any(|&sigma| sigma != 0.0);
                let deltas = rows.constants(|i| batch.deltas[samples.start + i])?;
                (rows.of(sigma)?.try_mul(deltas)?, alive)
            }
            // In a 2D field, a sample hides all that is behind it.
            None => (rows.constants(|_| 1e3)?.retaped::<Taped>(), true),
        };
        let (front, left) = rows.transmittance(tau.with_empty_tape())?;
        let shown = rows.sums(front.try_mul(alpha(tau)?)?, colour)?;
        let seen = over(shown, left, matrix(|ray| ray.background)?)?;
        let scale = 1.0 / (3 * batch.rays.len()) as f32;
        let error = squared_error(seen, matrix(|ray| ray.rgb)?, scale)?;
        // The tape of `h` holds the trunk, which density and colour share.
        Ok((with_tape(error, h.split_tape().1), alive))
    }

    /// Returns the contribution of `points` to the mean of ln(1 + sigma) over [`Batch::empty`]; `None` in a 2D field.
    fn thin(
        &self,
        weights: &[Weights],
        batch: &Batch,
        points: &[[f32; 3]],
    ) -> Result<Option<Scalar>, EngineError> {
        let h = self.trunk::<Taped>(weights, self.encode(POSITION, points)?)?;
        let Some(sigma) = self.density(weights, &h)? else { return Ok(None) };
        let sum = sigma.try_add(1.0)?.try_ln()?.try_sum::<Rank0, Axis<0>>()?;
        Ok(Some(with_tape(sum.try_mul(1.0 / batch.empty.len() as f32)?, h.split_tape().1)))
    }

    /// Returns the loss of a valid batch ([`Batch::check`]) and its gradient by parameter. Fails if training diverged.
    fn differentiate(&self, batch: &Batch) -> Result<(StepLoss, Vec<f32>), EngineError> {
        let weights = self.weights()?;
        let (mut chunks, mut gradients) = (Vec::new(), vec![0.0; self.optimiser.values().len()]);
        let count = batch.positions.len();
        let mut loss = StepLoss { evaluated: count, kept: count, dead: count > 0, ..StepLoss::default() };
        cut(batch, TAPE_SAMPLES, &mut chunks);
        for chunk in chunks {
            let term = match chunk {
                Chunk::Rays { rays, samples } if samples.is_empty() => {
                    loss.mse += unseen(&batch.rays[rays]) / (3 * batch.rays.len()) as f64;
                    continue;
                }
                Chunk::Rays { rays, samples } => {
                    let (error, alive) = self.render(&weights, batch, &batch.rays[rays], samples)?;
                    loss.mse += f64::from(error.array());
                    loss.dead &= !alive;
                    error
                }
                Chunk::Empty(points) => {
                    let Some(term) = self.thin(&weights, batch, &batch.empty[points])? else { continue };
                    loss.empty += f64::from(term.array());
                    term.try_mul(batch.empty_weight)?
                }
            };
            let mut found = term.try_backward()?;
            for (weights, node) in weights.iter().zip(&self.graph.nodes) {
                weights.collect(&node.dense, &mut found, &mut gradients)?;
            }
        }
        if !(loss.mse.is_finite() && loss.empty.is_finite() && usable(&gradients)) {
            return Err(EngineError::Diverged { step: self.optimiser.next_step() });
        }
        Ok((loss, gradients))
    }

    /// Returns the loss of a batch and its gradient with respect to each parameter, without a step.
    #[cfg(test)]
    pub(super) fn gradients(&mut self, batch: &Batch) -> Result<(StepLoss, Vec<f32>), EngineError> {
        batch.check()?;
        self.differentiate(batch)
    }
}

impl Engine for ReferenceEngine {
    fn step(&mut self, batch: &Batch, rate: f64) -> Result<StepLoss, EngineError> {
        check_step(batch, rate)?;
        let (loss, gradients) = self.differentiate(batch)?;
        for (parameter, node) in self.optimiser.parameters_mut().iter_mut().zip(&self.graph.nodes) {
            let d = &node.dense;
            parameter.gradient_mut()?.copy_from_slice(&gradients[d.weights..][..d.parameters()]);
        }
        self.optimiser.apply(rate)?;
        Ok(loss)
    }

    fn parameters(&self) -> Cow<'_, [f32]> {
        Cow::Owned(self.optimiser.values())
    }

    fn state(&self) -> OptimiserState {
        self.optimiser.state()
    }

    fn restore(&mut self, state: &OptimiserState) -> Result<(), EngineError> {
        self.optimiser.restore(state)
    }
}

/// Returns the sum of the squared errors of rays without samples, whose colour is their background.
pub(super) fn unseen(rays: &[BatchRay]) -> f64 {
    let channels = rays.iter().flat_map(|ray| ray.background.iter().zip(&ray.rgb));
    channels.map(|(seen, target)| f64::from(seen - target).powi(2)).sum()
}
