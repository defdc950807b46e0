//! A dense layer and volume rendering, written with dfdx tensors: shared by the two engines that use the tape.
//!
//! A tensor's tape records its operations; operations on a tensor without a tape are not recorded. `retaped` begins
//! an empty tape. If a value is used twice, each use has its own tape, and the loss merges them.

use super::{Dense, EngineError};
use dfdx::prelude::*;

pub(super) type Matrix<T = NoneTape> = Tensor<(usize, usize), f32, Cpu, T>;
pub(super) type Vector<T = NoneTape> = Tensor<(usize,), f32, Cpu, T>;
pub(super) type Scalar = Tensor<Rank0, f32, Cpu, Taped>;
pub(super) type Taped = OwnedTape<f32, Cpu>;

/// Number of samples at which a tape gets no further ray. Activations of the 8×256 network then take about 300 MiB.
pub(super) const TAPE_SAMPLES: usize = 4096;

/// Parameters of one layer; main and extra inputs have separate matrices, as dfdx has no concatenation.
pub(super) struct Weights {
    main: Matrix,
    extra: Option<Matrix>,
    bias: Vector,
}

impl Weights {
    /// Copies the parameters of layer `d` out of `parameters`, the parameters of all layers.
    pub(super) fn of(device: &Cpu, d: &Dense, parameters: &[f32]) -> Result<Self, EngineError> {
        let rows = || parameters[d.weights..d.bias].chunks_exact(d.inputs());
        let main = rows().flat_map(|row| &row[..d.main]).copied().collect();
        let extra = rows().flat_map(|row| &row[d.main..]).copied().collect();
        let bias = parameters[d.bias..][..d.outputs].to_vec();
        Ok(Self {
            main: device.try_tensor_from_vec(main, (d.outputs, d.main))?,
            extra: match d.extra {
                0 => None,
                columns => Some(device.try_tensor_from_vec(extra, (d.outputs, columns))?),
            },
            bias: device.try_tensor_from_vec(bias, (d.outputs,))?,
        })
    }

    /// Returns `W [x, extra] + b`, `[samples][outputs]`. `x`: main inputs, `[samples][main]`; `extra`: extra inputs.
    pub(super) fn apply<T: Tape<f32, Cpu>>(
        &self,
        x: Matrix<T>,
        extra: Option<&Matrix>,
    ) -> Result<Matrix<T>, EngineError> {
        let mut y = x.try_matmul(self.main.retaped::<T>().try_permute::<_, Axes2<1, 0>>()?)?;
        if let (Some(weights), Some(x)) = (&self.extra, extra) {
            let weights = weights.retaped::<T>().try_permute::<_, Axes2<1, 0>>()?;
            y = y.try_add(x.retaped::<T>().try_matmul(weights)?)?;
        }
        let shape = *y.shape();
        Ok(y.try_add(self.bias.retaped::<T>().try_broadcast_like::<_, Axis<0>>(&shape)?)?)
    }

    /// Adds the gradient of layer `d`, taken from `found`, to its range of `out`, the gradient of all parameters.
    pub(super) fn collect(
        &self,
        d: &Dense,
        found: &mut Gradients<f32, Cpu>,
        out: &mut [f32],
    ) -> Result<(), EngineError> {
        let parts = [(Some(&self.main), 0, d.main), (self.extra.as_ref(), d.main, d.extra)];
        for (tensor, first, columns) in parts {
            let Some(tensor) = tensor else { continue };
            let rows = found.get_or_alloc_mut(tensor)?.chunks_exact(columns);
            for (to, row) in out[d.weights..d.bias].chunks_exact_mut(d.inputs()).zip(rows) {
                add(&mut to[first..first + columns], row);
            }
        }
        add(&mut out[d.bias..][..d.outputs], found.get_or_alloc_mut(&self.bias)?);
        Ok(())
    }
}

pub(super) fn add(to: &mut [f32], values: &[f32]) {
    to.iter_mut().zip(values).for_each(|(to, value)| *to += value);
}

/// Arrangement of a list of samples as a matrix, `[rays][longest]`. Each ray has one row, padded to the number of
/// samples of the longest ray. The list holds the samples ray after ray.
pub(super) struct Rows {
    device: Cpu,
    shape: (usize, usize),
    /// Index, in the list of samples, of each matrix element; `None` after a ray's last sample.
    places: Vec<Option<usize>>,
    index: Tensor<(usize,), usize, Cpu>,
}

