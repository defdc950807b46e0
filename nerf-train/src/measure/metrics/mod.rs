//! Differences of two pictures: MSE, PSNR, SSIM.
//!
//! Pictures are display-encoded RGB in [0, 1], row-major. Only [`aligned_psnr_db`] clamps: elsewhere, values outside of
//! [0, 1] add to the error unless the caller clamps them. Sums are in f64.

use crate::train::psnr_db_of_mse;

/// Side of the SSIM window, pixels; Wang et al. use 11, with a Gaussian of standard deviation 1.5.
const WINDOW: usize = 11;
const SIGMA: f64 = 1.5;
/// Constant (K1 L)² of SSIM, with K1 = 0.01 and data range L = 1. It keeps the luminance term finite in the dark.
const C1: f64 = 0.01 * 0.01;
/// Constant (K2 L)² of SSIM, with K2 = 0.03 and L = 1. It keeps the structure term finite in flat areas.
const C2: f64 = 0.03 * 0.03;

/// Returns the mean squared error of `a` and `b`, `[n]`. NaN if the lengths differ or are 0, or if an input is NaN.
pub fn mse(a: &[[f32; 3]], b: &[[f32; 3]]) -> f64 {
    if a.len() != b.len() || a.is_empty() {
        return f64::NAN;
    }
    let squared = |(p, q): (&[f32; 3], &[f32; 3])| -> f64 {
        (0..3).map(|c| (f64::from(p[c]) - f64::from(q[c])).powi(2)).sum()
    };
    a.iter().zip(b).map(squared).sum::<f64>() / (3.0 * a.len() as f64)
}

/// Returns the peak signal-to-noise ratio in dB for a peak of 1: −10 log10(MSE).
///
/// +inf if the pictures are equal, NaN if [`mse`] is NaN (a NaN pixel is never hidden).
///
/// # Examples
/// ```
/// // Off by 0.1 everywhere: MSE 0.01, 20 dB.
/// let db = nerf_train::measure::metrics::psnr_db(&[[0.5; 3]; 4], &[[0.6; 3]; 4]);
/// assert!((db - 20.0).abs() < 1e-4);
/// ```
pub fn psnr_db(a: &[[f32; 3]], b: &[[f32; 3]]) -> f64 {
    psnr_db_of_mse(mse(a, b))
}

/// Returns the PSNR, dB, after each channel of `shown` is multiplied by the gain that brings it nearest to `truth`
/// (least squares), and clamped to 1.
pub fn aligned_psnr_db(shown: &[[f32; 3]], truth: &[[f32; 3]]) -> f64 {
    let gain: [f32; 3] = std::array::from_fn(|c| {
        let products = |other: &[[f32; 3]]| -> f64 {
            shown.iter().zip(other).map(|(s, o)| f64::from(s[c]) * f64::from(o[c])).sum()
        };
        let square = products(shown);
        if square > 0.0 { (products(truth) / square) as f32 } else { 1.0 }
    });
    let aligned: Vec<[f32; 3]> =
        shown.iter().map(|s| std::array::from_fn(|c| (s[c] * gain[c]).min(1.0))).collect();
    psnr_db(&aligned, truth)
}

/// Returns `psnr_db` minus `over`, dB; 0 if the two are equal, even if both are infinite.
pub fn gain_db(psnr_db: f64, over: f64) -> f64 {
    if psnr_db == over { 0.0 } else { psnr_db - over }
}

/// Returns the PSNR of a flat picture in the mean colour of `rgb`, against `rgb`, dB; +inf if all pixels have the same
/// colour. A network that has learned nothing scores no better.
pub fn flat_psnr_db(rgb: &[[f32; 3]]) -> f64 {
    let mean: [f32; 3] = std::array::from_fn(|c| {
        let sum: f64 = rgb.iter().map(|pixel| f64::from(pixel[c])).sum();
        (sum / rgb.len().max(1) as f64) as f32
    });
    psnr_db(&vec![mean; rgb.len()], rgb)
}

/// Whether no view scores better than one flat colour. `psnr_and_flat_db`: PSNR and [`flat_psnr_db`] of every view.
///
/// A single view that scores better than its mean colour proves that the network has learned something. Views of one
/// flat colour (+inf) prove nothing and are ignored. If all views are of one flat colour, the result is false.
pub fn is_flat(psnr_and_flat_db: impl IntoIterator<Item = (f64, f64)>) -> bool {
    let mut telling = psnr_and_flat_db.into_iter().filter(|(_, flat)| flat.is_finite()).peekable();
    telling.peek().is_some() && !telling.any(|(psnr, flat)| psnr > flat)
}

/// Returns the mean of [`flat_psnr_db`] over the views that are not one flat colour, dB; +inf if there is no such view.
pub fn mean_flat_psnr_db(flat_db: impl IntoIterator<Item = f64>) -> f64 {
    let telling: Vec<f64> = flat_db.into_iter().filter(|flat| flat.is_finite()).collect();
    if telling.is_empty() { f64::INFINITY } else { telling.iter().sum::<f64>() / telling.len() as f64 }
}

