//! The work of a call.

use crate::boundary::{by_width, versioned};
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

versioned!(unsafe Counters, "counters", by_width(if align_of::<u64>() == 4 { 76 } else { 80 }, 80));

/// Conversions of the fields from and to the core's.
macro_rules! convert {
    ($($field:ident),+) => {
        impl From<Counters> for render::Counters {
            fn from(c: Counters) -> Self {
                Self { $($field: c.$field),+ }
            }
        }

        impl From<render::Counters> for Counters {
            fn from(c: render::Counters) -> Self {
                Self { struct_size: size_of::<Self>(), $($field: c.$field),+ }
            }
        }
    };
}

convert!(
    rays,
    samples_kept,
    samples_skipped,
    density_evaluations,
    colour_evaluations,
    macs,
    invalid_samples,
    normal_evaluations,
    proposal_evaluations
);
