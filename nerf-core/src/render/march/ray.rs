//! State of a ray, and its march to the next sample in an occupied cell.

use super::coarse::CandidateBins;
use super::window::{LookUp, Window};
use crate::camera::Ray;
use crate::memory::{Layout, at, head, head_mut, put, tail, tail_mut};
use crate::plan::{Plan, Span};
use crate::render::field::Field;
use crate::render::pixel::PixelRay;
use crate::sampling::{Bins, Ends, OccupancyGrid, SampleInterval, SampleJitter, sample_interval, sample_pdf};
use crate::simd::{Isa, Lanes, Op, VECTORS};
use crate::space::Contraction;
use glam::Vec3;

/// State of a ray's march through one field.
#[derive(Clone, Copy)]
pub(in crate::render) struct RayState {
    pub pixel: PixelRay,
    /// Where the ray's first and last bin are cut, if the ray uses only parts of them.
    pub ends: Ends,
    /// Index of the next bin, or of the next drawn sample if a proposal network is used.
    pub next: u32,
    /// Index after the last bin; if a proposal network is used, index after the last drawn sample.
    pub end: u32,
    /// Occupancy of the bins that were last looked up in the occupancy grid.
    pub window: Window,
    /// The bins that may have a sample in an occupied cell. An empty array in builds without SIMD vectors, which look
    /// up every bin.
    pub candidates: [CandidateBins; VECTORS as usize],
    /// Number of evaluated samples of the ray. Samples behind the point where the ray ended are not counted.
    pub kept: u32,
}

impl Default for RayState {
    fn default() -> Self {
        Self::NONE
    }
}

impl RayState {
    pub const NONE: Self = Self {
        pixel: PixelRay::NONE,
        ends: Ends::NONE,
        next: 0,
        end: 0,
        window: Window::NONE,
        candidates: [CandidateBins::ALL; VECTORS as usize],
        kept: 0,
    };

    /// Returns a state that holds one point at which the field is evaluated, instead of a ray. `origin`: the point, in
    /// the network's space. `dir`: view direction. `index`: index of the point in its list, stored as `pixel.x`.
    pub fn of_point(origin: Vec3, dir: Vec3, index: usize) -> Self {
        Self { pixel: PixelRay { ray: Ray { origin, dir }, x: index as u32, ..PixelRay::NONE }, ..Self::NONE }
    }

    /// Sets the state to the start of the ray of pixel `(x, y)`. `range`: stored in [`PixelRay::range`]. `span`: the
    /// sampled part of the ray; `None` if the ray has no samples.
    #[inline]
    pub fn begin(&mut self, (x, y): (u32, u32), ray: Ray, range: [f32; 2], span: Option<Span>) {
        *self = Self { pixel: PixelRay { ray, range, x, y, done: false, ..PixelRay::NONE }, ..Self::NONE };
        if let Some(Span { ray, start, bins, ends }) = span {
            (self.pixel.ray, self.pixel.start, self.ends) = (ray, start, ends);
            (self.next, self.end) = (bins.start, bins.end);
        }
    }

    /// Advances `next` to the first bin at or after `next` whose sample is in an occupied cell. Returns `false` if
    /// there is no such bin. `bins`: bins through which the ray is marched. `jitter`: position of each sample in its
    /// bin.
    #[cfg_attr(target_os = "none", inline(never))]
    pub fn march(&mut self, isa: Isa, plan: &Plan<'_>, bins: &Bins, jitter: SampleJitter) -> bool {
        if VECTORS && self.march_looked_up() {
            return true;
        }
        match windows(isa, plan) {
            Some(occupancy) => {
                let (contraction, rays) = (plan.contraction.as_ref(), core::slice::from_mut(self));
                isa.run(MarchAll { occupancy, contraction, bins, rays, list: &[0], inner: false });
            }
            None => {
                let (bins, next, end) = (bins.with(self.ends), self.next, self.end);
                self.next = plan.first_occupied(&bins, &self.pixel.ray, jitter, next, end);
            }
        }
        self.next < self.end
    }

    /// Advances `next` to the first occupied bin of `window` at or after `next`; returns `false` if there is no such
    /// bin.
    #[inline]
    pub fn march_looked_up(&mut self) -> bool {
        let found = self.window.left(self.next).filter(|&bin| bin < self.end);
        self.next = found.unwrap_or(self.next);
        found.is_some()
    }
}

