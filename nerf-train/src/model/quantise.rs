//! Storage of a grid's tables in a file: f16, int8, or entropy-coded.

use super::coded;
use half::f16;
use nerf_core::blob::{StoredTables, decode_tables};
use nerf_core::encoding::{GridEncoding, GridLevel};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;

/// Storage of the values of a grid's tables in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum TableStorage {
    /// Values are stored as f16, two bytes each.
    F16,
    /// Values are stored as one byte each, with one quantisation step per level: half the size of f16.
    Int8,
    /// Values are stored as entropy-coded bytes, with quantisation steps at least as coarse as int8's. They must be
    /// decoded into memory before rendering.
    Coded,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rounding {
    pub storage: TableStorage,
    /// Largest size of coded tables, bytes; the quantisation steps are chosen to fit. `None`: no limit.
    pub most_bytes: Option<usize>,
}

impl From<TableStorage> for Rounding {
    fn from(storage: TableStorage) -> Self {
        Self { storage, most_bytes: None }
    }
}

/// Fraction of a run after which training reads int8 and coded tables rounded as in the exported file, so that the
/// parameters adapt to the rounding.
pub(crate) const ROUNDED_FROM: f64 = 0.85;
/// For each candidate quantisation step: fraction of a level's values that the step does not clip. The values of
/// largest magnitude are clipped.
const KEPT: [f64; 3] = [1.0, 0.9999, 0.9995];
/// Largest magnitude of an int8 value, in quantisation steps.
pub(crate) const STEPS: f32 = 127.0;

#[derive(Clone, Debug, PartialEq)]
pub struct Quantised {
    storage: TableStorage,
    bytes: Vec<u8>,
    scales: Vec<u8>,
}

impl Quantised {
    /// Rounds the `values` of `grid`. Int8 and coded values become multiples of their level's quantisation step.
    /// `given`: quantisation step of each level; if empty, [`scales`] chooses the steps. If coded tables exceed their
    /// limit of bytes, their steps become larger. Fails with index and value of the first value that is not finite or
    /// beyond ±65504, f16's largest. Panics if there are fewer values than the grid has.
    pub fn new(
        grid: &GridEncoding,
        values: &[f32],
        rounding: impl Into<Rounding>,
        given: &[f32],
    ) -> Result<Self, (usize, f32)> {
        let rounding = rounding.into();
        // NaN compares false.
        let fits = |value: &f32| value.abs() <= f16::MAX.to_f32();
        if let Some((index, &found)) = values.iter().enumerate().find(|(_, value)| !fits(value)) {
            return Err((index, found));
        }
        let given = || if given.is_empty() { scales(grid, values, rounding) } else { given.to_vec() };
        let (bytes, scales) = match rounding.storage {
            TableStorage::F16 => {
                (values.iter().flat_map(|&value| f16::from_f32(value).to_le_bytes()).collect(), vec![])
            }
            TableStorage::Int8 => {
                let scales = given();
                (coded::rounded(grid, values, &scales), scales)
            }
            TableStorage::Coded => coded::coded(grid, values, &given(), rounding.most_bytes),
        };
        let scales = scales.into_iter().flat_map(f32::to_le_bytes).collect();
        Ok(Self { storage: rounding.storage, bytes, scales })
    }

    pub fn stored(&self) -> StoredTables<'_> {
        match self.storage {
            TableStorage::F16 => StoredTables::F16(&self.bytes),
            TableStorage::Int8 => StoredTables::Int8 { scales: &self.scales, bytes: &self.bytes },
            TableStorage::Coded => StoredTables::Coded { scales: &self.scales, bytes: &self.bytes },
        }
    }
}

/// Decodes stored tables to the values that a renderer reads; panics if `tables` does not fit `grid`.
pub fn values_of(grid: &GridEncoding, tables: StoredTables<'_>) -> Vec<f32> {
    let (scales, bytes) = match tables {
        StoredTables::F16(bytes) => {
            return bytes.as_chunks().0.iter().map(|&value| f16::from_le_bytes(value).to_f32()).collect();
        }
        StoredTables::Int8 { scales, bytes } => (scales.as_chunks().0, Cow::Borrowed(bytes)),
        StoredTables::Coded { scales, bytes } => {
            let mut decoded = Vec::with_capacity(grid.values());
            decode_tables(grid, bytes, |value| decoded.push(value)).expect("the tables of a blob");
            (scales.as_chunks().0, Cow::Owned(decoded))
        }
    };
    let bytes = &*bytes;
    let level = |(level, &scale): (GridLevel, &[u8; 4])| {
        let (scale, features) = (f32::from_le_bytes(scale), usize::from(grid.features));
        let bytes = &bytes[level.first * features..][..level.entries * features];
        bytes.iter().map(move |&value| scale * f32::from(value.cast_signed()))
    };
    grid.levels().zip(scales).flat_map(level).collect()
}

pub(super) fn levels<'v>(grid: &GridEncoding, values: &'v [f32]) -> impl Iterator<Item = &'v [f32]> {
    let features = usize::from(grid.features);
    grid.levels().map(move |level| &values[level.first * features..][..level.entries * features])
}

