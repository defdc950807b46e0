//! The work a render did: what makes "paid only for what was used" testable without a clock.

/// The work a render did; of a 2D field only colour evaluations, MACs and invalid samples.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Rays.
    pub rays: u64,
    /// Samples the network was asked for.
    pub samples_kept: u64,
    /// Samples of the rays that it was not asked for: outside box or grid, or behind the cut.
    pub samples_skipped: u64,
    /// Evaluations of trunk and density head.
    pub density_evaluations: u64,
    /// Evaluations of the colour branch; of a 2D field, of the whole network.
    pub colour_evaluations: u64,
    /// Multiply-adds of the network.
    pub macs: u64,
    /// Samples whose density was NaN, or whose colour was where there is density; they count as
    /// empty (in a 2D field: black). Without [`Outputs::rgb`](crate::plan::Outputs::rgb) no colour is there to be NaN.
    pub invalid_samples: u64,
}

impl core::ops::AddAssign for Counters {
    fn add_assign(&mut self, b: Self) {
        self.rays += b.rays;
        self.samples_kept += b.samples_kept;
        self.samples_skipped += b.samples_skipped;
        self.density_evaluations += b.density_evaluations;
        self.colour_evaluations += b.colour_evaluations;
        self.macs += b.macs;
        self.invalid_samples += b.invalid_samples;
    }
}
