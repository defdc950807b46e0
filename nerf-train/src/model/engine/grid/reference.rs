//! The reference engine of grid fields: tables as a dfdx tensor that samples gather from, all derivatives left to the tape.
//!
//! It computes what [`GridEngine`](super::GridEngine) does, in the plainest form. Which samples are kept is decided without a
//! tape; the transmittance of the others is a constant. Deviations: every sample's density is evaluated, those behind the
//! end of a ray too; a photograph that is clipped at white is not told from one that is just as bright.

use super::kept::KeptSamples;
use super::{check_plain, check_state, gain_sums};
use crate::model::engine::chunk::{Chunk, cut};
use crate::model::engine::optimiser::usable;
use crate::model::engine::tape::{
    Matrix, Rows, Scalar, TAPE_SAMPLES, Taped, Vector, Weights, add, alpha, squared_error, with_tape,
};
use crate::model::engine::{
    Adam, Batch, BatchRay, Dense, Engine, EngineError, Model, OptimiserState, Part, StepLoss, Surface,
    check_rate,
};
use crate::model::quantise::{STEPS, scales};
use dfdx::prelude::*;
use dfdx::tensor_ops::AdamConfig;
use half::f16;
use nerf_core::camera::SceneBox;
use nerf_core::encoding::{DirectionEncoding, GridEncoding, GridLevel, encode_block, encode_harmonics_block};
use nerf_core::math::MathBackend;
use nerf_core::network::EXPONENTIAL_LIMIT;
use nerf_core::simd::Isa;
use std::borrow::Cow;
use std::ops::Range;

/// Trains the grid of a scene by dfdx's tape and dfdx's Adam: `--engine dfdx`, and the oracle of the fused engine.
pub struct GridReferenceEngine {
    model: Model,
    grid: GridEncoding,
    bounds: SceneBox,
    adam: Adam,
    /// Layers, then tables.
    state: OptimiserState,
    of_rays: OfRays,
    device: Cpu,
}

/// Gradients and errors of the last step's rays.
#[derive(Default)]
struct OfRays {
    /// Index of each ray's photograph, and gradient by its log gain.
    gains: Vec<(u32, [f32; 3])>,
    /// Index of each ray in the batch, and colour error.
    errors: Vec<(u32, [f32; 3])>,
}

/// Rendered rays of a chunk, and their loss.
struct Rendered {
    /// Their part in the mean squared error.
    mse: f32,
    /// Their part in the whole loss, with the tape.
    total: Scalar,
    /// Gains of the rays, `[rays][3]`: the loss is differentiated by them.
    gains: Matrix,
    /// Shown minus photographed, `[rays][3]`.
    errors: Vec<f32>,
}

/// The parameters of a step as tensors.
struct Network {
    layers: Vec<(Dense, Weights)>,
    /// Values of all levels as the renderer reads them, `[entries][features]`; their gradient is that of the parameters.
    table: Matrix,
}

impl GridReferenceEngine {
    /// An engine on the start values of `seed`; `bounds`: what the grid spans.
    ///
    /// # Errors
    /// [`EngineError::Model`], [`EngineError::NoGrid`], [`EngineError::NotPlain`] as [`super::GridEngine::new`], and
    /// [`EngineError::NoDensity`] for a 2D field.
    pub fn new(model: &Model, bounds: SceneBox, adam: Adam, seed: u64) -> Result<Self, EngineError> {
        let grid = check_plain(model)?;
        if model.architecture.density.is_none() {
            return Err(EngineError::NoDensity);
        }
        let parameters = model.initial_parameters(seed);
        let (moment1, moment2) = (vec![0.0; parameters.len()], vec![0.0; parameters.len()]);
        let state = OptimiserState { parameters, moment1, moment2, ..OptimiserState::default() };
        let (model, device) = (model.clone(), Cpu::default());
        Ok(Self { model, grid, bounds, adam, state, of_rays: OfRays::default(), device })
    }

