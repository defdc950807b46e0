//! Reduction of pictures by averaging areas.

use crate::data::pictures::file::Picture;
use image::DynamicImage;
use std::ops::Range;

/// Long side that [`Downscale::Auto`] aims at, pixels.
const AUTO_SIDE: f64 = 800.0;
const MAX_FACTOR: u32 = 64;

/// Factor by which the width and height of photographs are reduced.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Downscale {
    /// Reduces by the whole number, 1 to 64, that brings the long side nearest to 800 pixels.
    #[default]
    Auto,
    /// Reduces by this whole number; 0 has the effect of 1.
    By(u32),
}

impl Downscale {
    /// Returns the factor by which pictures of `width` by `height` pixels are reduced.
    pub(crate) fn factor(self, (width, height): (f64, f64)) -> u32 {
        if let Self::By(factor) = self {
            return factor.max(1);
        }
        let ratio = (width.max(height) / AUTO_SIDE).clamp(1.0, f64::from(MAX_FACTOR));
        let (low, high) = (ratio.floor(), ratio.ceil());
        // Chooses the factor nearest to `ratio` on a logarithmic scale.
        (if ratio / low <= high / ratio { low } else { high }) as u32
    }
}

impl std::str::FromStr for Downscale {
    type Err = String;

    fn from_str(s: &str) -> Result<Self, String> {
        match s.parse() {
            _ if s == "auto" => Ok(Self::Auto),
            Ok(factor @ 1..=MAX_FACTOR) => Ok(Self::By(factor)),
            _ => Err(format!("expected auto, or a whole number from 1 to {MAX_FACTOR}, found {s:?}")),
        }
    }
}

/// Returns the index of the first source pixel that target pixel `index` overlaps, and the fraction overlapped of each
/// source pixel from it on. `count`, `length`: number of target and source pixels along the side.
fn covered(index: u32, count: u32, length: u32) -> (usize, Vec<f32>) {
    let (from, to) = span(index, count, length);
    let first = from.floor() as usize;
    let last = (to.ceil() as usize).clamp(first + 1, length as usize);
    let part = |i: usize| (to.min(i as f64 + 1.0) - from.max(i as f64)).max(0.0) as f32;
    (first, (first..last).map(part).collect())
}

/// Returns start and end, in source pixels, of target pixel `index` of `count` along a side of `length` source pixels.
fn span(index: u32, count: u32, length: u32) -> (f64, f64) {
    let at = |i: u32| f64::from(i) * f64::from(length) / f64::from(count);
    (at(index), at(index + 1))
}

/// Returns the indices of the source pixels that a target pixel overlaps by more than rounding errors. `index`: index
/// of the target pixel. `count`, `length`: number of target and source pixels along the side.
fn touched(index: u32, count: u32, length: u32) -> Range<usize> {
    let (from, to) = span(index, count, length);
    (from + 1e-6).floor() as usize..((to - 1e-6).ceil() as usize).min(length as usize)
}

/// Converts `image` to straight 8-bit sRGB and alpha, and reduces it to `width` by `height` pixels if it is larger. A
/// new pixel is the mean over its area, weighted by alpha, in display space, as in the usual data sets.
pub(crate) fn shrunk(image: DynamicImage, width: u32, height: u32) -> Picture {
    let (from_width, from_height) = (image.width(), image.height());
    let (width, height) = (width.min(from_width), height.min(from_height));
    let alpha = image.color().has_alpha();
    if (width, height) == (from_width, from_height) {
        let pixels = image.into_rgba8().pixels().map(|pixel| pixel.0).collect();
        return Picture { width, height, pixels, alpha };
    }
    let (bytes, channels) = match image {
        DynamicImage::ImageRgb8(image) => (image.into_raw(), 3),
        DynamicImage::ImageLuma8(image) => (image.into_raw(), 1),
        image => (image.into_rgba8().into_raw(), 4),
    };
    let columns: Vec<_> = (0..width).map(|x| covered(x, width, from_width)).collect();
    let row_bytes = from_width as usize * channels;
    let mut pixels = Vec::with_capacity(width as usize * height as usize);
    let mut sums = vec![[0.0f32; 4]; width as usize];
    for y in 0..height {
        sums.fill([0.0; 4]);
        let (first, parts) = covered(y, height, from_height);
        for (row, part) in bytes.chunks_exact(row_bytes).skip(first).zip(parts) {
            add_row(&mut sums, row, channels, &columns, part);
        }
        let area = f64::from(from_width) / f64::from(width) * f64::from(from_height) / f64::from(height);
        pixels.extend(sums.iter().map(|sum| pixel_of(*sum, area as f32)));
    }
    Picture { width, height, pixels, alpha }
}

