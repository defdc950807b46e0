//! Objects that moved while the photographs were taken: found by the field's colour errors, and left out of the loss.
//!
//! Photographs are cut into square patches. A patch's error is the mean of its rays' signed errors. Errors of fine
//! texture that is hard to fit change sign from pixel to pixel, and cancel out. Errors of an object that only one
//! photograph shows do not. Large connected regions of patches with large errors are masked: their rays have weight 0
//! in the loss, but are still cast, so that a wrong mask can be undone. If the photograph of one of the two nearest
//! cameras has large errors at the same patches, the field is wrong, and the region is not masked.
//!
//! # Source
//! Sabour et al. 2023 (RobustNeRF), patch-wise robust weights. Deviation: the signed mean of a patch's error in place
//! of trimmed squared errors, which masked texture too; connected regions in place of fixed windows.

use crate::data::View;
use crate::data::cameras::bundle::median;
use crate::data::names::listed;
use crate::model::config::MovingObjects;
use crate::model::engine::Batch;
use glam::Vec3;
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// Number of steps between two updates of the masks.
const EVERY: u32 = 500;
/// Least number of training photographs with which a run masks moving objects.
const FEWEST_VIEWS: usize = 8;
/// Largest numbers of patches: along a photograph's longer side, and in all photographs. More patches get too few rays.
const PATCHES: [u32; 2] = [60, 90_000];
/// Least side of a patch, pixels.
const SMALLEST_SIDE: u32 = 4;
/// Least number of rays in a patch's 3 × 3 neighbourhood from which the patch's error is computed.
const KNOWN: f32 = 8.0;
/// Error above which a patch belongs to a region: the larger of two limits. First number: multiple of the median error
/// of all patches. Second number: root-mean-square error over the channels, for colours of 0 to 1.
const OFF: (f32, f32) = (3.0, 0.03);
/// Limits of a masked region. First number: least mean error. Second number: least product of the mean error and the
/// region's fraction of the photograph's area. Regions of static scenes have means up to 0.116 and products up to
/// 0.0084. Single-coloured figures in front of these scenes have means of 0.13 to 0.3 and products of at least 0.015.
const FAR_OFF: (f32, f32) = (0.125, 0.01);
/// Number of nearest cameras. A region is compared with the photographs of these cameras.
const NEIGHBOURS: usize = 2;
/// Limit on the fraction of a region's patches that also have large errors in the photograph of one of the nearest
/// cameras. From this fraction on, the field is taken to be wrong, and the region is not masked.
const SHARED: f32 = 0.5;
/// Largest fraction of all patches to mask. If it is exceeded, none is masked: the capture is wrong, not one object.
const MOST: f32 = 0.3;

/// Division of a photograph into patches.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct Tiles {
    first: usize,
    columns: usize,
    rows: usize,
    side: u32,
    width: u32,
}

impl Tiles {
    fn range(&self) -> Range<usize> {
        self.first..self.first + self.len()
    }

    fn len(&self) -> usize {
        self.columns * self.rows
    }

    /// Maps `patch` of another photograph, of division `other`, to the patch at the same relative position here.
    fn across(&self, patch: usize, other: &Self) -> usize {
        let (column, row) = (patch % other.columns, patch / other.columns);
        row * self.rows / other.rows * self.columns + column * self.columns / other.columns
    }

    fn patch(&self, pixel: u32) -> usize {
        let (x, y) = (pixel % self.width / self.side, pixel / self.width / self.side);
        self.first + y as usize * self.columns + x as usize
    }

    /// Returns the indices of `patch` and of its up to eight neighbours. Indices are row-major within the photograph.
    fn around(&self, patch: usize) -> impl Iterator<Item = usize> + use<> {
        let near = |at: usize, end: usize| at.saturating_sub(1)..(at + 2).min(end);
        let columns = self.columns;
        let across = near(patch % columns, columns);
        near(patch / columns, self.rows).flat_map(move |y| across.clone().map(move |x| y * columns + x))
    }
}

/// Masks of the training photographs, and the colour errors of all patches since the last update of the masks.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Moving {
    tiles: Vec<Tiles>,
    /// For each photograph, the indices of the photographs from the nearest cameras.
    neighbours: Vec<Vec<usize>>,
    /// For each patch, the sums of its rays' errors in red, green and blue, and the number of rays.
    sums: Vec<[f32; 4]>,
    masked: Vec<bool>,
}

/// A photograph with an object that the other photographs do not show.
#[derive(Clone, Debug, PartialEq)]
pub struct Moved {
    pub view: usize,
    pub name: String,
    pub share: f64,
    /// Whether each pixel is masked, row by row from the top.
    pub mask: Vec<bool>,
}

