//! Ray marching of fields shaded once a ray, a ray in each column of a block: compositing is vector arithmetic over rays.
//!
//! The results are those of `march.rs`, bit for bit. A column holds a ray from its first sample to its last; then the next
//! active ray takes the column. When fewer rays are left than a vector has columns, `march.rs` goes on with them.

use super::deferred::Deferred;
use super::frame::{Frame, VECTOR, columns_of};
use super::march::{ContractPoints, PartsInWorld, RayState};
use crate::math::Math;
use crate::matrix::Storage;
use crate::memory::{at, head, head_mut, put, put_column, tail, tail_mut};
use crate::network::Network;
use crate::plan::Plan;
use crate::simd::{BLOCK, Lanes, Op, VECTORS};
use crate::volume::side_by_side::{self, add_samples, left_of};
use core::marker::PhantomData;

/// Rows of a frame's [`Columns`]; 0 where rays are not marched side by side.
pub(super) fn column_rows(network: &Network<'_>, plan: &Plan<'_>) -> usize {
    let paired = network.kernel().storage == Storage::Bf16;
    let sums = Deferred::row(network, plan);
    let on = VECTORS && sums > 0 && network.whole_blocks() && !paired && plan.marches_side_by_side();
    if on { ROWS + sums } else { 0 }
}

/// The same without the sums of `h`.
const ROWS: usize = 3 + 3 + 1 + 3 + 1 + side_by_side::ROWS;

/// The rays that are marched side by side, one a column; `[rows][BLOCK]` each.
struct Columns<'w> {
    /// Index of each column's ray in the tile.
    owner: [u32; BLOCK],
    origins: &'w mut [f32],
    dirs: &'w mut [f32],
    /// The sample's distance along its ray, in the units of the bins.
    t: &'w mut [f32],
    /// What its bin is, in world units: distance, middle and width. In an unbounded scene first distance, start and end in
    /// the units of the bins.
    parts: &'w mut [f32],
    /// Least distance of an unbounded scene's samples.
    near: &'w mut [f32],
    /// Opacity, distance and optical thickness composited so far: rows of `volume::side_by_side`.
    gathered: &'w mut [f32],
    /// Σ weight · `h` so far, and behind it Σ weight.
    sums: &'w mut [f32],
}

impl<'w> Columns<'w> {
    /// Over `[column_rows][BLOCK]` values.
    fn new(mut memory: &'w mut [f32]) -> Self {
        let mut rows = |rows: usize| {
            let (first, rest) =
                core::mem::take(&mut memory).split_at_mut_checked(rows * BLOCK).unwrap_or_default();
            memory = rest;
            first
        };
        let (origins, dirs, t, parts, near) = (rows(3), rows(3), rows(1), rows(3), rows(1));
        let gathered = rows(side_by_side::ROWS);
        Self { owner: [0; BLOCK], origins, dirs, t, parts, near, gathered, sums: memory }
    }

    /// Puts the sample of `ray` at distance `t` into column `at`.
    #[inline]
    fn put_sample(&mut self, plan: &Plan<'_>, ray: &RayState, at: usize, t: f32) {
        let bins = plan.bins.with(ray.ends);
        put(self.t, at, t);
        if plan.contraction.is_some() {
            let (t, from, to) = bins.ends_around(t);
            put_column(self.parts, BLOCK, at, [t, from, to]);
        } else {
            let (t, _, delta) = bins.part_around(t);
            put_column(self.parts, BLOCK, at, [t, t, delta]);
        }
    }

    /// Starts `ray`, number `owner` of the tile, in column `at`.
    fn begin(&mut self, plan: &Plan<'_>, ray: &RayState, owner: u32, at: usize) {
        put(&mut self.owner, at, owner);
        put_column(self.origins, BLOCK, at, ray.ray.origin.to_array());
        put_column(self.dirs, BLOCK, at, ray.ray.dir.to_array());
        put(self.near, at, plan.near.max(ray.range[0]) - ray.start);
        ray.gathered.put_column(self.gathered, BLOCK, at);
        for row in self.sums.chunks_exact_mut(BLOCK) {
            put(row, at, 0.0);
        }
    }

