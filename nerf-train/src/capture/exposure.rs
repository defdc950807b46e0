//! Exposure and white balance: brightness of each photograph relative to the mean of all photographs.
//!
//! A gain is a factor on display-encoded colour, one per channel. Gains are stored as natural logarithms. Their mean
//! over the photographs is 0 in each channel, so that the field has the mean exposure.

use crate::capture::sights::Sights;
use crate::data::View;
use serde::{Deserialize, Serialize};
use std::borrow::Borrow;

/// Number of rounds of iteratively reweighted least squares.
const ROUNDS: usize = 30;
/// Lower limit of the absolute residual of log colour in the weight 1 / |residual|. It keeps the weight bounded.
const SMALLEST_RESIDUAL: f64 = 0.02;
/// Range of usable mean colours, on the scale 0 to 255. Below the range a colour is too dark, above it clipped.
const USABLE: (f64, f64) = (15.0, 245.0);
/// Number of pixels on each side of the middle pixel of the averaged square, which has 5 × 5 pixels.
const HALF_SIDE: i64 = 2;
/// Number of lines of sight that make a photograph usable. Gains are measured if at least two photographs, and at least
/// half of all, are usable.
const ENOUGH_SIGHTS: usize = 20;
/// Smallest standard deviation of the log gains at which exposure is fitted. On two captures of constant exposure
/// (measured standard deviations 0.043 and 0.079), fitted gains made the result 0.2 to 0.7 dB worse.
pub const CALLED_FOR: f64 = 0.12;
/// Absolute log gain of a single photograph at which exposure is also fitted: a factor of two.
const FAR_OFF: f32 = std::f32::consts::LN_2;

/// Natural logarithm of each photograph's gain (a factor on display-encoded colour) in red, green and blue.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LogGains(pub Vec<[f32; 3]>);

impl LogGains {
    pub fn none(views: usize) -> Self {
        Self(vec![[0.0; 3]; views])
    }

    /// Returns the standard deviation, over the photographs, of the log gain averaged over the colour channels.
    pub fn spread(&self) -> f64 {
        let count = self.0.len().max(1) as f64;
        let mean = self.0.iter().map(brightness).sum::<f64>() / count;
        (self.0.iter().map(|gain| (brightness(gain) - mean).powi(2)).sum::<f64>() / count).sqrt()
    }

    /// Returns the photograph whose log gain, averaged over the channels, has the largest absolute value: its index and
    /// this average. `None` if the absolute value is below ln 2.
    pub fn outlier(&self) -> Option<(u32, f32)> {
        let gains = self.0.iter().map(|gain| brightness(gain) as f32).zip(0..);
        let farthest = gains.max_by(|(a, _), (b, _)| a.abs().total_cmp(&b.abs()));
        farthest.filter(|(gain, _)| gain.abs() >= FAR_OFF).map(|(gain, view)| (view, gain))
    }

    /// Shifts the log gains so that their mean over the photographs is 0 in each channel; sums in f64.
    pub fn centre(&mut self) {
        for channel in 0..3 {
            let sum: f64 = self.0.iter().map(|gain| f64::from(gain[channel])).sum();
            let mean = (sum / self.0.len().max(1) as f64) as f32;
            self.0.iter_mut().for_each(|gain| gain[channel] -= mean);
        }
    }

    /// Measures gains at points that several photographs show; `None` if too few photographs show enough points.
    ///
    /// The model is: log colour at a key point = log colour of the 3D point + log gain of the photograph. The fit
    /// minimises absolute residuals. `sights`: one entry per view, in the order of `views`.
    pub fn measured<V: Borrow<View>>(views: &[V], sights: &Sights) -> Option<Self> {
        let enough = sights.of_views.iter().filter(|sights| sights.len() >= ENOUGH_SIGHTS).count();
        if enough < 2 || enough * 2 < views.len() {
            return None;
        }
        let mut observations = Vec::new();
        for (index, (view, sights)) in views.iter().zip(&sights.of_views).enumerate() {
            let usable =
                sights.iter().filter_map(|sight| Some((sight.point, log_colour(view.borrow(), sight.at)?)));
            observations.extend(usable.map(|(point, colour)| (index, point as usize, colour)));
        }
        let mut gains = Self::none(views.len());
        for channel in 0..3 {
            let observed: Vec<_> =
                observations.iter().map(|(view, point, colour)| (*view, *point, colour[channel])).collect();
            for (gain, found) in gains.0.iter_mut().zip(least_absolute(&observed, views.len())) {
                gain[channel] = found as f32;
            }
        }
        gains.centre();
        Some(gains)
    }
}

fn brightness(gain: &[f32; 3]) -> f64 {
    gain.iter().map(|&g| f64::from(g)).sum::<f64>() / 3.0
}

/// Returns the natural log of the mean colour (0 to 255) around pixel `at`; `None` if too dark, clipped or transparent.
fn log_colour(view: &View, at: [f32; 2]) -> Option<[f64; 3]> {
    let (mut sum, mut count) = ([0.0; 3], 0.0);
    let [x, y] = at.map(|v| v.floor() as i64);
    for y in y - HALF_SIDE..=y + HALF_SIDE {
        for x in x - HALF_SIDE..=x + HALF_SIDE {
            let inside = u32::try_from(x).ok().zip(u32::try_from(y).ok());
            let Some([r, g, b, 255]) = inside.and_then(|(x, y)| view.pixel(x, y)) else { continue };
            [r, g, b].iter().zip(&mut sum).for_each(|(&c, sum)| *sum += f64::from(c));
            count += 1.0;
        }
    }
    let mean = sum.map(|sum| sum / count);
    mean.iter().all(|c| (USABLE.0..USABLE.1).contains(c)).then(|| mean.map(f64::ln))
}

/// Fits the log gain of each view in one channel, by least absolute residuals. `observed`: (view, point, log colour).
fn least_absolute(observed: &[(usize, usize, f64)], views: usize) -> Vec<f64> {
    let points = observed.iter().map(|&(_, point, _)| point + 1).max().unwrap_or(0);
    let mut gains = vec![0.0; views];
    let mut weights = vec![1.0; observed.len()];
    let mean_by = |count: usize, values: &mut dyn Iterator<Item = (usize, f64, f64)>| {
        let (mut sums, mut totals) = (vec![0.0; count], vec![0.0; count]);
        for (index, weight, value) in values {
            sums[index] += weight * value;
            totals[index] += weight;
        }
        sums.iter().zip(&totals).map(|(s, t)| if *t > 0.0 { s / t } else { 0.0 }).collect::<Vec<f64>>()
    };
    for _ in 0..ROUNDS {
        let weighted = || observed.iter().zip(&weights);
        let colours =
            mean_by(points, &mut weighted().map(|(&(view, point, l), &w)| (point, w, l - gains[view])));
        gains = mean_by(views, &mut weighted().map(|(&(view, point, l), &w)| (view, w, l - colours[point])));
        let mean = gains.iter().sum::<f64>() / views.max(1) as f64;
        gains.iter_mut().for_each(|gain| *gain -= mean);
        for (weight, &(view, point, l)) in weights.iter_mut().zip(observed) {
            *weight = 1.0 / (l - colours[point] - gains[view]).abs().max(SMALLEST_RESIDUAL);
        }
    }
    gains
}
