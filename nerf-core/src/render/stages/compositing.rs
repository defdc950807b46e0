//! Compositing: converts a block's densities to weights, and marches each unfinished ray to its next sample.

use super::TileState;
use super::density::of_rays;
use crate::math::{Math, with_math};
use crate::memory::{Layout, at, column, head, put, put_column, tail, tail_mut};
use crate::plan::Plan;
use crate::render::Counters;
use crate::render::field::Field;
use crate::render::march::{RayState, Rays};
use crate::sampling::{Ends, SampleInterval};
use crate::simd::{Lanes, MAX_LANES, Op, VECTORS};
use crate::volume::{alpha, light, thickness};
use core::marker::PhantomData;

const ROWS: usize = 4;

/// Stage that composites a block of samples and picks the samples whose colour or normal is evaluated.
pub(in crate::render) struct Compositing<'w> {
    /// Four rows, `[4][samples]`: optical thickness in front of each sample, distance of each sample, opacity of each
    /// sample, and transmittance behind each sample. The rows of opacity and transmittance first hold optical
    /// thicknesses, which [`Absorb`] converts. `rows` is empty in builds without vector instructions.
    rows: &'w mut [f32],
    /// Indices of the block's columns whose colour or normal is evaluated, ascending: `[samples]`. Empty if neither
    /// colour nor normals are requested.
    picked: &'w mut [u32],
    weight: &'w mut [f32],
    pub count: usize,
}

impl<'w> Compositing<'w> {
    pub fn lay_out(layout: &mut impl Layout<'w>, field: Field<'_>) -> Self {
        let samples = field.block_samples();
        let picks = if field.plan.outputs.picks() { samples } else { 0 };
        Self {
            rows: layout.slice(if VECTORS { ROWS * samples } else { 0 }, 0.0),
            picked: layout.slice(picks, 0),
            weight: layout.slice(picks, 0.0),
            count: 0,
        }
    }

    /// Iterates over the samples of the block that were picked for colour or normal. Yields each sample's column, and
    /// the weight of its colour and normal.
    #[inline]
    pub fn iter(&self) -> impl Iterator<Item = (usize, f32)> {
        let picked = head(self.picked, self.count).iter().zip(&*self.weight);
        picked.map(|(&column, &weight)| (column as usize, weight))
    }

    /// Composites the block's samples and picks those whose colour or normal is evaluated. Marches each unfinished ray
    /// to its next sample in an occupied cell. Samples of a ray that has ended are ignored and not counted. If `COLLIDE`
    /// is true, a ray ends at the sample in which its photon collides, and this sample alone is picked, with weight 1.
    pub fn run<const COLLIDE: bool>(&mut self, tile: &mut TileState<'_, '_>, counters: &mut Counters) {
        // In builds without vectors, a separate pass would need more code and save no time.
        if VECTORS && !COLLIDE {
            self.absorb(tile);
        }
        let TileState { field, rays, density, surface } = tile;
        let (field, plan, medians, n) = (*field, field.plan, &mut surface.medians, density.count);
        let (room, picks) = (density.owner.len(), plan.outputs.picks());
        let Rays { states, active, samples, turn, .. } = rays;
        let (mut used, mut picked) = (0, 0);
        for column in 0..n {
            let owner = at(density.owner, column);
            let Some(state) = states.get_mut(owner as usize) else { break };
            if state.pixel.done {
                continue;
            }
            state.kept += 1;
            used += 1;
            let sigma = at(density.sigma, column);
            if sigma.is_nan() {
                counters.invalid_samples += 1;
            } else if sigma > 0.0 {
                let interval =
                    |state: &RayState| samples.interval(field, owner, state, column, at(density.t, column));
                let mut before = state.pixel.gathered.optical_thickness();
                let weight = if COLLIDE {
                    let SampleInterval { mid, delta, .. } = interval(state);
                    state.pixel.gathered.add_thickness(thickness(sigma, delta));
                    state.pixel.done = state.pixel.gathered.collide(before, sigma, mid, delta);
                    state.pixel.done.then_some(1.0)
                } else {
                    if VECTORS {
                        let [front, t, alpha, light] = self::column(self.rows, room, column);
                        before = front;
                        state.pixel.gathered.add_alpha(alpha, light, t);
                    } else {
                        let SampleInterval { t, delta, .. } = interval(state);
                        state.pixel.gathered.add_density(plan.math, sigma, t, delta);
                    }
                    if medians.passes(owner, &state.pixel.gathered) {
                        let SampleInterval { mid, delta, .. } = interval(state);
                        medians.put(owner, before, sigma, [mid, delta]);
                    }
                    state.pixel.done = state.pixel.gathered.transmittance() < plan.transmittance_cut;
                    if picks { state.pixel.gathered.take_uncoloured(plan.colour_cut) } else { None }
                };
                if picks && let Some(weight) = weight {
                    put(self.picked, picked, column as u32);
                    put(self.weight, picked, weight);
                    picked += 1;
                }
            }
            let last = column + 1 == n || at(density.owner, column + 1) != owner;
            if last && !state.pixel.done {
                let jitter = state.pixel.jitter(plan, *turn);
                if samples.march(field, owner, state, jitter) {
                    active.push(owner);
                }
            }
        }
        self.count = picked;
        counters.add_density(field.network, used);
    }

