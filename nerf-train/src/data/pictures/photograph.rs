//! A photograph, read as an upright, opaque picture of three channels.

pub use crate::data::pictures::decode::MAX_SIDE;
use crate::data::pictures::decode::decode;
use crate::data::pictures::rgb::Picture;
use anyhow::bail;
use image::DynamicImage;
use image::imageops::FilterType;
use image::metadata::Orientation;
use std::path::Path;

#[derive(Clone, Debug, PartialEq)]
pub struct Photo {
    pub name: String,
    pub picture: Picture,
    /// Changes that were made to the picture after decoding, as one text for each change.
    pub notes: Vec<String>,
}

impl Photo {
    /// Reads a picture of any bit depth and channel count, turned upright as its EXIF tag says, composited over
    /// `background` (display-encoded). Width and height are multiplied by `scale`, which is above 0 and at most 1.
    pub fn read(file: &Path, background: [f32; 3], scale: f64) -> anyhow::Result<Self> {
        if !(scale > 0.0 && scale <= 1.0) {
            bail!("--scale: expected a number above 0 and at most 1, found {scale}");
        }
        let (mut image, orientation) = decode(file)?;
        let mut notes = Vec::new();
        if orientation != Orientation::NoTransforms {
            image.apply_orientation(orientation);
            notes.push("turned as its EXIF orientation says".to_owned());
        }
        let (width, height) = (image.width(), image.height());
        if !(1..=MAX_SIDE).contains(&width) || !(1..=MAX_SIDE).contains(&height) {
            bail!("{}: expected 1 to {MAX_SIDE} pixels a side, found {width}x{height}", file.display());
        }
        let mut image = composited(image, background, &mut notes);
        if scale < 1.0 {
            let side = |side: u32| ((f64::from(side) * scale).round() as u32).max(1);
            // The triangle filter widens with the reduction: every source pixel contributes, and edges do not ring.
            image = image.resize_exact(side(width), side(height), FilterType::Triangle);
            notes.push(format!("reduced from {width}x{height} pixels"));
        }
        let rgb = image.into_rgb32f();
        let picture = Picture {
            width: rgb.width() as usize,
            height: rgb.height() as usize,
            rgb: rgb.pixels().map(|pixel| pixel.0.map(|c| c.clamp(0.0, 1.0))).collect(),
        };
        let name = file.file_name().unwrap_or(file.as_os_str()).to_string_lossy().into_owned();
        Ok(Self { name, picture, notes })
    }

    pub fn fingerprint(&self) -> u64 {
        const CRC: crc::Crc<u64> = crc::Crc::<u64>::new(&crc::CRC_64_XZ);
        let mut digest = CRC.digest();
        digest.update(&(self.picture.width as u64).to_le_bytes());
        self.picture.rgb.as_flattened().iter().for_each(|c| digest.update(&c.to_le_bytes()));
        digest.finalize()
    }

    pub fn size(&self) -> [u32; 2] {
        // Lossless: `read` limits both sides to `MAX_SIDE`.
        [self.picture.width as u32, self.picture.height as u32]
    }
}

fn composited(image: DynamicImage, background: [f32; 3], notes: &mut Vec<String>) -> DynamicImage {
    if !image.color().has_alpha() {
        return DynamicImage::ImageRgb32F(image.into_rgb32f());
    }
    let rgba = image.into_rgba32f();
    if rgba.pixels().any(|pixel| pixel.0[3] < 1.0) {
        notes.push("its transparent parts were composited over the background".to_owned());
    }
    let (width, height) = rgba.dimensions();
    DynamicImage::ImageRgb32F(image::ImageBuffer::from_fn(width, height, |x, y| {
        let [r, g, b, a] = rgba.get_pixel(x, y).0;
        let over = |c: f32, behind: f32| a * c + (1.0 - a) * behind;
        image::Rgb([over(r, background[0]), over(g, background[1]), over(b, background[2])])
    }))
}