    fn network(&self) -> Result<Network, EngineError> {
        let parameters = &self.state.parameters;
        let of = |dense: Dense| Ok((dense, Weights::of(&self.device, &dense, parameters)?));
        let layers = self.model.layers().into_iter().map(of).collect::<Result<_, EngineError>>()?;
        let mut table = parameters[self.model.layer_parameters()..].to_vec();
        let features = usize::from(self.grid.features);
        for (i, level) in self.grid.levels().enumerate() {
            for value in &mut table[level.first * features..][..level.entries * features] {
                if let Some(scale) = self.state.scales.get(i) {
                    *value = (*value / scale).round_ties_even().clamp(-STEPS, STEPS) * scale;
                }
                *value = f16::from_f32(*value).to_f32();
            }
        }
        let entries = table.len() / features;
        Ok(Network { layers, table: self.device.try_tensor_from_vec(table, (entries, features))? })
    }

    /// Interpolated values, `[samples][levels · features]`: `Σ_corners weight · table[entry]`.
    fn encode<T: Tape<f32, Cpu>>(
        &self,
        table: &Matrix,
        positions: &[[f32; 3]],
    ) -> Result<Matrix<T>, EngineError> {
        let (mut entries, mut weights) = (Vec::new(), Vec::new());
        let sides = (self.bounds.max - self.bounds.min).to_array();
        for x in positions {
            let unit: [f32; 3] =
                std::array::from_fn(|axis| ((x[axis] - self.bounds.min[axis]) / sides[axis]).clamp(0.0, 1.0));
            for level in self.grid.levels() {
                for (entry, weight) in corners(&level, unit) {
                    entries.push(entry);
                    weights.push(weight);
                }
            }
        }
        let (reads, features) = (entries.len(), usize::from(self.grid.features));
        let (samples, levels) = (positions.len(), self.grid.resolutions.len());
        let entries = self.device.try_tensor_from_vec(entries, (reads,))?;
        let weights = self.device.try_tensor_from_vec(weights, (reads,))?;
        let read: Matrix<T> = table.retaped::<T>().try_gather(entries)?;
        let read = read.try_mul(weights.try_broadcast_like::<_, Axis<1>>(&(reads, features))?)?;
        let corners = read.try_reshape_like(&(samples * levels, reads / (samples * levels), features))?;
        let sums = corners.try_sum::<(usize, usize), Axis<1>>()?;
        Ok(sums.try_reshape_like(&(samples, levels * features))?)
    }

    /// The trunk's output, `[samples][width]`.
    fn trunk<T: Tape<f32, Cpu>>(
        &self,
        network: &Network,
        positions: &[[f32; 3]],
    ) -> Result<Matrix<T>, EngineError> {
        let mut h = self.encode::<T>(&network.table, positions)?;
        for (_, weights) in network.layers.iter().filter(|(d, _)| matches!(d.part, Part::Trunk(_))) {
            h = weights.apply(h, None)?.try_relu()?;
        }
        Ok(h)
    }

    /// sigma of each sample, on a tape of its own.
    fn density<T: Tape<f32, Cpu>>(&self, network: &Network, h: &Matrix<T>) -> Result<Vector<T>, EngineError> {
        let density = network.layers.iter().find(|(d, _)| d.part == Part::Density);
        let (_, weights) = density.ok_or(EngineError::NoDensity)?;
        let raw = weights.apply(h.with_empty_tape(), None)?;
        let samples = raw.shape().0;
        Ok(raw.try_reshape_like(&(samples,))?.try_clamp(f32::MIN, EXPONENTIAL_LIMIT)?.try_exp()?)
    }

    /// Colour of each sample, `[samples][3]`, on a tape of its own.
    fn colour(
        &self,
        network: &Network,
        h: &Matrix<Taped>,
        dirs: &[[f32; 3]],
    ) -> Result<Matrix<Taped>, EngineError> {
        let dirs = self.directions(dirs)?;
        let mut h = h.with_empty_tape();
        for (dense, weights) in &network.layers {
            h = match dense.part {
                Part::Colour(_) => weights.apply(h, dirs.as_ref())?.try_relu()?,
                Part::Rgb => weights.apply(h, dirs.as_ref())?.try_sigmoid()?,
                Part::Trunk(_) | Part::Density | Part::Feature => h,
            };
        }
        Ok(h)
    }

