//! No median distances: this build was made without the feature `median`.

use crate::memory::Layout;
use crate::plan::Plan;
use crate::volume::Accumulator;
use core::marker::PhantomData;

/// Nothing.
pub(in crate::render) struct Medians<'w>(PhantomData<&'w mut [f32]>);

impl<'w> Medians<'w> {
    /// Whether this build has medians.
    pub const BUILT: bool = false;

    pub fn lay_out(_: &mut impl Layout<'w>, _: &Plan<'_>) -> Self {
        Self(PhantomData)
    }

    pub fn begin(&mut self, _: usize) {}

    #[inline]
    pub fn look(&mut self, _: u32, _: f32, _: &Accumulator, _: f32, _: f32, _: f32) {}

    pub fn finish(&self, _: Option<usize>, _: &Plan<'_>, _: f32, _: f32) -> f32 {
        0.0
    }
}
