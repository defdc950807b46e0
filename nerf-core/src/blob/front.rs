//! The Pareto front of a scene, accuracy against work, that a study measured.

use serde::{Deserialize, Serialize};

/// Most points of a front.
pub const MAX_FRONT: usize = 16;

/// The points of a scene, dearest first.
pub type ParetoFront = heapless::Vec<FrontPoint, MAX_FRONT>;

/// A setting, as [`Quality`](crate::plan::Quality) has it, and its price. Of a front's points none is both cheaper
/// and better than another.
///
/// There is no time in it: what a multiply-add takes is the host's to measure.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FrontPoint {
    /// Samples per ray, and never 0: 1 to [`super::MAX_SAMPLES`].
    pub samples: u16,
    /// Transmittance below which a ray ends, `[0, 1)`.
    pub transmittance_cut: f32,
    /// Weight above which a sample is worth a colour, `[0, 1)`.
    pub colour_cut: f32,
    /// Whether empty cells are skipped: only of a scene with an occupancy grid.
    pub occupancy: bool,
    /// [`MathBackend::tag`](crate::math::MathBackend::tag) of the elementary functions.
    pub math: u8,
    /// Whether the samples are drawn from the proposal: only of a scene with a proposal network.
    pub proposal: bool,
    /// PSNR of the scene's exact rendering minus this point's, both against ground truth, dB: below 0
    /// where the shortcut happens to be better.
    pub loss_db: f32,
    /// Multiply-adds of this point relative to the exact rendering's, above 0.
    pub cost: f32,
}
