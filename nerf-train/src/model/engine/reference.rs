//! The reference engine: the loss written with dfdx tensors, its derivative left to dfdx's tape.

use super::encode::encode_points;
use super::graph::{DIRECTION, Graph, POSITION};
use super::optimiser::{Optimiser, usable};
use super::{
    Adam, Batch, Dense, Engine, EngineError, Model, OptimiserState, SIGMA_LIMIT, StepLoss, check_rate,
};
use dfdx::prelude::*;
use nerf_core::encoding::SinusoidalEncoding;
use nerf_core::network::{DensityActivation, EXPONENTIAL_LIMIT};
use nerf_core::simd::{BLOCK, Isa};
use std::borrow::Cow;

type Matrix<T = NoneTape> = Tensor<(usize, usize), f32, Cpu, T>;
type Vector<T = NoneTape> = Tensor<(usize,), f32, Cpu, T>;
type Taped = OwnedTape<f32, Cpu>;
type Scalar = Tensor<Rank0, f32, Cpu, Taped>;

/// The oracle: dfdx's own derivatives. Every ray is padded to the longest one, with bins of length 0.
pub struct ReferenceEngine {
    graph: Graph,
    device: Cpu,
    optimiser: Optimiser,
}

/// One layer's parameters; `[main, extra]` as two products, for want of a concatenation.
struct Weights {
    main: Matrix,
    extra: Option<Matrix>,
    bias: Vector,
}

impl ReferenceEngine {
    /// An engine on the start values of `seed`.
    ///
    /// # Errors
    /// [`EngineError::Model`] if the model is out of bounds.
    pub fn new(model: &Model, adam: Adam, seed: u64) -> Result<Self, EngineError> {
        model.check()?;
        Self::with_parameters(model, adam, &model.initial_parameters(seed))
    }

    /// An engine on given parameters, in the model's own order; an exported network's are those of
    /// [`Model::plain`].
    ///
    /// # Errors
    /// Also if they are not as many as the model's, or not finite.
    pub fn with_parameters(model: &Model, adam: Adam, parameters: &[f32]) -> Result<Self, EngineError> {
        let graph = Graph::new(model)?;
        let optimiser = Optimiser::new(&model.layers(), adam, parameters)?;
        Ok(Self { graph, device: Cpu::default(), optimiser })
    }

