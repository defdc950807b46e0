//! Replaces `anti_aliasing.rs` in a build without the feature `anti-aliasing`: one ray through each pixel's centre.

use crate::memory::Layout;
use crate::plan::Effects;
use crate::volume::Pixel;
use core::marker::PhantomData;

#[inline(always)]
pub(crate) fn rays(_: &Effects) -> u32 {
    1
}

#[inline(always)]
pub(crate) fn offset(_: &Effects, _ray: u32) -> (f32, f32) {
    (0.5, 0.5)
}

pub(crate) struct Sums<'w>(PhantomData<&'w ()>);

impl<'w> Sums<'w> {
    #[inline(always)]
    pub fn lay_out(_: &mut impl Layout<'w>, _: &Effects, _surface: bool, _pixels: usize) -> Self {
        Self(PhantomData)
    }

    #[inline(always)]
    pub fn add(&mut self, _: &Effects, _index: usize, _ray: u32, _pixel: &mut Pixel, _far: f32) -> bool {
        true
    }
}
