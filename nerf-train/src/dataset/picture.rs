//! One picture file to straight 8-bit sRGB and alpha.

use super::DatasetError;
use crate::decode::{DecodeError, decode as decode_file};
use image::{DynamicImage, RgbaImage, metadata::Orientation};
use std::path::{Path, PathBuf};

/// A decoded picture.
pub(super) struct Picture {
    pub(super) width: u32,
    pub(super) height: u32,
    pub(super) pixels: Vec<[u8; 4]>,
    /// Whether the file has an alpha channel.
    pub(super) alpha: bool,
    /// What its EXIF tag says would turn it upright, where that has not been done.
    orientation: Orientation,
}

/// Decodes a picture of any depth and channel count, as it is stored; 16 bits round to 8.
pub(super) fn decode(file: &Path) -> Result<Picture, DatasetError> {
    let bad = |found: String| DatasetError::Picture { file: file.into(), found };
    let (picture, orientation) = decode_file(file).map_err(|error| match error {
        DecodeError::Read { file, source } => DatasetError::io(&file, source),
        DecodeError::Format { .. } => bad("another kind of file".into()),
        DecodeError::Damaged { found, .. } => bad(found),
    })?;
    let alpha = picture.color().has_alpha();
    let picture = picture.into_rgba8();
    let (width, height) = picture.dimensions();
    if width == 0 || height == 0 || width > 65_535 || height > 65_535 {
        return Err(bad(format!("{width}x{height} pixels")));
    }
    let pixels = picture.pixels().map(|pixel| pixel.0).collect();
    Ok(Picture { width, height, pixels, alpha, orientation })
}

/// Whether a picture of `found` pixels is one of the `stated` width and height, or that one scaled evenly.
pub(super) fn fits(found: (u32, u32), stated: (Option<f64>, Option<f64>)) -> bool {
    let size = (f64::from(found.0), f64::from(found.1));
    let (w, h) = (stated.0.unwrap_or(size.0), stated.1.unwrap_or(size.1));
    // Each side of a scaled picture is rounded by less than a pixel.
    (h * (size.0 / w) - size.1).abs() < 1.0 || (w * (size.1 / h) - size.0).abs() < 1.0
}

impl Picture {
    /// Turns it upright as its EXIF tag says where only then it has the shape that the poses' file states; what to say
    /// of the tag.
    ///
    /// Elsewhere the pixels stay as they are stored, which is how COLMAP, nerfstudio and instant-ngp read them, so that
    /// poses and principal points belong to those.
    pub(super) fn turn_to(&mut self, stated: (Option<f64>, Option<f64>)) -> Option<String> {
        if self.orientation == Orientation::NoTransforms {
            return None;
        }
        let (width, height) = (self.width, self.height);
        let sideways = matches!(
            self.orientation,
            Orientation::Rotate90
                | Orientation::Rotate270
                | Orientation::Rotate90FlipH
                | Orientation::Rotate270FlipH
        );
        if sideways && !fits((width, height), stated) && fits((height, width), stated) {
            self.turn();
            return Some(
                "turned as their EXIF orientation says: only so they have the size in the json".into(),
            );
        }
        let why = match (sideways, stated) {
            (true, (Some(_), _) | (_, Some(_))) if width != height => {
                "as they are stored they have the size in the json"
            }
            _ => {
                "no size in the json tells whether the poses are of the turned pictures or, as is usual, of the stored"
            }
        };
        Some(format!("their EXIF orientation is not applied: {why}"))
    }

    fn turn(&mut self) {
        let pixels = std::mem::take(&mut self.pixels).into_flattened();
        // As many pixels as its sides say.
        let Some(picture) = RgbaImage::from_raw(self.width, self.height, pixels) else { return };
        let mut picture = DynamicImage::ImageRgba8(picture);
        picture.apply_orientation(self.orientation);
        let picture = picture.into_rgba8();
        (self.width, self.height) = picture.dimensions();
        self.pixels = picture.pixels().map(|pixel| pixel.0).collect();
        self.orientation = Orientation::NoTransforms;
    }
}

/// The file that `file_path` means, or `None` if there is none: itself, or with an extension.
pub(super) fn locate(folder: &Path, file_path: &str) -> Option<PathBuf> {
    let written = folder.join(file_path.replace('\\', "/"));
    if written.is_file() {
        return Some(written);
    }
    ["png", "jpg", "jpeg", "PNG", "JPG", "JPEG"].into_iter().find_map(|extension| {
        // Appended, not replaced: `r_0.5` is a name.
        let mut name = written.clone().into_os_string();
        name.push(".");
        name.push(extension);
        let path = PathBuf::from(name);
        path.is_file().then_some(path)
    })
}
