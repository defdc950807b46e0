//! Whether the scene calls for view dependence, or would look the same without it.

use super::candidate::{About, Candidate};
use super::look::GRID_VIEWS;
use super::run::{RunError, Session, spread};
use crate::eval::measure;
use crate::report::metrics::gain_db;
use crate::study::{Verdict, flattened};
use nerf_core::plan::Quality;

/// Training views whose directions are averaged over.
const RAY_VIEWS: usize = 50;

/// What view dependence was found to be worth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ViewDependence {
    /// dB that it gains over its mean, on validation views.
    pub gain_db: f64,
    /// Whether the blob does without it.
    pub left_out: bool,
}

impl Session<'_, '_> {
    /// Replaces the candidate's direction by its mean over the training rays if that loses too little.
    ///
    /// `None` where nobody asks, without validation views, and if colour does not depend on the direction.
    pub(super) fn ask_direction(
        &self,
        candidate: &mut Candidate,
    ) -> Result<Option<ViewDependence>, RunError> {
        let views = spread(&self.dataset.val, GRID_VIEWS);
        let rays = spread(&self.dataset.train, RAY_VIEWS);
        let with = &self.trainer.model.architecture;
        let flat = flattened(with, &candidate.parameters, &rays).filter(|_| !views.is_empty());
        let (Some(threshold_db), Some((architecture, parameters))) = (self.options.effect_threshold_db, flat)
        else {
            return Ok(None);
        };
        let flat = Candidate { architecture: Some(architecture), parameters, ..candidate.clone() };
        let psnr_db = |candidate: &Candidate| -> Result<f64, RunError> {
            let draft = self.trainer.export(candidate, &About::default())?.bytes;
            let (tier, background) = (self.options.tier, self.trainer.background());
            let (quality, views) = (Quality::default(), views.iter().copied());
            let scores = measure(&draft, None, tier, &quality, background, views, |_, _, _, _| {})?;
            Ok(scores.psnr_db().unwrap_or(f64::NAN))
        };
        let gain_db = gain_db(psnr_db(candidate)?, psnr_db(&flat)?);
        // It takes work and spares none.
        let left_out = Verdict::of(gain_db, 1.0, threshold_db) == Verdict::Drops;
        if left_out {
            *candidate = flat;
        }
        Ok(Some(ViewDependence { gain_db, left_out }))
    }
}
