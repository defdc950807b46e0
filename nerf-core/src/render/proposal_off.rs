//! In the place of `proposal.rs` where the feature is off: no samples are drawn, and no code says how.

use super::Target;
use super::frame::Frame;
use super::march::RayState;
use super::source::RaySource;
use crate::blob::Blob;
use crate::math::Math;
use crate::matrix::{Kernel, Storage};
use crate::memory::Layout;
use crate::plan::Plan;
use crate::sampling::SampleJitter;
use crate::simd::Isa;
use core::marker::PhantomData;

/// No proposal network, whatever the scene has.
#[derive(Clone, Debug)]
pub(super) struct Proposer<'a>(PhantomData<&'a ()>);

impl<'a> Proposer<'a> {
    pub fn parameters(_: &Blob<'_>) -> usize {
        0
    }

    pub fn unpack(_: &Blob<'_>, _: Storage, _: &mut [f32]) {}

    pub fn view(_: &Blob<'a>, _: Kernel, _: &'a [f32]) -> Self {
        Self(PhantomData)
    }

    pub fn macs(&self) -> u64 {
        0
    }

    pub fn row(&self, _: &Plan<'_>) -> usize {
        0
    }

    pub fn rows(&self) -> (usize, usize) {
        (0, 0)
    }
}

/// The plan's bins are always meant.
pub(super) struct ProposalSamples<'f, 'w>(PhantomData<(&'f (), &'w ())>);

impl<'f, 'w> ProposalSamples<'f, 'w> {
    pub fn lay_out(_: &mut impl Layout<'w>, _: &'f Proposer<'f>, _: [usize; 3]) -> Self {
        Self(PhantomData)
    }

    #[inline]
    pub fn is_on(&self) -> bool {
        false
    }

    #[inline]
    pub fn march(
        &self,
        isa: Isa,
        plan: &Plan<'_>,
        _: u32,
        state: &mut RayState,
        place: SampleJitter,
    ) -> bool {
        state.march(isa, plan, &plan.bins, place)
    }

    #[inline]
    pub fn take(&mut self, plan: &Plan<'_>, _: u32, state: &RayState, place: SampleJitter, _: usize) -> f32 {
        place.t(&plan.bins.with(state.ends), state.next)
    }

    #[inline]
    pub fn interval(&self, _: &Plan<'_>, _: u32, _: usize, _: [f32; 2]) -> Option<(f32, f32)> {
        None
    }
}

impl Frame<'_, '_> {
    #[allow(clippy::extra_unused_type_parameters, reason = "the signature is that of `proposal.rs`")]
    pub(super) fn propose<M: Math>(&mut self, hits: usize, _: &impl RaySource, _: &mut impl Target) -> usize {
        hits
    }
}
