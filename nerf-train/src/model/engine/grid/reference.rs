//! The reference engine of grid fields: table entries are gathered from a dfdx tensor, and dfdx's tape differentiates.
//!
//! This engine computes the loss and gradients of [`GridEngine`](super::GridEngine) with the simplest code. The samples
//! that get gradients are chosen without a tape; the transmittance through all others is a constant. Differences: the
//! densities behind the end of a ray are evaluated, too, and pixels clipped at white are treated like all others.

mod forward;
mod terms;

use super::adam::{decay_weights, moves, waiting_entries};
use super::kept::KeptSamples;
use super::{check_plain, check_state, gain_sums, waiting_values};
use crate::model::engine::batch::{Chunk, cut};
use crate::model::engine::optimiser::usable;
use crate::model::engine::tape::{
    Matrix, Rows, Scalar, TAPE_SAMPLES, Taped, add, alpha, over, squared_error, with_tape,
};
use crate::model::engine::{
    Adam, Batch, BatchRay, Engine, EngineError, Model, OptimiserState, StepLoss, check_step,
};
use crate::model::quantise::{Rounding, scales};
use dfdx::prelude::*;
use dfdx::tensor_ops::AdamConfig;
use forward::Network;
use nerf_core::encoding::GridEncoding;
use nerf_core::space::SceneBox;
use std::borrow::Cow;
use std::ops::Range;
use terms::{distortion, smoothness, surfaces, with_gradient_scaled};

/// Engine that trains a scene's grid by dfdx's tape: `--engine dfdx`; oracle in tests of [`super::GridEngine`].
pub struct GridReferenceEngine {
    model: Model,
    grid: GridEncoding,
    bounds: SceneBox,
    adam: Adam,
    /// Parameters (layers, then tables) and Adam's moments.
    state: OptimiserState,
    of_rays: OfRays,
    device: Cpu,
}

#[derive(Default)]
struct OfRays {
    /// For each ray with a gain: the photograph's index, and gradient of the loss with respect to its log gain.
    gains: Vec<(u32, [f32; 3])>,
    /// For each ray with a known photograph: index of the ray in the batch, and rendered minus photographed colour.
    errors: Vec<(u32, [f32; 3])>,
}

struct Rendered {
    /// Contribution of the rendered rays to the batch's mean squared error.
    mse: f32,
    /// Contribution of the rendered rays to the loss, with the tape of the operations that computed it.
    total: Scalar,
    /// Gains of the rays, `[rays][3]`. The loss is also differentiated with respect to the gains.
    gains: Matrix,
    /// Rendered minus photographed colour, `[rays][3]`.
    errors: Vec<f32>,
}

impl GridReferenceEngine {
    /// Creates an engine with the initial values of `seed`; `bounds`: the box that the grid spans. Fails as
    /// [`engine_for`](super::super::engine_for), and with [`EngineError::NoGrid`] without a grid.
    pub fn new(model: &Model, bounds: SceneBox, adam: Adam, seed: u64) -> Result<Self, EngineError> {
        let grid = check_plain(model)?;
        if model.architecture.density.is_none() {
            return Err(EngineError::NoDensity);
        }
        let parameters = model.initial_parameters(seed);
        let waiting = vec![0.0; waiting_values(&grid, &adam)];
        let state = OptimiserState { waiting, ..OptimiserState::at(parameters) };
        let (model, device) = (model.clone(), Cpu::default());
        Ok(Self { model, grid, bounds, adam, state, of_rays: OfRays::default(), device })
    }

