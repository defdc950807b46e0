//! Rules for the names of outputs.
//!
//! | command | `-o` |
//! | --- | --- |
//! | `fit`, `image fit`, `import`, `study` | [`BLOB`] |
//! | `image render` | [`PICTURE`] |
//! | `render` of one view | [`VIEW`] |
//! | `export` | `.ply`, `.obj`, `.glb`, `.npz` |
//! | `render` of a video | `.gif`, `.mp4`, or a folder of frames |
//! | `check`, `poses`, `show`, `sweep`; also `demo --out` and every `--report` | a folder |
//!
//! For every format, a name without an extension and a device such as `/dev/null` are accepted.

use crate::system::output::claims::is_device;
use anyhow::bail;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};

pub const BLOB: &[&str] = &["nerf"];
pub const PICTURE: &[&str] = &["png"];
pub const VIEW: &[&str] = &["png", "exr"];
/// File extensions that the name of a new folder must not have.
const FILES: &str = "nerf png gif mp4 jpg jpeg exr webp tif tiff bmp npz npy json csv svg html md toml safetensors ply obj glb";

/// Refuses a file name whose extension is not in `accepted`. Accepts any device, and any name without an extension.
pub fn check_extension(flag: &str, path: &Path, accepted: &[&str]) -> anyhow::Result<()> {
    match extension(path) {
        Some(found) if !accepted.contains(&found.as_str()) && !is_device(path) => {
            let accepted: Vec<String> = accepted.iter().map(|extension| format!(".{extension}")).collect();
            bail!("{flag}: expected a name that ends in {}, found {}", accepted.join(" or "), path.display())
        }
        _ => Ok(()),
    }
}

/// Refuses a folder's name that has the extension of a file, unless the folder exists.
pub fn check_folder(flag: &str, path: &Path) -> anyhow::Result<()> {
    match extension(path) {
        Some(found) if FILES.split(' ').any(|file| file == found) && !path.is_dir() => {
            bail!("{flag}: expected the name of a folder, found {}", path.display())
        }
        _ => Ok(()),
    }
}

pub fn check_report(path: Option<&PathBuf>) -> anyhow::Result<()> {
    path.map_or(Ok(()), |path| check_folder("--report", path))
}

pub fn extension(path: &Path) -> Option<String> {
    path.extension().map(OsStr::to_ascii_lowercase).map(|extension| extension.to_string_lossy().into_owned())
}
