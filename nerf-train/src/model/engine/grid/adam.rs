//! Adam for values whose gradient is not 0, and the steps at which each level of the tables is updated.
//!
//! Adam takes as long for a small gradient as for a large one, and the hashed levels have most of a grid's entries. To
//! save time, a hashed level is updated only at every `hashed_every`th step, by the sum of its gradients since the last
//! update. Since Adam is invariant to the scale of gradients, the mean gradient would give the same step. Dense levels
//! are updated at every step.
//!
//! Weight decay is decoupled (Loshchilov & Hutter 2019) and applies to the colour branch alone, which would otherwise
//! overfit the directions of the photographs.

use crate::model::engine::{Adam, Model, Part};
use nerf_core::encoding::GridLevel;
use nerf_core::simd::{Lanes, Op};

/// Lower bound of the second moment in Adam's division, 1e-15 squared, which keeps every step finite.
const SMALLEST: f32 = 1e-30;

#[derive(Clone, Copy)]
pub(super) struct AdamStep {
    beta1: f32,
    beta2: f32,
    /// Learning rate divided by the first moment's bias correction.
    rate: f32,
    /// Inverse of the second moment's bias correction.
    correction2: f32,
}

impl AdamStep {
    /// Returns the constants of update `step`, counted from 1, at learning rate `rate`.
    pub fn new(adam: &Adam, rate: f64, step: u64) -> Self {
        let step = i32::try_from(step).unwrap_or(i32::MAX);
        let correction = |beta: f64| 1.0 - beta.powi(step);
        let [beta1, beta2] = adam.betas;
        Self {
            beta1: beta1 as f32,
            beta2: beta2 as f32,
            rate: (rate / correction(beta1)) as f32,
            correction2: (1.0 / correction(beta2)) as f32,
        }
    }
}

/// Multiplies the colour branch's weights by 1 − `rate` · weight decay; `parameters`: in the model's order.
pub(super) fn decay_weights(adam: &Adam, rate: f64, model: &Model, parameters: &mut [f32]) {
    let kept = (1.0 - rate * adam.weight_decay) as f32;
    for layer in model.layers() {
        if matches!(layer.part, Part::Colour(_) | Part::Rgb) {
            parameters[layer.weights..layer.bias].iter_mut().for_each(|weight| *weight *= kept);
        }
    }
}

/// Applies Adam to values whose gradient is not 0; values with gradient 0 and their moments do not change.
pub(super) struct Apply<'a> {
    pub step: AdamStep,
    pub values: &'a mut [f32],
    pub moment1: &'a mut [f32],
    pub moment2: &'a mut [f32],
    pub gradient: &'a [f32],
}

impl Op for Apply<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: Lanes>(self) {
        let Self { step, values, moment1, moment2, gradient } = self;
        move_values(step, gradient, values, moment1, moment2);
    }
}

/// Applies Adam to values whose gradient `g` is not 0, sixteen at a time; `m`, `v`: first and second moments.
#[inline(always)]
pub(super) fn move_values(step: AdamStep, g: &[f32], values: &mut [f32], m: &mut [f32], v: &mut [f32]) {
    let (gradients, last_g) = g.as_chunks::<16>();
    let (values, last) = values.as_chunks_mut::<16>();
    let (m, last_m) = m.as_chunks_mut::<16>();
    let (v, last_v) = v.as_chunks_mut::<16>();
    for (((value, m), v), g) in values.iter_mut().zip(m).zip(v).zip(gradients) {
        // If all sixteen gradients are 0, values and moments are neither read nor written.
        if g.iter().fold(0, |any, g| any | g.to_bits() << 1) != 0 {
            for i in 0..16 {
                moved(step, &mut value[i], &mut m[i], &mut v[i], g[i]);
            }
        }
    }
    for (((value, m), v), g) in last.iter_mut().zip(last_m).zip(last_v).zip(last_g) {
        moved(step, value, m, v, *g);
    }
}

/// Returns `1/√x` with a relative error of at most 5e-6, faster than a root and a division. `x`: positive, normal.
///
/// # Source
/// Lomont 2003, with two Newton iterations.
#[inline(always)]
fn reciprocal_root(x: f32) -> f32 {
    let y = f32::from_bits(0x5f37_5a86 - (x.to_bits() >> 1));
    let half = 0.5 * x;
    let y = y * (1.5 - half * y * y);
    y * (1.5 - half * y * y)
}

/// Applies Adam to a value and its moments `m`, `v` if the gradient `g` is not 0. Has no branch, so that a loop of
/// calls can be vectorised.
#[inline(always)]
fn moved(step: AdamStep, value: &mut f32, m: &mut f32, v: &mut f32, g: f32) {
    let new_m = step.beta1 * *m + (1.0 - step.beta1) * g;
    let new_v = step.beta2 * *v + (1.0 - step.beta2) * (g * g);
    let new = *value - step.rate * new_m * reciprocal_root((new_v * step.correction2).max(SMALLEST));
    let some = g != 0.0;
    *value = if some { new } else { *value };
    *m = if some { new_m } else { *m };
    *v = if some { new_v } else { *v };
}

/// Returns the number of updates of a level in steps 1 to `step`; `None` if step `step` does not update the level.
pub(super) fn moves(adam: &Adam, level: &GridLevel, step: u64) -> Option<u64> {
    if level.mask.is_none() {
        return Some(step);
    }
    let (every, first) = (u64::from(adam.hashed_every), level.index as u64);
    let at = step + first;
    at.is_multiple_of(every).then_some(at / every - first / every)
}

/// Returns the number of a level's entries if the level accumulates its gradient over several steps, else 0.
pub(super) fn waiting_entries(adam: &Adam, level: &GridLevel) -> usize {
    if adam.hashed_every > 1 && level.mask.is_some() { level.entries } else { 0 }
}
