//! Ray marching of fields shaded once a ray, a ray in each column of a block: compositing is vector arithmetic over rays.
//!
//! The results are those of `march.rs`, bit for bit. A column holds a ray from its first sample to its last; then the next
//! active ray takes the column. When fewer rays are left than a vector has columns, `march.rs` goes on with them.

use super::deferred::Deferred;
use super::frame::Frame;
use super::march::{ContractPoints, PartsInWorld, RayState};
use crate::math::Math;
use crate::matrix::Storage;
use crate::memory::{at, head, head_mut, put, tail, tail_mut};
use crate::network::Network;
use crate::plan::Plan;
use crate::sampling::Ends;
use crate::simd::{BLOCK, Lanes, MAX_LANES, Op, VECTORS};
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
const ROWS: usize = 3 + 3 + 1 + 3 + 1 + Ends::PARTS + side_by_side::ROWS;

/// Whether all samples lie in the middle of their bins, and those in the world.
fn in_middles(plan: &Plan<'_>) -> bool {
    plan.contraction.is_none() && plan.effects.jitter.is_none()
}

/// A value of each column.
type Row = [f32; BLOCK];

/// The rays that are marched side by side, one a column.
struct Columns<'w> {
    /// Index of each column's ray in the tile.
    owner: [u32; BLOCK],
    origins: &'w mut [Row; 3],
    dirs: &'w mut [Row; 3],
    /// The sample's distance along its ray in the units of the bins, or the number of its bin ([`in_middles`]).
    t: &'w mut Row,
    /// What its bin is, in world units: distance, middle and width. In an unbounded scene first distance, start and end in
    /// the units of the bins.
    parts: &'w mut [Row; 3],
    /// Least distance of an unbounded scene's samples.
    near: &'w mut Row,
    /// How the ray's outermost bins are cut.
    ends: &'w mut [Row; Ends::PARTS],
    /// Opacity, distance and optical thickness composited so far.
    gathered: &'w mut side_by_side::Rows,
    /// Σ weight · `h` so far, and behind it Σ weight.
    sums: &'w mut [Row],
}

impl<'w> Columns<'w> {
    /// Over `[column_rows][BLOCK]` values.
    fn new(memory: &'w mut [f32]) -> Option<Self> {
        let (rows, _) = memory.as_chunks_mut();
        let (origins, rows) = rows.split_first_chunk_mut()?;
        let (dirs, rows) = rows.split_first_chunk_mut()?;
        let (t, rows) = rows.split_first_mut()?;
        let (parts, rows) = rows.split_first_chunk_mut()?;
        let (near, rows) = rows.split_first_mut()?;
        let (ends, rows) = rows.split_first_chunk_mut()?;
        let (gathered, sums) = rows.split_first_chunk_mut()?;
        Some(Self { owner: [0; BLOCK], origins, dirs, t, parts, near, ends, gathered, sums })
    }

    /// Puts the next sample of `ray` into column `at`.
    #[inline(always)]
    fn put_sample(&mut self, plan: &Plan<'_>, ray: &mut RayState, turn: u32, at: usize) {
        self.t[at % BLOCK] = ray.next as f32;
        if !in_middles(plan) {
            self.put_distance(plan, ray, turn, at % BLOCK);
        }
        ray.next += 1;
    }

    #[inline(never)]
    fn put_distance(&mut self, plan: &Plan<'_>, ray: &RayState, turn: u32, at: usize) {
        let bins = plan.bins.with(ray.ends);
        let t = ray.place(plan, turn).t(&bins, ray.next);
        self.t[at] = t;
        let (t, from, to) = bins.ends_around(t);
        for (row, value) in self.parts.iter_mut().zip([t, from, to]) {
            row[at] = value;
        }
    }

