//! Optical depth from outside of the box to each corner of a lattice.
//!
//! Optical depths are summed from neighbour to neighbour along 26 directions. The result at a corner is the third
//! smallest of its 26 sums, so that a gap in one or two directions does not make a hidden corner visible.

use super::Lattice;
use half::f16;
use rayon::prelude::*;
use std::f32::consts::LN_2;

/// Argument of [`level`] at and above which the level is 1. At and below the inverse, `1 / RANGE`, the level is 0.
const RANGE: f32 = 1000.0;
/// Largest optical depth (opacity 15/16) that the sum at one corner adds to the sum at the next corner. Without this
/// limit, a decaying sum would stay large long after opaque matter.
const DARK: f32 = 4.0 * LN_2;
/// The nine directions from a corner to the next slice, as steps in x and y: straight, and to the eight neighbours.
const ACROSS: [[isize; 2]; 9] =
    [[0, 0], [-1, -1], [0, -1], [1, -1], [-1, 0], [1, 0], [-1, 1], [0, 1], [1, 1]];

/// Returns the level of a point, 0 to 1; above 0.5 inside the surface. `ratio`: density or optical depth, divided by
/// its value at the surface. The level is linear in the logarithm of `ratio`, which grows by factors across a surface.
pub(super) fn level(ratio: f32) -> f16 {
    f16::from_f32((0.5 + 0.5 * ratio.ln() / RANGE.ln()).clamp(0.0, 1.0))
}

/// The three smallest sums at a corner, ascending, as upper 16 bits of `f32`s; these integers sort like the values.
type Least = [u16; 3];

pub(super) struct OpticalDepth {
    slices: Vec<Vec<Least>>,
}

impl OpticalDepth {
    /// Sums optical depths over all slices. `cells`: [`Lattice::cell_depths`] of each slice. `decay`: number of cells
    /// over which a sum falls by a factor of about e; infinite: no decay. With decay, surfaces are visible from free
    /// space inside of the box, too.
    pub(super) fn new(lattice: &Lattice, cells: &[Vec<f16>], decay: f32) -> Self {
        let slices = cells.iter().map(|slice| vec![[u16::MAX; 3]; slice.len()]).collect();
        let (mut depths, keep) = (Self { slices }, 1.0 - 1.0 / decay);
        depths.within_slices(lattice, cells, keep);
        let up: Vec<usize> = (0..cells.len()).collect();
        depths.between_slices(lattice, cells, keep, &up);
        depths.between_slices(lattice, cells, keep, &up.into_iter().rev().collect::<Vec<_>>());
        depths
    }

    /// Returns the levels of slice `z`: above 0.5 if the opacity from outside is above 1/2; 0 at the lattice's sides.
    pub(super) fn levels(&self, z: usize) -> Vec<f16> {
        let depth = |least: &Least| match least[2] {
            u16::MAX => 0.0,
            bits => f32::from_bits(u32::from(bits) << 16),
        };
        self.slices[z].iter().map(|least| level(depth(least) / LN_2)).collect()
    }

    /// Sums optical depths along the eight directions within each slice. `keep`: factor on a sum for each cell of path
    /// length; 1 without decay.
    fn within_slices(&mut self, lattice: &Lattice, cells: &[Vec<f16>], keep: f32) {
        let [width, height] = lattice.corners();
        self.slices.par_iter_mut().zip(cells).for_each(|(least, cells)| {
            let sigma: Vec<f32> = cells.iter().map(|depth| depth.to_f32()).collect();
            for [dx, dy] in &ACROSS[1..] {
                let (step, half) = step([*dx, *dy, 0]);
                let keep = keep.powf(step);
                let mut depth = vec![0.0; width * height];
                for y in inner(height, *dy) {
                    for x in inner(width, *dx) {
                        let at = y * width + x;
                        let from = at.wrapping_add_signed(-(dy * width as isize + dx));
                        depth[at] = keep * DARK.min(depth[from]) + half * (sigma[at] + sigma[from]);
                        insert(&mut least[at], depth[at]);
                    }
                }
            }
        });
    }

    /// Sums optical depths along [`ACROSS`], slice by slice. `order`: indices of the slices, ascending or descending.
    /// `keep`: factor on a sum for each cell of path length.
    fn between_slices(&mut self, lattice: &Lattice, cells: &[Vec<f16>], keep: f32, order: &[usize]) {
        let [width, height] = lattice.corners();
        let steps = ACROSS.map(|[dx, dy]| {
            let (step, half) = step([dx, dy, 1]);
            (dy * width as isize + dx, keep.powf(step), half)
        });
        let [mut below, mut here] = [(); 2].map(|()| vec![0.0f32; width * height]);
        let [mut last, mut now] = [(); 2].map(|()| vec![[0.0f32; 9]; width * height]);
        for &z in &order[1..order.len() - 1] {
            here.iter_mut().zip(&cells[z]).for_each(|(here, sigma)| *here = sigma.to_f32());
            let rows = now.par_chunks_mut(width).zip(self.slices[z].par_chunks_mut(width)).enumerate();
            rows.filter(|(y, _)| (1..height - 1).contains(y)).for_each(|(y, (now, least))| {
                for x in inner(width, 1) {
                    let at = y * width + x;
                    for (direction, (offset, keep, half)) in steps.iter().enumerate() {
                        let from = at.wrapping_add_signed(-offset);
                        let depth = keep * DARK.min(last[from][direction]) + half * (here[at] + below[from]);
                        now[x][direction] = depth;
                        insert(&mut least[x], depth);
                    }
                }
            });
            std::mem::swap(&mut last, &mut now);
            std::mem::swap(&mut below, &mut here);
        }
    }
}

/// Returns the length of a step in `direction`, cells, and half of that length.
fn step(direction: [isize; 3]) -> (f32, f32) {
    let cells = (direction.iter().map(|d| d * d).sum::<isize>() as f32).sqrt();
    (cells, 0.5 * cells)
}

/// Iterates over the indices of an axis's corners except the first and the last; `direction` < 0: in descending order.
fn inner(corners: usize, direction: isize) -> impl Iterator<Item = usize> {
    (1..corners - 1).map(move |i| if direction < 0 { corners - 1 - i } else { i })
}

/// Inserts `depth` into the ascending sums `least`, if it is one of the three smallest.
fn insert(least: &mut Least, depth: f32) {
    let depth = (depth.to_bits() >> 16) as u16;
    if depth < least[2] {
        least[2] = depth;
        if least[2] < least[1] {
            least.swap(1, 2);
            if least[1] < least[0] {
                least.swap(0, 1);
            }
        }
    }
}
