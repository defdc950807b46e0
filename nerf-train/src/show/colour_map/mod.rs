//! Colour maps, false-colour pictures of distances and normals, and their legends.

use super::axis;
use super::text::{self, Direction};
use crate::data::pictures::rgb::{Picture, check_length};
use anyhow::Result;

/// Colour of pixels without a value: a light grey that occurs in none of the maps.
pub const EMPTY: [f32; 3] = [0.86; 3];

/// Opacity above which a pixel shows a surface. All other pixels are drawn without a value.
const SOLID: f32 = 0.5;

/// Colour map of values from 0 to 1. Lightness rises evenly: readable in grey print, and by the colour-blind.
///
/// # Source
/// Degree-6 polynomials fitted to matplotlib's maps (van der Walt and Smith, CC0) by Matt Zucker, public domain,
/// <https://www.shadertoy.com/view/WlfXRN>; within 0.02 of the tables.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ColourMap {
    /// Violet, blue, green, yellow: for distances.
    Viridis,
    /// Black, violet, orange, pale yellow: for errors, where 0 is black.
    Magma,
}

const VIRIDIS: [[f64; 3]; 7] = [
    [0.277_727_327_223_418, 0.005_407_344_544_966_58, 0.334_099_805_335_306],
    [0.105_093_043_108_577, 1.404_613_529_898_58, 1.384_590_162_594_69],
    [-0.330_861_828_725_556, 0.214_847_559_468_213, 0.095_095_163_028_236_6],
    [-4.634_230_498_983_49, -5.799_100_973_351_59, -19.332_440_956_279_9],
    [6.228_269_936_347_08, 14.179_933_366_805_1, 56.690_552_600_681_1],
    [4.776_384_997_670_29, -13.745_145_377_746, -65.353_032_633_372_3],
    [-5.435_455_855_934_63, 4.645_852_612_178_54, 26.312_435_249_583_2],
];

const MAGMA: [[f64; 3]; 7] = [
    [-0.002_136_485_053_939_58, -0.000_749_655_052_795_221, -0.005_386_127_855_323_93],
    [0.251_660_540_737_164, 0.677_523_243_683_767, 2.494_026_599_312_35],
    [8.353_717_279_216_63, -3.577_719_514_958_48, 0.314_467_903_013_257],
    [-27.668_733_085_768_7, 14.264_730_780_965_3, -13.649_213_188_138_2],
    [52.176_139_812_340_7, -27.943_606_071_683_5, 12.944_169_442_383_9],
    [-50.768_525_364_735_9, 29.046_582_821_272_9, 4.234_152_993_845_98],
    [18.655_705_065_918_8, -11.489_773_519_977_1, -5.601_961_508_734_1],
];

impl ColourMap {
    /// Returns the colour of the value `share`, clamped to [0, 1]; NaN gives [`EMPTY`].
    pub fn colour(self, share: f32) -> [f32; 3] {
        if share.is_nan() {
            return EMPTY;
        }
        let t = f64::from(share.clamp(0.0, 1.0));
        let table = match self {
            Self::Viridis => &VIRIDIS,
            Self::Magma => &MAGMA,
        };
        let polynomial = |c: usize| table.iter().rev().fold(0.0, |sum, row| sum * t + row[c]);
        [0, 1, 2].map(|c| polynomial(c).clamp(0.0, 1.0) as f32)
    }
}

/// Returns the range for colouring `values`: their 1st to 99th percentile over pixels of `opacity` > 0.5.
///
/// `values` (any unit), `opacity`: `[n]`. Values that are not finite are ignored; `None` if none remains. If both
/// percentiles are v, as for a flat wall, the range is v ± 0.5 % of v; −0.5 to 0.5 if v is 0.
pub fn robust_range(values: &[f32], opacity: &[f32]) -> Option<(f32, f32)> {
    let solid = |&(value, opacity): &(&f32, &f32)| value.is_finite() && *opacity > SOLID;
    let mut kept: Vec<f32> = values.iter().zip(opacity).filter(solid).map(|(&value, _)| value).collect();
    kept.sort_unstable_by(f32::total_cmp);
    let last = kept.len().checked_sub(1)?;
    // Percentiles are rounded outwards: if there are few values, the range covers them all.
    let low = kept[(last as f64 * 0.01).floor() as usize];
    let high = kept[(last as f64 * 0.99).ceil() as usize];
    Some(widened(low, high))
}

/// Returns the range between two finite ends, in either order; equal ends are moved apart as in [`robust_range`].
fn widened(low: f32, high: f32) -> (f32, f32) {
    let (low, high) = if low <= high { (low, high) } else { (high, low) };
    let middle = low.abs().max(high.abs());
    if high - low > 1e-6 * middle {
        return (low, high);
    }
    let margin = if middle > 0.0 { (0.005 * middle).min(f32::MAX - middle) } else { 0.5 };
    (low - margin, high + margin)
}

/// Returns the range of a distance picture's colours: `range` if it is given and finite, otherwise [`robust_range`]. If
/// no pixel has a value, the range is 0 to 1.
fn settle_range(values: &[f32], opacity: &[f32], range: Option<(f32, f32)>) -> (f32, f32) {
    match range {
        Some((low, high)) if low.is_finite() && high.is_finite() => widened(low, high),
        _ => robust_range(values, opacity).unwrap_or((0.0, 1.0)),
    }
}