    /// Adds the results of the rays `indices`, which have the samples `samples`, to `loss`, `gradients` and `of_rays`.
    fn add_rays(
        &self,
        network: &Network,
        batch: &Batch,
        (indices, samples): (Range<usize>, Range<usize>),
        loss: &mut StepLoss,
        gradients: &mut [f32],
        of_rays: &mut OfRays,
    ) -> Result<(), EngineError> {
        let mut depths = Vec::new();
        if !samples.is_empty() {
            let h = forward::trunk::<NoneTape>(self, network, &batch.positions[samples.clone()])?;
            let sigma = forward::density(network, &h)?.as_vec();
            depths = sigma.iter().zip(&batch.deltas[samples.clone()]).map(|(s, d)| s * d).collect();
        }
        let rays = &batch.rays[indices.clone()];
        let kept = KeptSamples::of(rays, &depths, samples.start, batch.roulette);
        loss.evaluated += samples.len();
        loss.kept += kept.samples.len();
        if kept.samples.is_empty() {
            for ((ray, transmittance), index) in rays.iter().zip(&kept.unkept).zip(indices) {
                let error = [0, 1, 2].map(|k| transmittance * ray.background[k] - ray.rgb[k]);
                let weight = batch.weights.get(index).copied().unwrap_or(1.0);
                let squared: f64 =
                    f64::from(weight) * error.map(|e| f64::from(e).powi(2)).iter().sum::<f64>();
                if batch.views.len() > index {
                    of_rays.errors.push((index as u32, error));
                }
                loss.mse += squared / (3 * batch.rays.len()) as f64;
            }
            return Ok(());
        }
        let rendered = self.render(network, batch, indices.clone(), &kept)?;
        loss.mse += f64::from(rendered.mse);
        let mut found = rendered.total.try_backward()?;
        let by_factor = found.get_or_alloc_mut(&rendered.gains)?.to_vec();
        let of_each = by_factor.chunks_exact(3).zip(rendered.errors.chunks_exact(3));
        for (index, (by_factor, error)) in indices.zip(of_each) {
            let Some(&view) = batch.views.get(index) else { continue };
            of_rays.errors.push((index as u32, [error[0], error[1], error[2]]));
            if let Some(gain) = batch.gains.get(index) {
                of_rays.gains.push((view, [0, 1, 2].map(|k| gain[k] * by_factor[k])));
            }
        }
        let (layers, table) = gradients.split_at_mut(self.model.layer_parameters());
        for (dense, weights) in &network.layers {
            weights.collect(dense, &mut found, layers)?;
        }
        add(table, found.get_or_alloc_mut(&network.table)?);
        Ok(())
    }

