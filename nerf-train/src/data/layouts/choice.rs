//! Chooses the layout of a folder of data, and reads the folder in this layout.

use crate::data::layouts::bare::Bare;
use crate::data::layouts::{blender, colmap, llff, nerfstudio};
use crate::data::{Dataset, DatasetError, ReadOptions, Watch};
use std::path::Path;

/// Layout of a folder of data. If several layouts fit a folder, the first in the order of the variants is taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Layout {
    /// A folder with `transforms.json`, or with a Blender split file such as `transforms_train.json`.
    Transforms,
    Colmap,
    /// A folder with `poses_bounds.npy`.
    Llff,
}

impl Layout {
    const ALL: [Self; 3] = [Self::Transforms, Self::Colmap, Self::Llff];

    /// Returns the files by which a folder of this layout is recognised, as text for errors.
    fn expected(self) -> String {
        match self {
            Self::Transforms => format!("{} or {}", blender::TRAIN, nerfstudio::FILE),
            Self::Colmap => {
                "a COLMAP model (cameras and images, .bin or .txt, in sparse/0, sparse, or the folder itself)"
                    .into()
            }
            Self::Llff => llff::FILE.into(),
        }
    }

    fn fits(self, folder: &Path) -> bool {
        match self {
            Self::Transforms => blender::is_here(folder) || folder.join(nerfstudio::FILE).is_file(),
            Self::Colmap => colmap::is_here(folder),
            Self::Llff => folder.join(llff::FILE).is_file(),
        }
    }
}

impl std::fmt::Display for Layout {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Transforms => "transforms",
            Self::Colmap => "colmap",
            Self::Llff => "llff",
        })
    }
}

impl std::str::FromStr for Layout {
    type Err = String;

    fn from_str(s: &str) -> Result<Self, String> {
        let found = Self::ALL.into_iter().find(|layout| layout.to_string() == s);
        found.ok_or_else(|| format!("expected transforms, colmap or llff, found {s:?}"))
    }
}

/// Reads a folder in the requested layout. By default, reads the first layout that fits, and notes all others that fit.
pub(crate) fn read(folder: &Path, options: &ReadOptions, watch: &Watch) -> Result<Dataset, DatasetError> {
    let fitting: Vec<Layout> = Layout::ALL.into_iter().filter(|layout| layout.fits(folder)).collect();
    let wanted = options.layout.or(fitting.first().copied());
    let Some(layout) = wanted.filter(|layout| fitting.contains(layout)) else {
        let bare = if fitting.is_empty() { Bare::of(folder)? } else { None };
        if let Some(bare) = bare {
            return Err(bare.no_poses(folder));
        }
        let expected: Vec<String> = match wanted {
            Some(layout) => vec![layout.expected()],
            None => Layout::ALL.into_iter().map(Layout::expected).collect(),
        };
        let fault = format!("not a data set: expected a folder with {}", expected.join("; or "));
        return Err(DatasetError::fault(folder, fault));
    };
    let mut dataset = match layout {
        Layout::Transforms if folder.join(blender::TRAIN).is_file() => blender::read(folder, options, watch)?,
        Layout::Transforms if folder.join(nerfstudio::FILE).is_file() => {
            nerfstudio::read(&folder.join(nerfstudio::FILE), options, watch)?
        }
        // Fails if the file of training views is missing and no existing field is evaluated; the error names the file.
        Layout::Transforms => blender::read(folder, options, watch)?,
        Layout::Colmap => colmap::read(folder, options, watch)?,
        Layout::Llff => llff::read(folder, options, watch)?,
    };
    if fitting.len() > 1 && options.layout.is_none() {
        let others: Vec<String> = fitting.iter().skip(1).map(Layout::to_string).collect();
        dataset.notes.push(format!("read as {layout}; --layout {} is there, too", others.join(" or ")));
    }
    Ok(dataset)
}
