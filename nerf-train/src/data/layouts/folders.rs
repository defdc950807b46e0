//! Folders of photographs: `images`, and `images_N` with copies N times smaller.

use crate::data::names::file_name;
use crate::data::pictures::file::is_picture_name;
use crate::data::{DatasetError, Downscale, ReadOptions, View};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

pub(crate) const IMAGES: &str = "images";
/// Usual folder of masks; COLMAP's convention is `masks/NAME.png` for `images/NAME`.
const MASKS: &str = "masks";

/// A photograph's file, and the reduction to be applied to its picture.
pub(crate) struct Located {
    pub(crate) path: PathBuf,
    /// Factor by which the size that the data set states is divided; `None`: the picture keeps the size of its file.
    pub(crate) downscale: Option<Downscale>,
    pub(crate) reduced: bool,
}

/// Folders of a data set's photographs. The key of `by_factor` is the factor by which a folder's pictures are reduced.
pub(crate) struct Folders {
    root: PathBuf,
    by_factor: BTreeMap<u32, PathBuf>,
}

impl Folders {
    /// Finds the folders `images` and `images_N` in `root`. If there are none, `root` itself is the folder.
    pub(crate) fn of(root: &Path) -> Result<Self, DatasetError> {
        let mut by_factor = BTreeMap::new();
        for path in entries(root)?.into_iter().filter(|path| path.is_dir()) {
            let name = file_name(&path);
            let factor = match name.strip_prefix(IMAGES) {
                Some("") => Some(1),
                Some(rest) => rest.strip_prefix('_').and_then(|n| n.parse().ok()).filter(|&n| n > 1),
                None => None,
            };
            if let Some(factor) = factor {
                by_factor.insert(factor, path);
            }
        }
        if by_factor.is_empty() {
            by_factor.insert(1, root.to_owned());
        }
        Ok(Self { root: root.to_owned(), by_factor })
    }

    /// Returns the folders to search, best first: path, [`Located::downscale`], and whether the folder holds reduced
    /// copies. `size`: width and height that the data set states, pixels.
    ///
    /// Folders of pictures reduced by the factor of `downscale` come first, then those of larger pictures in order of
    /// increasing size. Folders of smaller pictures come last for [`Downscale::Auto`], and are left out otherwise.
    fn candidates(&self, downscale: Downscale, size: (f64, f64)) -> Vec<(&Path, Option<Downscale>, bool)> {
        let factor = downscale.factor(size);
        let larger = self.by_factor.range(..=factor).rev();
        let smaller = self.by_factor.range(factor + 1..).filter(|_| downscale == Downscale::Auto);
        let mut candidates = Vec::new();
        for (&n, path) in larger.chain(smaller) {
            let whole = match downscale {
                Downscale::Auto => n * (f64::from(factor) / f64::from(n)).round().max(1.0) as u32,
                Downscale::By(_) => factor,
            };
            let scaled = (whole != n || n == 1).then_some(Downscale::By(whole));
            candidates.push((path.as_path(), scaled, n > 1));
        }
        candidates
    }

    /// Finds the photograph `name`, a path in an image folder, in the first [candidate folder](Self::candidates) that
    /// has it. `size`: the data set's width and height before any reduction, pixels.
    pub(crate) fn locate(&self, name: &str, downscale: Downscale, size: (f64, f64)) -> Option<Located> {
        self.candidates(downscale, size).into_iter().find_map(|(folder, downscale, reduced)| {
            let path = folder.join(name.replace('\\', "/"));
            let found =
                if path.is_file() { Some(path) } else { with_other_ending(&path).filter(|_| reduced) };
            found.map(|path| Located { path, downscale, reduced })
        })
    }

