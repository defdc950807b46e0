//! What accuracy costs in a scene: the front that a study measured.

use super::body::SceneFacts;
use super::check::samples_fit;
use super::error::FrontFault;
use crate::math::MathBackend;
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
    /// Where a ray ends, `[0, 1)`.
    pub transmittance_cut: f32,
    /// What weight is worth a colour, `[0, 1)`.
    pub colour_cut: f32,
    /// Whether empty cells are skipped: only of a scene with an occupancy grid.
    pub occupancy: bool,
    /// [`MathBackend::tag`] of the elementary functions.
    pub math: u8,
    /// Whether the samples are drawn from the proposal: only of a scene with a proposal network.
    pub proposal: bool,
    /// PSNR of the scene's exact rendering minus this point's, both against ground truth, dB: below 0
    /// where the shortcut happens to be better.
    pub loss_db: f32,
    /// Multiply-adds of this point relative to the exact rendering's, above 0.
    pub cost: f32,
}

/// Whether every point can be planned, and together they are a front; `occupancy` and `proposal` say whether
/// the scene has them.
pub(super) fn check(
    front: &[FrontPoint],
    scene: &SceneFacts,
    occupancy: bool,
    proposal: bool,
) -> Result<(), (usize, FrontFault)> {
    for (index, point) in front.iter().enumerate() {
        check_point(point, scene, occupancy, proposal).map_err(|fault| (index, fault))?;
        if let Some(before) = index.checked_sub(1).and_then(|i| front.get(i)) {
            if point.cost >= before.cost {
                return Err((index, FrontFault::CostOrder { before: before.cost, found: point.cost }));
            }
            if point.loss_db < before.loss_db {
                return Err((index, FrontFault::LossOrder { before: before.loss_db, found: point.loss_db }));
            }
        }
    }
    Ok(())
}

fn check_point(
    point: &FrontPoint,
    scene: &SceneFacts,
    occupancy: bool,
    proposal: bool,
) -> Result<(), FrontFault> {
    if !samples_fit(scene, point.samples) {
        return Err(FrontFault::Samples { found: point.samples });
    }
    if !(0.0..1.0).contains(&point.transmittance_cut) {
        return Err(FrontFault::TransmittanceCut { found: point.transmittance_cut });
    }
    if !(0.0..1.0).contains(&point.colour_cut) {
        return Err(FrontFault::ColourCut { found: point.colour_cut });
    }
    if (point.occupancy && !occupancy) || (scene.occupancy_required && !point.occupancy) {
        return Err(FrontFault::Occupancy { found: point.occupancy });
    }
    if point.math >= MathBackend::TAGS {
        return Err(FrontFault::Math { found: point.math });
    }
    if point.proposal && !proposal {
        return Err(FrontFault::Proposal);
    }
    if !point.loss_db.is_finite() {
        return Err(FrontFault::LossDb { found: point.loss_db });
    }
    if !(point.cost > 0.0 && point.cost.is_finite()) {
        return Err(FrontFault::Cost { found: point.cost });
    }
    Ok(())
}
