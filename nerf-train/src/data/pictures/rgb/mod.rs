//! Pictures in memory and as PNG files.

use crate::system::output::mark::MARK;
use crate::system::output::write_atomic;
use anyhow::{Context, anyhow, ensure};
use png::{BitDepth, ColorType};
use std::path::Path;

/// A colour picture, display-encoded (sRGB as in the training images), row-major, top row first.
///
/// Values outside [0, 1] are clamped only where a file is written; NaN is written as 0. If `rgb` has a wrong length,
/// writers return an error, and drawing skips missing pixels.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    pub width: usize,
    pub height: usize,
    /// Display-encoded red, green and blue of each pixel, in [0, 1]: `[height * width]`.
    pub rgb: Vec<[f32; 3]>,
}

impl Picture {
    /// Makes a picture of the colours `rgb`, `[height * width]`; another length is an error.
    pub fn new(width: usize, height: usize, rgb: Vec<[f32; 3]>) -> anyhow::Result<Self> {
        check_length("a picture", width, height, rgb.len())?;
        Ok(Self { width, height, rgb })
    }

    /// Makes a picture of one colour; empty if `width * height` overflows.
    pub fn filled(width: usize, height: usize, colour: [f32; 3]) -> Self {
        match width.checked_mul(height) {
            Some(pixels) => Self { width, height, rgb: vec![colour; pixels] },
            None => Self { width: 0, height: 0, rgb: Vec::new() },
        }
    }

    pub fn pixel(&self, x: usize, y: usize) -> Option<[f32; 3]> {
        (x < self.width).then(|| self.rgb.get(y.checked_mul(self.width)?.checked_add(x)?).copied())?
    }

    /// Mixes `colour` into the pixel at column `x`, row `y`, if it exists. `share`: 0 keeps the pixel, 1 replaces it.
    pub fn blend(&mut self, x: i64, y: i64, colour: [f32; 3], share: f32) {
        let (Ok(x), Ok(y)) = (usize::try_from(x), usize::try_from(y)) else { return };
        if x >= self.width || y >= self.height {
            return;
        }
        if let Some(pixel) = self.rgb.get_mut(y * self.width + x) {
            for (old, new) in pixel.iter_mut().zip(colour) {
                *old += (new - *old) * share;
            }
        }
    }

    /// Copies `other` with its top left corner to column `x`, row `y`; parts beyond this picture's edges are cut off.
    pub fn paste(&mut self, other: &Self, x: usize, y: usize) {
        if other.width == 0 || x >= self.width {
            return;
        }
        let columns = other.width.min(self.width - x);
        let rows = other.rgb.chunks_exact(other.width).zip(y..self.height);
        for (source, target_row) in rows {
            let start = target_row * self.width + x;
            if let Some(target) = self.rgb.get_mut(start..start + columns) {
                target.copy_from_slice(&source[..columns]);
            }
        }
    }

    /// Enlarges every pixel to a square of `factor` × `factor` pixels (nearest neighbour, nothing smoothed).
    pub fn enlarged(&self, factor: usize) -> Self {
        if factor <= 1 || self.width == 0 {
            return self.clone();
        }
        let mut rgb = Vec::new();
        for row in self.rgb.chunks_exact(self.width) {
            let wide: Vec<[f32; 3]> =
                row.iter().flat_map(|&pixel| std::iter::repeat_n(pixel, factor)).collect();
            (0..factor).for_each(|_| rgb.extend_from_slice(&wide));
        }
        Self { width: self.width * factor, height: self.height * factor, rgb }
    }

    /// Enlarges the picture by the smallest whole factor that makes the longer side at least `pixels`.
    pub fn enlarged_to(&self, pixels: usize) -> Self {
        self.enlarged(pixels.div_ceil(self.width.max(self.height).max(1)))
    }

    /// [Reduces](Self::box_filtered) the picture by the smallest whole factor after which no side exceeds `pixels`.
    pub fn reduced_to(&self, pixels: usize) -> Self {
        let factor = self.width.max(self.height).div_ceil(pixels.max(1));
        if factor <= 1 {
            return self.clone();
        }
        self.box_filtered(self.width.div_ceil(factor), self.height.div_ceil(factor))
    }

    /// Reduces the picture to `width` × `height` pixels, each the mean of the display-encoded colours that it overlaps.
    pub fn box_filtered(&self, width: usize, height: usize) -> Self {
        let block =
            |i: usize, to: usize, from: usize| (i * from / to, ((i + 1) * from).div_ceil(to).min(from));
        let mut rgb = Vec::with_capacity(width * height);
        for y in 0..height {
            let (top, bottom) = block(y, height, self.height);
            for x in 0..width {
                let (left, right) = block(x, width, self.width);
                let rows =
                    (top..bottom).filter_map(|y| self.rgb.get(y * self.width + left..y * self.width + right));
                let (mut sum, mut count) = ([0.0; 3], 0.0f32);
                for pixel in rows.flatten() {
                    sum = std::array::from_fn(|c| sum[c] + pixel[c]);
                    count += 1.0;
                }
                rgb.push(sum.map(|sum| sum / count.max(1.0)));
            }
        }
        Self { width, height, rgb }
    }

    /// Reads the colours of a picture file; `None` if it cannot be read.
    pub fn read(path: impl AsRef<Path>) -> Option<Self> {
        let picture = crate::data::pictures::decode::decode(path.as_ref()).ok()?.0.into_rgb8();
        let rgb = picture.pixels().map(|pixel| pixel.0.map(|c| f32::from(c) / 255.0)).collect();
        Some(Self { width: picture.width() as usize, height: picture.height() as usize, rgb })
    }

