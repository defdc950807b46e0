//! No normals: this build was made without the feature `normals`.

use super::compositing::Compositing;
use super::density::Density;
use crate::memory::Layout;
use crate::render::Counters;
use crate::render::field::Field;
use crate::render::march::RayState;
use crate::render::pixel::Surface;
use core::marker::PhantomData;

/// An empty queue of normals.
pub(in crate::render) struct Normals<'w>(PhantomData<&'w mut [f32]>);

impl<'w> Normals<'w> {
    pub fn lay_out(_: &mut impl Layout<'w>, _: Field<'_>) -> Self {
        Self(PhantomData)
    }

    pub fn queue(
        &mut self,
        _: Field<'_>,
        _: &mut Density<'_>,
        _: &Compositing<'_>,
        _: usize,
        _: (&[RayState], &mut Surface<'_>),
        _: &mut Counters,
    ) {
    }

    pub fn flush(
        &mut self,
        _: Field<'_>,
        _: &mut Density<'_>,
        _: &[RayState],
        _: &mut Surface<'_>,
        _: &mut Counters,
    ) {
    }
}
