//! What an imported network shows of a data set: whether the guesses about it were right.

pub mod occupancy;
mod outcome;
pub mod probe;
pub mod work;

use crate::data::{Dataset, View};
use crate::measure::eval::OCCUPANCY_LOSS_DB;
use crate::measure::eval::{EvalError, Scores, measure};
use crate::measure::metrics::gain_db;
use nerf_core::Kernel;
use nerf_core::plan::Quality;

/// Every so many pixels of a row, and rows, are measured. Odd: the middle of a block of so many is a pixel's centre.
pub const STRIDE: u32 = 3;
/// Views that are measured where none are named.
pub const VIEWS: usize = 10;
/// Views whose directions are averaged over.
pub const RAY_VIEWS: usize = 50;
/// Below this something about the network was guessed wrong, dB.
pub const SUSPICIOUS_DB: f64 = 15.0;

/// Figures of some views, over every third pixel of every third row.
#[derive(Clone, Debug)]
pub struct Check {
    /// Of the blob's own rounded weights.
    pub scores: Scores,
    /// dB that rounding to f16 cost.
    pub quantisation_loss_db: f64,
    /// dB by which the occupancy grid makes the picture better (below 0: worse); `None` without one.
    pub occupancy_gain_db: Option<f64>,
}

impl Check {
    /// Mean PSNR over the views, dB.
    pub fn psnr_db(&self) -> f64 {
        self.scores.psnr_db().unwrap_or(f64::NAN)
    }

    /// Whether the picture is not the same without the occupancy grid.
    pub fn occupancy_matters(&self) -> bool {
        self.occupancy_gain_db.is_some_and(|gain| gain.is_nan() || gain.abs() > OCCUPANCY_LOSS_DB)
    }

    /// Whether the picture is worse with the occupancy grid.
    pub fn occupancy_harms(&self) -> bool {
        self.occupancy_gain_db.is_some_and(|gain| gain < -OCCUPANCY_LOSS_DB)
    }

    /// Whether the picture is that of another scene, or of none.
    pub fn is_suspicious(&self) -> bool {
        let psnr_db = self.psnr_db();
        psnr_db.is_nan() || psnr_db < SUSPICIOUS_DB
    }
}

/// What a network is measured as.
#[derive(Clone, Copy, Debug)]
pub struct Draft<'a> {
    /// Its blob, in which no occupancy grid is required.
    pub blob: &'a [u8],
    /// Its parameters before rounding, in export order.
    pub parameters: &'a [f32],
    /// Whether the blob has an occupancy grid.
    pub has_occupancy: bool,
    /// What the views are composited over, display-encoded.
    pub background: [f32; 3],
}

/// Renders `views` with rounded weights, with f32 weights, and without the occupancy grid if there is one.
///
/// `each` is called after every view that was rendered.
///
/// # Errors
/// [`EvalError`] if the blob cannot be opened or rendered.
pub fn check(
    draft: &Draft<'_>,
    kernel: Kernel,
    views: &[View],
    mut each: impl FnMut(),
) -> Result<Check, EvalError> {
    let mut score = |parameters, quality: &Quality| {
        measure(draft.blob, parameters, kernel, quality, draft.background, views, |_, _, _, _| each())
    };
    let with_occupancy = Quality::default();
    let scores = score(None, &with_occupancy)?;
    let db = |scores: &Scores| scores.psnr_db().unwrap_or(f64::NAN);
    let quantisation_loss_db = gain_db(db(&score(Some(draft.parameters), &with_occupancy)?), db(&scores));
    let occupancy_gain_db = if draft.has_occupancy {
        let without = score(None, &Quality { occupancy: false, ..with_occupancy })?;
        Some(gain_db(db(&scores), db(&without)))
    } else {
        None
    };
    Ok(Check { scores, quantisation_loss_db, occupancy_gain_db })
}

/// Number of renderings [`check`] makes of each view.
pub fn renderings(has_occupancy: bool) -> u64 {
    if has_occupancy { 3 } else { 2 }
}

/// The views that can be asked for: those of validation, or else of training.
pub fn split(dataset: &Dataset) -> &[View] {
    if dataset.val.is_empty() { &dataset.train } else { &dataset.val }
}

/// A lattice of every [`STRIDE`]-th pixel of a view.
pub fn thinned(view: &View) -> View {
    view.thinned(STRIDE).into_owned()
}
