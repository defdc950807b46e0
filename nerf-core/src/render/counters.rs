//! Counters of a render's work: they make "paid only for what was used" testable without a clock.

use crate::network::Network;

/// The work of a render; that of a 2D field has only colour evaluations, multiply-adds and invalid samples.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Number of rays, including those that meet nothing.
    pub rays: u64,
    /// Samples at which the network was evaluated.
    pub samples_kept: u64,
    /// Samples of the rays without an evaluation: outside the box, in empty cells, or behind the cut. Together with
    /// `samples_kept`, the scene's samples of every ray, or more if a ray's path through the box is longer than
    /// `near..far`: it continues there with the same spacing.
    pub samples_skipped: u64,
    /// Evaluations of the proposal network, which do not count as samples.
    pub proposal_evaluations: u64,
    /// Evaluations of trunk and density head.
    pub density_evaluations: u64,
    /// Evaluations of the colour branch, for samples or, in a field shaded once a ray, for rays; in a 2D field,
    /// evaluations of the whole network.
    pub colour_evaluations: u64,
    /// Gradients of the density, each a forward and a backward pass of the trunk.
    pub normal_evaluations: u64,
    /// Multiply-adds of the layers of the network and its proposal network. Table reads do not count: their number is
    /// density evaluations times [`Architecture::table_reads`](crate::network::Architecture::table_reads).
    pub macs: u64,
    /// Invalid results of the network. A density that is NaN counts as empty (the proposal's too). A colour that is
    /// NaN (in a field shaded once a ray, that of a ray) counts as black. A sample whose gradient is not finite has
    /// no normal.
    pub invalid_samples: u64,
}

impl Counters {
    /// Counts `n` samples evaluated by trunk and density head.
    pub(super) fn add_density(&mut self, network: &Network<'_>, n: usize) {
        self.samples_kept += n as u64;
        self.density_evaluations += n as u64;
        self.macs += (n * network.architecture().density_macs()) as u64;
    }

    /// Counts `n` samples evaluated by the colour branch; the direction's share is counted once a ray.
    pub(super) fn add_colour(&mut self, network: &Network<'_>, n: usize) {
        self.colour_evaluations += n as u64;
        self.macs += (n * (network.architecture().colour_macs() - network.direction_macs())) as u64;
    }

    /// Returns `colour`, or black if it is NaN, which is counted.
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
