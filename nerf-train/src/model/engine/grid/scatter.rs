//! Update of one level of the tables: the kept samples' gradients are summed by entry, and Adam updates the entries.
//!
//! One thread updates a level. The levels that a thread updates share one gradient buffer, which stays in the cache.

use super::adam::{AdamStep, move_values};
use crate::model::engine::{GRADIENT_LIMIT, Phase, Phases};
use crate::model::quantise::STEPS;
use glam::Vec4;
use nerf_core::encoding::{GridCorners, GridEncoding, GridLevel, GridTables, grid_corners_block};
use nerf_core::simd::{BLOCK, Isa, Lanes, Op, prefetch};
use std::time::Instant;

/// Number of values in a part of a level; Adam skips a part that no sample reads.
const PART: usize = 64;
/// Prefetch distance in Adam's update, in parts of [`PART`] values.
const AHEAD: usize = 4;
/// Prefetch distance in the sum of gradients, in samples.
const SAMPLES_AHEAD: usize = 8;

/// Kept samples (the samples that are trained) of one accumulator's chunks, with the gradients that update the tables.
#[derive(Clone, Debug, Default)]
pub(super) struct Kept {
    /// Positions of the samples: for each axis, `[samples]`.
    pub positions: [Vec<f32>; 3],
    /// Compositing weights, `[samples]`.
    pub weights: Vec<f32>,
    /// Gradients of the loss with respect to the encoded positions, `[samples][width]`.
    pub gradients: Vec<f32>,
    pub width: usize,
    /// Largest absolute value of `gradients`; NaN if one of them is NaN.
    pub largest: f32,
}

impl Kept {
    pub fn clear(&mut self) {
        self.positions.iter_mut().for_each(Vec::clear);
        self.weights.clear();
        self.gradients.clear();
        self.largest = 0.0;
    }

    /// Appends gradients with respect to encoded positions, `[samples][width]`, and updates `self.largest`.
    pub fn extend(&mut self, isa: Isa, gradients: &[f32]) {
        self.largest = f32::from_bits(isa.run(Largest { gradients }).max(self.largest.to_bits()));
        self.gradients.extend_from_slice(gradients);
    }

    /// Returns whether every entry's gradient, summed over all of `kept`, is sure to be below [`GRADIENT_LIMIT`].
    pub fn usable<'k>(kept: impl Iterator<Item = &'k Self>) -> bool {
        // A sample's interpolation weights at a level sum to 1.
        let most: f64 = kept.map(|kept| kept.positions[0].len() as f64 * f64::from(kept.largest)).sum();
        most < f64::from(GRADIENT_LIMIT)
    }
}

/// Computes the bits of the largest absolute value of `gradients`. As integers, the bits of absolute values have the
/// same order as the values; NaN is the largest.
struct Largest<'a> {
    gradients: &'a [f32],
}

impl Op for Largest<'_> {
    type Output = u32;

    #[inline(always)]
    fn run<V: Lanes>(self) -> u32 {
        self.gradients.iter().fold(0, |most, g| most.max(g.abs().to_bits()))
    }
}

/// State of one level of the tables: each value has two moments and an f16 copy.
pub(super) struct LevelState<'a> {
    pub level: GridLevel,
    pub values: &'a mut [f32],
    pub moment1: &'a mut [f32],
    pub moment2: &'a mut [f32],
    pub halves: &'a mut [u8],
    /// Quantisation step; `None` if the level's values are not rounded.
    pub scale: Option<f32>,
    /// Gradient of the level if it is accumulated over several steps, else `None`.
    pub sum: Option<&'a mut LevelSum>,
    /// Adam's constants; `None` if this step does not update the level.
    pub adam: Option<AdamStep>,
}

/// Gradient of the loss with respect to the values of a level; Adam's update resets it to 0.
#[derive(Clone, Debug)]
pub(super) struct LevelSum {
    /// Gradient, `[entries][features]`, padded to whole parts of [`PART`] values and by one more part.
    gradient: Vec<f32>,
    /// Flag of each part of `gradient`: whether gradients were added to two adjacent entries, the first of which begins
    /// in this part. The second entry may be in the next part.
    touched: Vec<bool>,
}

impl LevelSum {
    pub fn new(values: usize) -> Self {
        let length = values.next_multiple_of(PART) + PART;
        Self { gradient: vec![0.0; length], touched: vec![false; length / PART] }
    }

    pub fn values(&self, values: usize) -> &[f32] {
        &self.gradient[..values]
    }

    pub fn restore(&mut self, values: &[f32]) {
        self.gradient.fill(0.0);
        self.gradient[..values.len()].copy_from_slice(values);
        for (touched, part) in self.touched.iter_mut().zip(self.gradient.chunks_exact(PART)) {
            *touched = part.iter().any(|&g| g != 0.0);
        }
    }
}