    /// Writes the composited values of column `at` back to its ray.
    fn end(&self, ray: &mut RayState, deferred: &mut Deferred<'_>, at: usize) {
        ray.gathered.take_column(self.gathered, BLOCK, at);
        let sums = self.sums.chunks_exact(BLOCK).map(|row| crate::memory::at(row, at));
        deferred.put(crate::memory::at(&self.owner, at) as usize, sums);
    }

    /// Copies column `from` to column `to`.
    fn copy(&mut self, from: usize, to: usize) {
        let owner = at(&self.owner, from);
        put(&mut self.owner, to, owner);
        let all = [&mut *self.origins, self.dirs, self.t, self.parts, self.near, self.gathered, self.sums];
        for row in all.into_iter().flat_map(|rows| rows.chunks_exact_mut(BLOCK)) {
            put(row, to, at(row, from));
        }
    }
}

impl Frame<'_, '_> {
    /// Marches the active rays while they fill a vector; those that are left stay active.
    pub(super) fn march_side_by_side<M: Math>(&mut self) {
        if !VECTORS || self.columns.is_empty() || self.active.len() < VECTOR {
            return;
        }
        let memory = core::mem::take(&mut self.columns);
        let mut columns = Columns::new(memory);
        let mut n = 0;
        while n < BLOCK && self.enter(&mut columns, n) {
            n += 1;
        }
        while n >= VECTOR {
            self.counters.add_density(self.network, n);
            self.evaluate_columns(&mut columns, n);
            self.absorb_columns::<M>(&mut columns, n);
            n = self.advance_columns(&mut columns, n);
        }
        for column in 0..n {
            let owner = at(&columns.owner, column);
            if let Some(ray) = self.rays.get_mut(owner as usize) {
                // Its sample is not taken yet.
                ray.next -= 1;
                columns.end(ray, &mut self.deferred, column);
                self.active.push(owner);
            }
        }
        self.columns = memory;
    }

    /// Starts the next active ray in column `at`; `false` if there is none.
    fn enter(&mut self, columns: &mut Columns<'_>, at: usize) -> bool {
        let Some(owner) = self.active.pop() else { return false };
        let Some(ray) = self.rays.get_mut(owner as usize) else { return false };
        let place = ray.place(self.plan, self.turn);
        columns.begin(self.plan, ray, owner, at);
        let t = place.t(&self.plan.bins.with(ray.ends), ray.next);
        columns.put_sample(self.plan, ray, at, t);
        ray.next += 1;
        true
    }

    /// Runs trunk and density head for the samples of the first `n` columns.
    fn evaluate_columns(&mut self, columns: &mut Columns<'_>, n: usize) {
        let (stride, isa) = (columns_of(self.network, n), self.network.isa());
        if let Some(contraction) = &self.plan.contraction {
            for axis in 0..3 {
                let to = head_mut(tail_mut(self.positions, axis * stride), stride);
                to.iter_mut().zip(tail(columns.origins, axis * BLOCK)).for_each(|(to, &from)| *to = from);
            }
            let (positions, dirs, t) = (&mut *self.positions, &*columns.dirs, &*columns.t);
            isa.run(ContractPoints { contraction, stride, dir_stride: BLOCK, positions, dirs, t });
            let (parts, near) = (&mut *columns.parts, &*columns.near);
            isa.run(PartsInWorld { contraction, room: BLOCK, columns: stride, parts, near });
        } else {
            let (origins, dirs, t) = (&*columns.origins, &*columns.dirs, &*columns.t);
            isa.run(Points { stride, origins, dirs, t, to: self.positions });
        }
        self.evaluate_density(stride);
    }

