//! No normals: this build was made without the feature `normals`.

use crate::memory::Layout;
use crate::network::Network;
use crate::plan::Plan;
use crate::render::frame::Frame;
use core::marker::PhantomData;

/// Nothing.
pub(in crate::render) struct Normals<'w>(PhantomData<&'w mut [f32]>);

impl<'w> Normals<'w> {
    pub fn lay_out(_: &mut impl Layout<'w>, _: &Network<'_>, _: &Plan<'_>) -> Self {
        Self(PhantomData)
    }

    pub fn begin(&mut self, _: usize) {}

    pub fn finish(&self, _: Option<usize>, _: f32) -> [f32; 3] {
        [0.0; 3]
    }
}

impl Frame<'_, '_> {
    pub(in crate::render) fn queue_normals(&mut self, _: usize) {}

    pub(in crate::render) fn flush_normals(&mut self) {}
}