    /// sigma, per world unit, and colour at each position, seen along the direction of the same index.
    ///
    /// sigma is empty in a 2D field.
    ///
    /// # Errors
    /// [`EngineError::Parameters`] if there are not as many directions as positions.
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
        let weights = self.graph.nodes.iter().map(|node| {
            let d = &node.dense;
            let rows = || values[d.weights..d.bias].chunks_exact(d.inputs());
            let main = rows().flat_map(|row| &row[..d.main]).copied().collect();
            let extra = rows().flat_map(|row| &row[d.main..]).copied().collect();
            let bias = values[d.bias..][..d.outputs].to_vec();
            Ok(Weights {
                main: self.device.try_tensor_from_vec(main, (d.outputs, d.main))?,
                extra: match d.extra {
                    0 => None,
                    columns => Some(self.device.try_tensor_from_vec(extra, (d.outputs, columns))?),
                },
                bias: self.device.try_tensor_from_vec(bias, (d.outputs,))?,
            })
        });
        weights.collect()
    }

    /// `[points][channels]` of the position or direction encoding.
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
        let w = &weights[layer];
        // `retaped`, because an operation on a tensor without tape is not recorded.
        let mut y = main.try_matmul(w.main.retaped::<T>().try_permute::<_, Axes2<1, 0>>()?)?;
        if let (Some(weights), Some(x)) = (&w.extra, extra) {
            let weights = weights.retaped::<T>().try_permute::<_, Axes2<1, 0>>()?;
            y = y.try_add(x.retaped::<T>().try_matmul(weights)?)?;
        }
        let shape = *y.shape();
        let y = y.try_add(w.bias.retaped::<T>().try_broadcast_like::<_, Axis<0>>(&shape)?)?;
        Ok(if self.graph.nodes[layer].relu { y.try_relu()? } else { y })
    }

    fn trunk<T: Tape<f32, Cpu>>(&self, weights: &[Weights], px: Matrix) -> Result<Matrix<T>, EngineError> {
        let mut h = px.retaped::<T>();
        for layer in self.graph.trunk.clone() {
            h = self.dense(layer, weights, h, Some(&px))?;
        }
        Ok(h)
    }

    /// sigma of each point, on a tape of its own.
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

    /// Colour of each point, `[points][3]`, on a tape of its own.
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

    /// Mean squared error of the batch's rays, which have up to `longest` samples, and whether all
    /// densities are 0.
    fn render(
        &self,
        weights: &[Weights],
        batch: &Batch,
        longest: usize,
    ) -> Result<(Scalar, bool), EngineError> {
        let rays = batch.rays.len();
        let matrix = |values, columns| self.device.try_tensor_from_vec(values, (rays, columns));
        let of_rays = |of: fn(&super::BatchRay) -> [f32; 3]| batch.rays.iter().flat_map(of).collect();
        let target = matrix(of_rays(|ray| ray.rgb), 3)?;
        let background = matrix(of_rays(|ray| ray.background), 3)?;

        let mut positions = vec![[0.0; 3]; rays * longest];
        let mut deltas = vec![0.0; rays * longest];
        // In a 2D field, a sample hides whatever is behind it.
        let mut opaque = vec![0.0; rays * longest];
        let mut dirs = Vec::with_capacity(rays * longest);
        let mut first = 0;
        for (row, ray) in batch.rays.iter().enumerate() {
            let samples = ray.samples as usize;
            positions[row * longest..][..samples].copy_from_slice(&batch.positions[first..][..samples]);
            deltas[row * longest..][..samples].copy_from_slice(&batch.deltas[first..][..samples]);
            opaque[row * longest..][..samples].fill(1e3);
            dirs.extend(std::iter::repeat_n(ray.dir, longest));
            first += samples;
        }

        let h = self.trunk::<Taped>(weights, self.encode(POSITION, &positions)?)?;
        let colour = self.colour(weights, &h, &dirs)?.try_reshape_like(&(rays, longest, 3))?;
        let mut dead = false;
        let tau = match self.density(weights, &h)? {
            Some(sigma) => {
                let sigma = sigma.try_reshape_like(&(rays, longest))?;
                let live =
                    deltas.iter().zip(sigma.as_vec()).all(|(&delta, sigma)| delta == 0.0 || sigma == 0.0);
                dead = live && !batch.positions.is_empty();
                sigma.try_mul(matrix(deltas, longest)?)?
            }
            None => matrix(opaque, longest)?.retaped::<Taped>(),
        };
        // Without cumsum: Σ_{j<i} tau_j is a product with a strictly triangular matrix of ones.
        let before = self.device.try_upper_tri_like(&(longest, longest), 1.0, 1)?;
        let transmittance = tau.with_empty_tape().try_matmul(before)?.try_negate()?.try_exp()?;
        let left = tau.with_empty_tape().try_sum::<_, Axis<1>>()?.try_negate()?.try_exp()?;
        let alpha = tau.try_negate()?.try_exp()?.try_negate()?.try_add(1.0)?;
        // h's tape holds the trunk, from which both branches grew.
        let weight = transmittance.try_mul(alpha)?;
        let weight = weight.try_broadcast_like::<_, Axis<2>>(&(rays, longest, 3))?;
        let shown = weight.try_mul(colour)?.try_sum::<_, Axis<1>>()?;
        let behind = left.try_broadcast_like::<_, Axis<1>>(&(rays, 3usize))?.try_mul(background)?;
        let error = shown.try_add(behind)?.try_sub(target)?.try_square()?;
        let error = error.try_mean::<Rank0, Axes2<0, 1>>()?;
        let (error, tape) = error.split_tape();
        let (_, trunk) = h.split_tape();
        Ok((error.put_tape(trunk.merge(tape)), dead))
    }

    /// Loss of a checked batch, and its gradients in the model's own order.
    fn differentiate(&self, batch: &Batch) -> Result<(StepLoss, Vec<f32>), EngineError> {
        let weights = self.weights()?;
        let mut loss = StepLoss::default();
        let mut gradients = vec![0.0; self.optimiser.values().len()];
        let longest = batch.rays.iter().map(|ray| ray.samples as usize).max().unwrap_or(0);
        if longest > 0 {
            let (mse, dead) = self.render(&weights, batch, longest)?;
            loss.mse = f64::from(mse.array());
            loss.dead = dead;
            self.collect(&weights, &mse.try_backward()?, 1.0, &mut gradients);
        } else if !batch.rays.is_empty() {
            let error = |ray: &super::BatchRay| -> f64 {
                let channels = ray.background.iter().zip(&ray.rgb);
                channels.map(|(b, c)| f64::from(b - c).powi(2)).sum()
            };
            loss.mse = batch.rays.iter().map(error).sum::<f64>() / (3 * batch.rays.len()) as f64;
        }
        if !batch.empty.is_empty() {
            let h = self.trunk::<Taped>(&weights, self.encode(POSITION, &batch.empty)?)?;
            if let Some(sigma) = self.density(&weights, &h)? {
                let term = sigma.try_add(1.0)?.try_ln()?.try_mean::<Rank0, Axis<0>>()?;
                loss.empty = f64::from(term.array());
                let (term, tape) = term.split_tape();
                let (_, trunk) = h.split_tape();
                let found = term.put_tape(trunk.merge(tape)).try_backward()?;
                self.collect(&weights, &found, batch.empty_weight, &mut gradients);
            }
        }
        if !(loss.mse.is_finite() && loss.empty.is_finite() && usable(&gradients)) {
            return Err(EngineError::Diverged { step: self.optimiser.next_step() });
        }
        Ok((loss, gradients))
    }

    /// Adds `factor` times the tape's gradients into the model's order.
    fn collect(&self, weights: &[Weights], found: &Gradients<f32, Cpu>, factor: f32, out: &mut [f32]) {
        for (w, node) in weights.iter().zip(&self.graph.nodes) {
            let d: &Dense = &node.dense;
            let mut found = found.clone();
            let mut add = |first: usize, row: usize, columns: usize, stride: usize, values: Vec<f32>| {
                for (i, value) in values.into_iter().enumerate() {
                    out[first + (i / columns) * stride + i % columns + row] += factor * value;
                }
            };
            let mut of = |t: &Matrix| found.get_or_alloc_mut(t).map(|g| g.to_vec()).unwrap_or_default();
            add(d.weights, 0, d.main, d.inputs(), of(&w.main));
            if let Some(extra) = &w.extra {
                add(d.weights, d.main, d.extra, d.inputs(), of(extra));
            }
            let bias = found.get_or_alloc_mut(&w.bias).map(|g| g.to_vec()).unwrap_or_default();
            add(d.bias, 0, d.outputs, d.outputs, bias);
        }
    }

    /// Loss and gradients, in the model's own order, without a step.
    #[cfg(test)]
    pub(super) fn gradients(&mut self, batch: &Batch) -> Result<(StepLoss, Vec<f32>), EngineError> {
        batch.check()?;
        self.differentiate(batch)
    }
}

impl Engine for ReferenceEngine {
    fn step(&mut self, batch: &Batch, rate: f64) -> Result<StepLoss, EngineError> {
        check_rate(rate)?;
        batch.check()?;
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
