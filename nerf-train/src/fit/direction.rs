//! Whether the scene calls for view dependence, or would look the same without it.

use crate::fit::run::{RunError, Session, spread};
use crate::measure::audit::{Verdict, flattened};
use crate::measure::eval::Scores;
use crate::measure::metrics::gain_db;
use crate::train::candidate::{About, Candidate};
use nerf_core::plan::Quality;

/// Training views whose directions are averaged over.
const RAY_VIEWS: usize = 50;

/// What view dependence was found to be worth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ViewDependence {
    /// dB that it gains over its mean, on training views.
    pub gain_db: f64,
    /// Whether the blob does without it.
    pub left_out: bool,
}

impl Session<'_, '_> {
    /// Replaces the candidate's direction by its mean over the training rays if that loses too little.
    ///
    /// Asked of training views: what is exported is not chosen by views whose PSNR is reported. `None` where
    /// nobody asks, and if colour does not depend on the direction.
    pub(super) fn ask_direction(
        &self,
        candidate: &mut Candidate,
    ) -> Result<Option<ViewDependence>, RunError> {
        let Some(threshold_db) = self.options.effect_threshold_db else { return Ok(None) };
        let views = self.asked_views();
        let views: Vec<_> = views.iter().collect();
        let rays = spread(&self.dataset.train, RAY_VIEWS);
        let with = &self.trainer.model().architecture;
        let Some((architecture, parameters)) = flattened(with, &candidate.parameters, &rays) else {
            return Ok(None);
        };
        let flat = Candidate { architecture: Some(architecture), parameters, ..candidate.clone() };
        let blob = |candidate| Ok::<_, RunError>(self.trainer.export(candidate, &About::default())?.bytes);
        let (dependent, independent) = (blob(candidate)?, blob(&flat)?);
        let quality = Quality::default();
        let scores = self.compare(&views, &[(&dependent, quality), (&independent, quality)])?;
        // Photographs of different exposure show the difference between them, whatever the direction is worth.
        let gains = self.trainer.exposure().is_some_and(|found| found.fitted);
        let db = |scores: &Scores| {
            let db = if gains { scores.aligned_psnr_db() } else { scores.psnr_db() };
            db.unwrap_or(f64::NAN)
        };
        let gain_db = gain_db(db(&scores[0]), db(&scores[1]));
        // It takes work and spares none.
        let left_out = Verdict::of(gain_db, 1.0, threshold_db) == Verdict::Drops;
        if left_out {
            *candidate = flat;
        }
        Ok(Some(ViewDependence { gain_db, left_out }))
    }
}