/// Returns the structural similarity of two `width` × `height` pictures, averaged over the channels; at most 1.
///
/// The window is Gaussian, 11×11, with sigma 1.5; K1 = 0.01, K2 = 0.03, data range 1, population covariance. The mean
/// is over the windows that lie wholly inside ("valid"). scikit-image computes the same value with
/// `gaussian_weights=True, use_sample_covariance=False`. If a side is shorter than 11, the window shrinks along that
/// side to its largest odd number of pixels, with the same sigma. Equal pictures, flat ones too, give 1.
///
/// NaN if the sizes disagree, if there is nothing to compare, or if an input is NaN.
///
/// # Source
/// Wang, Bovik, Sheikh, Simoncelli 2004, "Image quality assessment: from error visibility to structural similarity",
/// eq. 13.
pub fn ssim(a: &[[f32; 3]], b: &[[f32; 3]], width: usize, height: usize) -> f64 {
    ssim_of(a, b, width, height, None)
}

/// Returns [`ssim`] of the marked pixels. `counts`, `[width * height]`: whether each pixel is marked; `None`: all are.
/// Unmarked pixels are taken as equal. The mean is over windows whose middle pixel is marked; NaN if there are none.
pub fn ssim_of(a: &[[f32; 3]], b: &[[f32; 3]], width: usize, height: usize, counts: Option<&[bool]>) -> f64 {
    let pixels = width.checked_mul(height).unwrap_or(0);
    let differ = |length: usize| length != pixels;
    if pixels == 0 || differ(a.len()) || differ(b.len()) || counts.is_some_and(|mask| differ(mask.len())) {
        return f64::NAN;
    }
    let channel = |c| {
        let plane = |p: &[[f32; 3]]| p.iter().map(|rgb| f64::from(rgb[c])).collect::<Vec<_>>();
        let (mut a, b) = (plane(a), plane(b));
        for (i, _) in counts.into_iter().flatten().enumerate().filter(|(_, counts)| !**counts) {
            a[i] = b[i];
        }
        ssim_of_plane(&a, &b, width, height, counts)
    };
    (channel(0) + channel(1) + channel(2)) / 3.0
}

/// Returns the SSIM of one channel of two pictures. `counts`: as in [`ssim_of`]. The caller must check the sizes.
fn ssim_of_plane(a: &[f64], b: &[f64], width: usize, height: usize, counts: Option<&[bool]>) -> f64 {
    let (across, down) = (gaussian(width), gaussian(height));
    let blur = |plane: &[f64]| blur_valid(plane, width, height, &across, &down);
    let product = |f: fn(f64, f64) -> f64| -> Vec<f64> { a.iter().zip(b).map(|(&x, &y)| f(x, y)).collect() };
    let (mean_a, mean_b) = (blur(a), blur(b));
    // The formula needs only the sum of the two variances, which takes one blur instead of two.
    let squares = blur(&product(|x, y| x * x + y * y));
    let cross = blur(&product(|x, y| x * y));
    let (mut sum, mut windows) = (0.0, 0usize);
    let columns = width + 1 - across.len();
    for i in 0..mean_a.len() {
        let middle = (i / columns + down.len() / 2) * width + i % columns + across.len() / 2;
        if counts.is_some_and(|counts| !counts[middle]) {
            continue;
        }
        windows += 1;
        let (ma, mb) = (mean_a[i], mean_b[i]);
        let variances = squares[i] - ma * ma - mb * mb;
        let covariance = cross[i] - ma * mb;
        let luminance = (2.0 * ma * mb + C1) / (ma * ma + mb * mb + C1);
        sum += luminance * (2.0 * covariance + C2) / (variances + C2);
    }
    sum / windows as f64
}

/// Returns the Gaussian weights of an SSIM window along a side of `length` ≥ 1 pixels; their sum is 1. The number of
/// weights is 11 or, if the side is shorter, the largest odd number up to `length`.
fn gaussian(length: usize) -> Vec<f64> {
    let taps = WINDOW.min(if length % 2 == 1 { length } else { length - 1 });
    let middle = (taps / 2) as f64;
    let raw: Vec<f64> = (0..taps).map(|i| (-0.5 * ((i as f64 - middle) / SIGMA).powi(2)).exp()).collect();
    let sum: f64 = raw.iter().sum();
    raw.iter().map(|w| w / sum).collect()
}

/// Correlates each row with the window weights `across` and each column with the window weights `down`, without
/// padding. Returns `[height − down.len() + 1][width − across.len() + 1]`.
fn blur_valid(plane: &[f64], width: usize, height: usize, across: &[f64], down: &[f64]) -> Vec<f64> {
    let (out_width, out_height) = (width + 1 - across.len(), height + 1 - down.len());
    let mut blurred = vec![0.0; out_width * out_height];
    let mut row = vec![0.0; width];
    for (y, out) in blurred.chunks_exact_mut(out_width).enumerate() {
        // Vertical first, into one row: both inner loops run over contiguous memory.
        row.fill(0.0);
        for (k, &weight) in down.iter().enumerate() {
            let source = &plane[(y + k) * width..][..width];
            row.iter_mut().zip(source).for_each(|(sum, &value)| *sum += weight * value);
        }
        for (k, &weight) in across.iter().enumerate() {
            out.iter_mut().zip(&row[k..]).for_each(|(sum, &value)| *sum += weight * value);
        }
    }
    blurred
}

#[cfg(test)]
mod tests;