    /// Renders the rays `indices` of the batch from the samples `kept`. Computes the rays' contribution to the loss.
    fn render(
        &self,
        network: &Network,
        batch: &Batch,
        indices: Range<usize>,
        kept: &KeptSamples,
    ) -> Result<Rendered, EngineError> {
        let (device, rays) = (&self.device, &batch.rays[indices.clone()]);
        let of_rays = |of: fn(&BatchRay) -> [f32; 3]| {
            device.try_tensor_from_vec(rays.iter().flat_map(of).collect(), (rays.len(), 3))
        };
        let rows = Rows::new(device, &kept.counts)?;
        let positions: Vec<_> = kept.samples.iter().map(|&i| batch.positions[i]).collect();
        let scale = |i: usize| batch.gradient_scales.get(kept.samples[i]).copied().unwrap_or(1.0);

        let h = forward::trunk::<Taped>(self, network, &positions)?;
        let scales =
            device.try_tensor_from_vec((0..positions.len()).map(scale).collect(), (positions.len(),))?;
        let sigma = with_gradient_scaled(forward::density(network, &h)?, scales.clone())?;
        let tau = rows.of(sigma)?.try_mul(rows.constants(|i| batch.deltas[kept.samples[i]])?)?;

        // Russian roulette: the inverse probability multiplies the weight of a sample, and the gradient of its effect
        // on the transmittance behind it.
        let inverse = || rows.constants(|i| kept.inverse[i]);
        let (front, transmittance) =
            rows.transmittance(with_gradient_scaled(tau.with_empty_tape(), inverse()?)?)?;
        let front = front.try_mul(rows.constants(|i| kept.front[i])?)?;
        let transmittance =
            transmittance.try_mul(device.try_tensor_from_vec(kept.unkept.clone(), (rays.len(),))?)?;
        let weights = front.try_mul(alpha(tau)?)?.try_mul(inverse()?)?;

        let mut other = surfaces(&rows, batch, indices.clone(), kept, &weights, &transmittance)?;
        if let Some(smoothness) = smoothness(&rows, batch, indices.clone(), kept, &weights)? {
            other = other.try_add(smoothness)?;
        }
        let dirs: Vec<_> = rays.iter().map(|ray| ray.dir).collect();
        // The features of a ray without kept samples are divided by 1 instead of 0.
        let none = kept.counts.iter().map(|&count| f32::from(u8::from(count == 0))).collect();
        let opacity = weights.with_empty_tape().try_sum::<(usize,), Axis<1>>()?;
        let divisor = opacity.with_empty_tape().try_add(device.try_tensor_from_vec(none, (rays.len(),))?)?;
        let scales = scales.try_broadcast_like::<_, Axis<1>>(h.shape())?;
        let features = with_gradient_scaled(h.with_empty_tape(), scales)?;
        let sums = rows.sums(weights.with_empty_tape(), features)?;
        let shape = *sums.shape();
        let mean = sums.try_div(divisor.try_broadcast_like::<_, Axis<1>>(&shape)?)?;
        let colour = forward::colour(self, network, &mean, &dirs)?;
        let shape = *colour.shape();
        let shown = with_tape(colour, mean.split_tape().1)
            .try_mul(opacity.try_broadcast_like::<_, Axis<1>>(&shape)?)?;
        let gains =
            indices.clone().flat_map(|ray| batch.gains.get(ray).copied().unwrap_or([1.0; 3])).collect();
        let gains = device.try_tensor_from_vec(gains, (rays.len(), 3))?;
        let shown = shown.try_mul(gains.retaped::<Taped>())?;
        let seen = over(shown, transmittance, of_rays(|ray| ray.background)?)?;
        let rgb = rays.iter().flat_map(|ray| ray.rgb);
        let errors = seen.as_vec().into_iter().zip(rgb).map(|(seen, rgb)| seen - rgb).collect();
        let root = |ray: usize| batch.weights.get(ray).map_or(1.0, |weight| weight.sqrt());
        let roots = indices.flat_map(|ray| [root(ray); 3]).collect();
        let roots: Matrix = device.try_tensor_from_vec(roots, (rays.len(), 3))?;
        let target = of_rays(|ray| ray.rgb)?.try_mul(roots.clone())?;
        let error = squared_error(seen.try_mul(roots)?, target, 1.0 / (3 * batch.rays.len()) as f32)?;
        let mse = error.array();
        let error = error.try_add(other)?;
        let total = if batch.distortion == 0.0 {
            with_tape(error, weights.split_tape().1)
        } else {
            let along = kept.along(&positions);
            let distortion = distortion(&rows, weights, rows.constants(|i| along[i])?)?;
            error.try_add(distortion.try_mul(batch.distortion / batch.rays.len() as f32)?)?
        };
        Ok(Rendered { mse, total: with_tape(total, h.split_tape().1), gains, errors })
    }

    /// Returns the loss of a valid batch ([`Batch::check`]) and its gradient by parameter. Fails if training diverged.
    fn differentiate(&mut self, batch: &Batch) -> Result<(StepLoss, Vec<f32>), EngineError> {
        let network = forward::network(self)?;
        let (mut chunks, mut loss) = (Vec::new(), StepLoss::default());
        let mut gradients = vec![0.0; self.state.parameters.len()];
        let mut of_rays = OfRays::default();
        cut(batch, TAPE_SAMPLES, &mut chunks);
        for chunk in chunks {
            // The loss of a grid field has no term for points in empty cells.
            let Chunk::Rays { rays, samples } = chunk else { continue };
            self.add_rays(&network, batch, (rays, samples), &mut loss, &mut gradients, &mut of_rays)?;
        }
        // The density's bias keeps its initial value; a grid field has no other biases.
        for dense in self.model.layers() {
            gradients[dense.bias..][..dense.outputs].fill(0.0);
        }
        if !(loss.mse.is_finite() && usable(&gradients)) {
            return Err(EngineError::Diverged { step: self.state.steps + 1 });
        }
        loss.dead = loss.evaluated > 0 && loss.kept == 0;
        self.of_rays = of_rays;
        Ok((loss, gradients))
    }