/// Returns the plan's occupancy grid if bins are looked up sixteen at a time ([`Window`]). `None` without a grid, or if
/// bins are looked up one by one: with jitter, with [`Isa::Portable`], and in builds without vector instructions.
#[inline]
pub(super) fn windows<'p>(isa: Isa, plan: &'p Plan<'_>) -> Option<&'p OccupancyGrid<'p>> {
    plan.occupancy.as_ref().filter(|_| VECTORS && isa != Isa::Portable && plan.effects.jitter.is_none())
}

/// Vector loop that marches several rays, each to its next bin whose middle is in an occupied cell. All samples must
/// lie in the middle of their bins.
pub(super) struct MarchAll<'a> {
    pub occupancy: &'a OccupancyGrid<'a>,
    pub contraction: Option<&'a Contraction>,
    pub bins: &'a Bins,
    pub rays: &'a mut [RayState],
    /// Indices in `rays` of the rays to march.
    pub list: &'a [u32],
    /// Whether all cells at the faces of the scene box are known to be empty ([`LookUp::inner`]).
    pub inner: bool,
}

impl Op for MarchAll<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: Lanes>(self) {
        let Self { occupancy, contraction, inner, .. } = self;
        let lanes = occupancy.lanes::<V>();
        for &ray in self.list {
            let Some(state) = self.rays.get_mut(ray as usize) else { return };
            let candidates = state.candidates.first().unwrap_or(&CandidateBins::ALL);
            let (ray, bins) = (&state.pixel.ray, &self.bins.with(state.ends));
            let look_up = LookUp { occupancy, contraction, ray, bins, candidates, inner };
            state.next = look_up.first_occupied(&lanes, &mut state.window, state.next, state.end);
        }
    }
}

/// Queue of the rays that have a next sample in an occupied cell, stored in a ring buffer. No ray is queued twice.
pub(in crate::render) struct ActiveRays<'w> {
    ring: &'w mut [u32],
    first: usize,
    count: usize,
}

impl<'w> ActiveRays<'w> {
    /// Makes an empty queue. `ring`: the queue's memory; must have at least one element per ray.
    pub fn new(ring: &'w mut [u32]) -> Self {
        Self { ring, first: 0, count: 0 }
    }

    pub fn len(&self) -> usize {
        self.count
    }

    pub fn push(&mut self, ray: u32) {
        let (capacity, end) = (self.ring.len(), self.first + self.count);
        put(self.ring, if end < capacity { end } else { end - capacity }, ray);
        self.count += 1;
    }

    pub fn pop(&mut self) -> Option<u32> {
        self.count = self.count.checked_sub(1)?;
        let ray = at(self.ring, self.first);
        self.first = if self.first + 1 < self.ring.len() { self.first + 1 } else { 0 };
        Some(ray)
    }
}

/// Whether this build evaluates proposal networks.
pub(in crate::render) const PROPOSAL_BUILT: bool = cfg!(feature = "proposal");

/// Distances of the current tile's samples, drawn by importance sampling from the compositing weights of a proposal
/// network. Empty in builds without proposals.
pub(in crate::render) struct ProposalSamples<'w>([Rows<'w>; PROPOSAL_BUILT as usize]);

/// Table of sample distances, one row per ray. Empty if the frame uses no proposal network: samples then lie in the
/// plan's bins.
struct Rows<'w> {
    /// Distances of each ray's samples, ascending: `[rays][row]`. Before the samples of a ray are drawn, the end of the
    /// ray's row holds the compositing weights of the ray's proposal bins.
    t: &'w mut [f32],
    row: usize,
    /// One index per column of a block: `[samples]`. While the proposal network is evaluated: index of the column's
    /// proposal bin. While the scene's network is evaluated: index of the column's sample in the ray's row of `t`.
    index: &'w mut [u32],
}

impl Rows<'_> {
    fn of(&self, ray: u32) -> &[f32] {
        head(tail(self.t, ray as usize * self.row), self.row)
    }
}

impl<'w> ProposalSamples<'w> {
    /// Reserves memory for `rays` rows of `row` values each, and for `samples` indices, one per column of a block.
    /// Reserves nothing if `row` is 0.
    pub fn lay_out(layout: &mut impl Layout<'w>, [rays, samples, row]: [usize; 3]) -> Self {
        Self([(); PROPOSAL_BUILT as usize].map(|()| {
            let index = layout.slice(if row == 0 { 0 } else { samples }, 0);
            Rows { t: layout.slice(rays.saturating_mul(row), 0.0), row, index }
        }))
    }

