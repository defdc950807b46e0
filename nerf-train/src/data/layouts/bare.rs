//! A folder of photographs alone: what poses are made of.

use crate::data::DatasetError;
use crate::data::layouts::colmap::commands;
use crate::data::layouts::folders::{IMAGES, entries};
use crate::data::pictures::decode::{DecodeError, dimensions};
use crate::data::pictures::file::is_picture_name;
use std::path::{Path, PathBuf};

/// Photographs whose poses nobody knows yet.
#[derive(Debug)]
pub(crate) struct Bare {
    /// Where they are.
    pub(crate) folder: PathBuf,
    /// Their files, sorted by the bytes of their names.
    pub(crate) photographs: Vec<PathBuf>,
    /// Names of those that are no whole pictures.
    pub(crate) damaged: Vec<String>,
    /// Whether all have one size, and so probably one camera.
    pub(crate) one_size: bool,
}

impl Bare {
    /// Those of `folder`, or of `images` in it; `None` where there are none.
    ///
    /// # Errors
    /// [`DatasetError::Heif`]; where a folder or file cannot be read.
    pub(crate) fn of(folder: &Path) -> Result<Option<Self>, DatasetError> {
        let images = folder.join(IMAGES);
        let folder = if images.is_dir() { images } else { folder.to_owned() };
        let named = |path: &PathBuf| is_picture_name(path) && path.is_file();
        let mut files: Vec<PathBuf> = entries(&folder)?.into_iter().filter(named).collect();
        files.sort();
        let (mut photographs, mut damaged, mut sizes) = (Vec::new(), Vec::new(), Vec::new());
        for file in files {
            match dimensions(&file) {
                Ok(size) => {
                    photographs.push(file);
                    sizes.push(size);
                }
                Err(DecodeError::Heif { file }) => return Err(DatasetError::Heif { file }),
                Err(DecodeError::Read { file, source }) => return Err(DatasetError::io(&file, source)),
                Err(_) => damaged.push(file.file_name().unwrap_or_default().to_string_lossy().into_owned()),
            }
        }
        sizes.dedup();
        let one_size = sizes.len() == 1;
        Ok((!photographs.is_empty()).then_some(Self { folder, photographs, damaged, one_size }))
    }

    /// That `folder` has no poses of them, and how to make some beside them.
    pub(crate) fn no_poses(self, folder: &Path) -> DatasetError {
        let sparse = folder.join("sparse");
        // Not among the photographs, where COLMAP would take it for one.
        let database = sparse.join("database.db");
        let made = format!("mkdir -p {}", commands::quoted(&sparse));
        let stages = commands::stages(&self.folder, &database, &sparse, self.one_size, false);
        let commands = std::iter::once(made).chain(stages.iter().map(commands::Stage::line)).collect();
        DatasetError::NoPoses { path: folder.into(), photographs: self.photographs.len(), commands }
    }
}