/// Buffers of a thread. `sum`: gradient of the current level, unless it has its own sum ([`LevelState::sum`]).
#[derive(Clone, Debug)]
pub(super) struct LevelScratch {
    sum: LevelSum,
    corners: Corners,
    pub phases: Phases,
}

/// Buffers for the fields of [`GridCorners`], for a block of samples: `entry` and `weight`, `[rows][BLOCK]`, with one
/// row for each pair of cell corners that are neighbours in x; and `x`, `[BLOCK]`.
type Corners = (Vec<u32>, Vec<f32>, Vec<f32>);

impl LevelScratch {
    pub fn new(grid: &GridEncoding) -> Self {
        let most = grid.levels().map(|level| level.entries).max().unwrap_or(0) * usize::from(grid.features);
        let corners = (vec![0; 4 * BLOCK], vec![0.0; 4 * BLOCK], vec![0.0; BLOCK]);
        Self { sum: LevelSum::new(most), corners, phases: Phases::default() }
    }

    /// Adds the kept samples' gradients, in order, to a level's gradient. Applies Adam if the step updates the level.
    pub fn step<'k>(
        &mut self,
        isa: Isa,
        grid: &GridEncoding,
        tables: &GridTables<'_>,
        kept: impl Iterator<Item = &'k Kept>,
        state: &mut LevelState<'_>,
    ) {
        let begun = Instant::now();
        let Self { sum, corners, phases } = self;
        let sum = state.sum.take().unwrap_or(sum);
        for kept in kept {
            sum.add((isa, grid, tables), &state.level, kept, corners);
        }
        let begun = phases.lap(Phase::Scatter, begun);
        if let Some(adam) = state.adam {
            let LevelSum { gradient, touched } = sum;
            isa.run(Update { adam, gradient, touched, state });
        }
        phases.lap(Phase::Adam, begun);
    }
}

impl LevelSum {
    fn add(
        &mut self,
        (isa, grid, tables): (Isa, &GridEncoding, &GridTables<'_>),
        level: &GridLevel,
        kept: &Kept,
        (entry, weight, across): &mut Corners,
    ) {
        let Self { gradient, touched } = self;
        let count = kept.positions[0].len();
        for first in (0..count).step_by(BLOCK) {
            let samples = BLOCK.min(count - first);
            let mut x = [0.0; 3 * BLOCK];
            for (x, positions) in x.chunks_exact_mut(BLOCK).zip(&kept.positions) {
                x[..samples].copy_from_slice(&positions[first..first + samples]);
            }
            let mut corners = GridCorners { entry, weight, x: across };
            grid_corners_block(isa, grid, tables, level, BLOCK, &x, &mut corners);
            let rows = &kept.gradients[first * kept.width..][..samples * kept.width];
            let (first, index) = (level.first, level.index);
            let add = Add { entry, weight, across, rows, width: kept.width, first, index, gradient, touched };
            match (grid.inputs, grid.features) {
                (2, 1) => isa.run(Features::<2, 1, 2>(add)),
                (2, 2) => isa.run(Features::<2, 2, 4>(add)),
                (2, _) => isa.run(Features::<2, 4, 8>(add)),
                (_, 1) => isa.run(Features::<4, 1, 2>(add)),
                (_, 2) => isa.run(Features::<4, 2, 4>(add)),
                _ => isa.run(Features::<4, 4, 8>(add)),
            }
        }
    }
}

/// Adds the samples' gradients `rows`, `[samples][width]`, times interpolation weights, to the gradients of `entry`.
struct Add<'a> {
    entry: &'a [u32],
    weight: &'a [f32],
    across: &'a [f32],
    rows: &'a [f32],
    width: usize,
    first: usize,
    index: usize,
    gradient: &'a mut [f32],
    touched: &'a mut [bool],
}

/// [`Add`] with sizes known at compile time: `ROWS` pairs of entries per cell, `F` values per entry, `F2` per pair.
struct Features<'a, const ROWS: usize, const F: usize, const F2: usize>(Add<'a>);