    /// Applies Adam to all layers and to the levels that this step updates; accumulates the other levels' gradients.
    fn update(&mut self, mut gradients: Vec<f32>, rate: f64) -> Result<(), EngineError> {
        let step = self.state.steps + 1;
        let (features, mut first) = (usize::from(self.grid.features), 0);
        let tables = self.model.layer_parameters();
        decay_weights(&self.adam, rate, &self.model, &mut self.state.parameters);
        self.move_values(0..tables, &gradients, step, rate)?;
        for level in self.grid.clone().levels() {
            let values = tables + level.first * features..tables + (level.first + level.entries) * features;
            let turn = moves(&self.adam, &level, step);
            let waiting = waiting_entries(&self.adam, &level) * features;
            if waiting > 0 {
                let (waiting, gradient) =
                    (&mut self.state.waiting[first..][..waiting], &mut gradients[values.clone()]);
                add(waiting, gradient);
                gradient.copy_from_slice(waiting);
                if turn.is_some() {
                    waiting.fill(0.0);
                }
            }
            first += waiting;
            if let Some(moves) = turn {
                self.move_values(values, &gradients, moves, rate)?;
            }
        }
        self.state.steps = step;
        Ok(())
    }

    /// Does step number `step` of dfdx's Adam on the parameters in `range` whose gradient is not 0, and their moments.
    fn move_values(
        &mut self,
        range: Range<usize>,
        gradients: &[f32],
        step: u64,
        rate: f64,
    ) -> Result<(), EngineError> {
        let OptimiserState { parameters, moment1, moment2, .. } = &mut self.state;
        let step = i32::try_from(step).map_err(|_| EngineError::Steps { found: step })?;
        let Adam { betas, epsilon: eps, .. } = self.adam;
        let config = AdamConfig { lr: rate, betas, eps, weight_decay: None };
        let moved: Vec<usize> = range.filter(|&i| gradients[i] != 0.0).collect();
        // dfdx cannot read a tensor without values.
        if moved.is_empty() {
            return Ok(());
        }
        let take = |from: &[f32]| {
            let values = moved.iter().map(|&i| from[i]).collect();
            self.device.try_tensor_from_vec::<(usize,)>(values, (moved.len(),))
        };
        let storage = |from: &[f32]| -> Result<_, EngineError> {
            let mut values = Storage::<f32>::try_alloc_len(&self.device, moved.len())?;
            values.iter_mut().zip(&moved).for_each(|(to, &i)| *to = from[i]);
            Ok(values)
        };
        let mut values = take(parameters)?;
        let (mut first, mut second) = (storage(moment1)?, storage(moment2)?);
        config.try_update(step, &mut values, &mut first, &mut second, &storage(gradients)?)?;
        for (k, (&i, value)) in moved.iter().zip(values.as_vec()).enumerate() {
            (parameters[i], moment1[i], moment2[i]) = (value, first[k], second[k]);
        }
        Ok(())
    }
}

impl Engine for GridReferenceEngine {
    fn step(&mut self, batch: &Batch, rate: f64) -> Result<StepLoss, EngineError> {
        check_step(batch, rate)?;
        let (loss, gradients) = self.differentiate(batch)?;
        self.update(gradients, rate)?;
        Ok(loss)
    }

    fn gain_gradients(&self, views: usize) -> Vec<[f32; 3]> {
        gain_sums(&self.of_rays.gains, views)
    }

    fn errors(&self) -> Box<dyn Iterator<Item = &(u32, [f32; 3])> + '_> {
        Box::new(self.of_rays.errors.iter())
    }

    fn set_weight_decay(&mut self, weight_decay: f64) {
        self.adam.weight_decay = weight_decay;
    }

    fn round_tables(&mut self, rounding: Rounding) {
        if self.state.scales.is_empty() {
            let tables = &self.state.parameters[self.model.layer_parameters()..];
            self.state.scales = scales(&self.grid, tables, rounding);
        }
    }

    fn table_scales(&self) -> &[f32] {
        &self.state.scales
    }

    fn parameters(&self) -> Cow<'_, [f32]> {
        Cow::Borrowed(&self.state.parameters)
    }

    fn state(&self) -> OptimiserState {
        self.state.clone()
    }

    fn restore(&mut self, state: &OptimiserState) -> Result<(), EngineError> {
        check_state(state, self.state.parameters.len(), &self.grid, &self.adam)?;
        self.state = state.clone();
        Ok(())
    }
}
