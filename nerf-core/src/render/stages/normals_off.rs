//! Replaces `normals.rs` in a build without the feature `normals`: no normals are computed.

use super::TileState;
use super::compositing::Compositing;
use crate::memory::Layout;
use crate::render::Counters;
use crate::render::field::Field;
use core::marker::PhantomData;

/// Queue of samples for normals, always empty in this build.
pub(in crate::render) struct Normals<'w>(PhantomData<&'w mut [f32]>);

impl<'w> Normals<'w> {
    pub fn lay_out(_: &mut impl Layout<'w>, _: Field<'_>) -> Self {
        Self(PhantomData)
    }

    pub fn queue(&mut self, _: &mut TileState<'_, '_>, _: &Compositing<'_>, _: &mut Counters) {}

    pub fn flush(&mut self, _: &mut TileState<'_, '_>, _: &mut Counters) {}
}
