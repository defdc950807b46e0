//! Ray marching with deferred shading, one ray per column of a block: vector instructions march one ray per SIMD lane.
//!
//! A column holds a ray from the ray's first sample to its last; then the next active ray takes the column. When fewer
//! rays are left than a vector has lanes, the module `compositing` marches the remaining rays. The results are
//! bit-identical to those of `compositing` alone.

use super::TileState;
use super::per_ray::Deferred;
use crate::math::{Math, with_math};
use crate::matrix::Storage;
use crate::memory::{Layout, at, head, put, tail, tail_mut};
use crate::plan::Plan;
use crate::render::Counters;
use crate::render::field::Field;
use crate::render::march::{RayState, Rays};
use crate::sampling::Ends;
use crate::simd::{BLOCK, Lanes, MAX_LANES, Op, VECTORS};
use crate::volume::side_by_side::{self, LEFT, add_samples};
use core::marker::PhantomData;

/// Number of rows of [`Columns`], not counting `sums`: the number of rows of `sums` depends on the network. Each row
/// has one value per ray. The terms below are, in order: origin, direction, position, interval, least distance, bin
/// cuts, compositing state.
const ROWS: usize = 3 + 3 + 1 + 2 + 1 + Ends::PARTS + side_by_side::ROWS;

/// Whether each sample lies in the middle of its bin and bins are in world units. A bin's index then determines the
/// sample's position.
fn in_middles(plan: &Plan<'_>) -> bool {
    plan.contraction.is_none() && plan.effects.jitter.is_none()
}

/// One value for each column of a block. A column holds one ray.
type Row = [f32; BLOCK];

/// Memory for the rows of [`Columns`], `[rows][BLOCK]`; empty in frames that do not march one ray per column.
pub(in crate::render) struct ColumnMarch<'w> {
    memory: &'w mut [f32],
}

impl<'w> ColumnMarch<'w> {
    pub fn lay_out(layout: &mut impl Layout<'w>, field: Field<'_>) -> Self {
        let (network, sums) = (field.network, Deferred::row(field));
        let paired = network.kernel().storage == Storage::Bf16;
        let on =
            VECTORS && sums > 0 && network.whole_blocks() && !paired && field.plan.marches_side_by_side();
        Self { memory: layout.slice(if on { (ROWS + sums) * BLOCK } else { 0 }, 0.0) }
    }

    /// Marches active rays in SIMD lanes until too few are left to fill a vector. The remaining rays stay active.
    pub fn run(
        &mut self,
        tile: &mut TileState<'_, '_>,
        deferred: &mut Deferred<'_>,
        counters: &mut Counters,
    ) {
        let TileState { field, rays, density, .. } = tile;
        let field = *field;
        if !VECTORS || rays.active.len() < MAX_LANES {
            return;
        }
        let Some(mut columns) = Columns::new(field.plan, self.memory) else { return };
        let mut n = 0;
        while n < BLOCK && columns.enter(rays, n) {
            n += 1;
        }
        while n >= MAX_LANES {
            counters.add_density(field.network, n);
            let stride = n.next_multiple_of(MAX_LANES);
            field.isa().run(Samples { stride, columns: &mut columns, to: density.positions });
            density.evaluate(field, stride);
            let h = head(density.scratch.front, field.network.trunk_rows() * stride);
            with_math!(field.plan.math, M => {
                let (sigma, columns, math) = (&*density.sigma, &mut columns, PhantomData);
                field.isa().run_portable(stride, Absorb::<M> { stride, sigma, h, columns, math });
            });
            let sigma = head(density.sigma, n);
            counters.invalid_samples += sigma.iter().map(|sigma| u64::from(sigma.is_nan())).sum::<u64>();
            n = columns.advance(rays, deferred, n);
        }
        for column in 0..n {
            let owner = at(&columns.owner, column);
            if let Some(ray) = rays.states.get_mut(owner as usize) {
                // Steps back, since the ray's sample in this column has not been evaluated.
                ray.next -= 1;
                columns.end(ray, deferred, column);
                rays.active.push(owner);
            }
        }
    }
}

