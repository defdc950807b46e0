//! Loops over the elements of slices, compiled for each instruction set.

use crate::model::engine::graph::VECTOR;
use nerf_core::math::polynomial::exp;
use nerf_core::simd::{Lanes, Op};

/// Computes sigma `out[i] = exp(min(x[i] + bias, limit))`; NaN stays NaN. The length must be a multiple of [`VECTOR`].
pub(super) struct Exponentials<'a> {
    pub x: &'a [f32],
    pub bias: f32,
    pub limit: f32,
    pub out: &'a mut [f32],
}

impl Op for Exponentials<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: Lanes>(self) {
        for (x, out) in self.x.chunks_exact(V::COUNT).zip(self.out.chunks_exact_mut(V::COUNT)) {
            let x = V::load(x).add(V::splat(self.bias));
            // The lower limit, -87, is applied in `exp`. NaN compares false, and stays NaN.
            let limited = V::select(V::splat(self.limit).less(x), V::splat(self.limit), x);
            V::select(limited.equals(limited), exp(limited), limited).store(out);
        }
    }
}

/// Computes the transmittance `out[i] = exp(−a[i] · b[i])` of intervals with sigma `a[i]` and length `b[i]`.
pub(super) struct Transmitted<'a> {
    pub a: &'a [f32],
    pub b: &'a [f32],
    pub out: &'a mut [f32],
}

impl Op for Transmitted<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: Lanes>(self) {
        let columns = self.a.chunks_exact(V::COUNT).zip(self.b.chunks_exact(V::COUNT));
        for ((a, b), out) in columns.zip(self.out.chunks_exact_mut(V::COUNT)) {
            let x = V::load(a).mul(V::load(b)).neg();
            V::select(x.equals(x), exp(x), x).store(out);
        }
    }
}

/// Replaces `x[i]` by its sigmoid, `1 / (1 + exp(−x[i]))`.
pub(super) struct Sigmoids<'a> {
    pub x: &'a mut [f32],
}

impl Op for Sigmoids<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: Lanes>(self) {
        for x in self.x.chunks_exact_mut(V::COUNT) {
            let v = V::load(x);
            let one = V::splat(1.0);
            let y = one.div(one.add(exp(v.neg())));
            V::select(v.equals(v), y, v).store(x);
        }
    }
}

/// Backward pass of a ReLU with outputs `h`: sets the gradient `d[i]` to 0 if `h[i]` is not above 0.
pub(super) struct Mask<'a> {
    pub d: &'a mut [f32],
    pub h: &'a [f32],
}

impl Op for Mask<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: Lanes>(self) {
        let zero = V::splat(0.0);
        for (d, h) in self.d.chunks_exact_mut(V::COUNT).zip(self.h.chunks_exact(V::COUNT)) {
            V::select(zero.less(V::load(h)), V::load(d), zero).store(d);
        }
    }
}

/// Transposes `channels`, `[channels][stride]`, to `rows`, `[count][width]`: a row per sample, a column per channel.
pub(super) fn to_rows(channels: &[f32], stride: usize, count: usize, rows: &mut [f32], width: usize) {
    for (sample, row) in rows.chunks_exact_mut(width).take(count).enumerate() {
        for (value, channel) in row.iter_mut().zip(channels.chunks_exact(stride)) {
            *value = channel[sample];
        }
    }
}

/// Fills `to`, whose length must be a multiple of [`VECTOR`], from the start of `from`, without a call of `memcpy`.
pub(super) fn copy_row(from: &[f32], to: &mut [f32]) {
    for (to, from) in to.as_chunks_mut::<VECTOR>().0.iter_mut().zip(from.as_chunks::<VECTOR>().0) {
        *to = *from;
    }
}
