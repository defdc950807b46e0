//! What moved while photographs were taken, found by how the field errs and left out of its loss.
//!
//! Photographs are cut into square patches. A patch's error is the mean of its rays' errors with their signs: fine texture
//! that is hard to fit is too bright here and too dark there, which cancels out, while something that only this photograph
//! shows has another colour as a whole. Where patches that err together are large and far off, their rays have weight 0; they
//! are drawn as before, so that what was masked wrongly is taken back.
//!
//! # Source
//! Sabour et al. 2023 (RobustNeRF), patch-wise robust weights. Deviation: the signed mean of a patch's error in place of
//! trimmed squared errors, which masked texture too; connected regions in place of fixed windows.

use crate::data::View;
use crate::model::config::MovingObjects;
use crate::model::engine::Batch;
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// Steps from one decision to the next.
const EVERY: u32 = 500;
/// Photographs from which on one can contradict the others.
const FEWEST_VIEWS: usize = 8;
/// Patches along the longer side of a photograph, and over all of them, at most: what a decision's rays suffice for.
const PATCHES: [u32; 2] = [60, 90_000];
/// Least side of a patch, pixels.
const SMALLEST_SIDE: u32 = 4;
/// Rays in three by three patches from which on their error is known.
const KNOWN: f32 = 8.0;
/// Error of a patch in a region: in medians over all patches, and at least; colours are from 0 to 1, root mean square.
const OFF: (f32, f32) = (3.0, 0.03);
/// Mean error of a region that is masked, and that times its share of the photograph. Clean captures have regions of up to
/// 0.116, and 0.14 times 0.06; figures of a flat colour in front of the same captures 0.13 to 0.3, and from 0.015 on.
const FAR_OFF: (f32, f32) = (0.125, 0.01);
/// Share of all patches beyond which the capture is wrong as a whole and nothing is masked.
const MOST: f32 = 0.3;

/// How a photograph is cut into patches.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct Tiles {
    first: usize,
    columns: usize,
    rows: usize,
    /// Of a patch, and width of the photograph, pixels.
    side: u32,
    width: u32,
}

impl Tiles {
    fn range(&self) -> Range<usize> {
        self.first..self.first + self.columns * self.rows
    }

    /// The patch of a pixel.
    fn patch(&self, pixel: u32) -> usize {
        let (x, y) = (pixel % self.width / self.side, pixel / self.width / self.side);
        self.first + y as usize * self.columns + x as usize
    }

    /// The patches within one of `patch`, which is counted from the photograph's first, itself among them.
    fn around(&self, patch: usize) -> impl Iterator<Item = usize> + use<> {
        let near = |at: usize, end: usize| at.saturating_sub(1)..(at + 2).min(end);
        let columns = self.columns;
        let across = near(patch % columns, columns);
        near(patch / columns, self.rows).flat_map(move |y| across.clone().map(move |x| y * columns + x))
    }
}

/// Patches of a run's photographs, their errors since the last decision, and which of them are masked.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Moving {
    tiles: Vec<Tiles>,
    /// Of the errors, red, green, blue, and how many.
    sums: Vec<[f32; 4]>,
    masked: Vec<bool>,
}

/// A photograph that shows something which the others contradict.
#[derive(Clone, Debug, PartialEq)]
pub struct Moved {
    /// Index of the training photograph.
    pub view: usize,
    /// Masked share of its pixels.
    pub share: f64,
    /// Which they are, row by row from the top.
    pub mask: Vec<bool>,
}

impl Moving {
    /// Of these photographs; `None` where nothing is to be masked.
    pub fn of(views: &[View], setting: MovingObjects) -> Option<Self> {
        if setting == MovingObjects::Off || views.len() < FEWEST_VIEWS {
            return None;
        }
        let tiles = tiles(views);
        let patches = tiles.last().map_or(0, |tiles| tiles.range().end);
        Some(Self { tiles, sums: vec![[0.0; 4]; patches], masked: vec![false; patches] })
    }

    /// Whether they belong to `views` and are finite: a checkpoint may hold anything.
    pub fn is_of(&self, views: &[View]) -> bool {
        let patches = self.tiles.last().map_or(0, |tiles| tiles.range().end);
        self.tiles == tiles(views)
            && (self.sums.len(), self.masked.len()) == (patches, patches)
            && self.sums.as_flattened().iter().all(|x| x.is_finite())
    }

    /// Weights of a batch's rays; none where all are 1.
    pub fn weigh(&self, batch: &mut Batch) {
        batch.weights.clear();
        if self.masked.contains(&true) {
            let rays = batch.views.iter().zip(&batch.pixels);
            let masked = rays.map(|(&view, &pixel)| self.masked[self.tiles[view as usize].patch(pixel)]);
            batch.weights.extend(masked.map(|masked| f32::from(u8::from(!masked))));
        }
    }