/// Rays that are marched at the same time, one per column of a block.
struct Columns<'a> {
    plan: &'a Plan<'a>,
    /// Index of each column's ray in the tile.
    owner: [u32; BLOCK],
    origins: &'a mut [Row; 3],
    dirs: &'a mut [Row; 3],
    /// Position of each column's sample along the ray, in the unit of the plan's bins; the bin's index if
    /// [`in_middles`] is true.
    t: &'a mut Row,
    /// Two rows, world units. First row: the distance of each sample along its ray, whose weighted mean is
    /// `ray_distance`. Second row: width of each sample's interval.
    intervals: &'a mut [Row; 2],
    /// Least distance of a sample on each ray, world units ([`Plan::least_distance`]). Used in unbounded scenes only.
    near: &'a mut Row,
    /// Limits at which each ray cuts its first and last bin, in the unit of the bins: one row per value of
    /// [`Ends::parts`].
    ends: &'a mut [Row; Ends::PARTS],
    /// Compositing state of each ray, without colour: transmittance, and sums over the samples composited so far.
    gathered: &'a mut side_by_side::Rows,
    /// Sums over each ray's samples so far: one row of Σ weight · `h` per hidden feature, then one row of Σ weight.
    sums: &'a mut [Row],
}

impl<'a> Columns<'a> {
    /// Divides `memory`, `[rows][BLOCK]`, into rows; returns `None` if `memory` is too short.
    fn new(plan: &'a Plan<'a>, memory: &'a mut [f32]) -> Option<Self> {
        let (rows, _) = memory.as_chunks_mut();
        let (origins, rows) = rows.split_first_chunk_mut()?;
        let (dirs, rows) = rows.split_first_chunk_mut()?;
        let (t, rows) = rows.split_first_mut()?;
        let (intervals, rows) = rows.split_first_chunk_mut()?;
        let (near, rows) = rows.split_first_mut()?;
        let (ends, rows) = rows.split_first_chunk_mut()?;
        let (gathered, sums) = rows.split_first_chunk_mut()?;
        Some(Self { plan, owner: [0; BLOCK], origins, dirs, t, intervals, near, ends, gathered, sums })
    }

    /// Puts the next sample of `ray` into column `at`, and advances `ray.next`. `turn`: index of the ray in its pixel.
    #[inline(always)]
    fn put_sample(&mut self, ray: &mut RayState, turn: u32, at: usize) {
        self.t[at % BLOCK] = if in_middles(self.plan) {
            ray.next as f32
        } else {
            ray.pixel.jitter(self.plan, turn).t(&self.plan.bins.with(ray.ends), ray.next)
        };
        ray.next += 1;
    }

    /// Takes the next ray from the queue of active rays and puts it, with its next sample, into column `at`. Returns
    /// `false` if the queue is empty.
    fn enter(&mut self, rays: &mut Rays<'_, '_>, at: usize) -> bool {
        let Some(owner) = rays.active.pop() else { return false };
        let Some(ray) = rays.states.get_mut(owner as usize) else { return false };
        let at = at % BLOCK;
        let line = &ray.pixel;
        self.owner[at] = owner;
        for axis in 0..3 {
            self.origins[axis][at] = line.ray.origin[axis];
            self.dirs[axis][at] = line.ray.dir[axis];
        }
        self.near[at] = self.plan.least_distance(line.start, line.range[0]);
        for (row, end) in self.ends.iter_mut().zip(ray.ends.parts()) {
            row[at] = end;
        }
        line.gathered.put_column(self.gathered, at);
        for row in &mut *self.sums {
            row[at] = 0.0;
        }
        self.put_sample(ray, rays.turn, at);
        true
    }

    /// Copies the results of column `at` to its ray: the column's sums to `deferred`, its compositing state to `ray`.
    #[inline]
    fn end(&self, ray: &mut RayState, deferred: &mut Deferred<'_>, at: usize) {
        ray.pixel.gathered.take_column(self.gathered, at);
        deferred.put(self.owner[at % BLOCK] as usize, self.sums.iter().map(|row| row[at % BLOCK]));
    }

    fn copy(&mut self, from: usize, to: usize) {
        let (from, to) = (from % BLOCK, to % BLOCK);
        self.owner[to] = self.owner[from];
        (self.t[to], self.near[to]) = (self.t[from], self.near[from]);
        let copy = |rows: &mut [Row]| {
            for row in rows {
                row[to] = row[from];
            }
        };
        copy(self.origins);
        copy(self.dirs);
        copy(self.ends);
        copy(self.gathered);
        copy(self.sums);
    }

