//! In place of `proposal.rs` in a build without the feature: no samples are drawn.

use super::InFlight;
use crate::blob::Blob;
use crate::math::Math;
use crate::matrix::{Kernel, Storage};
use crate::plan::Plan;
use crate::render::pixel::{Pixels, RaySource, Target};
use core::marker::PhantomData;

/// No proposal network, whatever the scene has.
#[derive(Clone, Debug)]
pub(in crate::render) struct Proposer<'a>(PhantomData<&'a ()>);

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

    pub fn rows(&self, _: &Plan<'_>) -> (usize, usize) {
        (0, 0)
    }
}

#[allow(clippy::extra_unused_type_parameters, reason = "the signature is that of `proposal.rs`")]
pub(in crate::render) fn propose<M: Math>(
    _: &Proposer<'_>,
    _: &mut InFlight<'_, '_>,
    _: &mut Pixels<'_, '_>,
    _: &impl RaySource,
    _: &mut impl Target,
) {
}