/// Returns the quantisation step of each level. Coded tables get the smallest steps with which they fit the limit of
/// bytes; without a limit, default steps. An int8 level gets the step of least squared error. An f16 level, which needs
/// no step, gets the same.
pub fn scales(grid: &GridEncoding, values: &[f32], rounding: Rounding) -> Vec<f32> {
    match rounding.storage {
        TableStorage::Coded => coded::scales(grid, values, rounding.most_bytes),
        TableStorage::F16 | TableStorage::Int8 => levels(grid, values).map(scale_of).collect(),
    }
}

/// Returns `value` as a number of steps of size `scale`, clipped to ±127 and rounded to a whole number, half to even.
#[inline]
pub(super) fn steps(value: f32, scale: f32) -> f32 {
    // From 2^23 to 2^24, f32 are whole numbers: the sum is rounded to one. `round_ties_even` would call a function.
    const WHOLE: f32 = 1.5 * (1 << 23) as f32;
    ((value / scale).clamp(-STEPS, STEPS) + WHOLE) - WHOLE
}

/// Returns the quantisation step with the least squared error of rounding and clipping a level's values. There is one
/// candidate step for each fraction in [`KEPT`]. A few values are often many times as large as all others: clipping
/// these few adds less error than coarse steps.
pub(super) fn scale_of(values: &[f32]) -> f32 {
    let mut magnitudes: Vec<f32> = values.iter().map(|value| value.abs()).collect();
    magnitudes.sort_unstable_by(f32::total_cmp);
    let candidates = KEPT.map(|share| {
        let last = (share * values.len() as f64).ceil() as usize;
        let largest = magnitudes.get(last.saturating_sub(1)).copied().unwrap_or_default();
        // A level of zeros takes any step above 0.
        (largest / STEPS).max(f32::MIN_POSITIVE)
    });
    let error = |scale: f32| -> f64 {
        values.iter().map(|&value| f64::from(value - scale * steps(value, scale)).powi(2)).sum()
    };
    let errors = candidates.map(|scale| (error(scale), scale));
    errors.into_iter().min_by(|(a, _), (b, _)| a.total_cmp(b)).map_or(f32::MIN_POSITIVE, |(_, scale)| scale)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid(levels: &[[u16; 3]]) -> GridEncoding {
        GridEncoding {
            inputs: 3,
            features: 2,
            log2_entries: 12,
            resolutions: levels.iter().copied().collect(),
        }
    }

    fn read(grid: &GridEncoding, quantised: &Quantised) -> Vec<f32> {
        values_of(grid, quantised.stored())
    }

    #[test]
    fn each_level_has_its_own_scale_and_is_half_a_step_off_at_most() {
        let grid = grid(&[[4, 4, 4], [9, 9, 9]]);
        let first = 2 * grid.levels().nth(1).expect("two levels").first;
        // Values are spread over ±1e-3 in the first level, ±100 in the second: clipping would not lower the error.
        let values: Vec<f32> = (0..grid.values())
            .map(|i| ((i * 7919 % 1009) as f32 / 504.0 - 1.0) * if i < first { 1e-3 } else { 100.0 })
            .collect();
        let quantised = Quantised::new(&grid, &values, TableStorage::Int8, &[]).expect("finite");
        for (i, (value, found)) in values.iter().zip(read(&grid, &quantised)).enumerate() {
            let half = if i < first { 1e-3 } else { 100.0 } / 127.0 / 2.0;
            assert!((value - found).abs() <= 1.001 * half, "value {i}: {value} became {found}");
        }
    }

    #[test]
    fn a_large_value_is_clipped_where_that_loses_less_than_it_costs_the_others() {
        let mut values: Vec<f32> = (0..100_000).map(|i| (i * 7919 % 1009) as f32 / 504.0 - 1.0).collect();
        // For `large` = 3: steps of 3/127 instead of 1/127 add (3² - 1²) / 127² / 12 to the squared error of each of
        // 100,000 values, 4.1 in all. Clipping the large value adds 4.
        for (large, scale) in [(1.0, 1.0), (3.0, 1.0), (30.0, 30.0)] {
            values[17] = large;
            assert!((scale_of(&values) * 127.0 / scale - 1.0).abs() < 0.01, "{large}: {}", scale_of(&values));
        }
    }

    #[test]
    fn zeros_nothing_and_the_smallest_number_have_a_scale_that_a_blob_may_have() {
        for values in [&[0.0, -0.0, 0.0][..], &[], &[1e-45, -1e-45]] {
            let scale = scale_of(values);
            assert!(scale > 0.0 && scale.is_finite(), "{values:?}");
            assert!(values.iter().all(|&value| steps(value, scale) == 0.0), "{values:?}");
        }
    }

    #[test]
    fn what_is_beyond_f16_is_named_in_either_storage() {
        let grid = grid(&[[4, 4, 4]]);
        for storage in [TableStorage::F16, TableStorage::Int8, TableStorage::Coded] {
            for bad in [f32::NAN, f32::INFINITY, -65_505.0] {
                let mut values = vec![1.0; grid.values()];
                values[7] = bad;
                let error = Quantised::new(&grid, &values, storage, &[]).expect_err("refused");
                assert_eq!((error.0, error.1.to_bits()), (7, bad.to_bits()));
            }
        }
    }
}
