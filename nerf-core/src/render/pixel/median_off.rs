//! Replaces `median.rs` in a build without the feature `median`: no median distances are computed.

use crate::memory::Layout;
use crate::plan::Plan;
use crate::volume::Accumulator;
use core::marker::PhantomData;

pub(in crate::render) struct Medians<'w>(PhantomData<&'w mut [f32]>);

impl<'w> Medians<'w> {
    pub const BUILT: bool = false;

    pub fn lay_out(_: &mut impl Layout<'w>, _: &Plan<'_>) -> Self {
        Self(PhantomData)
    }

    pub fn begin(&mut self, _: usize) {}

    #[inline(always)]
    pub fn passes(&self, _: u32, _: &Accumulator) -> bool {
        false
    }

    pub fn put(&mut self, _: u32, _: f32, _: f32, _: [f32; 2]) {}

    pub fn finish(&self, _: usize, _: f32, _: f32) -> f32 {
        0.0
    }
}
