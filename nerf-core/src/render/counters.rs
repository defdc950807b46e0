//! Counters of a render's work, by which tests check without a clock that a frame pays only for the stages it uses.

use crate::network::Network;

/// Work of a render. A render of a 2D field counts only colour evaluations, multiply-adds and invalid samples.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Number of rays, including rays without a sample.
    pub rays: u64,
    /// Number of samples at which the network was evaluated.
    pub samples_kept: u64,
    /// Number of samples without an evaluation: outside the box, in empty cells, or behind the transmittance cut. The
    /// sum with `samples_kept` is the scene's number of samples for every ray, or more if a ray's path through the box
    /// is longer than `near..far`: samples continue there with the same spacing.
    pub samples_skipped: u64,
    /// Number of evaluations of the proposal network, which do not count as samples.
    pub proposal_evaluations: u64,
    /// Number of evaluations of trunk and density head.
    pub density_evaluations: u64,
    /// Number of evaluations of the colour branch: for samples, or in a field shaded once a ray, for rays. In a 2D
    /// field, number of evaluations of the whole network.
    pub colour_evaluations: u64,
    /// Number of gradients of the density, each a forward and a backward pass of the trunk.
    pub normal_evaluations: u64,
    /// Number of multiply-adds in layers of network and proposal network. Table reads do not count; their number is
    /// `density_evaluations` times [`Architecture::table_reads`](crate::network::Architecture::table_reads).
    pub macs: u64,
    /// Number of invalid results of the network. A NaN density, also of the proposal network, is rendered as 0. A NaN
    /// colour of a sample, or of a ray in a field shaded once a ray, is rendered as black. A sample whose gradient is
    /// not finite has no normal.
    pub invalid_samples: u64,
}

impl Counters {
    /// Counts `n` samples evaluated by trunk and density head.
    pub(super) fn add_density(&mut self, network: &Network<'_>, n: usize) {
        self.samples_kept += n as u64;
        self.density_evaluations += n as u64;
        self.macs += (n * network.architecture().density_macs()) as u64;
    }

    /// Counts `n` evaluations of the colour branch, without the direction's share, which is counted once a ray.
    pub(super) fn add_colour(&mut self, network: &Network<'_>, n: usize) {
        self.colour_evaluations += n as u64;
        self.macs += (n * (network.architecture().colour_macs() - network.direction_macs())) as u64;
    }

    /// Returns `colour`, or black for a NaN colour, which is counted as invalid.
    pub(super) fn or_black(&mut self, colour: [f32; 3]) -> [f32; 3] {
        if colour.iter().any(|c| c.is_nan()) {
            self.invalid_samples += 1;
            return [0.0; 3];
        }
        colour
    }

    /// Counts `n` gradients: forward and backward passes of the trunk.
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
