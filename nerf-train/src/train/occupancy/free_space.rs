//! Free space: cells proved empty by lines of sight, from cameras to the sparse points that their photographs show.

use crate::capture::sights::{Sight, Sights};
use crate::data::View;
use nerf_core::space::{Contraction, SceneBox};
use rayon::prelude::*;

/// Fraction of a line of sight, from its camera on, that counts as free. The fraction is below 1, since points are
/// inexact and surfaces may be slanted.
const FREE_SHARE: f32 = 0.85;
/// Least number of crossings by lines of sight that proves a cell free; for a block, summed over its cells.
const MIN_CROSSINGS: u32 = 3;
/// A cell can be free only if more than this many times as many lines of sight cross it as end in it.
const ENDS: u32 = 4;
/// Side of a block, in cells. Blocks are tested as a whole, in addition to their cells.
const BLOCK: usize = 4;
/// Confidence below which a line of sight is ignored.
const MIN_CONFIDENCE: f32 = 0.15;
/// Number of steps per side of a cell along a line of sight. Outside of the uncontracted ball, steps and cells grow.
const STEPS_A_CELL: f32 = 2.0;

/// Returns for each cell of an unbounded scene whether it is free, at index `(x ny + y) nz + z`.
///
/// A cell is free if at least three lines of sight cross it, and more than four times as many as end in it. The cells
/// of a block of 4 × 4 × 4 are also free if they have at least three crossings in all and no line ends in the block.
pub(crate) fn free_cells(
    bounds: SceneBox,
    resolution: [u16; 3],
    views: &[View],
    contraction: &Contraction,
    sights: &Sights,
) -> Vec<bool> {
    let sides = resolution.map(f32::from);
    let count: usize = resolution.iter().map(|&side| usize::from(side)).product();
    let step = 4.0 / (sides[0] * STEPS_A_CELL);
    let cell_of = |p: glam::Vec3| {
        let at = (contraction.contract(p) - bounds.min) / (bounds.max - bounds.min);
        let cell = |axis: usize| (at[axis] * sides[axis]).clamp(0.0, sides[axis] - 1.0) as usize;
        (cell(0) * usize::from(resolution[1]) + cell(1)) * usize::from(resolution[2]) + cell(2)
    };
    // Returns the cells that a view's lines of sight cross, and the cells in which they end.
    let of_view = |(view, sights): (&View, &Vec<Sight>)| {
        let (mut crossed, mut ended) = (Vec::new(), Vec::new());
        for sight in sights.iter().filter(|sight| sight.confidence >= MIN_CONFIDENCE) {
            let eye = view.camera.ray(sight.at[0], sight.at[1]);
            ended.push(cell_of(eye.at(sight.distance)) as u32);
            let (ray, start) = contraction.centred(&eye);
            let (mut s, end) =
                (contraction.step_at(-start), contraction.step_at(FREE_SHARE * sight.distance - start));
            let mut last = usize::MAX;
            while s < end {
                let cell = cell_of(ray.at(contraction.distance(s)));
                if cell != last {
                    crossed.push(cell as u32);
                }
                (last, s) = (cell, s + step);
            }
        }
        (crossed, ended)
    };
    let (mut crossings, mut ends) = (vec![0u32; count], vec![0u32; count]);
    // A few views at a time, so that their lists take little memory.
    for (views, sights) in views.chunks(16).zip(sights.of_views.chunks(16)) {
        let found: Vec<_> = views.par_iter().zip(sights).map(of_view).collect();
        for (crossed, ended) in found {
            crossed.into_iter().for_each(|cell| crossings[cell as usize] += 1);
            ended.into_iter().for_each(|cell| ends[cell as usize] += 1);
        }
    }
    // Single cells are crossed by too few lines of sight: blocks are tested as a whole, too.
    let blocks = sides.map(|side| (side as usize).div_ceil(BLOCK));
    let block_of = |cell: usize| {
        let [ny, nz] = [resolution[1], resolution[2]].map(usize::from);
        let [x, y, z] = [cell / (ny * nz), cell / nz % ny, cell % nz].map(|index| index / BLOCK);
        (x * blocks[1] + y) * blocks[2] + z
    };
    let mut of_blocks = vec![(0u32, 0u32); blocks.iter().product()];
    for (cell, (&crossed, &ended)) in crossings.iter().zip(&ends).enumerate() {
        let block = &mut of_blocks[block_of(cell)];
        *block = (block.0 + crossed, block.1 + ended);
    }
    let free = |(cell, (&crossed, &ended)): (usize, (&u32, &u32))| {
        let (block_crossed, block_ended) = of_blocks[block_of(cell)];
        (crossed >= MIN_CROSSINGS && ENDS * ended < crossed)
            || (block_crossed >= MIN_CROSSINGS && block_ended == 0)
    };
    crossings.iter().zip(&ends).enumerate().map(free).collect()
}