    /// Adds the errors of a batch's rays, by their index.
    pub fn add<'e>(&mut self, batch: &Batch, errors: impl Iterator<Item = &'e (u32, [f32; 3])>) {
        for &(ray, [r, g, b]) in errors {
            let at = batch.views.get(ray as usize).zip(batch.pixels.get(ray as usize));
            let Some((&view, &pixel)) = at else { continue };
            let sum = &mut self.sums[self.tiles[view as usize].patch(pixel)];
            sum.iter_mut().zip([r, g, b, 1.0]).for_each(|(sum, x)| *sum += x);
        }
    }

    /// Decides after step `step` what is masked, where it is time to.
    pub fn step(&mut self, step: u32) {
        if !(step + 1).is_multiple_of(EVERY) {
            return;
        }
        let errors: Vec<Option<f32>> = self.tiles.iter().flat_map(|tiles| self.errors(tiles)).collect();
        let mut known: Vec<f32> = errors.iter().copied().flatten().collect();
        let middle = known.len() / 2;
        let limit = match known.is_empty() {
            true => f32::INFINITY,
            false => (OFF.0 * *known.select_nth_unstable_by(middle, f32::total_cmp).1).max(OFF.1),
        };
        self.masked.fill(false);
        for tiles in &self.tiles {
            let masked = regions(tiles, &errors[tiles.range()], limit);
            masked.for_each(|patch| self.masked[tiles.first + patch] = true);
        }
        let count = self.masked.iter().filter(|&&masked| masked).count();
        if count as f32 > MOST * self.masked.len() as f32 {
            self.masked.fill(false);
        }
        self.sums.fill([0.0; 4]);
    }

    /// Error of each patch of a photograph, by those around it too, beside the photograph's median; `None`: unknown.
    fn errors(&self, tiles: &Tiles) -> Vec<Option<f32>> {
        let sums = &self.sums[tiles.range()];
        let mean = |patch: usize| {
            let mut sum = [0.0f32; 4];
            for of in tiles.around(patch) {
                sum.iter_mut().zip(sums[of]).for_each(|(sum, x)| *sum += x);
            }
            let [r, g, b, count] = sum;
            (count >= KNOWN).then(|| [r, g, b].map(|x| x / count))
        };
        let means: Vec<Option<[f32; 3]>> = (0..sums.len()).map(mean).collect();
        let median = |channel: usize| {
            let mut values: Vec<f32> = means.iter().flatten().map(|mean| mean[channel]).collect();
            let middle = values.len() / 2;
            if values.is_empty() {
                return 0.0;
            }
            *values.select_nth_unstable_by(middle, f32::total_cmp).1
        };
        let medians = [0, 1, 2].map(median);
        let beside = |mean: [f32; 3]| {
            let squares = mean.iter().zip(medians).map(|(x, median)| (x - median).powi(2));
            (squares.sum::<f32>() / 3.0).sqrt()
        };
        means.into_iter().map(|mean| mean.map(beside)).collect()
    }

    /// Whether anything is masked.
    pub fn is_found(&self) -> bool {
        self.masked.contains(&true)
    }

    /// The photographs of which something is masked.
    pub fn found(&self, views: &[View]) -> Vec<Moved> {
        let of = |(view, tiles): (usize, &Tiles)| {
            let mask: Vec<bool> = (0..views[view].pixels.len() as u32)
                .map(|pixel| self.masked[tiles.patch(pixel)])
                .collect();
            let count = mask.iter().filter(|&&masked| masked).count();
            Moved { view, share: count as f64 / mask.len().max(1) as f64, mask }
        };
        let some = |(_, tiles): &(usize, &Tiles)| self.masked[tiles.range()].contains(&true);
        self.tiles.iter().enumerate().filter(some).map(of).collect()
    }
}

fn tiles(views: &[View]) -> Vec<Tiles> {
    let pixels: u64 = views.iter().map(View::pixel_count).sum();
    let least = (pixels as f64 / f64::from(PATCHES[1])).sqrt().ceil() as u32;
    let mut first = 0;
    let of = |view: &View| {
        let (width, height) = view.size();
        let side = width.max(height).div_ceil(PATCHES[0]).max(least).max(SMALLEST_SIDE);
        let [columns, rows] = [width, height].map(|length| length.div_ceil(side) as usize);
        let tiles = Tiles { first, columns, rows, side, width };
        first = tiles.range().end;
        tiles
    };
    views.iter().map(of).collect()
}

/// Patches of the regions that are masked, and those around them: `errors` beyond `limit` are off.
fn regions(tiles: &Tiles, errors: &[Option<f32>], limit: f32) -> impl Iterator<Item = usize> + use<> {
    let off = |patch: usize| errors[patch].filter(|&error| error > limit);
    let (mut visited, mut masked) = (vec![false; errors.len()], Vec::new());
    for start in 0..errors.len() {
        if visited[start] || off(start).is_none() {
            continue;
        }
        let (mut region, mut next) = (vec![start], 0);
        visited[start] = true;
        while let Some(&patch) = region.get(next) {
            next += 1;
            for near in tiles.around(patch) {
                if !visited[near] && off(near).is_some() {
                    visited[near] = true;
                    region.push(near);
                }
            }
        }
        let sum: f32 = region.iter().filter_map(|&patch| off(patch)).sum();
        if sum >= FAR_OFF.0 * region.len() as f32 && sum >= FAR_OFF.1 * errors.len() as f32 {
            masked.extend(region.iter().flat_map(|&patch| tiles.around(patch)));
        }
    }
    masked.into_iter()
}