/// Adds a source row to the sums of a target row: red, green and blue, all times alpha, and alpha. `columns`: result of
/// [`covered`] for each target column. `part`: fraction of the source row that the target row covers.
fn add_row(sums: &mut [[f32; 4]], row: &[u8], channels: usize, columns: &[(usize, Vec<f32>)], part: f32) {
    for (sum, (first, shares)) in sums.iter_mut().zip(columns) {
        for (pixel, share) in row[first * channels..].chunks_exact(channels).zip(shares) {
            let alpha = pixel.get(3).map_or(1.0, |&alpha| f32::from(alpha) / 255.0);
            let weight = share * part * alpha;
            for c in 0..3 {
                // A grey pixel has one channel.
                sum[c] += weight * f32::from(pixel[if channels == 1 { 0 } else { c }]);
            }
            sum[3] += weight;
        }
    }
}

fn pixel_of([r, g, b, weight]: [f32; 4], area: f32) -> [u8; 4] {
    if weight <= 0.0 {
        return [0; 4];
    }
    let [r, g, b] = [r, g, b].map(|sum| (sum / weight).round() as u8);
    [r, g, b, (255.0 * weight / area).round() as u8]
}

/// Scales a mask from the size `from` to `to`, pixels: a pixel is kept if all source pixels it overlaps are kept.
pub(crate) fn shrunk_mask(kept: &[bool], from: (u32, u32), to: (u32, u32)) -> Vec<bool> {
    let columns: Vec<_> = (0..to.0).map(|x| touched(x, to.0, from.0)).collect();
    let mut out = Vec::with_capacity(to.0 as usize * to.1 as usize);
    for y in 0..to.1 {
        let rows = touched(y, to.1, from.1);
        let line = |row: usize, columns: &Range<usize>| {
            let start = row * from.0 as usize;
            kept[start + columns.start..start + columns.end].iter().all(|&kept| kept)
        };
        out.extend(columns.iter().map(|columns| rows.clone().all(|row| line(row, columns))));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{Rgb, RgbImage, Rgba, RgbaImage};

    #[test]
    fn auto_brings_the_long_side_nearest_to_800() {
        let auto = |side| Downscale::Auto.factor((side, side / 2.0));
        for (side, factor) in
            [(1.0, 1), (800.0, 1), (1100.0, 1), (1200.0, 2), (1920.0, 2), (4032.0, 5), (1e6, 64)]
        {
            assert_eq!(auto(side), factor, "{side}");
        }
        assert_eq!(Downscale::By(3).factor((10.0, 10.0)), 3);
        assert_eq!(("auto".parse(), "4".parse()), (Ok(Downscale::Auto), Ok(Downscale::By(4))));
        assert!(["0", "65", "-1", "2.5", ""].iter().all(|s| s.parse::<Downscale>().is_err()));
    }

    #[test]
    fn a_pixel_is_the_mean_over_its_area() {
        let image = RgbImage::from_fn(5, 4, |x, y| Rgb([(10 * x) as u8, (40 * y) as u8, 7]));
        let small = shrunk(image.clone().into(), 2, 2);
        // Each new pixel covers 2.5 columns: (0 + 10 + 0.5 · 20) / 2.5 = 8, (0.5 · 20 + 30 + 40) / 2.5 = 32.
        let expected = [[8, 20, 7, 255], [32, 20, 7, 255], [8, 100, 7, 255], [32, 100, 7, 255]];
        assert_eq!((small.width, small.height, small.pixels), (2, 2, expected.to_vec()));
        let same = shrunk(image.into(), 9, 9);
        assert_eq!((same.width, same.height, same.pixels[6]), (5, 4, [10, 40, 7, 255]));
    }

    #[test]
    fn what_is_transparent_has_no_colour_to_give() {
        let image = RgbaImage::from_fn(4, 1, |x, _| {
            Rgba([if x < 2 { 200 } else { 9 }, 0, 0, [255, 0, 0, 0][x as usize]])
        });
        let small = shrunk(image.into(), 2, 1);
        assert_eq!(small.pixels, [[200, 0, 0, 128], [0, 0, 0, 0]]);
    }

    #[test]
    fn a_masked_pixel_masks_all_that_it_is_part_of() {
        let kept: Vec<bool> = (0..15).map(|i| i != 2).collect();
        assert_eq!(shrunk_mask(&kept, (5, 3), (2, 3)), [false, false, true, true, true, true]);
        assert_eq!(shrunk_mask(&kept, (5, 3), (5, 3)), kept);
        assert_eq!(shrunk_mask(&[true, false], (2, 1), (4, 2)), [true, true, false, false].repeat(2));
    }
}
