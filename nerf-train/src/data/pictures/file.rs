//! Decoding of pictures with a stated size, and search for picture files. The EXIF orientation is applied only if the
//! picture then fits the stated size.

use crate::data::DatasetError;
use crate::data::pictures::decode::{DecodeError, FORMATS, decode_of};
use image::DynamicImage;
use image::metadata::Orientation;
use std::collections::{HashMap, HashSet};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

/// File extensions of pictures, in the order in which they are tried for a file name without extension.
const ENDINGS: [&str; 8] = ["png", "jpg", "jpeg", "webp", "tif", "tiff", "bmp", "gif"];
/// File extensions of pictures that are not decoded, but refused with an error that names the file.
const REFUSED_ENDINGS: [&str; 3] = ["heic", "heif", "avif"];

pub(crate) struct Picture {
    pub(crate) width: u32,
    pub(crate) height: u32,
    pub(crate) pixels: Vec<[u8; 4]>,
    pub(crate) alpha: bool,
}

pub(crate) struct Decoded {
    pub(crate) image: DynamicImage,
    /// EXIF orientation that has not been applied to the image yet.
    orientation: Orientation,
}

/// Width and height of a picture, pixels, as stated with its pose; `None` for a side that is not stated.
pub(crate) type StatedSize = (Option<f64>, Option<f64>);

/// Decodes a picture of any bit depth and channel count; the EXIF orientation is not applied. Returns an error, without
/// decoding, if the size in the header does not fit `stated`, either as stored or turned by 90°.
pub(crate) fn decode(file: &Path, stated: StatedSize) -> Result<Decoded, DatasetError> {
    let bad =
        |found: String| DatasetError::fault(file, format!("expected a {FORMATS} picture, found {found}"));
    let wanted = |size: (u32, u32)| fits(size, stated) || fits((size.1, size.0), stated);
    let (image, orientation) = decode_of(file, wanted).map_err(|error| match error {
        DecodeError::Read { file, source } => DatasetError::io(&file, source),
        DecodeError::Damaged { found, .. } => bad(found),
        DecodeError::Size { file, found } => other_size(&file, stated, found),
        error => error.into(),
    })?;
    let (width, height) = (image.width(), image.height());
    if width == 0 || height == 0 {
        return Err(bad(format!("{width}x{height} pixels")));
    }
    Ok(Decoded { image, orientation })
}

/// Makes the error that a picture of `found` pixels does not have the `stated` size.
pub(crate) fn other_size(file: &Path, stated: StatedSize, found: (u32, u32)) -> DatasetError {
    let expected = (stated.0.unwrap_or(found.0.into()), stated.1.unwrap_or(found.1.into()));
    let fault = format!(
        "expected a picture of {}x{} pixels (or scaled evenly), as its poses (or, of a mask, its picture) say, found {}x{}",
        expected.0, expected.1, found.0, found.1
    );
    DatasetError::fault(file, fault)
}

/// Whether a picture of `found` pixels has the `stated` size, up to uniform scaling; a side that is not stated fits.
pub(crate) fn fits(found: (u32, u32), stated: StatedSize) -> bool {
    let size = (f64::from(found.0), f64::from(found.1));
    let (w, h) = (stated.0.unwrap_or(size.0), stated.1.unwrap_or(size.1));
    // Each side of a scaled picture is rounded by less than a pixel.
    (h * (size.0 / w) - size.1).abs() < 1.0 || (w * (size.1 / h) - size.0).abs() < 1.0
}

impl Decoded {
    pub(crate) fn size(&self) -> (u32, u32) {
        (self.image.width(), self.image.height())
    }

