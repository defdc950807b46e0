//! A field's network and the plan of its frames: an argument of every stage of a frame.

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

    /// Number of samples in a block.
    pub fn block_samples(&self) -> usize {
        if self.network.whole_blocks() { BLOCK } else { self.plan.batch.samples }
    }

    /// Number of columns for `n` samples: `n`, or the next multiple of [`Network::columns`] for kernels of whole
    /// blocks.
    ///
    /// The result in a column does not depend on the number of columns.
    pub fn columns(&self, n: usize) -> usize {
        if self.network.whole_blocks() { n.next_multiple_of(self.network.columns()) } else { n }
    }

    /// Whether colour is requested and computed once a ray.
    pub fn shades_rays(&self) -> bool {
        PER_RAY_BUILT && self.plan.outputs.rgb && self.network.architecture().shading == Shading::PerRay
    }

    /// Whether colour is requested and computed at samples.
    pub fn shades_samples(&self) -> bool {
        self.plan.outputs.rgb && !self.shades_rays()
    }
}
