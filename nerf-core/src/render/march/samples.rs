//! Samples drawn from a proposal's weights, which take the place of a ray's bins.

use super::rays::RayState;
use crate::memory::{Layout, at, head, head_mut, put, tail, tail_mut};
use crate::render::field::Field;
use crate::sampling::{Bins, SampleInterval, SampleJitter, sample_interval, sample_pdf};

/// Whether this build evaluates proposal networks.
pub(in crate::render) const PROPOSAL_BUILT: bool = cfg!(feature = "proposal");

/// The drawn samples of the rays in flight; without rows in a build without proposals.
pub(in crate::render) struct ProposalSamples<'w>([Rows<'w>; PROPOSAL_BUILT as usize]);

/// A row of samples for each ray; empty if the frame draws none and uses the plan's bins.
struct Rows<'w> {
    /// `[rays][row]`: distances, ascending; before samples are drawn, a row's last values are the proposal's weights.
    t: &'w mut [f32],
    row: usize,
    /// Index of each sample of a block in its ray's row, or of its bin in the proposal: `[samples]`.
    index: &'w mut [u32],
}

impl Rows<'_> {
    fn of(&self, ray: u32) -> &[f32] {
        head(tail(self.t, ray as usize * self.row), self.row)
    }
}

impl<'w> ProposalSamples<'w> {
    /// Memory for `row` samples of each of `rays` rays; none if `row` is 0.
    pub fn lay_out(layout: &mut impl Layout<'w>, [rays, samples, row]: [usize; 3]) -> Self {
        Self([(); PROPOSAL_BUILT as usize].map(|()| {
            let index = layout.slice(if row == 0 { 0 } else { samples }, 0);
            Rows { t: layout.slice(rays.saturating_mul(row), 0.0), row, index }
        }))
    }

    /// The rows, if samples are drawn.
    #[inline]
    fn rows(&self) -> Option<&Rows<'w>> {
        self.0.first().filter(|rows| rows.row > 0)
    }

    /// Whether samples are drawn.
    #[inline]
    pub fn is_on(&self) -> bool {
        self.rows().is_some()
    }

    /// Moves `state.next` to the first occupied sample of ray `ray` at or after it; `false` if there is none.
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
        let Some(rows) = self.0.first_mut().filter(|rows| rows.row > 0) else {
            return jitter.t(&field.plan.bins.with(state.ends), state.next);
        };
        put(rows.index, column, state.next);
        at(rows.of(ray), state.next as usize)
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

    /// Clears the rows of the first `rays` rays, for their march through the proposal.
    pub fn begin(&mut self, rays: usize) {
        self.0.iter_mut().for_each(|rows| head_mut(rows.t, rays * rows.row).fill(0.0));
    }

    /// Notes that column `column` of the block holds bin `bin` of its ray.
    #[inline]
    pub fn take_bin(&mut self, bin: u32, column: usize) {
        self.0.iter_mut().for_each(|rows| put(rows.index, column, bin));
    }

    /// Stores the weight of the bin in column `column` of the block; `drawn`: number of values before a row's
    /// weights.
    pub fn put_weight(&mut self, ray: u32, column: usize, drawn: usize, weight: f32) {
        for Rows { t, row, index } in &mut self.0 {
            put(t, ray as usize * *row + drawn + at(index, column) as usize, weight);
        }
    }

    /// Draws the samples of ray `from` from the weights of the `coarse` bins, and stores them as those of ray `to`,
    /// which is at most `from`. Returns their number.
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
