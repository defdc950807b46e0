//! Cross-validation of a capture: how well each photograph is predicted by fits that were not trained on it.

use crate::data::cameras::bundle::median;
use crate::data::names::count;
use crate::data::{Dataset, View};
use crate::fit::run::{Ended, RunOptions, run};
use crate::measure::eval::ViewScore;
use crate::model::config::Config;
use anyhow::ensure;
use serde::Serialize;
use std::path::Path;

/// Number of fits. Each fit holds out every eighth photograph by name; each photograph is held out of exactly one fit.
pub const FITS: usize = 8;
/// Margin, dB: a photograph counts as unpredicted if its PSNR is below the median by more than this.
const BELOW_MEDIAN_DB: f64 = 1.0;
/// Largest fraction of the photographs that are named as unpredicted.
const MOST: f64 = 0.3;

#[derive(Clone, Debug, Serialize)]
pub struct CrossValidation {
    /// Training steps of each fit.
    pub steps: u32,
    pub median_psnr_db: f64,
    /// Names of the photographs that fits to other photographs predict badly, lowest PSNR first.
    pub unpredicted: Vec<String>,
    /// Scores of each photograph, from the fit that held it out; lowest PSNR first.
    pub held_out: Vec<ViewScore>,
}

impl CrossValidation {
    /// Fits the training and validation photographs of `dataset` [`FITS`] times, with the settings `config`. Returns
    /// `None` if `stop` ends a fit. Fails with fewer than two held-out photographs per fit.
    pub fn of(
        dataset: &Dataset,
        config: &Config,
        options: &RunOptions,
        stop: &dyn Fn(u32) -> bool,
    ) -> anyhow::Result<Option<Self>> {
        let mut views: Vec<&View> = dataset.train.iter().chain(&dataset.val).collect();
        views.sort_by(|a, b| a.name.cmp(&b.name));
        ensure!(
            views.len() >= 2 * FITS,
            "--cross-validate: expected at least {} photographs that are not test photographs, found {}",
            2 * FITS,
            views.len()
        );
        let (mut split, mut held_out) = (dataset.clone(), Vec::with_capacity(views.len()));
        for fit in 0..FITS {
            let part = |is_held_out: bool| {
                let of_part = views.iter().enumerate().filter(|(i, _)| (i % FITS == fit) == is_held_out);
                of_part.map(|(_, view)| (*view).clone()).collect()
            };
            (split.train, split.val) = (part(false), part(true));
            let Ended::Finished(outcome) = run(&split, config.clone(), options, stop)? else {
                return Ok(None);
            };
            held_out.extend(outcome.scores.views);
        }
        Ok(Some(Self::judged(held_out, config.optimiser.steps)))
    }

    /// Returns the result as a sentence for the user. `file`: path of the file that lists the names in `unpredicted`.
    pub fn finding(&self, file: &Path) -> String {
        let Self { steps, median_psnr_db, unpredicted, .. } = self;
        let fits = format!(
            "{FITS} fits of {steps} steps, each photograph held out of one: median {median_psnr_db:.1} dB"
        );
        if unpredicted.is_empty() {
            return format!("{fits}; none is more than {BELOW_MEDIAN_DB} dB below it");
        }
        let file = file.display();
        let photographs = count(unpredicted.len(), "photograph");
        format!(
            "{fits}; {photographs} below it by more than {BELOW_MEDIAN_DB} dB are listed in {file}, the worst first: look at \
             them, and fit without them (--leave-out {file})"
        )
    }

    fn judged(mut held_out: Vec<ViewScore>, steps: u32) -> Self {
        held_out.sort_by(|a, b| a.psnr_db.total_cmp(&b.psnr_db));
        let median_psnr_db = median(held_out.iter().map(|score| score.psnr_db));
        let most = (MOST * held_out.len() as f64) as usize;
        let low = held_out.iter().take(most).filter(|score| score.psnr_db < median_psnr_db - BELOW_MEDIAN_DB);
        let unpredicted = low.map(|score| score.view.clone()).collect();
        Self { steps, median_psnr_db, unpredicted, held_out }
    }
}
