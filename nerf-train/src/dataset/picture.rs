//! One picture file to straight 8-bit sRGB and alpha.

use super::DatasetError;
use crate::decode::{DecodeError, decode as decode_file};
use std::path::{Path, PathBuf};

/// A decoded picture.
pub(super) struct Picture {
    pub(super) width: u32,
    pub(super) height: u32,
    pub(super) pixels: Vec<[u8; 4]>,
}

/// Decodes a picture of any depth and channel count; 16 bits round to 8.
pub(super) fn decode(file: &Path) -> Result<Picture, DatasetError> {
    let bad = |found: String| DatasetError::Picture { file: file.into(), found };
    // Poses belong to the pixels as they are stored, so they are not turned.
    let (picture, _) = decode_file(file).map_err(|error| match error {
        DecodeError::Read { file, source } => DatasetError::io(&file, source),
        DecodeError::Format { .. } => bad("another kind of file".into()),
        DecodeError::Damaged { found, .. } => bad(found),
    })?;
    let picture = picture.into_rgba8();
    let (width, height) = picture.dimensions();
    if width == 0 || height == 0 || width > 65_535 || height > 65_535 {
        return Err(bad(format!("{width}x{height} pixels")));
    }
    Ok(Picture { width, height, pixels: picture.pixels().map(|pixel| pixel.0).collect() })
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