    /// Composites the samples of the first `n` columns.
    fn absorb_columns<M: Math>(&mut self, columns: &mut Columns<'_>, n: usize) {
        let stride = columns_of(self.network, n);
        let Columns { parts, gathered, sums, .. } = columns;
        let h = head(self.scratch.front, self.network.trunk_rows() * stride);
        let sigma = &*self.block.sigma;
        let cut = self.plan.colour_cut;
        let absorb = Absorb::<M> { stride, sigma, h, parts, gathered, sums, cut, math: PhantomData };
        self.network.isa().run_portable(stride, absorb);
    }

    /// Marches the ray of each of the first `n` columns to its next occupied sample, and replaces the rays that end. Returns
    /// the number of columns that have a sample.
    fn advance_columns(&mut self, columns: &mut Columns<'_>, mut n: usize) -> usize {
        let (plan, isa) = (self.plan, self.network.isa());
        let mut column = 0;
        while column < n {
            let owner = at(&columns.owner, column);
            let Some(ray) = self.rays.get_mut(owner as usize) else { return 0 };
            ray.kept += 1;
            self.counters.invalid_samples += u64::from(at(self.block.sigma, column).is_nan());
            ray.done = left_of(columns.gathered, BLOCK, column) < plan.transmittance_cut;
            let place = ray.place(plan, self.turn);
            if !ray.done && ray.march(isa, plan, &plan.bins, place) {
                let t = place.t(&plan.bins.with(ray.ends), ray.next);
                columns.put_sample(plan, ray, column, t);
                ray.next += 1;
                column += 1;
                continue;
            }
            columns.end(ray, &mut self.deferred, column);
            if self.enter(columns, column) {
                column += 1;
                continue;
            }
            // The last column, whose turn is still to come, fills the gap.
            n -= 1;
            columns.copy(n, column);
            put(self.block.sigma, column, at(self.block.sigma, n));
        }
        n
    }
}

/// Positions at distances `t` along rays: `[3][stride]` from origins and directions `[3][BLOCK]`.
struct Points<'a> {
    stride: usize,
    origins: &'a [f32],
    dirs: &'a [f32],
    t: &'a [f32],
    to: &'a mut [f32],
}

impl Op for Points<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: Lanes>(self) {
        for from in (0..self.stride).step_by(V::COUNT) {
            let t = V::load(tail(self.t, from));
            for axis in 0..3 {
                let [origin, dir] =
                    [self.origins, self.dirs].map(|rows| V::load(tail(rows, axis * BLOCK + from)));
                origin.add(dir.mul(t)).store(tail_mut(self.to, axis * self.stride + from));
            }
        }
    }
}

/// Compositing of a block: its densities and `h` are added to its rays.
struct Absorb<'a, M> {
    stride: usize,
    sigma: &'a [f32],
    /// `[rows][stride]`.
    h: &'a [f32],
    parts: &'a [f32],
    gathered: &'a mut [f32],
    /// `[rows + 1][BLOCK]`.
    sums: &'a mut [f32],
    cut: f32,
    math: PhantomData<M>,
}

impl<M: Math> Op for Absorb<'_, M> {
    type Output = ();

    #[inline(always)]
    fn run<V: Lanes>(self) {
        for from in (0..self.stride).step_by(V::COUNT) {
            let [t, delta] = [0, 2].map(|row| V::load(tail(self.parts, row * BLOCK + from)));
            let sample = [V::load(tail(self.sigma, from)), t, delta];
            let weight = add_samples::<M, V>((&mut *self.gathered, BLOCK, from), sample, self.cut);
            let (zero, mut h) = (V::splat(0.0), self.h.chunks_exact(self.stride));
            let takes = zero.less(weight);
            for sums in self.sums.chunks_exact_mut(BLOCK) {
                // Behind the rows of h stands the weight itself.
                let more = h.next().map_or(weight, |row| V::load(tail(row, from)).mul(weight));
                V::load(tail(sums, from)).add(V::select(takes, more, zero)).store(tail_mut(sums, from));
            }
        }
    }
}
