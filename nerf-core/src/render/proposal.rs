//! The coarse pass of a scene with a proposal network: where on its rays the scene's own is asked.
//!
//! The rays of a tile walk the proposal's bins as they walk the scene's (`march`), through a network of
//! densities alone. From the weights they gather, each ray draws its samples, which take the weights'
//! place; from there on the frame is any other. Without the feature `proposal`, `proposal_off.rs`
//! stands here.

use super::Target;
use super::frame::{Frame, columns_of};
use super::march::RayState;
use super::source::RaySource;
use crate::blob::Blob;
use crate::math::Math;
use crate::matrix::{Kernel, Storage};
use crate::memory::{Layout, at, head, head_mut, put, tail, tail_mut};
use crate::network::{Network, Weights};
use crate::plan::Plan;
use crate::sampling::{SampleJitter, sample_interval, sample_pdf};
use crate::simd::Isa;
use crate::volume::Accumulator;

#[cfg(test)]
mod tests;

/// Where a ray's walk through the proposal ends: what is left of the light, and so of the weights, would
/// draw less than a thousandth of the samples. It is no setting: where samples lie does not depend on
/// [`Quality::transmittance_cut`](crate::plan::Quality::transmittance_cut), whose price stays what it is.
const DARK: f32 = 1e-3;

/// The proposal network of a scene, if it has one.
#[derive(Clone, Debug)]
pub(super) struct Proposer<'a> {
    network: Option<Network<'a>>,
}

impl<'a> Proposer<'a> {
    /// Parameters that are unpacked; 0 without a network.
    pub fn parameters(blob: &Blob<'_>) -> usize {
        blob.proposal().map_or(0, |it| it.architecture().density_parameters())
    }

    /// Decodes the proposal network's weights from the stored format `storage` into `to`: one value a parameter.
    pub fn unpack(blob: &Blob<'_>, storage: Storage, to: &mut [f32]) {
        if let Some(proposal) = blob.proposal() {
            Weights::unpack(&proposal.architecture(), storage, proposal.weights, to);
        }
    }

    /// The network over its weights: where they lie in the blob, or what [`Proposer::unpack`] made.
    pub fn view(blob: &Blob<'a>, kernel: Kernel, unpacked: &'a [f32]) -> Self {
        let network = blob.proposal().and_then(|it| {
            let architecture = it.architecture();
            let weights = Weights::view(&architecture, kernel.storage, it.weights, unpacked);
            Network::of_density(&architecture, weights, kernel.isa)
        });
        Self { network }
    }

    /// Multiply-adds of an evaluation; 0 without a network.
    pub fn macs(&self) -> u64 {
        self.network.as_ref().map_or(0, |network| network.architecture().density_macs() as u64)
    }

    /// Samples of a ray that are drawn or the proposal's own; 0 where none are.
    pub fn row(&self, plan: &Plan<'_>) -> usize {
        if self.network.is_some() && plan.proposal.is_some() { plan.samples_per_ray() as usize } else { 0 }
    }

    /// Rows of encoded inputs and of activations that an evaluation needs.
    pub fn rows(&self) -> (usize, usize) {
        self.network.as_ref().map_or((0, 0), |network| (network.encoded_rows(), network.activation_rows()))
    }
}

/// The samples of the rays in flight, where they are drawn; else nothing, and the plan's bins are meant.
pub(super) struct ProposalSamples<'f, 'w> {
    proposer: &'f Proposer<'f>,
    /// `[rays][row]`: `t`, ascending; before they are drawn, a row's last values are the proposal's weights.
    t: &'w mut [f32],
    row: usize,
    /// Which of its ray's samples, or of the proposal's bins, the block's are: `[samples]`.
    index: &'w mut [u32],
}

impl<'f, 'w> ProposalSamples<'f, 'w> {
    /// `row` samples for each of the `rays`; nothing where `row` is 0.
    pub fn lay_out(
        layout: &mut impl Layout<'w>,
        proposer: &'f Proposer<'f>,
        [rays, samples, row]: [usize; 3],
    ) -> Self {
        let index = layout.slice(if row == 0 { 0 } else { samples }, 0);
        Self { proposer, t: layout.slice(rays.saturating_mul(row), 0.0), row, index }
    }

    /// Whether samples are drawn.
    #[inline]
    pub fn is_on(&self) -> bool {
        self.row > 0
    }

    /// Moves `state.next` to the first live sample of ray `ray` at or after it; `false` if there is none.
    #[inline]
    pub fn march(
        &self,
        isa: Isa,
        plan: &Plan<'_>,
        ray: u32,
        state: &mut RayState,
        place: SampleJitter,
    ) -> bool {
        if self.row == 0 {
            return state.march(isa, plan, &plan.bins, place);
        }
        let row = self.row_of(ray);
        while state.next < state.end && !plan.occupied(state.ray.at(at(row, state.next as usize))) {
            state.next += 1;
        }
        state.next < state.end
    }