    /// Starts `ray`, number `owner` of the tile, in column `at`.
    #[inline]
    fn begin(&mut self, plan: &Plan<'_>, ray: &RayState, owner: u32, at: usize) {
        let at = at % BLOCK;
        self.owner[at] = owner;
        for axis in 0..3 {
            self.origins[axis][at] = ray.ray.origin[axis];
            self.dirs[axis][at] = ray.ray.dir[axis];
        }
        self.near[at] = plan.near.max(ray.range[0]) - ray.start;
        for (row, end) in self.ends.iter_mut().zip(ray.ends.parts()) {
            row[at] = end;
        }
        ray.gathered.put_column(self.gathered, at);
        for row in &mut *self.sums {
            row[at] = 0.0;
        }
    }

    /// Writes the composited values of column `at` back to its ray.
    #[inline]
    fn end(&self, ray: &mut RayState, deferred: &mut Deferred<'_>, at: usize) {
        ray.gathered.take_column(self.gathered, at);
        deferred.put(self.owner[at % BLOCK] as usize, self.sums.iter().map(|row| row[at % BLOCK]));
    }

    /// Copies column `from` to column `to`.
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
        copy(self.parts);
        copy(self.ends);
        copy(self.gathered);
        copy(self.sums);
    }
}

impl Frame<'_, '_> {
    /// Marches the active rays while they fill a vector; those that are left stay active.
    pub(super) fn march_side_by_side<M: Math>(&mut self) {
        if !VECTORS || self.active.len() < MAX_LANES {
            return;
        }
        let memory = core::mem::take(&mut self.columns);
        if let Some(mut columns) = Columns::new(memory) {
            self.march_columns::<M>(&mut columns);
        }
        self.columns = memory;
    }

