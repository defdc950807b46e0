//! Counters of a render's work, with which tests check without timing that a frame runs only the stages it needs.

use crate::network::Network;

/// Work of a render, as counts. For a 2D field only `colour_evaluations`, `macs` and `invalid_samples` are counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Number of rays, including rays on which no sample was evaluated.
    pub rays: u64,
    /// Number of samples at which the scene's network was evaluated.
    pub samples_kept: u64,
    /// Number of samples that were not evaluated: outside the box, in empty cells, or behind the transmittance
    /// threshold. Kept and skipped samples of a ray add up to the plan's number of samples per ray, or to more on a ray
    /// whose path through the box is longer than `near..far`: samples continue there with the same spacing.
    pub samples_skipped: u64,
    /// Number of evaluations of the proposal network, not included in `samples_kept`.
    pub proposal_evaluations: u64,
    /// Number of evaluations of trunk and density head.
    pub density_evaluations: u64,
    /// Number of evaluations of the colour branch: one per coloured sample, or with deferred shading one per ray. In a
    /// 2D field, number of evaluations of the whole network.
    pub colour_evaluations: u64,
    /// Number of density gradients computed for normals, each by a forward and a backward pass of the trunk.
    pub normal_evaluations: u64,
    /// Number of multiply-adds in the layers of network and proposal network. Reads of the encoding's grid tables are
    /// not included: [`Architecture::table_reads`](crate::network::Architecture::table_reads) per density evaluation.
    pub macs: u64,
    /// Number of invalid network outputs: NaN densities, also of the proposal network, which are rendered as 0; NaN
    /// colours, rendered as black; and density gradients that are not finite, which are left out of normals.
    pub invalid_samples: u64,
}

impl Counters {
    /// Counts `n` evaluations of trunk and density head, one per sample.
    pub(super) fn add_density(&mut self, network: &Network<'_>, n: usize) {
        self.samples_kept += n as u64;
        self.density_evaluations += n as u64;
        self.macs += (n * network.architecture().density_macs()) as u64;
    }

    /// Counts `n` evaluations of the colour branch, without the work on the direction, which is counted once per ray.
    pub(super) fn add_colour(&mut self, network: &Network<'_>, n: usize) {
        self.colour_evaluations += n as u64;
        self.macs += (n * (network.architecture().colour_macs() - network.direction_macs())) as u64;
    }

    /// Returns `colour`. A colour with a NaN channel is counted as invalid, and black is returned.
    pub(super) fn or_black(&mut self, colour: [f32; 3]) -> [f32; 3] {
        if colour.iter().any(|c| c.is_nan()) {
            self.invalid_samples += 1;
            return [0.0; 3];
        }
        colour
    }

    /// Counts `n` density gradients, each a forward and a backward pass of the trunk.
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
