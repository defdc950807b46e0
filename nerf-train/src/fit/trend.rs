//! Detection of overfitting: whether the validation PSNR stopped rising while the training PSNR kept rising.

use crate::train::CurvePoint;
use std::fmt;

/// Least rise of the validation PSNR, dB, that counts as better. With only two views, smaller gains are noise.
const VAL_RISE_DB: f64 = 0.05;
/// Least gain of the smoothed training PSNR, dB, that counts as a rise: three times the noise of the curve.
const TRAIN_RISE_DB: f64 = 0.3;
/// Least number of validations without a rise after the best one, so that one bad validation is not taken for a trend.
const VALIDATIONS_AFTER: usize = 2;

/// The validation after which the validation PSNR (mean over the validated views) stopped rising. `train_psnr_db` is
/// the smoothed PSNR of the training rays. The fields with `last_` hold the values at the last validation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stop {
    pub step: u32,
    pub seconds: f64,
    /// PSNR at `step`, dB; at most 0.05 dB below the best of all validations.
    pub val_psnr_db: f64,
    pub last_val_psnr_db: f64,
    pub train_psnr_db: f64,
    pub last_train_psnr_db: f64,
}

impl Stop {
    /// Finds the validation after which validation PSNR stopped rising while training PSNR still rose: overfitting.
    /// Returns `None` if no overfitting is found. `curve`: oldest point first.
    ///
    /// Validation PSNR stopped rising at the first validation that no later validation exceeds by more than 0.05 dB.
    /// At least two validations must follow. Training PSNR still rose if its smoothed value gained more than 0.3 dB
    /// from the validation at which validation PSNR stopped rising to the last validation.
    ///
    /// # Examples
    /// Validations of 20, 22, 21, 20 dB, and training PSNR of 20, 23, 26, 29 dB: stopped at the second validation.
    /// ```
    /// use nerf_train::fit::trend::Stop;
    /// use nerf_train::train::CurvePoint;
    /// let at = |i: u32, val| CurvePoint {
    ///     step: 100 * i,
    ///     seconds: 1.0,
    ///     train_psnr_db: 17.0 + 3.0 * f64::from(i),
    ///     val_psnr_db: Some(val),
    ///     ..CurvePoint::default()
    /// };
    /// let stop = Stop::of(&[at(1, 20.0), at(2, 22.0), at(3, 21.0), at(4, 20.0)]);
    /// assert_eq!(stop.map(|stop| stop.step), Some(200));
    /// ```
    pub fn of(curve: &[CurvePoint]) -> Option<Self> {
        let validated = |point: &CurvePoint| Some((*point, point.val_psnr_db.filter(|db| !db.is_nan())?));
        let validations: Vec<(CurvePoint, f64)> = curve.iter().filter_map(validated).collect();
        let &(last, last_val_psnr_db) = validations.last()?;
        let best_after =
            |i: usize| validations[i + 1..].iter().map(|l| l.1).fold(f64::NEG_INFINITY, f64::max);
        let stopped = (0..validations.len().saturating_sub(VALIDATIONS_AFTER))
            .find(|&i| best_after(i) <= validations[i].1 + VAL_RISE_DB);
        let (at, val_psnr_db) = validations[stopped?];
        let stop = Self {
            step: at.step,
            seconds: at.seconds,
            val_psnr_db,
            last_val_psnr_db,
            train_psnr_db: at.train_psnr_db,
            last_train_psnr_db: last.train_psnr_db,
        };
        (stop.last_train_psnr_db - stop.train_psnr_db > TRAIN_RISE_DB).then_some(stop)
    }
}

impl fmt::Display for Stop {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "validation stopped rising at step {}, after {:.1} s ({:.2} dB; {:.2} dB in the end), while training \
             went on from {:.2} to {:.2} dB: overfitting",
            self.step,
            self.seconds,
            self.val_psnr_db,
            self.last_val_psnr_db,
            self.train_psnr_db,
            self.last_train_psnr_db
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Training curve with a validation every 100 steps, and a point without validation 50 steps before each
    /// validation. `validations`: pairs of training and validation PSNR, dB.
    fn curve(validations: &[(f64, f64)]) -> Vec<CurvePoint> {
        let points = validations.iter().zip(1u32..).flat_map(|(&(train_psnr_db, val), i)| {
            let validated = CurvePoint {
                step: 100 * i,
                seconds: f64::from(i),
                train_psnr_db,
                val_psnr_db: Some(val),
                ..CurvePoint::default()
            };
            [CurvePoint { step: validated.step - 50, val_psnr_db: None, ..validated }, validated]
        });
        points.collect()
    }

    #[test]
    fn overfitting_needs_a_stop_and_training_that_goes_on() {
        let falling = curve(&[(20.0, 20.0), (22.0, 22.0), (25.0, 21.5), (28.0, 20.0)]);
        let stop = Stop::of(&falling).expect("overfitting");
        assert_eq!((stop.step, stop.val_psnr_db, stop.last_val_psnr_db), (200, 22.0, 20.0));
        assert_eq!((stop.train_psnr_db, stop.last_train_psnr_db), (22.0, 28.0));
        // Validation PSNR that stays flat counts as stopped if training PSNR rises.
        let flat = curve(&[(20.0, 20.0), (22.0, 22.0), (23.0, 22.04), (24.0, 22.03)]);
        assert_eq!(Stop::of(&flat).map(|stop| stop.step), Some(200));
        let settled = curve(&[(20.0, 20.0), (22.0, 22.0), (22.1, 22.0), (22.2, 21.9)]);
        assert_eq!(Stop::of(&settled), None);
    }

    #[test]
    fn a_rise_to_the_end_is_no_overfitting() {
        let rising = curve(&[(20.0, 20.0), (22.0, 21.0), (25.0, 21.5), (28.0, 21.6)]);
        // A dip of the validation PSNR is no stop if the PSNR rises again.
        let dip = curve(&[(20.0, 20.0), (22.0, 18.0), (25.0, 18.0), (28.0, 21.6)]);
        // One validation without a rise at the end is no stop.
        let one = curve(&[(20.0, 20.0), (22.0, 21.0), (25.0, 22.0), (28.0, 21.0)]);
        assert_eq!([rising, dip, one].map(|curve| Stop::of(&curve)), [None; 3]);
    }

    #[test]
    fn few_validations_and_odd_figures_say_nothing_wrong() {
        for validations in 0..3 {
            assert_eq!(Stop::of(&curve(&vec![(20.0, 20.0); validations])), None);
        }
        let nan = curve(&[(20.0, f64::NAN), (f64::NAN, 20.0), (21.0, f64::NAN)]);
        let perfect = curve(&[(20.0, f64::INFINITY); 4]);
        assert_eq!([nan, perfect].map(|curve| Stop::of(&curve)), [None; 2]);
    }
}
