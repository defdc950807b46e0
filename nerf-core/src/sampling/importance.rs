//! Importance sampling: places a ray's fine samples by the compositing weights that a coarse network gives the bins.

use super::Bins;
use crate::math::Sum;
use crate::memory::{at, put, tail};

#[cfg(test)]
mod tests;

/// Constant added to every bin's weight, so that samples may also lie in bins of weight 0, and a ray whose weights are
/// all 0 gets uniform samples.
const WEIGHT_FLOOR: f32 = 1e-5;

/// Draws samples of a ray from the weights of `bins`, and merges the drawn samples with the middles of the bins.
///
/// `row`: on entry, room for `drawn = row.len() - bins.count()` samples, then one weight per bin. Weights are clamped
/// to `[0, 1]`; a NaN counts as 0. On return, the whole row holds distances along the ray, world units, ascending: the
/// middle of every bin, and the `drawn` samples. A row with fewer values than bins is left unchanged.
///
/// The probability density of the drawn samples is constant in a bin and proportional to the bin's weight plus 1e-5.
/// Sample `k` is the inverse distribution function at `(k + within(k)) / drawn`. `within` must return numbers in
/// `[0, 1)`. If `within` always returns ½, sampling is deterministic, and the same weights give the same bits.
///
/// # Source
/// Mildenhall et al. 2020, section 5.2, and the authors' code (`sample_pdf`), with the code's weight floor and its
/// union with the coarse samples. Deviations: deterministic samples are at the middles of strata, not at
/// `linspace(0, 1)`, so that no sample lies at an end of the range. The density of samples changes at the edges of
/// bins; these edges equal the midpoints between coarse samples.
///
/// # Accuracy
/// The distribution function at the returned `t` has an error of 4 ulp of 1, plus the effect of rounding `t` itself.
///
/// # Examples
/// ```
/// use nerf_core::sampling::{Bins, sample_pdf};
/// // Two bins, all the weight in the second, two samples: middles at 2.5 and 3.5.
/// let bins = Bins::new(2.0, 4.0, 2)?;
/// let mut row = [0.0, 0.0, /* weights: */ 0.0, 1.0];
/// sample_pdf(&bins, &mut row, |_| 0.5);
/// assert!((row[0] - 2.5).abs() < 1e-4 && (row[2] - 3.5).abs() < 1e-4);
/// assert!((row[1] - 3.25).abs() < 1e-4 && (row[3] - 3.75).abs() < 1e-4);
/// # Ok::<(), nerf_core::space::BoundsError>(())
/// ```
pub fn sample_pdf(bins: &Bins, row: &mut [f32], within: impl Fn(u32) -> f32) {
    let count = bins.count() as usize;
    let Some(drawn) = row.len().checked_sub(count) else { return };
    let mut total = Sum::ZERO;
    tail(row, drawn).iter().for_each(|&weight| total.add(mass(weight)));
    let step = total.value / drawn.max(1) as f32;
    // The row is written from its start while weights are read from its end. After bin `i`, at most `drawn + i + 1`
    // values are written, so that no unread weight is overwritten.
    let (mut written, mut k) = (0, 0);
    let mut push = |row: &mut [f32], t: f32| {
        put(row, written, t);
        written += 1;
    };
    let mut reached = Sum::ZERO;
    for bin in 0..count {
        let (before, own) = (reached.value, mass(at(row, drawn + bin)));
        reached.add(own);
        let (last, index) = (bin + 1 == count, bin as u32);
        let mut middle = Some(bins.at(index, 0.5));
        while k < drawn {
            let target = (k as f32 + within(k as u32)) * step;
            if target >= reached.value && !last {
                break;
            }
            let fraction = ((target - before) / own).clamp(0.0, 1.0);
            if fraction > 0.5
                && let Some(t) = middle.take()
            {
                push(row, t);
            }
            push(row, bins.at(index, fraction));
            k += 1;
        }
        if let Some(t) = middle {
            push(row, t);
        }
    }
}

/// Returns middle and width of the interval of sample `row[k]`: the part of the ray to which this sample is nearest.
///
/// `row`: distances of the ray's samples, ascending. The first interval begins at `near`, the last ends at `far`, so
/// that the widths add up to `far − near`. Samples in the middles of equal bins get the bins' width.
#[inline]
pub fn sample_interval(near: f32, far: f32, row: &[f32], k: usize) -> (f32, f32) {
    let between = |a: f32, b: f32| 0.5 * a + 0.5 * b;
    let start = if k == 0 { near } else { between(at(row, k - 1), at(row, k)) };
    let end = if k + 1 == row.len() { far } else { between(at(row, k), at(row, k + 1)) };
    (between(start, end), end - start)
}

/// The sampling weight of a bin: `weight` clamped to `[0, 1]`, plus [`WEIGHT_FLOOR`].
#[inline]
fn mass(weight: f32) -> f32 {
    // A NaN is not above 0 and counts as 0.
    WEIGHT_FLOOR + if weight > 0.0 { weight.min(1.0) } else { 0.0 }
}
