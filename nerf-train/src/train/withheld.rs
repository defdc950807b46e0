//! Photographs withheld from training at first. Their PSNR gap to the other photographs sets the weight decay.

use crate::data::View;
use crate::model::config::{Config, OptimiserConfig, Withholding};
use crate::model::engine::Batch;
use serde::{Deserialize, Serialize};

/// Number of steps during which photographs are withheld, from the start of a run on.
const TRIAL: u32 = 1_500;
/// First step whose colour errors are summed to find the PSNR of the photographs.
const SUMMED_FROM: u32 = 1_000;
/// Step from which a run that withheld photographs looks for moving objects: by then the field has also learned the
/// photographs that were withheld at first.
pub const LEARNED_FROM: u32 = 2_000;
/// Least number of steps that a run must have for photographs to be withheld.
const FEWEST_STEPS: u32 = 2 * TRIAL;
/// Fraction of the run after which withholding ends even without a finding.
const GIVEN_UP_AT: f64 = 0.5;
/// Number of withheld photographs.
const COUNT: usize = 6;
/// Least number of training photographs that a run must have for some to be withheld.
const FEWEST: usize = 24;
/// Limits of the PSNR gap between withheld and other photographs, dB. Up to the first, the weight decay stays as
/// configured; from the second on, it is multiplied by [`MOST`]. Captures whose PSNR falls with more decay have gaps of
/// 0.8 to 2.9. A capture whose light turned with the object has gaps of 4.9 to 5.1; more decay gains 2.4 dB.
const GAPS: [f64; 2] = [3.4, 4.4];
const MOST: f64 = 30.0;
/// Least number of rays from which the PSNR of a photograph is computed.
const KNOWN: f64 = 64.0;

/// Colour errors of the training photographs while some of them are withheld.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Withheld {
    /// For each photograph: sums of its rays' errors in red, green and blue, sum of the squared errors, number of rays.
    sums: Vec<[f64; 5]>,
}

/// Result of withholding photographs: the PSNR gap, and the weight decay chosen from it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct WithheldFound {
    /// PSNR gap, dB: mean over the photographs that are trained on, minus mean over the withheld photographs.
    pub gap_db: f64,
    pub weight_decay: f64,
}

impl WithheldFound {
    /// Whether the photographs contradict each other: the PSNR of the withheld ones is far below that of the others.
    pub fn contradict(&self) -> bool {
        self.gap_db > GAPS[0]
    }

    /// Whether this finding, read from an untrusted checkpoint, is one that [`Withheld::verdict`] can return.
    pub fn is_sound(&self, optimiser: &OptimiserConfig) -> bool {
        (0.0..=1.0 / optimiser.rate).contains(&self.weight_decay)
    }
}

impl std::fmt::Display for WithheldFound {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { gap_db, weight_decay } = self;
        write!(
            f,
            "{COUNT} photographs withheld in the first {TRIAL} steps come out {gap_db:.1} dB worse than the others: \
             weight decay {weight_decay:.2}"
        )
    }
}

impl Withheld {
    /// Creates the initial state; `None` if nothing is withheld, because of the settings or of too few photographs.
    pub fn of(views: &[View], config: &Config) -> Option<Self> {
        let fits = config.capture.withhold == Withholding::Auto
            && config.network.grid.is_some()
            && config.optimiser.weight_decay > 0.0
            && config.optimiser.steps >= FEWEST_STEPS
            && views.len() >= FEWEST;
        fits.then(|| Self { sums: vec![[0.0; 5]; views.len()] })
    }

    /// Whether it is too late for a finding: withholding ends without one. `share`: used fraction of the budget.
    pub fn is_given_up(share: f64) -> bool {
        share > GIVEN_UP_AT
    }

    pub fn is_of(&self, views: &[View]) -> bool {
        self.sums.len() == views.len() && self.sums.as_flattened().iter().all(|x| x.is_finite())
    }

    /// Whether photograph `view` is withheld. The [`COUNT`] withheld photographs are spread evenly over all.
    fn has(&self, view: usize) -> bool {
        let apart = self.sums.len() / COUNT;
        view % apart == apart / 2 && view / apart < COUNT
    }

    /// Sets the loss weights of the rays of withheld photographs in `batch` to 0.
    pub fn weigh(&self, batch: &mut Batch) {
        batch.weights.resize(batch.rays.len(), 1.0);
        for (weight, &view) in batch.weights.iter_mut().zip(&batch.views) {
            if self.has(view as usize) {
                *weight = 0.0;
            }
        }
    }

    /// Adds colour errors of rays to the sums of their photographs. Does nothing before step `SUMMED_FROM`. `errors`:
    /// index of a ray in `batch`, and its error in red, green and blue.
    pub fn add<'e>(&mut self, batch: &Batch, step: u32, errors: impl Iterator<Item = &'e (u32, [f32; 3])>) {
        if step < SUMMED_FROM {
            return;
        }
        for &(ray, error) in errors {
            let view = batch.views.get(ray as usize).map(|&view| view as usize);
            let Some(sum) = view.and_then(|view| self.sums.get_mut(view)) else { continue };
            let [r, g, b] = error.map(f64::from);
            let of_ray = [r, g, b, r * r + g * g + b * b, 1.0];
            sum.iter_mut().zip(of_ray).for_each(|(sum, x)| *sum += x);
        }
    }

    /// Returns the PSNR gap and the weight decay chosen from it, after the last of `TRIAL` steps with withheld
    /// photographs; `None` after any other `step`.
    pub fn verdict(&self, step: u32, optimiser: &OptimiserConfig) -> Option<WithheldFound> {
        if step + 1 != TRIAL {
            return None;
        }
        let mean_db = |withheld: bool| {
            let views = self.sums.iter().enumerate().filter(|(view, _)| self.has(*view) == withheld);
            let all: Vec<f64> = views.filter_map(|(_, sums)| psnr_db(sums)).collect();
            all.iter().sum::<f64>() / all.len() as f64
        };
        let gap_db = mean_db(false) - mean_db(true);
        // The gap is unknown if photographs have no rays or no error.
        let above = if gap_db.is_finite() { (gap_db - GAPS[0]) / (GAPS[1] - GAPS[0]) } else { 0.0 };
        let weight_decay = optimiser.weight_decay * MOST.powf(above.clamp(0.0, 1.0));
        Some(WithheldFound { gap_db, weight_decay: weight_decay.min(1.0 / optimiser.rate) })
    }
}

/// Returns a photograph's PSNR, dB, after each channel's mean error is subtracted; `None` with fewer than `KNOWN` rays.
fn psnr_db(&[r, g, b, squares, count]: &[f64; 5]) -> Option<f64> {
    let offset = (r * r + g * g + b * b) / count;
    (count >= KNOWN).then(|| crate::train::psnr_db_of_mse((squares - offset) / (3.0 * count)))
}

#[cfg(test)]
mod tests;
