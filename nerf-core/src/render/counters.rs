//! The work a render did: what makes "paid only for what was used" testable without a clock.

use crate::network::Network;

/// The work a render did; of a 2D field only colour evaluations, MACs and invalid samples.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Rays.
    pub rays: u64,
    /// Samples the network was asked for.
    pub samples_kept: u64,
    /// Samples of the rays that it was not asked for: outside box or occupancy grid, or behind the cut. With
    /// `samples_kept` the scene's samples of every ray, or more where a ray's way through the box is longer
    /// than `near..far`: it goes on there with samples as far apart.
    pub samples_skipped: u64,
    /// Evaluations of the proposal network, which are no samples.
    pub proposal_evaluations: u64,
    /// Evaluations of trunk and density head.
    pub density_evaluations: u64,
    /// Evaluations of the colour branch: samples, or of a field shaded once a ray the rays that it was run for; of a 2D
    /// field, of the whole network.
    pub colour_evaluations: u64,
    /// Gradients of the density: trunk forward and back.
    pub normal_evaluations: u64,
    /// Multiply-adds of the network's layers and of its proposal's. Reading a grid's tables is none: density
    /// evaluations times [`Architecture::table_reads`](crate::network::Architecture::table_reads) says how often.
    pub macs: u64,
    /// Samples whose density was NaN, which count as empty (the proposal's among them), and samples (of a field shaded
    /// once a ray, rays) whose colour was asked for and was NaN, which count as black, or samples whose gradient was and is not finite, which
    /// have no normal.
    pub invalid_samples: u64,
}

impl Counters {
    /// `n` samples through trunk and density head.
    pub(super) fn add_density(&mut self, network: &Network<'_>, n: usize) {
        self.samples_kept += n as u64;
        self.density_evaluations += n as u64;
        self.macs += (n * network.architecture().density_macs()) as u64;
    }

    /// `n` samples through the colour branch; the direction's share was paid once per ray.
    pub(super) fn add_colour(&mut self, network: &Network<'_>, n: usize) {
        self.colour_evaluations += n as u64;
        self.macs += (n * (network.architecture().colour_macs() - network.direction_macs())) as u64;
    }

    /// A colour of the network; one that is NaN is counted, and black.
    pub(super) fn or_black(&mut self, colour: [f32; 3]) -> [f32; 3] {
        if colour.iter().any(|c| c.is_nan()) {
            self.invalid_samples += 1;
            return [0.0; 3];
        }
        colour
    }

    /// `n` samples through the trunk and back.
    #[cfg(feature = "normals")]
    pub(super) fn add_normals(&mut self, network: &Network<'_>, n: usize) {
        self.normal_evaluations += n as u64;
        self.macs += (n * network.architecture().gradient_macs()) as u64;
    }
}

impl core::ops::AddAssign for Counters {
    fn add_assign(&mut self, b: Self) {
        self.rays += b.rays;
        self.samples_kept += b.samples_kept;
        self.samples_skipped += b.samples_skipped;
        self.proposal_evaluations += b.proposal_evaluations;
        self.density_evaluations += b.density_evaluations;
        self.colour_evaluations += b.colour_evaluations;
        self.normal_evaluations += b.normal_evaluations;
        self.macs += b.macs;
        self.invalid_samples += b.invalid_samples;
    }
}