    /// Applies the EXIF orientation if the picture fits the size `stated` only when turned. Otherwise the pixels stay
    /// as stored: COLMAP, nerfstudio and instant-ngp ignore the EXIF orientation, and poses belong to the stored
    /// pixels. Returns a note that says whether the orientation was applied; `None` if the orientation changes nothing.
    /// `says`: name, in the note, of the file that states the size, such as "the json".
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

/// Finds the picture `file_path`, which may lack its extension, in `folder`; `None` if there is none.
pub(crate) fn locate(folder: &Path, file_path: &str) -> Option<PathBuf> {
    let written = folder.join(file_path.replace('\\', "/"));
    if written.is_file() {
        return Some(written);
    }
    let endings = || ENDINGS.into_iter().chain(REFUSED_ENDINGS);
    endings().map(str::to_owned).chain(endings().map(str::to_uppercase)).find_map(|extension| {
        // Appends the extension to the whole name: the `.5` of `r_0.5` is no extension.
        let mut name = written.clone().into_os_string();
        name.push(".");
        name.push(extension);
        let path = PathBuf::from(name);
        path.is_file().then_some(path)
    })
}

/// File names in folders. Each folder is listed once, so that a missing picture is not tried under every extension.
#[derive(Default)]
pub(crate) struct Listings(HashMap<PathBuf, Option<HashSet<String>>>);

impl Listings {
    pub(crate) fn locate(&mut self, folder: &Path, file_path: &str) -> Option<PathBuf> {
        let written = folder.join(file_path.replace('\\', "/"));
        // Only ASCII names are looked up: file systems differ in which other letters they treat as equal.
        if let (Some(parent), Some(name)) = (written.parent(), written.file_name())
            && let Some(name) = name.to_str().filter(|name| name.is_ascii())
        {
            let names = self.0.entry(parent.into()).or_insert_with(|| names_in(parent));
            if names.as_ref().is_some_and(|names| !names.contains(&name.to_lowercase())) {
                return None;
            }
        }
        locate(folder, file_path)
    }
}

/// Lists a folder's file names in lower case, with and without extension; `None` if unreadable, empty if missing.
fn names_in(folder: &Path) -> Option<HashSet<String>> {
    let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    let entries = match std::fs::read_dir(folder) {
        Ok(entries) => entries,
        Err(error) if matches!(error.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory) => {
            return Some(HashSet::new());
        }
        Err(_) => return None,
    };
    let mut names = HashSet::new();
    for entry in entries {
        let name = PathBuf::from(entry.ok()?.file_name());
        for name in [name.file_name(), name.file_stem()].into_iter().flatten() {
            names.insert(name.to_string_lossy().to_lowercase());
        }
    }
    Some(names)
}

/// Whether a file has the extension of a picture, also of a format that is refused when read.
pub(crate) fn is_picture_name(path: &Path) -> bool {
    let ending = path.extension().and_then(|ending| ending.to_str()).unwrap_or_default().to_ascii_lowercase();
    ENDINGS.into_iter().chain(REFUSED_ENDINGS).any(|known| known == ending)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Instant;

    #[test]
    fn a_listed_folder_has_what_is_found_by_asking() {
        let folder = tempfile::tempdir().expect("a folder");
        let at = folder.path();
        std::fs::create_dir(at.join("sub")).expect("a folder");
        for name in ["a.png", "B.JPG", "r_0.5.png", "plain", "sub/c.webp", "ä.png"] {
            std::fs::write(at.join(name), "").expect("room");
        }
        let mut listings = Listings::default();
        let (mut found, mut all) = (0, 0);
        let names = "a a.png A B B.jpg b r_0 r_0.5 plain sub sub/c sub\\c sub/../a ./a ä . .. nowhere/a a.png/b sub/ a/";
        for name in names.split(' ').chain([""]) {
            let asked = locate(at, name);
            assert_eq!(listings.locate(at, name), asked, "{name}");
            (found, all) = (found + usize::from(asked.is_some()), all + 1);
        }
        assert!(found >= 10 && found < all, "{found} of {all}");
    }

    #[test]
    fn pictures_that_are_nowhere_are_not_looked_for_one_by_one() {
        let folder = tempfile::tempdir().expect("a folder");
        let names: Vec<String> = (0..20_000).map(|i| format!("images/{i:06}")).collect();
        std::fs::create_dir(folder.path().join("images")).expect("a folder");
        let begun = Instant::now();
        assert!(names.iter().all(|name| locate(folder.path(), name).is_none()));
        let (asked, begun) = (begun.elapsed(), Instant::now());
        let mut listings = Listings::default();
        assert!(names.iter().all(|name| listings.locate(folder.path(), name).is_none()));
        let listed = begun.elapsed();
        assert!(4 * listed < asked, "{listed:?} instead of {asked:?}");
    }
}
