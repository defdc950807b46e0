//! One picture file to straight 8-bit sRGB and alpha.

use crate::data::DatasetError;
use crate::data::pictures::decode::{DecodeError, decode as decode_file};
use image::{DynamicImage, metadata::Orientation};
use std::path::{Path, PathBuf};

/// Endings of pictures, in the order in which a name without one is completed.
const ENDINGS: [&str; 8] = ["png", "jpg", "jpeg", "webp", "tif", "tiff", "bmp", "gif"];
/// Endings of pictures that are not decoded, to be refused by name rather than overlooked.
const REFUSED_ENDINGS: [&str; 3] = ["heic", "heif", "avif"];

/// A picture's pixels.
pub(crate) struct Picture {
    pub(crate) width: u32,
    pub(crate) height: u32,
    pub(crate) pixels: Vec<[u8; 4]>,
    /// Whether the file has an alpha channel.
    pub(crate) alpha: bool,
}

/// A picture file, decoded.
pub(crate) struct Decoded {
    pub(crate) image: DynamicImage,
    /// What its EXIF tag says would turn it upright, where that has not been done.
    orientation: Orientation,
}

/// Width and height as far as the poses' file states them, pixels.
pub(crate) type StatedSize = (Option<f64>, Option<f64>);

/// Decodes a picture of any depth and channel count, as it is stored.
pub(crate) fn decode(file: &Path) -> Result<Decoded, DatasetError> {
    let bad = |found: String| DatasetError::Picture { file: file.into(), found };
    let (image, orientation) = decode_file(file).map_err(|error| match error {
        DecodeError::Read { file, source } => DatasetError::io(&file, source),
        DecodeError::Format { .. } => bad("another kind of file".into()),
        DecodeError::Heif { .. } => DatasetError::Heif { file: file.into() },
        DecodeError::Damaged { found, .. } => bad(found),
    })?;
    let (width, height) = (image.width(), image.height());
    if width == 0 || height == 0 || width > 65_535 || height > 65_535 {
        return Err(bad(format!("{width}x{height} pixels")));
    }
    Ok(Decoded { image, orientation })
}

/// Whether a picture of `found` pixels is one of the `stated` width and height, or that one scaled evenly.
pub(crate) fn fits(found: (u32, u32), stated: StatedSize) -> bool {
    let size = (f64::from(found.0), f64::from(found.1));
    let (w, h) = (stated.0.unwrap_or(size.0), stated.1.unwrap_or(size.1));
    // Each side of a scaled picture is rounded by less than a pixel.
    (h * (size.0 / w) - size.1).abs() < 1.0 || (w * (size.1 / h) - size.0).abs() < 1.0
}

impl Decoded {
    /// Width and height, pixels.
    pub(crate) fn size(&self) -> (u32, u32) {
        (self.image.width(), self.image.height())
    }

    /// Turns it upright as its EXIF tag says where only then it has the shape that the poses' file (`says`, such as "the
    /// json") states; what to say of the tag.
    ///
    /// Elsewhere the pixels stay as they are stored, which is how COLMAP, nerfstudio and instant-ngp read them, so that
    /// poses and principal points belong to those.
    pub(crate) fn turn_to(&mut self, stated: StatedSize, says: &str) -> Option<String> {
        if self.orientation == Orientation::NoTransforms {
            return None;
        }
        let (width, height) = self.size();
        let sideways = matches!(
            self.orientation,
            Orientation::Rotate90
                | Orientation::Rotate270
                | Orientation::Rotate90FlipH
                | Orientation::Rotate270FlipH
        );
        if sideways && !fits((width, height), stated) && fits((height, width), stated) {
            self.image.apply_orientation(self.orientation);
            self.orientation = Orientation::NoTransforms;
            return Some(format!(
                "turned as their EXIF orientation says: only so they have the size in {says}"
            ));
        }
        let why = match (sideways, stated) {
            (true, (Some(_), _) | (_, Some(_))) if width != height => {
                format!("as they are stored they have the size in {says}")
            }
            _ => format!(
                "no size in {says} tells whether the poses are of the turned pictures or, as is usual, of the stored"
            ),
        };
        Some(format!("their EXIF orientation is not applied: {why}"))
    }
}

/// The file that `file_path` means, or `None` if there is none: itself, or with an extension.
pub(crate) fn locate(folder: &Path, file_path: &str) -> Option<PathBuf> {
    let written = folder.join(file_path.replace('\\', "/"));
    if written.is_file() {
        return Some(written);
    }
    let endings = || ENDINGS.into_iter().chain(REFUSED_ENDINGS);
    endings().map(str::to_owned).chain(endings().map(str::to_uppercase)).find_map(|extension| {
        // Appended, not replaced: `r_0.5` is a name.
        let mut name = written.clone().into_os_string();
        name.push(".");
        name.push(extension);
        let path = PathBuf::from(name);
        path.is_file().then_some(path)
    })
}

/// Whether a file's name ends as those of pictures do, also of such as are refused.
pub(crate) fn is_picture_name(path: &Path) -> bool {
    let ending = path.extension().and_then(|ending| ending.to_str()).unwrap_or_default().to_ascii_lowercase();
    ENDINGS.into_iter().chain(REFUSED_ENDINGS).any(|known| known == ending)
}
