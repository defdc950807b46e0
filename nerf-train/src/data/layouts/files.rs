//! Files that belong to a data set, found without reading its pictures.

use crate::data::layouts::folders::entries;
use crate::data::layouts::{blender, colmap, llff, nerfstudio};
use crate::data::names::file_name;
use crate::data::pictures::file::{self, Listings};
use crate::system::output::claims::Claims;
use serde::Deserialize;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

/// Maximum number of bytes that are read from a list of views to find file names.
const MAX_LIST_BYTES: u64 = 256 << 20;

#[derive(Deserialize)]
struct List {
    frames: Vec<Frame>,
}

#[derive(Deserialize)]
struct Frame {
    file_path: Option<String>,
    mask_path: Option<String>,
    depth_file_path: Option<String>,
}

/// Adds the files of the data set at `path`, if any, to `claims`, as inputs that must not be overwritten.
pub fn reads_data<'p, P: AsRef<Path> + ?Sized + 'p>(
    claims: Claims,
    path: impl Into<Option<&'p P>>,
) -> Claims {
    let Some(path) = path.into().map(P::as_ref) else { return claims };
    let claims = claims.reads("the data set", path);
    files(path).iter().fold(claims, |claims, file| claims.reads("a file of the data set,", file))
}

/// Finds the existing files of the data set at `path`: lists of views, files named in these lists, and a folder's
/// photographs. A damaged list is treated as empty; reading the data set reports the damage.
pub fn files(path: &Path) -> Vec<PathBuf> {
    let folder = if path.is_dir() { path } else { path.parent().unwrap_or(Path::new("")) };
    let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
    let lists: Vec<PathBuf> = if path.is_dir() || blender::SPLITS.contains(&name) {
        let names = blender::SPLITS.into_iter().chain([nerfstudio::FILE]);
        names.map(|name| folder.join(name)).chain([path.to_owned()]).filter(|list| list.is_file()).collect()
    } else {
        vec![path.to_owned()]
    };
    let named = lists.iter().filter(|list| list.extension().is_some_and(|e| e.eq_ignore_ascii_case("json")));
    let named: Vec<PathBuf> = named.flat_map(|list| named_in(list, folder)).collect();
    let whole = if path.is_dir() { photographs(folder) } else { Vec::new() };
    lists.into_iter().chain(named).chain(whole).collect()
}

/// Finds COLMAP and LLFF files, photographs and masks in `folder`; empty if there is no COLMAP or LLFF file.
fn photographs(folder: &Path) -> Vec<PathBuf> {
    let poses = folder.join(llff::FILE);
    let mut files = colmap::files(folder);
    files.extend(poses.is_file().then_some(poses));
    if files.is_empty() {
        return files;
    }
    let of_pictures = |path: &PathBuf| {
        let name = file_name(path);
        path.is_dir() && (name == "masks" || name.starts_with("images")) || file::is_picture_name(path)
    };
    let mut open: Vec<PathBuf> =
        entries(folder).unwrap_or_default().into_iter().filter(of_pictures).collect();
    // Links are not followed: a link to a parent folder would make an endless loop.
    while let Some(path) = open.pop() {
        if path.is_symlink() || !path.is_dir() {
            files.push(path);
        } else {
            open.extend(entries(&path).unwrap_or_default());
        }
    }
    files
}

fn named_in(list: &Path, folder: &Path) -> Vec<PathBuf> {
    let mut bytes = Vec::new();
    // A pipe is not read: the later reader of the data set would find it empty.
    let read = list.is_file().then(|| File::open(list)?.take(MAX_LIST_BYTES).read_to_end(&mut bytes));
    if !matches!(read, Some(Ok(_))) {
        return Vec::new();
    }
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&bytes);
    let Ok(List { frames }) = serde_json::from_slice(bytes) else { return Vec::new() };
    let mut listings = Listings::default();
    let of = |frame: Frame| {
        let others =
            [frame.mask_path, frame.depth_file_path].into_iter().flatten().map(|name| folder.join(name));
        let picture = frame.file_path.and_then(|name| listings.locate(folder, &name));
        picture.into_iter().chain(others.filter(|path| path.is_file()))
    };
    frames.into_iter().flat_map(of).collect()
}