    /// Where the next sample of ray `ray` is, which goes into column `column` of the block.
    #[inline]
    pub fn take(
        &mut self,
        plan: &Plan<'_>,
        ray: u32,
        state: &RayState,
        place: SampleJitter,
        column: usize,
    ) -> f32 {
        if self.row == 0 {
            return place.t(&plan.bins.with(state.ends), state.next);
        }
        put(self.index, column, state.next);
        at(self.row_of(ray), state.next as usize)
    }

    /// Middle and width of what the sample in column `column` of the block stands for, world units along its
    /// ray; `None` for a bin.
    #[inline]
    pub fn interval(
        &self,
        plan: &Plan<'_>,
        ray: u32,
        column: usize,
        [t_min, t_max]: [f32; 2],
    ) -> Option<(f32, f32)> {
        if self.row == 0 {
            return None;
        }
        let (middle, width) =
            sample_interval(plan.near, plan.far, self.row_of(ray), at(self.index, column) as usize);
        if t_min <= plan.near && t_max >= plan.far {
            return Some((middle, width));
        }
        let start = (middle - 0.5 * width).max(t_min);
        let end = (middle + 0.5 * width).min(t_max);
        Some((0.5 * start + 0.5 * end, end - start))
    }

    /// Moves the row of one ray to the place of an earlier one, or its own.
    fn move_row(&mut self, from: usize, to: usize) {
        debug_assert!(to <= from, "expected a row at or before {from}, found {to}");
        for i in 0..self.row {
            let t = at(self.t, from * self.row + i);
            put(self.t, to * self.row + i, t);
        }
    }

    fn row_of(&self, ray: u32) -> &[f32] {
        head(tail(self.t, ray as usize * self.row), self.row)
    }
}

impl Frame<'_, '_> {
    /// Asks the proposal where the samples of the tile's first `hits` rays should be, and draws them.
    ///
    /// Rays of which none is live are finished; those left move together. Returns their number.
    pub(super) fn propose<M: Math>(
        &mut self,
        hits: usize,
        source: &impl RaySource,
        target: &mut impl Target,
    ) -> usize {
        let (plan, row, proposer) = (self.plan, self.drawn.row, self.drawn.proposer);
        let (Some(network), Some(coarse)) = (&proposer.network, &plan.proposal) else { return hits };
        head_mut(self.drawn.t, hits * row).fill(0.0);
        loop {
            let n = self.fill_coarse();
            if n == 0 {
                break;
            }
            self.scratch.stride = columns_of(self.network, n);
            network.trunk(plan.math, &mut self.scratch, self.positions);
            network.density(plan.math, &self.scratch, self.block.sigma);
            self.counters.proposal_evaluations += n as u64;
            self.counters.macs += n as u64 * proposer.macs();
            self.gather_coarse::<M>(n);
        }
        let mut left = 0;
        for from in 0..hits {
            let mut state = at(self.rays, from);
            let place = state.place(plan, self.turn);
            sample_pdf(coarse, head_mut(tail_mut(self.drawn.t, from * row), row), |k| place.within(k));
            self.drawn.move_row(from, left);
            (state.next, state.end, state.done) = (0, row as u32, false);
            state.gathered = Accumulator::NONE;
            if self.drawn.march(self.network.isa(), plan, left as u32, &mut state, place) {
                put(self.rays, left, state);
                self.active.push(left as u32);
                left += 1;
            } else {
                self.finish::<M>(&state, None, source, target);
            }
        }
        left
    }

    /// Takes the next bin of as many rays as a block has room for. Returns their number.
    fn fill_coarse(&mut self) -> usize {
        let plan = self.plan;
        let Some(coarse) = &plan.proposal else { return 0 };
        let mut n = 0;
        // The next bin of an active ray is occupied.
        while n < self.block.owner.len()
            && let Some(i) = self.active.pop()
        {
            let Some(state) = self.rays.get_mut(i as usize) else { break };
            put(self.block.owner, n, i);
            put(self.block.t, n, coarse.at(state.next, 0.5));
            put(self.drawn.index, n, state.next);
            state.next += 1;
            n += 1;
        }
        self.put_positions(n);
        n
    }

    /// Notes the weights of the block's `n` samples, and sends the rays that see on back to wait.
    fn gather_coarse<M: Math>(&mut self, n: usize) {
        let plan = self.plan;
        let Some(coarse) = &plan.proposal else { return };
        let (row, drawn) = (self.drawn.row, plan.bins.count() as usize);
        for column in 0..n {
            let owner = at(self.block.owner, column);
            let Some(state) = self.rays.get_mut(owner as usize) else { break };
            let sigma = at(self.block.sigma, column);
            if sigma.is_nan() {
                self.counters.invalid_samples += 1;
            } else if sigma > 0.0 {
                let weight = state.gathered.add_density::<M>(sigma, at(self.block.t, column), coarse.delta());
                let bin = at(self.drawn.index, column) as usize;
                put(self.drawn.t, owner as usize * row + drawn + bin, weight);
                state.done = state.gathered.transmittance() < DARK;
            }
            if !state.done && state.march(self.network.isa(), plan, coarse, SampleJitter::MIDDLE) {
                self.active.push(owner);
            }
        }
    }
}
