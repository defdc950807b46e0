//! The Pareto front of a scene: accuracy against work, as measured by a study.

use serde::{Deserialize, Serialize};

/// Maximum number of points of a Pareto front.
pub const MAX_FRONT: usize = 16;

/// The Pareto front of a scene, most expensive point first.
pub type ParetoFront = heapless::Vec<FrontPoint, MAX_FRONT>;

/// The settings of a [`Quality`](crate::plan::Quality) with their loss and cost. No point of a Pareto front is both
/// cheaper and better than another.
///
/// Cost is in multiply-adds, not in time, which depends on the host.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FrontPoint {
    /// Samples per ray, 1 to [`super::MAX_SAMPLES`].
    pub samples: u16,
    /// Transmittance below which a ray ends, `[0, 1)`.
    pub transmittance_cut: f32,
    /// Weight above which a sample's colour is evaluated, `[0, 1)`.
    pub colour_cut: f32,
    /// Whether empty cells are skipped; true only in a scene with an occupancy grid.
    pub occupancy: bool,
    /// [`MathBackend::tag`](crate::math::MathBackend::tag) of the elementary functions.
    pub math: u8,
    /// Whether samples are drawn from the proposal network; true only in a scene that has one.
    pub proposal: bool,
    /// PSNR of the scene's exact rendering minus this point's, both against ground truth, dB. Negative if the
    /// approximation happens to be better.
    pub loss_db: f32,
    /// Multiply-adds of this point relative to the exact rendering's, above 0.
    pub cost: f32,
}