impl Rows {
    /// Arranges rays as rows. `samples`: number of samples of each ray; at least one ray must have samples.
    pub(super) fn new(device: &Cpu, samples: &[usize]) -> Result<Self, EngineError> {
        let longest = samples.iter().copied().max().unwrap_or(0);
        let mut places = Vec::with_capacity(samples.len() * longest);
        let mut first = 0;
        for &count in samples {
            places.extend((0..longest).map(|i| (i < count).then_some(first + i)));
            first += count;
        }
        let index = places.iter().map(|place| place.unwrap_or(0)).collect();
        let index = device.try_tensor_from_vec(index, (places.len(),))?;
        Ok(Self { device: device.clone(), shape: (samples.len(), longest), places, index })
    }

    /// Returns `values(i)` of each sample `i` as constants, `[rays][longest]`; 0 after a ray's last sample.
    pub(super) fn constants(&self, values: impl Fn(usize) -> f32) -> Result<Matrix, EngineError> {
        let values = self.places.iter().map(|place| place.map_or(0.0, &values)).collect();
        Ok(self.device.try_tensor_from_vec(values, self.shape)?)
    }

    /// Arranges values of samples by ray, `[rays][longest]`. Elements after a ray's last sample are arbitrary.
    pub(super) fn of<T: Tape<f32, Cpu>>(&self, values: Vector<T>) -> Result<Matrix<T>, EngineError> {
        Ok(values.try_gather(self.index.clone())?.try_reshape_like(&self.shape)?)
    }

    /// Returns `Σ_i weight_i value_i` over the samples of each ray, `[rays][channels]`. `weights`: `[rays][longest]`, 0
    /// after a ray's last sample; `values`: `[samples][channels]`.
    pub(super) fn sums(
        &self,
        weights: Matrix<Taped>,
        values: Matrix<Taped>,
    ) -> Result<Matrix<Taped>, EngineError> {
        let (rays, longest) = self.shape;
        let shape = (rays, longest, values.shape().1);
        let values: Matrix<Taped> = values.try_gather(self.index.clone())?;
        let weights = weights.try_broadcast_like::<_, Axis<2>>(&shape)?;
        Ok(weights.try_mul(values.try_reshape_like(&shape)?)?.try_sum::<(usize, usize), Axis<1>>()?)
    }

    /// Returns `Σ_{j<i} x_j` for each sample `i` of each ray, `[rays][longest]`: a product with a triangular matrix.
    pub(super) fn sums_in_front(&self, x: Matrix<Taped>) -> Result<Matrix<Taped>, EngineError> {
        let longest = self.shape.1;
        Ok(x.try_matmul(self.device.try_upper_tri_like(&(longest, longest), 1.0, 1)?)?)
    }

    /// Returns `T_i = exp(−Σ_{j<i} tau_j)` before each sample, and `T_end` after each ray's last sample. `tau`: optical
    /// depths, `[rays][longest]`, 0 after a ray's last sample.
    pub(super) fn transmittance(
        &self,
        tau: Matrix<Taped>,
    ) -> Result<(Matrix<Taped>, Vector<Taped>), EngineError> {
        let front = self.sums_in_front(tau.with_empty_tape())?.try_negate()?.try_exp()?;
        let transmittance = tau.try_sum::<(usize,), Axis<1>>()?.try_negate()?.try_exp()?;
        Ok((front, transmittance))
    }
}

/// Composites colours over `background`, `[rays][3]`. `shown`: Σ weight · colour of each ray, `[rays][3]`;
/// `transmittance`: transmittance at the end of each ray.
pub(super) fn over(
    shown: Matrix<Taped>,
    transmittance: Vector<Taped>,
    background: Matrix,
) -> Result<Matrix<Taped>, EngineError> {
    let shape = *shown.shape();
    Ok(shown.try_add(transmittance.try_broadcast_like::<_, Axis<1>>(&shape)?.try_mul(background)?)?)
}

/// Returns `alpha = 1 − exp(−tau)` of optical depths `tau`.
pub(super) fn alpha(tau: Matrix<Taped>) -> Result<Matrix<Taped>, EngineError> {
    Ok(tau.try_negate()?.try_exp()?.try_negate()?.try_add(1.0)?)
}

/// Returns `scale · Σ (shown − target)²`, computed in f32.
pub(super) fn squared_error(shown: Matrix<Taped>, target: Matrix, scale: f32) -> Result<Scalar, EngineError> {
    let squares = shown.try_sub(target)?.try_square()?;
    Ok(squares.try_sum::<Rank0, Axes2<0, 1>>()?.try_mul(scale)?)
}

/// Returns `value` with the operations of `tape` added to the tape of `value`.
pub(super) fn with_tape<S: Shape>(
    value: Tensor<S, f32, Cpu, Taped>,
    tape: Taped,
) -> Tensor<S, f32, Cpu, Taped> {
    let (value, own) = value.split_tape();
    value.put_tape(own.merge(tape))
}
