//! What a call cost.

use crate::boundary::{Versioned, by_width};
use nerf_core::render;

/// The work a call did; exact, no clock readings. A picture (a 2D field) has no rays and no samples:
/// only its colour evaluations, multiply-adds and invalid samples count.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct Counters {
    /// `sizeof(nerf_counters)`, set by the caller.
    pub struct_size: usize,
    /// Rays.
    pub rays: u64,
    /// Samples the network was asked for.
    pub samples_kept: u64,
    /// Samples it was not asked for: outside box or occupancy grid, or behind the transmittance cut.
    pub samples_skipped: u64,
    /// Evaluations of trunk and density head.
    pub density_evaluations: u64,
    /// Evaluations of the colour branch: samples, or of a field shaded once a ray the rays that it was run for; of a
    /// picture, of the whole network.
    pub colour_evaluations: u64,
    /// Multiply-adds of the network and of its proposal.
    pub macs: u64,
    /// Samples whose density was NaN (they count as empty), whose colour was (black) or whose gradient was
    /// no finite vector (they have no normal).
    pub invalid_samples: u64,
    /// Gradients of the density, for normals.
    pub normal_evaluations: u64,
    /// Evaluations of the coarse proposal network, which are no samples.
    pub proposal_evaluations: u64,
}

// SAFETY: `repr(C)`, `struct_size` comes first, and integers have no invalid bytes.
unsafe impl Versioned for Counters {
    const NAME: &'static str = "counters";
    const SIZE_V2: usize = by_width(if align_of::<u64>() == 4 { 76 } else { 80 }, 80);
}

impl From<Counters> for render::Counters {
    fn from(c: Counters) -> Self {
        Self {
            rays: c.rays,
            samples_kept: c.samples_kept,
            samples_skipped: c.samples_skipped,
            density_evaluations: c.density_evaluations,
            colour_evaluations: c.colour_evaluations,
            macs: c.macs,
            invalid_samples: c.invalid_samples,
            normal_evaluations: c.normal_evaluations,
            proposal_evaluations: c.proposal_evaluations,
        }
    }
}

impl From<render::Counters> for Counters {
    fn from(c: render::Counters) -> Self {
        Self {
            struct_size: size_of::<Self>(),
            rays: c.rays,
            samples_kept: c.samples_kept,
            samples_skipped: c.samples_skipped,
            density_evaluations: c.density_evaluations,
            colour_evaluations: c.colour_evaluations,
            macs: c.macs,
            invalid_samples: c.invalid_samples,
            normal_evaluations: c.normal_evaluations,
            proposal_evaluations: c.proposal_evaluations,
        }
    }
}
