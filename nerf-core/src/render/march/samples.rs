//! Samples drawn from a proposal's weights, which take the place of a ray's bins.

use super::rays::RayState;
use crate::memory::{Layout, at, head, head_mut, put, tail, tail_mut};
use crate::render::field::Field;
use crate::sampling::{Bins, SampleInterval, SampleJitter, sample_interval, sample_pdf};

/// The drawn samples of the rays in flight; empty if the frame has none and uses the plan's bins.
pub(in crate::render) struct ProposalSamples<'w> {
    /// `[rays][row]`: distances, ascending; before samples are drawn, a row's last values are the proposal's weights.
    t: &'w mut [f32],
    row: usize,
    /// Index of each sample of a block in its ray's row, or of its bin in the proposal: `[samples]`.
    index: &'w mut [u32],
}

impl<'w> ProposalSamples<'w> {
    /// Memory for `row` samples of each of `rays` rays; none if `row` is 0.
    pub fn lay_out(layout: &mut impl Layout<'w>, [rays, samples, row]: [usize; 3]) -> Self {
        let index = layout.slice(if row == 0 { 0 } else { samples }, 0);
        Self { t: layout.slice(rays.saturating_mul(row), 0.0), row, index }
    }

    /// Whether samples are drawn.
    #[inline]
    pub fn is_on(&self) -> bool {
        self.row > 0
    }

    /// Moves `state.next` to the first occupied sample of ray `ray` at or after it; `false` if there is none.
    #[inline]
    pub fn march(&self, field: Field<'_>, ray: u32, state: &mut RayState, jitter: SampleJitter) -> bool {
        let plan = field.plan;
        if self.row == 0 {
            return state.march(field.isa(), plan, &plan.bins, jitter);
        }
        let row = self.row_of(ray);
        while state.next < state.end && !plan.occupied(state.pixel.ray.at(at(row, state.next as usize))) {
            state.next += 1;
        }
        state.next < state.end
    }

    /// Distance of the next sample of ray `ray`, which goes into column `column` of the block.
    #[inline]
    pub fn take(
        &mut self,
        field: Field<'_>,
        ray: u32,
        state: &RayState,
        jitter: SampleJitter,
        column: usize,
    ) -> f32 {
        if self.row == 0 {
            return jitter.t(&field.plan.bins.with(state.ends), state.next);
        }
        self.take_bin(state.next, column);
        at(self.row_of(ray), state.next as usize)
    }

    /// The interval of the sample at `t` in column `column` of the block.
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
        if self.row == 0 {
            return plan.interval(&state.ends, start, t_min, t);
        }
        let (row, index) = (self.row_of(ray), at(self.index, column) as usize);
        let (mut mid, mut delta) = sample_interval(plan.near, plan.far, row, index);
        if !(t_min <= plan.near && t_max >= plan.far) {
            let start = (mid - 0.5 * delta).max(t_min);
            let end = (mid + 0.5 * delta).min(t_max);
            (mid, delta) = (0.5 * start + 0.5 * end, end - start);
        }
        SampleInterval { t: t.max(t_min).min(t_max), mid, delta }
    }

    /// Clears the rows of the first `rays` rays, for their march through the proposal.
    pub fn begin(&mut self, rays: usize) {
        head_mut(self.t, rays * self.row).fill(0.0);
    }

    /// Notes that column `column` of the block holds bin `bin` of its ray.
    #[inline]
    pub fn take_bin(&mut self, bin: u32, column: usize) {
        put(self.index, column, bin);
    }

    /// Stores the weight of the bin in column `column` of the block; `drawn`: number of values before a row's
    /// weights.
    pub fn put_weight(&mut self, ray: u32, column: usize, drawn: usize, weight: f32) {
        let bin = at(self.index, column) as usize;
        put(self.t, ray as usize * self.row + drawn + bin, weight);
    }

    /// Draws the samples of ray `from` from the weights of the `coarse` bins, and stores them as those of ray `to`,
    /// which is at most `from`. Returns their number.
    pub fn draw(&mut self, coarse: &Bins, from: usize, to: usize, jitter: SampleJitter) -> u32 {
        debug_assert!(to <= from, "expected a row at or before {from}, found {to}");
        let row = self.row;
        sample_pdf(coarse, head_mut(tail_mut(self.t, from * row), row), |k| jitter.within(k));
        for i in 0..row {
            let t = at(self.t, from * row + i);
            put(self.t, to * row + i, t);
        }
        row as u32
    }

    fn row_of(&self, ray: u32) -> &[f32] {
        head(tail(self.t, ray as usize * self.row), self.row)
    }
}