impl Moved {
    /// Masks the moved object's pixels in `view`, so that scores ignore them, unless no pixel would remain.
    pub fn leave_out_of(&self, view: &mut View) {
        let counts: Vec<bool> =
            self.mask.iter().enumerate().map(|(pixel, &masked)| !masked && view.counts(pixel)).collect();
        if counts.contains(&true) {
            view.mask = Some(counts);
        }
    }
}

/// Returns the messages for the user that name the photographs in `moved`; empty if `moved` is empty.
pub fn in_words(moved: &[Moved]) -> Vec<String> {
    let of = |moved: &[&Moved]| match moved {
        [one] => format!("1 photograph ({})", one.name),
        all => {
            let names: Vec<&str> = all.iter().map(|moved| &*moved.name).collect();
            format!("{} photographs ({})", all.len(), listed(&names))
        }
    };
    let (most, some): (Vec<&Moved>, Vec<&Moved>) = moved.iter().partition(|moved| moved.share > 0.5);
    let mut words = Vec::new();
    if !some.is_empty() {
        words.push(format!(
            "something moved in {}: {:.0} % of their pixels, which the other photographs contradict, are left out \
             of the fit; --report shows which (moving = \"off\" under [capture] keeps them)",
            of(&some),
            100.0 * some.iter().map(|moved| moved.share).sum::<f64>() / some.len() as f64
        ));
    }
    if !most.is_empty() {
        words.push(format!(
            "{} with more than half of the pixels contradicted by the other photographs and left out of the fit: a wrong \
             pose, or another place or time; take such photographs out of the data set",
            of(&most)
        ));
    }
    words
}

impl Moving {
    /// Creates the state without masks. `None` if the settings turn masks off, or with fewer than eight photographs.
    pub fn of(views: &[View], setting: MovingObjects) -> Option<Self> {
        if setting == MovingObjects::Off || views.len() < FEWEST_VIEWS {
            return None;
        }
        let tiles = tiles(views);
        let patches = tiles.last().map_or(0, |tiles| tiles.range().end);
        let neighbours = neighbours(views);
        Some(Self { tiles, neighbours, sums: vec![[0.0; 4]; patches], masked: vec![false; patches] })
    }

    /// Whether this state, read from an untrusted checkpoint, fits the photographs `views` and is finite.
    pub fn is_of(&self, views: &[View]) -> bool {
        let patches = self.tiles.last().map_or(0, |tiles| tiles.range().end);
        (&self.tiles, &self.neighbours) == (&tiles(views), &neighbours(views))
            && (self.sums.len(), self.masked.len()) == (patches, patches)
            && self.sums.as_flattened().iter().all(|x| x.is_finite())
    }

    /// Sets the loss weights of a batch's rays: 0 in masked patches, else 1. Clears the weights if nothing is masked.
    pub fn weigh(&self, batch: &mut Batch) {
        batch.weights.clear();
        if self.masked.contains(&true) {
            let rays = batch.views.iter().zip(&batch.pixels);
            let masked = rays.map(|(&view, &pixel)| self.masked[self.tiles[view as usize].patch(pixel)]);
            batch.weights.extend(masked.map(|masked| f32::from(u8::from(!masked))));
        }
    }

