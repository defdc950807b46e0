//! Counts of the work of a call.

use crate::boundary::{by_width, versioned};
use nerf_core::render;

/// Exact counts of the work that a call did. For a 2D field, which has no rays, only colour evaluations, multiply-adds
/// and invalid samples are counted.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct Counters {
    /// `sizeof(nerf_counters)`, set by the caller.
    pub struct_size: usize,
    /// Number of rays, including rays on which no sample was evaluated.
    pub rays: u64,
    /// Number of samples at which the scene's network was evaluated.
    pub samples_kept: u64,
    /// Number of samples skipped outside the scene box, in empty cells, or behind the point where the ray ended.
    pub samples_skipped: u64,
    /// Number of evaluations of the layers that give the density: the trunk and the density head.
    pub density_evaluations: u64,
    /// Number of evaluations of the colour branch: one per sample that gets a colour, or, with deferred shading, one
    /// per ray. For a 2D field: number of evaluations of the whole network.
    pub colour_evaluations: u64,
    /// Number of multiply-adds in the layers of network and proposal network. Density gradients for normals are
    /// included, reads of the learned grid's tables are not.
    pub macs: u64,
    /// Number of invalid results of the networks: NaN densities (rendered as empty), NaN colours (rendered as black),
    /// and density gradients that are not finite (left out of normals).
    pub invalid_samples: u64,
    /// Number of evaluations of the gradient of the density with respect to position, for normals.
    pub normal_evaluations: u64,
    /// Number of evaluations of the proposal network, which finds where to place samples; not part of `samples_kept`.
    pub proposal_evaluations: u64,
}

versioned!(unsafe Counters, "counters", by_width(if align_of::<u64>() == 4 { 76 } else { 80 }, 80));

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

convert! {
    rays, samples_kept, samples_skipped, density_evaluations, colour_evaluations, macs, invalid_samples,
    normal_evaluations, proposal_evaluations
}
