//! Folders of smaller copies: `images_N` beside `images`.

use std::path::{Path, PathBuf};

/// The copy, `factor` times smaller, of a picture that a json names by its path from `root`: out of `images_4` for
/// `images/a.jpg` and 4.
pub(super) fn smaller_copy(root: &Path, file_path: &str, factor: u32) -> Option<PathBuf> {
    let path = file_path.replace('\\', "/");
    let (folder, rest) = path.trim_start_matches("./").split_once('/')?;
    let copy = root.join(format!("{folder}_{factor}")).join(rest);
    if copy.is_file() { Some(copy) } else { with_other_ending(&copy) }
}

/// The picture of this name but for its ending: smaller copies are often PNG where the photographs are JPEG.
fn with_other_ending(path: &Path) -> Option<PathBuf> {
    let endings = ["png", "jpg", "jpeg", "JPG", "PNG"];
    endings.into_iter().map(|ending| path.with_extension(ending)).find(|path| path.is_file())
}
