//! Gradients of the tables: what the samples kept, added to the entries they read, level by level.

use super::adam::AdamStep;
use crate::engine::GRADIENT_LIMIT;
use nerf_core::encoding::{GridCorners, GridEncoding, GridLevel, GridTables, grid_corners_block};
use nerf_core::kernels::{BLOCK, Tier, prefetch};

/// Values of a part of a level whose gradient is looked at together.
const PART: usize = 64;

/// The samples whose gradient reaches the tables.
#[derive(Clone, Debug, Default)]
pub(super) struct Kept {
    /// Positions, `[samples]` along each axis.
    pub positions: [Vec<f32>; 3],
    /// Gradients of the encoded values, `[samples][width]`.
    pub gradients: Vec<f32>,
    /// Row length of the gradients.
    pub width: usize,
}

impl Kept {
    pub fn clear(&mut self) {
        self.positions.iter_mut().for_each(Vec::clear);
        self.gradients.clear();
    }
}

/// One level's gradient.
#[derive(Clone, Debug)]
pub(super) struct LevelGradient {
    level: GridLevel,
    features: usize,
    /// `[entries][features]`, and a part more for rows that reach beyond the last entry.
    values: Vec<f32>,
    /// Whether a part has a gradient.
    touched: Vec<bool>,
    /// Entries, weights and x of a block of samples.
    corners: (Vec<u32>, Vec<f32>, Vec<f32>),
}

impl LevelGradient {
    pub fn new(grid: &GridEncoding, level: GridLevel) -> Self {
        let features = usize::from(grid.features);
        let values = (level.entries * features).next_multiple_of(PART) + PART;
        let corners = (vec![0; 4 * BLOCK], vec![0.0; 4 * BLOCK], vec![0.0; BLOCK]);
        Self { level, features, values: vec![0.0; values], touched: vec![false; values / PART], corners }
    }

    /// Values of the level.
    pub fn len(&self) -> usize {
        self.level.entries * self.features
    }

    /// Adds what all samples have for this level, in their order.
    pub fn gather<'k>(
        &mut self,
        tier: Tier,
        grid: &GridEncoding,
        tables: &GridTables<'_>,
        kept: impl Iterator<Item = &'k Kept>,
    ) {
        for kept in kept {
            let count = kept.positions[0].len();
            for first in (0..count).step_by(BLOCK) {
                let samples = BLOCK.min(count - first);
                let mut x = [0.0; 3 * BLOCK];
                for (x, positions) in x.chunks_exact_mut(BLOCK).zip(&kept.positions) {
                    x[..samples].copy_from_slice(&positions[first..first + samples]);
                }
                let (entry, weight, across) = &mut self.corners;
                let mut corners = GridCorners { entry, weight, x: across };
                grid_corners_block(tier, grid, tables, &self.level, BLOCK, &x, &mut corners);
                let gradients = &kept.gradients[first * kept.width..][..samples * kept.width];
                match self.features {
                    1 => self.add::<1>(gradients, kept.width),
                    2 => self.add::<2>(gradients, kept.width),
                    _ => self.add::<4>(gradients, kept.width),
                }
            }
        }
    }

    /// Adds a block's gradients, `[samples][width]`.
    fn add<const F: usize>(&mut self, gradients: &[f32], width: usize) {
        let (entry, weight, across) = &self.corners;
        let base = self.level.first;
        // The gradient outgrows the caches; which entries are next is known.
        for row in entry.chunks_exact(BLOCK) {
            row.iter().for_each(|&entry| prefetch(&self.values, (entry as usize - base) * F));
        }
        for (i, gradient) in gradients.chunks_exact(width).enumerate() {
            let gradient: &[f32; F] =
                gradient[self.level.index * F..].first_chunk().expect("a level's values");
            let far = gradient.map(|g| g * across[i]);
            let near: [f32; F] = std::array::from_fn(|f| gradient[f] - far[f]);
            for row in 0..4 {
                let at = (entry[row * BLOCK + i] as usize - base) * F;
                let weight = weight[row * BLOCK + i];
                let values = &mut self.values[at..at + 2 * F];
                for f in 0..F {
                    values[f] += weight * near[f];
                    values[F + f] += weight * far[f];
                }
                self.touched[at / PART] = true;
                self.touched[(at + 2 * F - 1) / PART] = true;
            }
        }
    }

    /// The parts that have a gradient.
    fn parts(&self) -> impl Iterator<Item = usize> {
        self.touched.iter().enumerate().filter(|part| *part.1).map(|part| part.0)
    }

    /// Whether Adam can take the gradient.
    pub fn usable(&self) -> bool {
        self.parts().all(|part| {
            self.values[part * PART..][..PART].iter().fold(true, |ok, g| ok & (g.abs() < GRADIENT_LIMIT))
        })
    }

    /// Forgets the gradient.
    pub fn clear(&mut self) {
        self.values.fill(0.0);
        self.touched.fill(false);
    }

    /// One step of the level's values and moments, where there is a gradient, which is then 0.
    pub fn update(
        &mut self,
        tier: Tier,
        step: &AdamStep,
        values: &mut [f32],
        moment1: &mut [f32],
        moment2: &mut [f32],
    ) {
        for part in 0..self.touched.len() {
            if !std::mem::take(&mut self.touched[part]) {
                continue;
            }
            let from = part * PART;
            let to = values.len().min(from + PART);
            let gradient = &mut self.values[from..from + PART];
            if from < to {
                let (m, v) = (&mut moment1[from..to], &mut moment2[from..to]);
                step.apply(tier, &mut values[from..to], m, v, &mut gradient[..to - from]);
            }
            gradient.fill(0.0);
        }
    }
}
