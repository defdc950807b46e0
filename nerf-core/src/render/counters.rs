//! Counters of a render's work. Tests use the counters to check that a frame runs only the stages that it needs.

use crate::network::Network;

/// Counts of the work of a render. For a 2D field only `colour_evaluations`, `macs` and `invalid_samples` are counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Number of rays, including rays on which no sample was evaluated.
    pub rays: u64,
    /// Number of samples at which the scene's network was evaluated.
    pub samples_kept: u64,
    /// Number of planned samples at which the scene's network was not evaluated: samples outside the box, in empty
    /// cells, or behind the point where the ray ended. The planned number of samples per ray and field is
    /// [`Quality::samples`](crate::plan::Quality), plus one per bin of the proposal network, if one is used. Each ray
    /// adds, for each field, the number of planned samples minus the number of evaluated samples, but at least 0. The
    /// evaluated samples can be more than the planned samples: a ray may have samples in front of `near` or behind
    /// `far`, up to the ends of the box.
    pub samples_skipped: u64,
    /// Number of evaluations of the proposal network, not included in `samples_kept`.
    pub proposal_evaluations: u64,
    /// Number of evaluations of trunk and density head.
    pub density_evaluations: u64,
    /// Number of evaluations of the colour branch: at most one per sample; with deferred shading, at most one per ray.
    /// For a 2D field, number of evaluations of the whole network. With one field, the branch is evaluated at a sample
    /// if the ray's weights since the last evaluation sum to more than the colour cut
    /// ([`Quality`](crate::plan::Quality)). With several fields, the branch is evaluated if the weight of the sample
    /// alone can exceed the cut.
    pub colour_evaluations: u64,
    /// Number of density gradients computed for normals, each by a forward and a backward pass of the trunk.
    pub normal_evaluations: u64,
    /// Number of multiply-adds in the layers of network and proposal network. Reads of grid tables are not included:
    /// one density evaluation reads [`Architecture::table_reads`](crate::network::Architecture::table_reads) entries.
    pub macs: u64,
    /// Number of invalid network outputs. A NaN density, also one of the proposal network, is rendered as 0, and a NaN
    /// colour as black. A density gradient that is not finite is left out of the normal.
    pub invalid_samples: u64,
}

impl Counters {
    /// Counts `n` evaluations of trunk and density head, one per sample.
    pub(super) fn add_density(&mut self, network: &Network<'_>, n: usize) {
        self.samples_kept += n as u64;
        self.density_evaluations += n as u64;
        self.macs += (n * network.density_macs()) as u64;
    }

    /// Counts `n` evaluations of the colour branch, without the multiply-adds that depend on the direction alone.
    pub(super) fn add_colour(&mut self, network: &Network<'_>, n: usize) {
        self.colour_evaluations += n as u64;
        self.macs += (n * network.colour_macs_without_direction()) as u64;
    }

    /// Returns `colour`, or black if a channel of `colour` is NaN. A NaN colour is counted as invalid.
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
        self.macs += (n * network.gradient_macs()) as u64;
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
