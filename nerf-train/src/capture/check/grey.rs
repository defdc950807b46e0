//! Photographs as small grey images, to compare patches, measure sharpness and find duplicates.

use crate::data::View;
use crate::data::pictures::rgb::Picture;
use glam::Vec3;
use rayon::prelude::*;

/// Maximum long side of a downscaled grey image, pixels.
const WORKING_SIDE: u32 = 640;
/// Half-width of a patch, samples: a patch has 13 × 13 samples.
pub(super) const HALF_PATCH: i32 = 6;
/// Number of nearest photographs with which a photograph's sharpness is compared.
const NEIGHBOURS: usize = 6;
/// Fraction of the median sharpness of the nearest photographs below which a photograph is blurred.
const BLURRED: f32 = 0.3;
/// Side of the thumbnails that are compared to find duplicates, pixels.
const STAMP: usize = 32;
/// Limit for duplicates: mean absolute difference of two thumbnails, divided by the lower of their standard deviations.
const SAME: f32 = 0.01;

pub(super) struct Grey {
    /// Downscale factor from the view to the grey image.
    pub factor: u32,
    width: usize,
    height: usize,
    /// Grey levels, 0 to 255, row by row; transparent pixels are white.
    levels: Vec<u8>,
}

impl Grey {
    /// Converts a view to grey, and divides its size by the smallest whole factor that makes the long side at most
    /// [`WORKING_SIDE`] pixels. The factor is at most the short side.
    pub fn of(view: &View) -> Self {
        let (width, height) = view.size();
        let factor = width.max(height).div_ceil(WORKING_SIDE).clamp(1, width.min(height).max(1));
        let side = factor as usize;
        let (columns, rows) = (width as usize / side, height as usize / side);
        let mut levels = Vec::with_capacity(columns * rows);
        let level = |[r, g, b, a]: [u8; 4]| {
            let (sum, alpha) = (f32::from(r) + f32::from(g) + f32::from(b), f32::from(a) / 255.0);
            sum / 3.0 * alpha + 255.0 * (1.0 - alpha)
        };
        let lines: Vec<&[[u8; 4]]> = view.pixels.chunks_exact(width as usize).collect();
        for lines in lines.chunks_exact(side) {
            let mean = |x: usize| {
                let square = lines.iter().flat_map(|line| &line[x * side..][..side]);
                square.map(|pixel| level(*pixel)).sum::<f32>() / (factor * factor) as f32
            };
            levels.extend((0..columns).map(|x| mean(x).round() as u8));
        }
        Self { factor, width: columns, height: rows, levels }
    }

    /// Interpolates the grey level at (`x`, `y`) pixels; pixel centres are at +0.5. `None` outside the image.
    fn at(&self, x: f32, y: f32) -> Option<f32> {
        let (x, y) = (x - 0.5, y - 0.5);
        if !(x >= 0.0 && y >= 0.0 && x + 1.0 < self.width as f32 && y + 1.0 < self.height as f32) {
            return None;
        }
        let (column, row) = (x as usize, y as usize);
        let (u, v) = (x - column as f32, y - row as f32);
        let [a, b] = [row, row + 1].map(|row| {
            let at = row * self.width + column;
            let [left, right] = [self.levels[at], self.levels[at + 1]].map(f32::from);
            left + u * (right - left)
        });
        Some(a + v * (b - a))
    }

    /// Returns the grey levels of a patch around `middle`, row by row; `None` if the patch leaves the image. `right`:
    /// step between samples of a row. `down`: step between rows. All arguments are in pixels of the grey image.
    pub fn patch(&self, middle: [f32; 2], right: [f32; 2], down: [f32; 2]) -> Option<Vec<f32>> {
        let range = -HALF_PATCH..=HALF_PATCH;
        let steps = range.clone().flat_map(|v| range.clone().map(move |u| (u as f32, v as f32)));
        let at = |(u, v)| {
            let [x, y] = [0, 1].map(|axis| middle[axis] + u * right[axis] + v * down[axis]);
            self.at(x, y)
        };
        steps.map(at).collect()
    }