    fn march_columns<M: Math>(&mut self, columns: &mut Columns<'_>) {
        let mut n = 0;
        while n < BLOCK && self.enter(columns, n) {
            n += 1;
        }
        while n >= MAX_LANES {
            self.counters.add_density(self.network, n);
            self.evaluate_columns(columns, n);
            self.absorb_columns::<M>(columns, n);
            n = self.advance_columns(columns, n);
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
    }

    /// Starts the next active ray in column `at`; `false` if there is none.
    fn enter(&mut self, columns: &mut Columns<'_>, at: usize) -> bool {
        let Some(owner) = self.active.pop() else { return false };
        let Some(ray) = self.rays.get_mut(owner as usize) else { return false };
        columns.begin(self.plan, ray, owner, at);
        columns.put_sample(self.plan, ray, self.turn, at);
        true
    }

    /// Runs trunk and density head for the samples of the first `n` columns.
    fn evaluate_columns(&mut self, columns: &mut Columns<'_>, n: usize) {
        let (stride, isa) = (n.next_multiple_of(MAX_LANES), self.network.isa());
        let (dirs, t) = (columns.dirs.as_flattened(), &columns.t[..]);
        if let Some(contraction) = &self.plan.contraction {
            for (axis, origins) in columns.origins.iter().enumerate() {
                let to = head_mut(tail_mut(self.positions, axis * stride), stride);
                to.iter_mut().zip(origins).for_each(|(to, &from)| *to = from);
            }
            let positions = &mut *self.positions;
            isa.run(ContractPoints { contraction, stride, dir_stride: BLOCK, positions, dirs, t });
            let (parts, near) = (columns.parts.as_flattened_mut(), &columns.near[..]);
            isa.run(PartsInWorld { contraction, room: BLOCK, columns: stride, parts, near });
        } else {
            isa.run(Points { stride, plan: self.plan, columns, to: self.positions });
        }
        self.evaluate_density(stride);
    }

    /// Composites the samples of the first `n` columns.
    fn absorb_columns<M: Math>(&mut self, columns: &mut Columns<'_>, n: usize) {
        let stride = n.next_multiple_of(MAX_LANES);
        let h = head(self.scratch.front, self.network.trunk_rows() * stride);
        let (sigma, cut) = (&*self.block.sigma, self.plan.colour_cut);
        let absorb = Absorb::<M> { stride, sigma, h, columns, cut, math: PhantomData };
        self.network.isa().run_portable(stride, absorb);
    }

    /// Marches the ray of each of the first `n` columns to its next occupied sample, and replaces the rays that end. Returns
    /// the number of columns that have a sample.
    fn advance_columns(&mut self, columns: &mut Columns<'_>, mut n: usize) -> usize {
        let plan = self.plan;
        let sigma = head(self.block.sigma, n);
        self.counters.invalid_samples += sigma.iter().map(|sigma| u64::from(sigma.is_nan())).sum::<u64>();
        let (mut waiting, mut waits) = ([0; BLOCK], 0);
        let (mut marching, mut marches) = ([0; BLOCK], 0);
        for column in 0..n.min(BLOCK) {
            let owner = columns.owner[column];
            let Some(ray) = self.rays.get_mut(owner as usize) else { return 0 };
            ray.kept += 1;
            ray.done = left_of(columns.gathered)[column] < plan.transmittance_cut;
            if !ray.done {
                if ray.march_looked_up() {
                    columns.put_sample(plan, ray, self.turn, column);
                    continue;
                }
                put(&mut marching, marches, owner);
                marches += 1;
            }
            put(&mut waiting, waits, column);
            waits += 1;
        }
        self.march_all(head(&marching, marches));
        // From the last on, so that a column that fills a gap has its sample.
        for &column in head(&waiting, waits).iter().rev() {
            let Some(ray) = self.rays.get_mut(at(&columns.owner, column) as usize) else { return 0 };
            if !ray.done && ray.next < ray.end {
                columns.put_sample(plan, ray, self.turn, column);
                continue;
            }
            columns.end(ray, &mut self.deferred, column);
            if !self.enter(columns, column) {
                n -= 1;
                columns.copy(n, column);
            }
        }
        n
    }
}

/// Positions of samples, `[3][stride]`, and what of their bins counts.
struct Points<'a, 'w> {
    stride: usize,
    plan: &'a Plan<'a>,
    columns: &'a mut Columns<'w>,
    to: &'a mut [f32],
}

impl Op for Points<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<V: Lanes>(self) {
        let Self { stride, plan, columns, to } = self;
        let (bins, middles) = (&plan.bins, in_middles(plan));
        for from in (0..stride.min(BLOCK)).step_by(V::COUNT) {
            let row = |row: &Row| V::load(&row[from..]);
            let mut t = row(columns.t);
            let mut ends = [t; Ends::PARTS];
            for (end, from) in ends.iter_mut().zip(&*columns.ends) {
                *end = row(from);
            }
            if middles {
                t = bins.middles_of(t, ends);
            }
            for axis in 0..3 {
                let point = row(&columns.origins[axis]).add(row(&columns.dirs[axis]).mul(t));
                point.store(tail_mut(to, axis * stride + from));
            }
            let (t, width) = Ends::part_around(ends, t, V::splat(bins.delta()));
            t.store(&mut columns.parts[0][from..]);
            width.store(&mut columns.parts[2][from..]);
        }
    }
}

/// Compositing of a block: its densities and `h` are added to its rays.
struct Absorb<'a, 'w, M> {
    stride: usize,
    sigma: &'a [f32],
    /// `[rows][stride]`.
    h: &'a [f32],
    columns: &'a mut Columns<'w>,
    cut: f32,
    math: PhantomData<M>,
}

impl<M: Math> Op for Absorb<'_, '_, M> {
    type Output = ();

    #[inline(always)]
    fn run<V: Lanes>(self) {
        let Columns { parts, gathered, sums, .. } = self.columns;
        for from in (0..self.stride.min(BLOCK)).step_by(V::COUNT) {
            let [t, delta] = [0, 2].map(|row: usize| V::load(&parts[row][from..]));
            let sample = [V::load(tail(self.sigma, from)), t, delta];
            let weight = add_samples::<M, V>(gathered, from, sample, self.cut);
            let (zero, mut h) = (V::splat(0.0), self.h.chunks_exact(self.stride));
            let takes = zero.less(weight);
            for sums in &mut **sums {
                // Behind the rows of h stands the weight itself.
                let more = h.next().map_or(weight, |row| V::load(tail(row, from)).mul(weight));
                V::load(&sums[from..]).add(V::select(takes, more, zero)).store(&mut sums[from..]);
            }
        }
    }
}