/// Draws distances in [`ColourMap::Viridis`] (near is dark), enlarged if small, with a legend on the right.
///
/// `values`, `opacity`: `[height * width]`; `values` in world units. Pixels of opacity ≤ 0.5 or without a finite value
/// are [`EMPTY`]. `range`: near and far end of the colours, world units; `None`: [`robust_range`]. All frames of an
/// animation need the same range. `title`: name and unit of the values, for example "z_depth, world units".
pub fn depth_picture_with_legend(
    values: &[f32],
    opacity: &[f32],
    (width, height): (usize, usize),
    range: Option<(f32, f32)>,
    title: &str,
) -> Result<Picture> {
    let range = settle_range(values, opacity, range);
    let picture = depth_picture(values, opacity, (width, height), range)?;
    Ok(with_legend(&picture, ColourMap::Viridis, range, title))
}

fn depth_picture(
    values: &[f32],
    opacity: &[f32],
    (width, height): (usize, usize),
    (low, high): (f32, f32),
) -> Result<Picture> {
    check_length("the distances of a picture", width, height, values.len())?;
    check_length("the opacity of a picture", width, height, opacity.len())?;
    let colour = |(&value, &opacity): (&f32, &f32)| {
        if opacity > SOLID && value.is_finite() {
            let (value, low, high) = (f64::from(value), f64::from(low), f64::from(high));
            ColourMap::Viridis.colour(((value - low) / (high - low)) as f32)
        } else {
            EMPTY
        }
    };
    Picture::new(width, height, values.iter().zip(opacity).map(colour).collect())
}

/// Draws normals: a unit normal (x, y, z) gets red (x + 1) / 2, green (y + 1) / 2 and blue (z + 1) / 2.
///
/// `normals` (unit length, world axes), `opacity`: `[height * width]`. Pixels of opacity ≤ 0.5, or whose normal is 0,
/// are [`EMPTY`].
pub fn normal_picture(normals: &[[f32; 3]], opacity: &[f32], width: usize, height: usize) -> Result<Picture> {
    check_length("the normals of a picture", width, height, normals.len())?;
    check_length("the opacity of a picture", width, height, opacity.len())?;
    let colour = |(&normal, &opacity): (&[f32; 3], &f32)| {
        if opacity > SOLID && normal != [0.0; 3] { normal.map(|x| 0.5 * x + 0.5) } else { EMPTY }
    };
    Picture::new(width, height, normals.iter().zip(opacity).map(colour).collect())
}

/// Draws a legend on the right of `picture`: a bar of the map's colours, ticks in the unit of `range`, and a vertical
/// `title`. A small `picture` is enlarged by the smallest whole factor that makes its longer side at least 256 pixels.
pub fn with_legend(picture: &Picture, map: ColourMap, range: (f32, f32), title: &str) -> Picture {
    const SIZE: f32 = 18.0;
    const MARGIN: usize = 12;
    const BAR: usize = 18;
    const INK: [f32; 3] = [0.1; 3];
    let picture = picture.enlarged_to(256);
    let line = text::line_height(SIZE);
    let (low, high) =
        if range.0.is_finite() && range.1.is_finite() { widened(range.0, range.1) } else { (0.0, 1.0) };
    let (low, high) = (f64::from(low), f64::from(high));

    // A very flat picture still gets a bar with room for its ticks and title.
    let titles = text::wrap(title, SIZE, picture.height.max(200));
    let title_length = titles.iter().map(|t| text::width(t, SIZE)).max().unwrap_or(0);
    let bar_height = picture.height.max(title_length).max(100);
    let ticks = axis::nice_ticks(low, high, (bar_height / 40).clamp(2, 8));
    let labels = axis::labels(&ticks);
    let label_width = labels.iter().map(|label| text::width(label, SIZE)).max().unwrap_or(0);

    let bar_left = MARGIN + picture.width + MARGIN;
    let title_left = bar_left + BAR + 8 + label_width + 8;
    let width = title_left + titles.len() * line + MARGIN;
    let mut page = Picture::filled(width, bar_height + 2 * MARGIN, [1.0; 3]);
    page.paste(&picture, MARGIN, MARGIN);

    for y in 0..bar_height {
        // The far end of the range is at the top of the bar.
        let share = 1.0 - y as f32 / (bar_height - 1) as f32;
        for x in 0..BAR {
            page.blend((bar_left + x) as i64, (MARGIN + y) as i64, map.colour(share), 1.0);
        }
    }
    for (tick, label) in ticks.iter().zip(&labels) {
        let share = (tick - low) / (high - low);
        let y = MARGIN as i64 + ((1.0 - share) * (bar_height - 1) as f64).round() as i64;
        for x in 0..5 {
            page.blend((bar_left + BAR + x) as i64, y, INK, 1.0);
        }
        let top = (y - line as i64 / 2).clamp(0, (bar_height + 2 * MARGIN - line) as i64);
        let corner = ((bar_left + BAR + 8) as i64, top);
        text::draw(&mut page, label, corner, SIZE, INK, Direction::Right);
    }
    for (i, title) in titles.iter().enumerate() {
        let top = MARGIN + (bar_height - text::width(title, SIZE).min(bar_height)) / 2;
        let corner = ((title_left + i * line) as i64, top as i64);
        text::draw(&mut page, title, corner, SIZE, INK, Direction::Up);
    }
    page
}

#[cfg(test)]
mod tests;