    /// Returns the picture as `[height * width * 3]` bytes: clamped, scaled by 255, rounded half up; NaN gives 0.
    pub fn to_rgb8(&self) -> Vec<u8> {
        self.rgb.iter().flatten().map(|&value| to_u8(value)).collect()
    }

    pub fn to_png(&self) -> anyhow::Result<Vec<u8>> {
        check_length("a picture", self.width, self.height, self.rgb.len())?;
        encode_png(&self.to_rgb8(), self.width, self.height, (ColorType::Rgb, BitDepth::Eight))
    }

    /// Writes an 8-bit RGB PNG. A failed write leaves no partial file.
    pub fn write_png(&self, path: impl AsRef<Path>) -> anyhow::Result<()> {
        Ok(write_atomic(path, &self.to_png()?)?)
    }
}

/// Converts a value to a byte: clamped to [0, 1], scaled by 255, rounded half up; NaN gives 0.
pub(crate) fn to_u8(value: f32) -> u8 {
    // NaN passes through `clamp`; the cast turns it into 0.
    (value.clamp(0.0, 1.0) * 255.0 + 0.5) as u8
}

/// Converts a render over black to RGBA bytes with straight alpha, `[n * 4]`. `rgb_over_black`: display-encoded, `[n]`.
/// `opacity`: in [0, 1], `[n]`. The colour is divided by the opacity *as stored* in 8 bits, so that compositing the
/// bytes over black gives the render again to within rounding. Where the opacity rounds to 0, the pixel is transparent
/// black. Pixels beyond the shorter input are left out.
pub fn straight_rgba8(rgb_over_black: &[[f32; 3]], opacity: &[f32]) -> Vec<u8> {
    let pixel = |(rgb, &opacity): (&[f32; 3], &f32)| {
        let alpha = to_u8(opacity);
        let scale = if alpha == 0 { 0.0 } else { 255.0 / f32::from(alpha) };
        [to_u8(rgb[0] * scale), to_u8(rgb[1] * scale), to_u8(rgb[2] * scale), alpha]
    };
    rgb_over_black.iter().zip(opacity).flat_map(pixel).collect()
}

/// Writes an 8-bit RGBA PNG with [straight alpha](straight_rgba8). `rgb_over_black`, `opacity`: `[height * width]`.
pub fn write_rgba_png(
    path: impl AsRef<Path>,
    rgb_over_black: &[[f32; 3]],
    opacity: &[f32],
    width: usize,
    height: usize,
) -> anyhow::Result<()> {
    check_length("the colour of a picture", width, height, rgb_over_black.len())?;
    check_length("the opacity of a picture", width, height, opacity.len())?;
    let bytes = straight_rgba8(rgb_over_black, opacity);
    Ok(write_atomic(path, &encode_png(&bytes, width, height, (ColorType::Rgba, BitDepth::Eight))?)?)
}

/// Writes a 16-bit grey PNG. The value `range.0` is written as 0, `range.1` as 65,535. `values`: `[height * width]`, in
/// the unit of `range`, for example world units. Values are clamped and rounded half up. NaN gives 0. If the range is
/// empty, all values give 0. One grey level is (range.1 − range.0) / 65,535: store the range with the file.
pub fn write_grey16_png(
    path: impl AsRef<Path>,
    values: &[f32],
    width: usize,
    height: usize,
    range: (f32, f32),
) -> anyhow::Result<()> {
    check_length("a grey picture", width, height, values.len())?;
    let (low, span) = (f64::from(range.0), f64::from(range.1) - f64::from(range.0));
    let grey = |&value: &f32| {
        let share = (f64::from(value) - low) / span;
        let level = if span > 0.0 { share.clamp(0.0, 1.0) * 65_535.0 + 0.5 } else { 0.0 };
        (level as u16).to_be_bytes()
    };
    let bytes: Vec<u8> = values.iter().flat_map(grey).collect();
    Ok(write_atomic(path, &encode_png(&bytes, width, height, (ColorType::Grayscale, BitDepth::Sixteen))?)?)
}

/// Encodes a PNG. `bytes`: samples of the pixels, row-major, without padding; 16-bit samples are big-endian.
fn encode_png(
    bytes: &[u8],
    width: usize,
    height: usize,
    (colour, depth): (ColorType, BitDepth),
) -> anyhow::Result<Vec<u8>> {
    const LIMIT: usize = i32::MAX as usize;
    if width == 0 || height == 0 || width > LIMIT || height > LIMIT {
        return Err(wrong_size("PNG", (width, height), LIMIT));
    }
    let mut png = Vec::new();
    let mut encoder = png::Encoder::new(&mut png, width as u32, height as u32);
    encoder.set_color(colour);
    encoder.set_depth(depth);
    encoder.set_compression(png::Compression::Fast);
    encoder.set_filter(png::Filter::Adaptive);
    let encoded = encoder
        .add_text_chunk("Comment".into(), MARK.into())
        .and_then(|()| encoder.write_header()?.write_image_data(bytes));
    encoded.context("cannot make the PNG")?;
    Ok(png)
}

/// Returns an error that names `what`, unless `found` is `width * height`.
pub(crate) fn check_length(what: &str, width: usize, height: usize, found: usize) -> anyhow::Result<()> {
    let expected = width.saturating_mul(height);
    ensure!(expected == found, "{what}: {width}×{height} pixels need {expected} values, found {found}");
    Ok(())
}

/// Makes the error that `format` cannot hold a picture of this size. `limit`: largest side, pixels.
pub(crate) fn wrong_size(format: &str, (width, height): (usize, usize), limit: usize) -> anyhow::Error {
    anyhow!("{format} cannot hold a picture of {width}×{height} pixels; allowed is 1 to {limit} a side")
}

#[cfg(test)]
mod tests;
