//! In place of `samples.rs` in a build without the feature `proposal`: the plan's bins are always used.

use super::rays::RayState;
use crate::memory::Layout;
use crate::render::field::Field;
use crate::sampling::{SampleInterval, SampleJitter};
use core::marker::PhantomData;

/// Stand-in for a proposal network's samples in a build without the feature `proposal`.
pub(in crate::render) struct ProposalSamples<'w>(PhantomData<&'w ()>);

impl<'w> ProposalSamples<'w> {
    pub fn lay_out(_: &mut impl Layout<'w>, _: [usize; 3]) -> Self {
        Self(PhantomData)
    }

    #[inline]
    pub fn is_on(&self) -> bool {
        false
    }

    #[inline]
    pub fn march(&self, field: Field<'_>, _: u32, state: &mut RayState, jitter: SampleJitter) -> bool {
        state.march(field.isa(), field.plan, &field.plan.bins, jitter)
    }

    #[inline]
    pub fn take(
        &mut self,
        field: Field<'_>,
        _: u32,
        state: &RayState,
        jitter: SampleJitter,
        _: usize,
    ) -> f32 {
        jitter.t(&field.plan.bins.with(state.ends), state.next)
    }

    #[inline]
    pub fn interval(&self, field: Field<'_>, _: u32, state: &RayState, _: usize, t: f32) -> SampleInterval {
        field.plan.interval(&state.ends, state.pixel.start, state.pixel.range[0], t)
    }
}