impl<const ROWS: usize, const F: usize, const F2: usize> Op for Features<'_, ROWS, F, F2> {
    type Output = ();

    #[inline(always)]
    fn run<V: Lanes>(self) {
        let Add { entry, weight, across, rows, width, first, index, gradient, touched } = self.0;
        let (entry, weight) = (entry.as_chunks::<BLOCK>().0, weight.as_chunks::<BLOCK>().0);
        let (Some(entry), Some(weight)) = (entry.first_chunk::<ROWS>(), weight.first_chunk::<ROWS>()) else {
            return;
        };
        for ((i, &across), row) in (0..BLOCK).zip(across).zip(rows.chunks_exact(width)) {
            if i + SAMPLES_AHEAD < BLOCK {
                for entry in entry {
                    prefetch(gradient, (entry[i + SAMPLES_AHEAD] as usize - first) * F);
                }
            }
            let of_level = &row[index * F..][..F];
            // Gradients of the two entries of a pair of corners, which are neighbours in x and adjacent in the table.
            let mut both = [0.0f32; F2];
            for f in 0..F {
                let far = of_level[f] * across;
                both[f] = of_level[f] - far;
                both[F + f] = far;
            }
            for (entry, weight) in entry.iter().zip(weight) {
                let at = (entry[i] as usize - first) * F;
                touched[at / PART] = true;
                let Some(values) = gradient[at..].first_chunk_mut::<F2>() else { continue };
                add_scaled(values, &both, weight[i]);
            }
        }
    }
}

/// Adds `from` times `factor` to `to`, in vectors of four. At nerf-train's optimisation level, the compiler does not
/// vectorise loops this short.
#[inline(always)]
fn add_scaled<const N: usize>(to: &mut [f32; N], from: &[f32; N], factor: f32) {
    let (to, last) = to.as_chunks_mut::<4>();
    let (from, last_from) = from.as_chunks::<4>();
    for (to, from) in to.iter_mut().zip(from) {
        *to = (Vec4::from(*to) + Vec4::from(*from) * factor).into();
    }
    for (to, from) in last.iter_mut().zip(last_from) {
        *to += factor * from;
    }
}

/// Applies Adam to a level's values with a gradient other than 0, resets the gradient and updates the f16 copy.
struct Update<'a, 's, 'l> {
    adam: AdamStep,
    gradient: &'a mut [f32],
    touched: &'a mut [bool],
    state: &'s mut LevelState<'l>,
}

impl Op for Update<'_, '_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<V: Lanes>(self) {
        let Self { adam, gradient, touched, state } = self;
        let length = state.values.len();
        let mut before = false;
        for (part, gradient) in gradient.chunks_exact_mut(PART).enumerate() {
            let here = std::mem::take(&mut touched[part]);
            // A pair of entries that begins in one part may end in the next.
            if !std::mem::replace(&mut before, here) && !here {
                continue;
            }
            let from = part * PART;
            if touched.get(part + AHEAD).is_some_and(|&touched| touched) {
                for line in (from + AHEAD * PART..from + (AHEAD + 1) * PART).step_by(16) {
                    prefetch(state.values, line);
                    prefetch(state.moment1, line);
                    prefetch(state.moment2, line);
                }
            }
            let to = length.min(from + PART);
            if from < to {
                let values = &mut state.values[from..to];
                let (m, v) = (&mut state.moment1[from..to], &mut state.moment2[from..to]);
                move_values(adam, &gradient[..to - from], values, m, v);
                halve::<V>(values, state.scale, &mut state.halves[2 * from..2 * to]);
            }
            gradient.fill(0.0);
        }
    }
}

/// Writes `values` to `halves` as little-endian f16. With a `scale`, each value is first rounded to a multiple of it.
pub(super) struct Halve<'a> {
    pub values: &'a [f32],
    pub scale: Option<f32>,
    pub halves: &'a mut [u8],
}

impl Op for Halve<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: Lanes>(self) {
        halve::<V>(self.values, self.scale, self.halves);
    }
}

#[inline(always)]
fn halve<V: Lanes>(values: &[f32], scale: Option<f32>, halves: &mut [u8]) {
    let (values, last) = values.as_chunks::<16>();
    let (halves, last_halves) = halves.as_chunks_mut::<2>().0.as_chunks_mut::<16>();
    for (values, halves) in values.iter().zip(halves) {
        *halves = halve_16::<V>(values, scale);
    }
    let mut values = [0.0; 16];
    values[..last.len()].copy_from_slice(last);
    for (to, half) in last_halves.iter_mut().zip(halve_16::<V>(&values, scale)) {
        *to = half;
    }
}

#[inline(always)]
fn halve_16<V: Lanes>(values: &[f32; 16], scale: Option<f32>) -> [[u8; 2]; 16] {
    let mut halves = [0u16; 16];
    for from in (0..16).step_by(V::COUNT) {
        let mut values = V::load(&values[from..]);
        if let Some(scale) = scale {
            let most = V::splat(STEPS);
            let steps = values.div(V::splat(scale)).round_even().min_of(most).max_of(most.neg());
            values = steps.mul(V::splat(scale));
        }
        let bits = values.to_f16();
        halves[from..from + V::COUNT].copy_from_slice(&bits[..V::COUNT]);
    }
    halves.map(u16::to_le_bytes)
}