    /// Lists the pictures in the first [candidate folder](Self::candidates), sorted by the bytes of their names. Fails
    /// if there is no candidate. `size`: picture size that the data set states, pixels.
    pub(crate) fn list(
        &self,
        downscale: Downscale,
        size: (f64, f64),
    ) -> Result<Vec<(String, Located)>, DatasetError> {
        let candidates = self.candidates(downscale, size);
        let Some(&(folder, downscale, reduced)) = candidates.first() else {
            let expected = format!("one for which there are large enough pictures: {}", self.names());
            return Err(DatasetError::value(&self.root, "--downscale", expected, downscale.factor(size)));
        };
        let pictures = entries(folder)?.into_iter().filter(|path| is_picture_name(path));
        let named = pictures.map(|path| (file_name(&path), Located { path, downscale, reduced }));
        let mut pictures: Vec<(String, Located)> = named.collect();
        pictures.sort_by(|a, b| a.0.cmp(&b.0));
        Ok(pictures)
    }

    pub(crate) fn names(&self) -> String {
        let name = |path: &PathBuf| match path.strip_prefix(&self.root) {
            Ok(rest) if rest.as_os_str().is_empty() => ".".to_owned(),
            Ok(rest) => rest.display().to_string(),
            Err(_) => path.display().to_string(),
        };
        self.by_factor.values().map(name).collect::<Vec<_>>().join(", ")
    }

    /// Finds the mask of photograph `name`, if any: for `a.jpg`, the first of `a.jpg.png`, `a.png`, `a.jpg` in `masks`.
    pub(crate) fn mask(&self, name: &str) -> Option<PathBuf> {
        let folder = self.root.join(MASKS);
        let appended = folder.join(format!("{name}.png"));
        let own = folder.join(name);
        [appended, own.with_extension("png"), own].into_iter().find(|path| path.is_file())
    }
}

/// Finds the copy of `file_path` that is `factor` times smaller, if any: `images_4/a.jpg` for `images/a.jpg` and 4.
pub(crate) fn smaller_copy(root: &Path, file_path: &str, factor: u32) -> Option<PathBuf> {
    let path = file_path.replace('\\', "/");
    let (folder, rest) = path.trim_start_matches("./").split_once('/')?;
    let copy = root.join(format!("{folder}_{factor}")).join(rest);
    if copy.is_file() { Some(copy) } else { with_other_ending(&copy) }
}

/// Finds a picture that differs from `path` only in its extension: copies of JPEG photographs are often PNG.
fn with_other_ending(path: &Path) -> Option<PathBuf> {
    let endings = ["png", "jpg", "jpeg", "JPG", "PNG"];
    endings.into_iter().map(|ending| path.with_extension(ending)).find(|path| path.is_file())
}

pub(crate) fn entries(folder: &Path) -> Result<Vec<PathBuf>, DatasetError> {
    let io = |source| DatasetError::io(folder, source);
    std::fs::read_dir(folder).map_err(io)?.map(|entry| entry.map(|entry| entry.path()).map_err(io)).collect()
}

/// Interval, among views sorted by name, between two views that are held out for validation. Eight is usual.
pub(crate) const HOLD: usize = 8;

/// Sorts views by the bytes of their names, and splits them into training and validation views. Every eighth view from
/// index o = [`ReadOptions::hold_offset`] modulo 8 is for validation. With at most o + 1 views, all are for training.
pub(crate) fn every_eighth(
    mut views: Vec<View>,
    options: &ReadOptions,
    notes: &mut Vec<String>,
) -> (Vec<View>, Vec<View>) {
    views.sort_by(|a, b| a.name.cmp(&b.name));
    let offset = options.hold_offset % HOLD;
    if views.len() <= 1 + offset {
        return (views, Vec::new());
    }
    let [mut train, mut val] = [Vec::new(), Vec::new()];
    for (index, view) in views.into_iter().enumerate() {
        let split = if index % HOLD == offset { &mut val } else { &mut train };
        split.push(view);
    }
    notes.push(format!(
        "{} of {} held out: every eighth by name, from number {offset} on",
        val.len(),
        train.len() + val.len()
    ));
    (train, val)
}