    /// Returns the sharpness: the variance of the Laplacian, in squared grey levels.
    fn sharpness(&self) -> f32 {
        let (mut sum, mut squares, mut count) = (0.0f64, 0.0f64, 0u32);
        for y in 1..self.height.saturating_sub(1) {
            for x in 1..self.width.saturating_sub(1) {
                let at = y * self.width + x;
                let around = [at - 1, at + 1, at - self.width, at + self.width];
                let around: f32 = around.iter().map(|&at| f32::from(self.levels[at])).sum();
                let laplacian = f64::from(around - 4.0 * f32::from(self.levels[at]));
                (sum, squares, count) = (sum + laplacian, squares + laplacian * laplacian, count + 1);
            }
        }
        let count = f64::from(count.max(1));
        (squares / count - (sum / count).powi(2)) as f32
    }

    /// Returns a thumbnail of [`STAMP`] by [`STAMP`] grey levels, and the standard deviation of these levels.
    fn stamp(&self) -> (Vec<f32>, f32) {
        let rgb = self.levels.iter().map(|&level| [f32::from(level); 3]).collect();
        let small = Picture { width: self.width, height: self.height, rgb }.box_filtered(STAMP, STAMP);
        let stamp: Vec<f32> = small.rgb.iter().map(|pixel| pixel[0]).collect();
        let (_, norm) = centred(stamp.clone());
        (stamp, norm / STAMP as f32)
    }
}

/// Returns the values minus their mean, and the norm of the result, for correlations and standard deviations.
pub(super) fn centred(mut values: Vec<f32>) -> (Vec<f32>, f32) {
    let mean = values.iter().sum::<f32>() / values.len().max(1) as f32;
    values.iter_mut().for_each(|value| *value -= mean);
    let norm = values.iter().map(|value| value * value).sum::<f32>().sqrt();
    (values, norm)
}

/// Returns each photograph's sharpness divided by the median sharpness of the [`NEIGHBOURS`] photographs with the
/// nearest poses; 1 for a single photograph.
pub(super) fn sharpness(views: &[&View], greys: &[Grey]) -> Vec<f32> {
    let own: Vec<f32> = greys.par_iter().map(Grey::sharpness).collect();
    let place = |view: &View| (view.camera.pose().position, view.camera.pose().forward());
    let middle = views.iter().map(|view| place(view).0).sum::<Vec3>() / views.len().max(1) as f32;
    let reach = views.iter().map(|view| place(view).0.distance(middle)).fold(f32::MIN_POSITIVE, f32::max);
    let relative = |i: usize| {
        let (position, forward) = place(views[i]);
        let mut near: Vec<(f32, f32)> = (0..views.len())
            .filter(|&j| j != i)
            .map(|j| {
                let (other, ahead) = place(views[j]);
                (position.distance(other) / reach + forward.distance(ahead), own[j])
            })
            .collect();
        near.sort_by(|a, b| a.0.total_cmp(&b.0));
        near.truncate(NEIGHBOURS);
        near.sort_by(|a, b| a.1.total_cmp(&b.1));
        near.get(near.len() / 2).map_or(1.0, |(_, median)| own[i] / median.max(f32::MIN_POSITIVE))
    };
    (0..views.len()).into_par_iter().map(relative).collect()
}

pub(super) fn is_blurred(sharpness: f32) -> bool {
    sharpness < BLURRED
}

pub(super) fn duplicates(greys: &[Grey]) -> Vec<[usize; 2]> {
    let stamps: Vec<_> = greys.par_iter().map(Grey::stamp).collect();
    let same = |a: usize, b: usize| {
        let difference: f32 = stamps[a].0.iter().zip(&stamps[b].0).map(|(a, b)| (a - b).abs()).sum();
        let alike = (greys[a].width, greys[a].height) == (greys[b].width, greys[b].height);
        alike && difference <= SAME * stamps[a].1.min(stamps[b].1) * (STAMP * STAMP) as f32
    };
    let of = |a: usize| (a + 1..greys.len()).filter(move |&b| same(a, b)).map(move |b| [a, b]).collect();
    (0..greys.len()).into_par_iter().map(of).collect::<Vec<Vec<_>>>().concat()
}
