//! Division of a run's time limit between training, validation, and the work after the last step.
//!
//! Views are measured at every N-th row and column, with N as small as the time allows. The seconds per pixel are known
//! from earlier measurements, or measured on very few pixels first. The caller passes in all measured times.

/// Fraction of the run's time that validation during training may take.
pub const VALIDATION_SHARE: f64 = 0.05;
/// Fraction of the time limit that the final evaluation of all validation views may take.
pub const FINAL_SHARE: f64 = 0.10;
/// Fraction of the time limit that each of six measurements at the end may take: with and without view dependence, with
/// and without the occupancy grid, without quantisation, and on few pixels of all training photographs.
pub const QUESTION_SHARE: f64 = 0.015;
const QUESTIONS: usize = 6;
/// Seconds reserved for writing files: `[without a report, with a report]`.
const WRITING: [f64; 2] = [0.1, 0.5];
/// Largest number of pixels per view that validation during training measures, even if time is left.
const PIXELS_A_VIEW: u64 = 40_000;
/// Number of pixels of a view on which the seconds per pixel are first measured.
const PROBED_PIXELS: u64 = 100;
/// Safety factor on estimated times, which are extrapolated from times measured earlier in the run.
const MARGIN: f64 = 1.15;

/// Measured times of rendering and exporting, and the time limit of the run.
#[derive(Clone, Copy, Debug, Default)]
pub struct Pace {
    /// Limit of the run in seconds; `None` if only the number of steps limits the run.
    seconds: Option<f64>,
    validated: f64,
    /// Seconds of exporting the present state, without any rendering; `None` until measured.
    overhead: Option<f64>,
    per_pixel: Option<f64>,
    report: bool,
    /// Whether the scene will also be measured without its occupancy grid at the end.
    dense: bool,
}

/// Returns the smallest odd spacing, along rows and columns, that measures at most about `count` of `pixels` pixels.
/// Of each block of spacing × spacing pixels, the middle pixel is measured. Only an odd spacing has a middle pixel.
pub fn lattice_of(pixels: u64, count: f64) -> u32 {
    let step = (pixels as f64 / count.max(1.0)).sqrt().ceil().max(1.0) as u32;
    step | 1
}

impl Pace {
    /// Creates the state before any measurement, for a run with a limit of `seconds`. `report`: whether a report is
    /// written. `dense`: whether the scene will also be measured without its occupancy grid.
    pub fn new(seconds: Option<f64>, report: bool, dense: bool) -> Self {
        Self { seconds, report, dense, ..Self::default() }
    }

    pub fn is_limited(&self) -> bool {
        self.seconds.is_some()
    }

    /// Returns `share` times the time limit, seconds; infinity without a limit.
    pub fn share(&self, share: f64) -> f64 {
        self.seconds.map_or(f64::INFINITY, |seconds| share * seconds)
    }

    /// Returns the seconds that a validation may take if it begins after `now` seconds of the run, so that all
    /// validations take at most the fraction [`VALIDATION_SHARE`] of `now`. Infinity without a time limit.
    pub fn allowance(&self, now: f64) -> f64 {
        self.seconds.map_or(f64::INFINITY, |_| VALIDATION_SHARE * now - self.validated)
    }

    /// Whether after `now` seconds enough time is left to validate `views` views with `PROBED_PIXELS` pixels each.
    pub fn affords(&self, now: f64, views: usize) -> bool {
        let coarsest = (views as u64 * PROBED_PIXELS) as f64 * self.per_pixel.unwrap_or(0.0);
        MARGIN * (self.overhead.unwrap_or(0.0) + coarsest) <= self.allowance(now)
    }

    pub fn probe(&self, largest: u64) -> u32 {
        lattice_of(largest, PROBED_PIXELS as f64)
    }

    pub fn knows(&self) -> bool {
        self.per_pixel.is_some()
    }

    /// Returns the stride N at which views are measured, for validation during training and for comparisons of export
    /// candidates: every N-th pixel of every N-th row. As in [`Self::lattice`], but at most about `PIXELS_A_VIEW` pixels
    /// of a view of `largest` pixels are measured.
    pub fn lattice_on_the_way(&self, pixels: u64, largest: u64, seconds: f64) -> u32 {
        lattice_of(largest, PIXELS_A_VIEW as f64).max(self.lattice(pixels, largest, seconds))
    }

    /// Returns the smallest spacing, along rows and columns, at which rendering the views is expected to take at most
    /// `seconds`. `pixels`: number of pixels of all views. `largest`: number of pixels of the largest view, of which at
    /// least about `PROBED_PIXELS` are measured. Returns 1 if `seconds` is infinite or the time per pixel is unknown.
    pub fn lattice(&self, pixels: u64, largest: u64, seconds: f64) -> u32 {
        let coarsest = self.probe(largest);
        match self.per_pixel {
            Some(price) if seconds.is_finite() => {
                lattice_of(pixels, seconds / (MARGIN * price)).min(coarsest)
            }
            _ => 1,
        }
    }

    /// Returns the seconds that rendering `pixels` pixels is expected to take; 0 before the first measurement.
    pub fn seconds_of(&self, pixels: u64) -> f64 {
        MARGIN * self.per_pixel.unwrap_or(0.0) * pixels as f64
    }

    pub fn made(&mut self, seconds: f64) {
        self.overhead = Some(seconds);
    }

    pub fn measured(&mut self, pixels: u64, seconds: f64) {
        self.per_pixel = Some(seconds / pixels.max(1) as f64);
    }

    /// Adds `seconds`, the time of one validation (export and rendering), to the run's total time of validation.
    pub fn validated(&mut self, seconds: f64) {
        self.validated += seconds;
    }

    /// Returns the estimated seconds of the work after the last step: a last validation, comparisons of export
    /// candidates, exports, final evaluation, and writing files. Returns 0 without a time limit. `validation`: number
    /// of pixels that the final evaluation renders. Measuring the quantisation loss is assumed to render the same
    /// number of pixels. `asked`: number of pixels that each comparison renders.
    pub fn reserve(&self, validation: u64, asked: u64) -> f64 {
        let Some(seconds) = self.seconds else { return 0.0 };
        let price = |pixels: u64, share: f64| match self.per_pixel {
            Some(price) => (MARGIN * price * pixels as f64).min(share * seconds),
            None => share * seconds,
        };
        // A rendering without the occupancy grid is slow: it takes all the time that it may.
        let dense = if self.dense { QUESTION_SHARE * seconds } else { 0.0 };
        let rounding = price(validation, QUESTION_SHARE);
        let questions = (QUESTIONS - 2) as f64 * price(asked, QUESTION_SHARE) + rounding + dense;
        // Exports for the last validation and for the final blob.
        let files = 2.0 * self.overhead.unwrap_or(0.01 * seconds);
        let last = (VALIDATION_SHARE * seconds - self.validated).clamp(0.0, 0.02 * seconds);
        let known = last + files + questions + price(validation, FINAL_SHARE);
        (known + WRITING[usize::from(self.report)]).min(0.5 * seconds)
    }
}

#[cfg(test)]
mod tests;