    /// Adds colour errors of rays to the sums of their patches. `errors`: index of a ray in `batch`, and signed error
    /// of its red, green and blue, for colours of 0 to 1.
    pub fn add<'e>(&mut self, batch: &Batch, errors: impl Iterator<Item = &'e (u32, [f32; 3])>) {
        for &(ray, [r, g, b]) in errors {
            let at = batch.views.get(ray as usize).zip(batch.pixels.get(ray as usize));
            let Some((&view, &pixel)) = at else { continue };
            let sum = &mut self.sums[self.tiles[view as usize].patch(pixel)];
            sum.iter_mut().zip([r, g, b, 1.0]).for_each(|(sum, x)| *sum += x);
        }
    }

    /// Updates the masks after every `EVERY`th step; `step` counts from 0.
    pub fn step(&mut self, step: u32) {
        if !(step + 1).is_multiple_of(EVERY) {
            return;
        }
        let errors: Vec<Option<f32>> = self.tiles.iter().flat_map(|tiles| self.errors(tiles)).collect();
        let limit = (OFF.0 * median(errors.iter().copied().flatten()) as f32).max(OFF.1);
        self.masked.fill(false);
        let off: Vec<bool> = errors.iter().map(|error| error.is_some_and(|error| error > limit)).collect();
        for (tiles, neighbours) in self.tiles.iter().zip(&self.neighbours) {
            for region in regions(tiles, &off[tiles.range()]) {
                let error: f32 = region.iter().filter_map(|&patch| errors[tiles.first + patch]).sum();
                let is_far_off =
                    error >= FAR_OFF.0 * region.len() as f32 && error >= FAR_OFF.1 * tiles.len() as f32;
                let is_shared = |&other: &usize| {
                    let other = &self.tiles[other];
                    let both = region.iter().filter(|&&patch| off[other.first + other.across(patch, tiles)]);
                    both.count() as f32 >= SHARED * region.len() as f32
                };
                if is_far_off && !neighbours.iter().any(is_shared) {
                    let around = region.iter().flat_map(|&patch| tiles.around(patch));
                    around.for_each(|patch| self.masked[tiles.first + patch] = true);
                }
            }
        }
        let count = self.masked.iter().filter(|&&masked| masked).count();
        if count as f32 > MOST * self.masked.len() as f32 {
            self.masked.fill(false);
        }
        self.sums.fill([0.0; 4]);
    }

    /// Returns each patch's error; `None` with fewer than `KNOWN` rays in the patch's 3 × 3 neighbourhood. For each
    /// channel, the mean signed error of these rays is computed, and the median of this mean over the photograph's
    /// patches is subtracted. The patch's error is the root mean square of the three differences.
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
        let medians = [0, 1, 2].map(|c| median(means.iter().flatten().map(|mean| mean[c])) as f32);
        let beside = |mean: [f32; 3]| {
            let squares = mean.iter().zip(medians).map(|(x, median)| (x - median).powi(2));
            (squares.sum::<f32>() / 3.0).sqrt()
        };
        means.into_iter().map(|mean| mean.map(beside)).collect()
    }

    pub fn is_found(&self) -> bool {
        self.masked.contains(&true)
    }

    pub fn found(&self, views: &[View]) -> Vec<Moved> {
        let of = |(view, tiles): (usize, &Tiles)| {
            let mask: Vec<bool> =
                (0..views[view].pixels.len() as u32).map(|pixel| self.masked[tiles.patch(pixel)]).collect();
            let count = mask.iter().filter(|&&masked| masked).count();
            let share = count as f64 / mask.len().max(1) as f64;
            Moved { view, name: views[view].name.clone(), share, mask }
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

/// Returns, for each photograph, the [`NEIGHBOURS`] others whose cameras are nearest in position and direction.
fn neighbours(views: &[View]) -> Vec<Vec<usize>> {
    let poses: Vec<(Vec3, Vec3)> =
        views.iter().map(|view| (view.camera.pose().position, view.camera.pose().forward())).collect();
    let middle = poses.iter().map(|(eye, _)| *eye).sum::<Vec3>() / poses.len().max(1) as f32;
    let spread = poses.iter().map(|(eye, _)| eye.distance(middle)).sum::<f32>() / poses.len().max(1) as f32;
    let of = |view: usize| {
        let (eye, forward) = poses[view];
        let distance = |other: &usize| {
            eye.distance(poses[*other].0) / spread.max(f32::MIN_POSITIVE) + forward.distance(poses[*other].1)
        };
        let mut others: Vec<usize> = (0..poses.len()).filter(|&other| other != view).collect();
        others.sort_by(|a, b| distance(a).total_cmp(&distance(b)));
        others.truncate(NEIGHBOURS);
        others
    };
    (0..poses.len()).map(of).collect()
}

/// Returns the connected regions (8 neighbours) of the patches marked in `off`, as lists of patch indices.
fn regions(tiles: &Tiles, off: &[bool]) -> Vec<Vec<usize>> {
    let (mut visited, mut regions) = (vec![false; off.len()], Vec::new());
    for start in 0..off.len() {
        if visited[start] || !off[start] {
            continue;
        }
        let (mut region, mut next) = (vec![start], 0);
        visited[start] = true;
        while let Some(&patch) = region.get(next) {
            next += 1;
            for near in tiles.around(patch) {
                if !visited[near] && off[near] {
                    visited[near] = true;
                    region.push(near);
                }
            }
        }
        regions.push(region);
    }
    regions
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::demo;

    const SIDE: u32 = 80;

    /// Photographs with a mask after one update. `error`: a pixel's colour error by photograph, column and row.
    fn decided(moving: &mut Moving, views: &[View], error: impl Fn(usize, u32, u32) -> f32) -> Vec<Moved> {
        for view in 0..views.len() {
            let pixels: Vec<u32> = (0..SIDE * SIDE).collect();
            let of = |&pixel: &u32| (pixel, [error(view, pixel % SIDE, pixel / SIDE); 3]);
            let errors: Vec<(u32, [f32; 3])> = pixels.iter().map(of).collect();
            let batch = Batch { views: vec![view as u32; pixels.len()], pixels, ..Batch::default() };
            moving.add(&batch, errors.iter());
        }
        moving.step(EVERY - 2);
        assert!(moving.sums.as_flattened().iter().any(|&sum| sum != 0.0), "it is not time yet");
        moving.step(EVERY - 1);
        moving.found(views)
    }

    fn views() -> Vec<View> {
        demo::small(9, 1, SIDE).train
    }

    /// Error like a fine texture's before it is fitted: `size` and −`size` in turn from pixel to pixel, mean 0.
    fn grain(x: u32, y: u32, size: f32) -> f32 {
        if (x + y).is_multiple_of(2) { size } else { -size }
    }

    fn is_figure(view: usize, x: u32, y: u32) -> bool {
        view == 4 && (20..44).contains(&x) && (16..56).contains(&y)
    }

    #[test]
    fn a_region_of_another_colour_is_masked_and_taken_back() {
        let views = views();
        let mut moving = Moving::of(&views, MovingObjects::Auto).expect("enough photographs");
        let figure = |view, x, y| grain(x, y, 0.1) + if is_figure(view, x, y) { 0.25 } else { 0.0 };
        let found = decided(&mut moving, &views, figure);
        assert_eq!(found.iter().map(|moved| moved.view).collect::<Vec<_>>(), [4]);
        let (mut hit, mut beside) = (0, 0);
        for (pixel, _) in found[0].mask.iter().enumerate().filter(|(_, masked)| **masked) {
            let (x, y) = (pixel as u32 % SIDE, pixel as u32 / SIDE);
            if is_figure(4, x, y) { hit += 1 } else { beside += 1 }
        }
        // On each side of the figure, at most two patches (eight pixels) are masked.
        assert!(hit == 24 * 40 && beside <= 40 * 56 - 24 * 40, "{hit}, {beside}");

        let mut batch = Batch {
            views: vec![4, 4, 3],
            pixels: vec![30 * SIDE + 30, 0, 30 * SIDE + 30],
            ..Batch::default()
        };
        moving.weigh(&mut batch);
        assert_eq!(batch.weights, [0.0, 1.0, 1.0]);
        assert_eq!(decided(&mut moving, &views, |_, x, y| grain(x, y, 0.1)), []);
        moving.weigh(&mut batch);
        assert!(batch.weights.is_empty());
    }

    #[test]
    fn texture_exposure_small_things_and_captures_that_are_wrong_as_a_whole_are_not_masked() {
        let views = views();
        let found = |error: &dyn Fn(usize, u32, u32) -> f32| {
            let mut moving = Moving::of(&views, MovingObjects::Auto).expect("enough photographs");
            decided(&mut moving, &views, error).len()
        };
        assert_eq!(found(&|view, x, y| grain(x, y, if is_figure(view, x, y) { 0.6 } else { 0.1 })), 0);
        assert_eq!(found(&|view, x, y| grain(x, y, 0.1) + if view == 4 { 0.3 } else { 0.0 }), 0);
        assert_eq!(found(&|view, x, y| if view == 4 && x < 8 && y < 8 { 0.6 } else { grain(x, y, 0.1) }), 0);
        let halves =
            |view: usize, x: u32, y: u32| grain(x, y, 0.1) + if x < 36 { [-0.3, 0.3][view % 2] } else { 0.0 };
        assert_eq!(found(&halves), 0);
        // All photographs, also those of the nearest cameras, have the error in this region.
        assert_eq!(found(&|_, x, y| grain(x, y, 0.1) + if is_figure(4, x, y) { 0.25 } else { 0.0 }), 0);
        assert!(Moving::of(&views, MovingObjects::Off).is_none());
        assert!(Moving::of(&views[..7], MovingObjects::Auto).is_none());
    }

    #[test]
    fn the_words_name_photographs_and_those_that_are_contradicted_as_a_whole() {
        assert!(in_words(&[]).is_empty());
        let of = |name: &str, share| Moved { view: 0, name: name.into(), share, mask: Vec::new() };
        let words = in_words(&[of("a.jpg", 0.1), of("b.jpg", 0.2), of("c.jpg", 0.7)]);
        assert!(words[0].contains("2 photographs (a.jpg, b.jpg): 15 %"), "{words:?}");
        assert!(words[1].contains("1 photograph (c.jpg) with more than half"), "{words:?}");
    }
}