    /// Adds the optical thickness of the block's samples to their rays. Computes the opacity of each sample and the
    /// transmittance behind each sample.
    ///
    /// The exponentials are computed up to sixteen at a time. The results are bit-identical on every instruction set.
    fn absorb(&mut self, TileState { field, rays, density, .. }: &mut TileState<'_, '_>) {
        let (field, n, room) = (*field, density.count, density.owner.len());
        let (plan, isa) = (field.plan, field.isa());
        if plan.contraction.is_some() {
            let (owner, t, columns) = (&*density.owner, &*density.t, field.columns(n));
            let to = tail_mut(self.rows, room);
            isa.run_columns(columns, Intervals { plan, columns, room, rays: rays.states, owner, t, to });
        }
        for column in 0..n {
            let owner = at(density.owner, column);
            let Some(state) = rays.states.get_mut(owner as usize) else { break };
            let before = state.pixel.gathered.optical_thickness();
            let (sigma, mut t, mut tau) = (at(density.sigma, column), 0.0, 0.0);
            if sigma > 0.0 {
                let delta;
                if plan.contraction.is_some() {
                    [t, delta] = self::column(tail(self.rows, room), room, column);
                } else {
                    SampleInterval { t, delta, .. } =
                        rays.samples.interval(field, owner, state, column, at(density.t, column));
                }
                tau = thickness(sigma, delta);
            }
            let total = state.pixel.gathered.add_thickness(tau);
            put_column(self.rows, room, column, [before, t, tau, total]);
        }
        // A multiple of the portable vector's number of lanes, which is the same with every instruction set.
        let columns = field.columns(n).next_multiple_of(MAX_LANES).min(room);
        if let Some((alpha, light)) = tail_mut(self.rows, 2 * room).split_at_mut_checked(room) {
            let [alpha, light] = [alpha, light].map(|row| &mut row[..columns]);
            with_math!(plan.math, M => {
                isa.run_portable(columns, Absorb::<M> { alpha, light, math: PhantomData });
            });
        }
    }
}

/// Vector loop that converts two rows in place. Row `alpha`: optical thickness of each sample, converted to opacity.
/// Row `light`: optical thickness from the ray's start to behind each sample, converted to transmittance.
struct Absorb<'a, M> {
    alpha: &'a mut [f32],
    light: &'a mut [f32],
    math: PhantomData<M>,
}

impl<M: Math> Op for Absorb<'_, M> {
    type Output = ();

    #[inline(always)]
    fn run<V: Lanes>(self) {
        for (a, l) in self.alpha.chunks_exact_mut(V::COUNT).zip(self.light.chunks_exact_mut(V::COUNT)) {
            alpha::<M, V>(V::load(a)).store(a);
            light::<M, V>(V::load(l)).store(l);
        }
    }
}

/// Vector loop for unbounded scenes that computes the distance of each sample and the width of its interval, world
/// units. `to`: a row of distances and a row of widths, `[2][room]`. `room`: largest number of samples of a block.
struct Intervals<'a> {
    plan: &'a Plan<'a>,
    columns: usize,
    room: usize,
    rays: &'a [RayState],
    owner: &'a [u32],
    t: &'a [f32],
    to: &'a mut [f32],
}

impl Op for Intervals<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: Lanes>(self) {
        let Self { plan, columns, room, rays, owner, t, to } = self;
        for from in (0..columns).step_by(V::COUNT) {
            let values = |state: &RayState| {
                let [start, low, high, far, stop] = state.ends.parts();
                [start, low, high, far, stop, plan.least_distance(state.pixel.start, state.pixel.range[0])]
            };
            let [start, low, high, far, stop, near] =
                of_rays::<V, { Ends::PARTS + 1 }>(rays, &owner[from..], values);
            let interval = plan.spacing().interval([start, low, high, far, stop], near, V::load(&t[from..]));
            interval.t.store(tail_mut(to, from));
            interval.delta.store(tail_mut(to, room + from));
        }
    }
}