    fn directions(&self, dirs: &[[f32; 3]]) -> Result<Option<Matrix>, EngineError> {
        let Some(encoding) = &self.model.architecture.direction else { return Ok(None) };
        let channels = encoding.outputs();
        let mut values = vec![0.0; dirs.len() * channels];
        for (dir, out) in dirs.iter().zip(values.chunks_exact_mut(channels)) {
            match encoding {
                DirectionEncoding::Sinusoidal(encoding) => {
                    encode_block(Isa::Portable, MathBackend::Polynomial, encoding, 1, dir, out);
                }
                DirectionEncoding::SphericalHarmonics { degree } => {
                    encode_harmonics_block(Isa::Portable, *degree, 1, dir, out);
                }
            }
        }
        Ok(Some(self.device.try_tensor_from_vec(values, (dirs.len(), channels))?))
    }

    /// Adds loss and gradients of rays whose samples are `samples`.
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
            let h = self.trunk::<NoneTape>(network, &batch.positions[samples.clone()])?;
            let sigma = self.density(network, &h)?.as_vec();
            depths = sigma.iter().zip(&batch.deltas[samples.clone()]).map(|(s, d)| s * d).collect();
        }
        let rays = &batch.rays[indices.clone()];
        let kept = KeptSamples::of(rays, &depths, samples.start, batch.faint);
        loss.evaluated += samples.len();
        loss.kept += kept.samples.len();
        if kept.samples.is_empty() {
            for ((ray, left), index) in rays.iter().zip(&kept.left).zip(indices) {
                let gain = batch.gains.get(index).copied().unwrap_or([1.0; 3]);
                let shown = |k: usize| gain[k] * left * ray.background[k];
                let error = [0, 1, 2].map(|k| shown(k) - ray.rgb[k]);
                let weight = batch.weights.get(index).copied().unwrap_or(1.0);
                let squared: f64 =
                    f64::from(weight) * error.map(|e| f64::from(e).powi(2)).iter().sum::<f64>();
                if let Some(&view) = batch.views.get(index) {
                    let scale = 2.0 * weight / (3 * batch.rays.len()) as f32;
                    of_rays.gains.push((view, [0, 1, 2].map(|k| scale * error[k] * shown(k))));
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

    /// Renders the rays of these indices.
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
        let counted = rays.iter().zip(&kept.counts);
        let dirs: Vec<_> = counted.flat_map(|(ray, &count)| std::iter::repeat_n(ray.dir, count)).collect();
        let scale = |i: usize| batch.gradient_scales.get(kept.samples[i]).copied().unwrap_or(1.0);

        let h = self.trunk::<Taped>(network, &positions)?;
        let scales =
            device.try_tensor_from_vec((0..positions.len()).map(scale).collect(), (positions.len(),))?;
        let scales_of_channels =
            scales.clone().try_broadcast_like::<_, Axis<1>>(&(positions.len(), 3usize))?;
        let colour = with_gradient_scaled(self.colour(network, &h, &dirs)?, scales_of_channels)?;
        let sigma = with_gradient_scaled(self.density(network, &h)?, scales)?;
        let tau = rows.of(sigma)?.try_mul(rows.constants(|i| batch.deltas[kept.samples[i]])?)?;

        // Russian roulette: inverse-probability weights, of what a sample shows and of the gradient of what it hides.
        let inverse = || rows.constants(|i| kept.inverse[i]);
        let (front, left) = rows.transmittance(with_gradient_scaled(tau.with_empty_tape(), inverse()?)?)?;
        let front = front.try_mul(rows.constants(|i| kept.front[i])?)?;
        let left = left.try_mul(device.try_tensor_from_vec(kept.left.clone(), (rays.len(),))?)?;
        let weights = front.try_mul(alpha(tau)?)?.try_mul(inverse()?)?;

        let towards = surfaces(&rows, batch, indices.clone(), kept, &weights, &left)?;
        let seen = rows.pixels(weights.with_empty_tape(), colour, left, of_rays(|ray| ray.background)?)?;
        let gains =
            indices.clone().flat_map(|ray| batch.gains.get(ray).copied().unwrap_or([1.0; 3])).collect();
        let gains = device.try_tensor_from_vec(gains, (rays.len(), 3))?;
        let seen = seen.try_mul(gains.retaped::<Taped>())?;
        let rgb = rays.iter().flat_map(|ray| ray.rgb);
        let errors = seen.as_vec().into_iter().zip(rgb).map(|(seen, rgb)| seen - rgb).collect();
        let root = |ray: usize| batch.weights.get(ray).map_or(1.0, |weight| weight.sqrt());
        let roots = indices.flat_map(|ray| [root(ray); 3]).collect();
        let roots: Matrix = device.try_tensor_from_vec(roots, (rays.len(), 3))?;
        let target = of_rays(|ray| ray.rgb)?.try_mul(roots.clone())?;
        let error = squared_error(seen.try_mul(roots)?, target, 1.0 / (3 * batch.rays.len()) as f32)?;
        let mse = error.array();
        let error = error.try_add(towards)?;
        let total = if batch.distortion == 0.0 {
            with_tape(error, weights.split_tape().1)
        } else {
            let along = kept.along(&positions);
            let distortion = distortion(&rows, weights, rows.constants(|i| along[i])?)?;
            error.try_add(distortion.try_mul(batch.distortion / batch.rays.len() as f32)?)?
        };
        Ok(Rendered { mse, total: with_tape(total, h.split_tape().1), gains, errors })
    }

    /// Loss of a checked batch, and its gradients in the model's own order.
    fn differentiate(&mut self, batch: &Batch) -> Result<(StepLoss, Vec<f32>), EngineError> {
        let network = self.network()?;
        let (mut chunks, mut loss) = (Vec::new(), StepLoss::default());
        let mut gradients = vec![0.0; self.state.parameters.len()];
        let mut of_rays = OfRays::default();
        cut(batch, TAPE_SAMPLES, &mut chunks);
        for chunk in chunks {
            // Culled space is not trained beside a grid.
            let Chunk::Rays { rays, samples } = chunk else { continue };
            self.add_rays(&network, batch, (rays, samples), &mut loss, &mut gradients, &mut of_rays)?;
        }
        // The density's bias stays as it starts; the others have no part in a grid field.
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

    /// dfdx's Adam, of the parameters that have a gradient; the others and their moments are left alone.
    fn update(&mut self, gradients: &[f32], rate: f64) -> Result<(), EngineError> {
        let OptimiserState { parameters, moment1, moment2, steps, .. } = &mut self.state;
        let step = i32::try_from(*steps + 1).map_err(|_| EngineError::Steps { found: *steps + 1 })?;
        let Adam { betas, epsilon: eps, weight_decay: _ } = self.adam;
        let config = AdamConfig { lr: rate, betas, eps, weight_decay: None };
        let moved: Vec<usize> = (0..gradients.len()).filter(|&i| gradients[i] != 0.0).collect();
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
        *steps += 1;
        Ok(())
    }
}

/// The entries of a cell's corners, among those of all levels, and their trilinear weights.
fn corners(level: &GridLevel, unit: [f32; 3]) -> [(usize, f32); 8] {
    let at: [(u32, f32); 3] = std::array::from_fn(|axis| {
        let along = unit[axis] * level.cells[axis] as f32;
        let cell = along.floor().min(level.cells[axis] as f32 - 1.0);
        (cell as u32, along - cell)
    });
    std::array::from_fn(|corner| {
        let far = [0, 1, 2].map(|axis| corner as u32 >> axis & 1);
        let [x, y, z] = [0, 1, 2].map(|axis| at[axis].0 + far[axis]);
        let weight = (0..3).map(|axis| if far[axis] == 1 { at[axis].1 } else { 1.0 - at[axis].1 }).product();
        (level.first + (level.row(y, z) + x) as usize, weight)
    })
}

/// `x`, whose gradient is multiplied by `scale` on its way back.
fn with_gradient_scaled<S: Shape>(
    x: Tensor<S, f32, Cpu, Taped>,
    scale: Tensor<S, f32, Cpu>,
) -> Result<Tensor<S, f32, Cpu, Taped>, EngineError> {
    let constant = x.device().try_tensor_from_vec(x.as_vec(), *x.shape())?;
    // The difference is 0: the value stays what it is to the bit.
    Ok(x.try_sub(constant.clone())?.try_mul(scale)?.try_add(constant)?)
}

/// What known surfaces add to the loss of the rays of these indices, on a tape of its own: see [`Surface`].
fn surfaces(
    rows: &Rows,
    batch: &Batch,
    indices: Range<usize>,
    kept: &KeptSamples,
    weights: &Matrix<Taped>,
    left: &Vector<Taped>,
) -> Result<Scalar, EngineError> {
    let weight =
        |ray: usize| batch.surfaces.get(ray).map_or(0.0, |surface| surface.weight) / batch.rays.len() as f32;
    let counted = indices.clone().zip(&kept.counts);
    let ray_of: Vec<usize> = counted.flat_map(|(ray, &count)| std::iter::repeat_n(ray, count)).collect();
    let cost = rows.constants(|i| {
        let (Some(surface), Some(along)) = (batch.surfaces.get(ray_of[i]), batch.along.get(kept.samples[i]))
        else {
            return 0.0;
        };
        weight(ray_of[i]) * (along - surface.at).abs().min(Surface::CLIP)
    })?;
    let passed = indices.map(|ray| weight(ray) * Surface::CLIP).collect::<Vec<_>>();
    let passed = left.device().try_tensor_from_vec(passed, *left.shape())?;
    let front = weights.with_empty_tape().try_mul(cost)?.try_sum::<Rank0, Axes2<0, 1>>()?;
    Ok(front.try_add(left.with_empty_tape().try_mul(passed)?.try_sum::<Rank0, Axis<0>>()?)?)
}

/// `Σ_ij w_i w_j |s_i − s_j|` over all rays, of samples at distances `s` that ascend along each.
fn distortion(rows: &Rows, weights: Matrix<Taped>, along: Matrix) -> Result<Scalar, EngineError> {
    let front = rows.sums_in_front(weights.with_empty_tape())?;
    let moments = rows.sums_in_front(weights.with_empty_tape().try_mul(along.clone())?)?;
    let pairs = weights.try_mul(front.try_mul(along)?.try_sub(moments)?)?;
    Ok(pairs.try_sum::<Rank0, Axes2<0, 1>>()?.try_mul(2.0)?)
}

impl Engine for GridReferenceEngine {
    fn step(&mut self, batch: &Batch, rate: f64) -> Result<StepLoss, EngineError> {
        check_rate(rate)?;
        batch.check()?;
        let (loss, gradients) = self.differentiate(batch)?;
        self.update(&gradients, rate)?;
        Ok(loss)
    }

    fn gain_gradients(&self, views: usize) -> Vec<[f32; 3]> {
        gain_sums(&self.of_rays.gains, views)
    }

    fn errors(&self) -> Box<dyn Iterator<Item = &(u32, [f32; 3])> + '_> {
        Box::new(self.of_rays.errors.iter())
    }

    fn round_tables(&mut self) {
        if self.state.scales.is_empty() {
            self.state.scales = scales(&self.grid, &self.state.parameters[self.model.layer_parameters()..]);
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
        check_state(state, self.state.parameters.len(), self.grid.resolutions.len())?;
        self.state = state.clone();
        Ok(())
    }
}
