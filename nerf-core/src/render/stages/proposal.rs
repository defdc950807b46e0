//! Coarse pass of a scene with a proposal network: selects the samples at which the scene's network is evaluated.
//!
//! The rays of a tile are marched through the proposal's bins with the proposal network, which outputs only densities.
//! Each ray draws its samples from the resulting compositing weights. All later stages are as in a scene without a
//! proposal network.

use super::TileState;
use crate::blob::Blob;
use crate::encoding::GridTables;
use crate::matrix::{Kernel, Storage};
use crate::memory::{at, put};
use crate::network::{Network, Role, Weights};
use crate::plan::Plan;
use crate::render::march::PROPOSAL_BUILT;
use crate::render::pixel::{Pixels, Target};
use crate::sampling::SampleJitter;
use crate::volume::Accumulator;

#[cfg(all(test, feature = "proposal"))]
mod tests;

/// Transmittance below which a ray's march through the proposal's bins ends. The bins behind the end of the march would
/// get less than a thousandth of the drawn samples.
/// [`Quality::transmittance_cut`](crate::plan::Quality::transmittance_cut) has no effect here, so that a change of that
/// setting does not move samples.
const LEAST_TRANSMITTANCE: f32 = 1e-3;

/// Proposal network of a scene; empty if the scene has none, or in a build without the feature `proposal`.
#[derive(Clone, Debug)]
pub(in crate::render) struct Proposer<'a>([Option<Network<'a>>; PROPOSAL_BUILT as usize]);

impl<'a> Proposer<'a> {
    /// Length of the buffer for [`Proposer::unpack`]: number of the proposal network's parameters, 0 without a network.
    pub fn parameters(blob: &Blob<'_>) -> usize {
        blob.proposal().filter(|_| PROPOSAL_BUILT).map_or(0, |it| it.architecture().density_parameters())
    }

    /// Decodes the proposal network's parameters from the blob's f16 values into `to`, which has one element per
    /// parameter. `storage`: format to write. With [`Storage::Bf16`], two weights share an element, and some elements
    /// are unused.
    pub fn unpack(blob: &Blob<'_>, storage: Storage, to: &mut [f32]) {
        if let Some(proposal) = blob.proposal().filter(|_| PROPOSAL_BUILT) {
            Weights::unpack(&proposal.architecture(), storage, proposal.weights, to);
        }
    }

    /// Returns the proposal network. Its parameters are read from the blob if `kernel.storage` allows that, else from
    /// `unpacked`, which [`Proposer::unpack`] has filled.
    pub fn view(blob: &Blob<'a>, kernel: Kernel, unpacked: &'a [f32]) -> Self {
        Self([(); PROPOSAL_BUILT as usize].map(|()| {
            let it = blob.proposal()?;
            let architecture = it.architecture();
            let weights = Weights::view(&architecture, kernel.storage, it.weights, unpacked);
            let mut layers = architecture.layers();
            layers.retain(|layer| matches!(layer.role, Role::Trunk(_) | Role::Density));
            Network::of_layers(&architecture, layers, weights, GridTables::NONE, kernel.isa)
        }))
    }

    fn network(&self) -> Option<&Network<'a>> {
        self.0.first()?.as_ref()
    }

    /// Returns the number of multiply-adds of one evaluation of the proposal network; 0 without a proposal network.
    pub fn macs(&self) -> u64 {
        self.network().map_or(0, |network| network.density_macs() as u64)
    }

    /// Number of values stored per ray: one per drawn sample and one per proposal bin. 0 if `plan` uses no proposal.
    pub fn row(&self, plan: &Plan<'_>) -> usize {
        if self.network().is_some() && plan.proposal.is_some() { plan.samples_per_ray() as usize } else { 0 }
    }

    /// Numbers of encoded inputs and activations per sample of the proposal network; 0 if `plan` does not use it.
    pub fn rows(&self, plan: &Plan<'_>) -> (usize, usize) {
        let network = self.network().filter(|_| plan.proposal.is_some());
        network.map_or((0, 0), |network| (network.encoded_rows(), network.activation_rows()))
    }
}

/// Evaluates the proposal network along the tile's rays, and draws each ray's samples from the compositing weights.
///
/// If a ray has no sample in an occupied cell, its result is added to its pixel. All other rays are moved to the start
/// of `rays.states`.
pub(in crate::render) fn propose(
    proposer: &Proposer<'_>,
    TileState { field, rays, density, .. }: &mut TileState<'_, '_>,
    pixels: &mut Pixels<'_, '_>,
    target: &mut dyn Target,
) {
    let (field, plan, hits) = (*field, field.plan, rays.hits);
    let (Some(network), Some(coarse)) = (proposer.network(), &plan.proposal) else { return };
    let own = plan.bins.count() as usize;
    rays.samples.begin(hits);
    loop {
        let mut n = 0;
        // The next bin of an active ray is always occupied.
        while n < density.owner.len()
            && let Some(i) = rays.active.pop()
        {
            let Some(state) = rays.states.get_mut(i as usize) else { break };
            density.put(n, i, coarse.at(state.next, 0.5));
            rays.samples.take_bin(state.next, n);
            state.next += 1;
            n += 1;
        }
        if n == 0 {
            break;
        }
        density.place(field, n, rays.states);
        // Uses as many columns as a block of the scene's own network.
        density.scratch.stride = field.columns(n);
        network.trunk(plan.math, &mut density.scratch, density.positions);
        network.density(plan.math, &density.scratch, density.sigma);
        pixels.counters.proposal_evaluations += n as u64;
        pixels.counters.macs += n as u64 * proposer.macs();
        for column in 0..n {
            let owner = at(density.owner, column);
            let Some(state) = rays.states.get_mut(owner as usize) else { break };
            let (sigma, ray) = (at(density.sigma, column), &mut state.pixel);
            if sigma.is_nan() {
                pixels.counters.invalid_samples += 1;
            } else if sigma > 0.0 {
                let weight =
                    ray.gathered.add_density(plan.math, sigma, at(density.t, column), coarse.delta());
                rays.samples.put_weight(owner, column, own, weight);
                ray.done = ray.gathered.transmittance() < LEAST_TRANSMITTANCE;
            }
            if !ray.done && state.march(field.isa(), plan, coarse, SampleJitter::MIDDLE) {
                rays.active.push(owner);
            }
        }
    }
    let mut left = 0;
    for from in 0..hits {
        let mut state = at(rays.states, from);
        let jitter = state.pixel.jitter(plan, rays.turn);
        (state.next, state.end) = (0, rays.samples.draw(coarse, from, left, jitter));
        (state.pixel.done, state.pixel.gathered) = (false, Accumulator::NONE);
        if rays.samples.march(field, left as u32, &mut state, jitter) {
            put(rays.states, left, state);
            rays.active.push(left as u32);
            left += 1;
        } else {
            pixels.counters.samples_skipped += u64::from(plan.samples_per_ray());
            pixels.finish(&state.pixel, None, target);
        }
    }
    rays.hits = left;
}