    #[inline]
    fn rows(&self) -> Option<&Rows<'w>> {
        self.0.first().filter(|rows| rows.row > 0)
    }

    /// Whether importance sampling is on: samples are drawn from the compositing weights of a proposal network.
    #[inline]
    pub fn is_on(&self) -> bool {
        self.rows().is_some()
    }

    /// Advances `state.next` past samples of `ray` in empty cells. Returns `false` if no sample is left.
    #[inline]
    pub fn march(&self, field: Field<'_>, ray: u32, state: &mut RayState, jitter: SampleJitter) -> bool {
        let plan = field.plan;
        let Some(rows) = self.rows() else { return state.march(field.isa(), plan, &plan.bins, jitter) };
        let row = rows.of(ray);
        while state.next < state.end && !plan.occupied(state.pixel.ray.at(at(row, state.next as usize))) {
            state.next += 1;
        }
        state.next < state.end
    }

    /// Returns the position of the next sample along `ray`, in the units of `Density::t`. `column`: column of the block
    /// into which the caller puts the sample. With a proposal network, also stores the sample's index, for
    /// [`ProposalSamples::interval`].
    #[inline]
    pub fn take(
        &mut self,
        field: Field<'_>,
        ray: u32,
        state: &RayState,
        jitter: SampleJitter,
        column: usize,
    ) -> f32 {
        let Some(rows) = self.0.first_mut().filter(|rows| rows.row > 0) else {
            return jitter.t(&field.plan.bins.with(state.ends), state.next);
        };
        put(rows.index, column, state.next);
        at(rows.of(ray), state.next as usize)
    }

    /// Returns the interval, on `ray`, of the sample in column `column` of the block: the density is taken as constant
    /// over this interval. `t`: position of the sample, from [`ProposalSamples::take`].
    #[inline]
    pub fn interval(
        &self,
        field: Field<'_>,
        ray: u32,
        state: &RayState,
        column: usize,
        t: f32,
    ) -> SampleInterval {
        let (plan, start, [t_min, t_max]) = (field.plan, state.pixel.start, state.pixel.range);
        let Some(rows) = self.rows() else { return plan.interval(&state.ends, start, t_min, t) };
        let (row, index) = (rows.of(ray), at(rows.index, column) as usize);
        let (mut mid, mut delta) = sample_interval(plan.near, plan.far, row, index);
        if !(t_min <= plan.near && t_max >= plan.far) {
            let start = (mid - 0.5 * delta).max(t_min);
            let end = (mid + 0.5 * delta).min(t_max);
            (mid, delta) = (0.5 * start + 0.5 * end, end - start);
        }
        SampleInterval { t: t.max(t_min).min(t_max), mid, delta }
    }

    /// Zeroes the rows of the first `rays` rays, so that a proposal bin without a stored weight has weight 0.
    pub fn begin(&mut self, rays: usize) {
        self.0.iter_mut().for_each(|rows| head_mut(rows.t, rays * rows.row).fill(0.0));
    }

    /// Stores `bin` as the proposal bin in column `column` of the block, for [`ProposalSamples::put_weight`].
    #[inline]
    pub fn take_bin(&mut self, bin: u32, column: usize) {
        self.0.iter_mut().for_each(|rows| put(rows.index, column, bin));
    }

    /// Stores `weight`, the compositing weight of the proposal bin that was evaluated in column `column` of the block. The
    /// row of `ray` holds `drawn` distances of samples, then the weights of all proposal bins.
    pub fn put_weight(&mut self, ray: u32, column: usize, drawn: usize, weight: f32) {
        for Rows { t, row, index } in &mut self.0 {
            put(t, ray as usize * *row + drawn + at(index, column) as usize, weight);
        }
    }

    /// Draws the samples of a ray in proportion to the weights of its proposal bins `coarse`. Reads the weights from
    /// row `from`, writes the samples' distances to row `to` and returns the number of samples. `jitter`: position of
    /// each sample within its stratum.
    ///
    /// Requires `to <= from`. `to` is smaller than `from` if the caller has removed earlier rays from the table, since
    /// they have no samples in occupied cells.
    pub fn draw(&mut self, coarse: &Bins, from: usize, to: usize, jitter: SampleJitter) -> u32 {
        debug_assert!(to <= from, "expected a row at or before {from}, found {to}");
        let Some(&mut Rows { ref mut t, row, .. }) = self.0.first_mut() else { return 0 };
        sample_pdf(coarse, head_mut(tail_mut(t, from * row), row), |k| jitter.within(k));
        for i in 0..row {
            let value = at(t, from * row + i);
            put(t, to * row + i, value);
        }
        row as u32
    }
}
