//! A field's network and the plan of the frame, which are passed together to every stage of the frame.

use crate::network::{Network, PER_RAY_BUILT, Shading};
use crate::plan::Plan;
use crate::simd::{BLOCK, Isa};

#[derive(Clone, Copy)]
pub(super) struct Field<'f> {
    pub network: &'f Network<'f>,
    pub plan: &'f Plan<'f>,
}

impl Field<'_> {
    pub fn isa(&self) -> Isa {
        self.network.isa()
    }

    /// Largest number of samples in a block. The network evaluates all samples of a block together.
    pub fn block_samples(&self) -> usize {
        if self.network.whole_blocks() { BLOCK } else { self.plan.batch.samples }
    }

    /// Returns the number of columns of the activation matrices for a block of `n` samples. Most kernels need a
    /// multiple of 8 or 16: `n` is then rounded up ([`Network::padded`]), and the added columns are padding.
    pub fn columns(&self, n: usize) -> usize {
        self.network.padded(n)
    }

    /// Whether colour is requested and the colour branch is evaluated once per ray (deferred shading).
    pub fn shades_rays(&self) -> bool {
        PER_RAY_BUILT && self.plan.outputs.rgb && self.network.architecture().shading == Shading::PerRay
    }

    /// Whether colour is requested and the colour branch is evaluated at samples, not once per ray.
    pub fn shades_samples(&self) -> bool {
        self.plan.outputs.rgb && !self.shades_rays()
    }
}
