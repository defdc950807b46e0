//! Evaluation of trunk and density head for a block of samples.

use crate::camera::Ray;
use crate::memory::{Layout, at, put, put_column, tail_mut};
use crate::network::Scratch;
use crate::render::field::Field;
use crate::render::march::RayState;
use crate::sampling::Spacing;
use crate::simd::{Lanes, MAX_LANES, Op, VECTORS};

/// A block of samples at which trunk and density head are evaluated; each buffer is `[samples]` unless noted.
pub(in crate::render) struct Density<'w> {
    /// Index of each sample's ray; samples of one ray are adjacent, in marching order.
    pub owner: &'w mut [u32],
    /// Distance of each sample along its ray, world units. In an unbounded scene, `t` is the position `s` along
    /// the ray, which [`Contraction::distance`](crate::space::Contraction::distance) converts to a distance.
    pub t: &'w mut [f32],
    pub sigma: &'w mut [f32],
    /// Positions of the samples in the network's space (contracted in an unbounded scene), `[3][stride]`.
    pub positions: &'w mut [f32],
    /// Buffers of the network's layers; `stride` is the number of columns of the current block.
    pub scratch: Scratch<'w>,
    /// Number of samples of the block that was last evaluated.
    pub count: usize,
}

impl<'w> Density<'w> {
    /// Reserves memory for blocks of `samples` samples. `encoded`: number of rows of [`Scratch::encoded`].
    /// `activations`: number of rows of [`Scratch::front`] and [`Scratch::back`].
    pub fn lay_out(layout: &mut impl Layout<'w>, samples: usize, encoded: usize, activations: usize) -> Self {
        Self {
            owner: layout.slice(samples, 0),
            t: layout.slice(samples, 0.0),
            sigma: layout.slice(samples, 0.0),
            positions: layout.slice(3 * samples, 0.0),
            scratch: Scratch {
                stride: samples,
                encoded: layout.slice(encoded * samples, 0.0),
                front: layout.slice(activations * samples, 0.0),
                back: layout.slice(activations * samples, 0.0),
            },
            count: 0,
        }
    }

    /// Puts the sample at distance `t` on ray `owner` into column `column`. `t`: in the units of [`Density::t`].
    #[inline]
    pub fn put(&mut self, column: usize, owner: u32, t: f32) {
        put(self.owner, column, owner);
        put(self.t, column, t);
    }

    /// Computes the positions of the block's `n` samples, in the network's space, from `self.t` and `rays`.
    pub fn place(&mut self, field: Field<'_>, n: usize, rays: &[RayState]) {
        let stride = field.columns(n);
        // Padding columns are copies of the block's last sample; without vectors there is no padding.
        if VECTORS {
            let last = n.saturating_sub(1);
            let (owner, t) = (at(self.owner, last), at(self.t, last));
            (n..stride).for_each(|column| self.put(column, owner, t));
        }
        let (owner, t, to) = (&*self.owner, &*self.t, &mut *self.positions);
        if VECTORS && field.plan.contraction.is_some() {
            let spacing = field.plan.spacing();
            return field.isa().run_columns(stride, Place { spacing, stride, rays, owner, t, to });
        }
        for column in 0..stride {
            let Some(state) = rays.get(at(owner, column) as usize) else { break };
            put_column(to, stride, column, field.plan.point(&state.pixel.ray, at(t, column)).to_array());
        }
    }

    /// Evaluates trunk and density head for the first `n` samples of `self.positions`: `[3][stride]`, where the stride
    /// is [`Field::columns`] of `n`.
    pub fn evaluate(&mut self, field: Field<'_>, n: usize) {
        (self.count, self.scratch.stride) = (n, field.columns(n));
        field.network.trunk(field.plan.math, &mut self.scratch, self.positions);
        field.network.density(field.plan.math, &self.scratch, self.sigma);
    }
}

/// Vector loop for unbounded scenes that computes the points of samples in the network's space. `t`: distances, as in
/// [`Density::t`]. `to`: points, `[3][stride]`.
struct Place<'a> {
    spacing: Spacing<'a>,
    stride: usize,
    rays: &'a [RayState],
    owner: &'a [u32],
    t: &'a [f32],
    to: &'a mut [f32],
}

impl Op for Place<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: Lanes>(self) {
        let Self { spacing, stride, rays, owner, t, to } = self;
        for from in (0..stride).step_by(V::COUNT) {
            let values = |state: &RayState| {
                let Ray { origin, dir } = state.pixel.ray;
                [origin.x, origin.y, origin.z, dir.x, dir.y, dir.z]
            };
            let [x, y, z, u, v, w] = of_rays::<V, 6>(rays, &owner[from..], values);
            let p = spacing.point([x, y, z], [u, v, w], V::load(&t[from..]));
            for (axis, p) in p.into_iter().enumerate() {
                p.store(tail_mut(to, axis * stride + from));
            }
        }
    }
}

/// Gathers `N` values of each sample's ray into vectors, one sample per SIMD lane. `owner`: index of each sample's ray.
/// `of`: function that takes a ray and returns its `N` values.
#[inline(always)]
pub(super) fn of_rays<V: Lanes, const N: usize>(
    rays: &[RayState],
    owner: &[u32],
    of: impl Fn(&RayState) -> [f32; N],
) -> [V; N] {
    let mut rows = [[0.0; MAX_LANES]; N];
    for (lane, &ray) in owner.iter().enumerate().take(V::COUNT) {
        if let Some(state) = rays.get(ray as usize) {
            for (row, value) in rows.iter_mut().zip(of(state)) {
                row[lane] = value;
            }
        }
    }
    let mut values = [V::splat(0.0); N];
    for (value, row) in values.iter_mut().zip(&rows) {
        *value = V::load(row);
    }
    values
}

/// Reduces the stride of a block, in place, from `from` to `to` values per row. Keeps the first `n` values of each of
/// the `rows` rows. Does nothing unless `to < from`.
pub(in crate::render) fn narrow(block: &mut [f32], rows: usize, [from, to]: [usize; 2], n: usize) {
    if to < from {
        for row in 1..rows {
            for column in 0..n {
                let value = at(block, row * from + column);
                put(block, row * to + column, value);
            }
        }
    }
}