    /// Marches the ray of each of the first `n` columns to its next sample in an occupied cell. If a ray ends, the next
    /// ray without a column takes the ended ray's column. If all rays have had a column, the last column in use is
    /// moved there, so that the columns in use are always the first ones. Returns the number of columns in use; each of
    /// these has a sample.
    fn advance(&mut self, rays: &mut Rays<'_, '_>, deferred: &mut Deferred<'_>, mut n: usize) -> usize {
        let (mut waiting, mut waits) = ([0; BLOCK], 0);
        let (mut marching, mut marches) = ([0; BLOCK], 0);
        for column in 0..n.min(BLOCK) {
            let owner = self.owner[column];
            let Some(ray) = rays.states.get_mut(owner as usize) else { return 0 };
            ray.kept += 1;
            ray.pixel.done = self.gathered[LEFT][column] < self.plan.transmittance_cut;
            if !ray.pixel.done {
                if ray.march_looked_up() {
                    self.put_sample(ray, rays.turn, column);
                    continue;
                }
                put(&mut marching, marches, owner);
                marches += 1;
            }
            put(&mut waiting, waits, column);
            waits += 1;
        }
        rays.march_all(head(&marching, marches));
        // In descending order. A gap is filled with a copy of the last column, which must have its next sample by then.
        for &column in head(&waiting, waits).iter().rev() {
            let Some(ray) = rays.states.get_mut(at(&self.owner, column) as usize) else { return 0 };
            if !ray.pixel.done && ray.next < ray.end {
                self.put_sample(ray, rays.turn, column);
                continue;
            }
            self.end(ray, deferred, column);
            if !self.enter(rays, column) {
                n -= 1;
                self.copy(n, column);
            }
        }
        n
    }
}

/// Vector loop that computes the position and the interval of the sample in each column. `to`: positions,
/// `[3][stride]`.
struct Samples<'a, 'c> {
    stride: usize,
    columns: &'a mut Columns<'c>,
    to: &'a mut [f32],
}

impl Op for Samples<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<V: Lanes>(self) {
        let Self { stride, columns, to } = self;
        let (spacing, middles) = (columns.plan.spacing(), in_middles(columns.plan));
        for from in (0..stride.min(BLOCK)).step_by(V::COUNT) {
            let row = |row: &Row| V::load(&row[from..]);
            let (mut t, near) = (row(columns.t), row(columns.near));
            let (mut origin, mut dir, mut ends) = ([t; 3], [t; 3], [t; Ends::PARTS]);
            let values = origin.iter_mut().chain(&mut dir).chain(&mut ends);
            let rows = columns.origins.iter().chain(&*columns.dirs).chain(&*columns.ends);
            for (value, from) in values.zip(rows) {
                *value = row(from);
            }
            if middles {
                t = spacing.bins.points(t, V::splat(0.5), ends);
            }
            for (axis, point) in spacing.point(origin, dir, t).into_iter().enumerate() {
                point.store(tail_mut(to, axis * stride + from));
            }
            let interval = spacing.interval(ends, near, t);
            interval.t.store(&mut columns.intervals[0][from..]);
            interval.delta.store(&mut columns.intervals[1][from..]);
        }
    }
}

/// Vector loop that composites a block of samples: adds each column's weighted sample to the sums of the column's ray.
struct Absorb<'a, 'c, M> {
    stride: usize,
    sigma: &'a [f32],
    /// Hidden features `h` of the samples, `[rows][stride]`.
    h: &'a [f32],
    columns: &'a mut Columns<'c>,
    math: PhantomData<M>,
}

impl<M: Math> Op for Absorb<'_, '_, M> {
    type Output = ();

    #[inline(always)]
    fn run<V: Lanes>(self) {
        let Columns { plan, intervals, gathered, sums, .. } = self.columns;
        for from in (0..self.stride.min(BLOCK)).step_by(V::COUNT) {
            let [t, delta] = &**intervals;
            let sample = [V::load(tail(self.sigma, from)), V::load(&t[from..]), V::load(&delta[from..])];
            let weight = add_samples::<M, V>(gathered, from, sample, plan.colour_cut);
            let (zero, mut h) = (V::splat(0.0), self.h.chunks_exact(self.stride));
            let takes = zero.less(weight);
            for sums in &mut **sums {
                // The last row of `sums` is the sum of weights and has no row of `h`.
                let more = h.next().map_or(weight, |row| V::load(tail(row, from)).mul(weight));
                V::load(&sums[from..]).add(V::select(takes, more, zero)).store(&mut sums[from..]);
            }
        }
    }
}
