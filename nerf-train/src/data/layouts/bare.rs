//! A folder of photographs without poses.

use crate::data::DatasetError;
use crate::data::layouts::colmap::commands::{self, RENAMED, quoted};
use crate::data::layouts::folders::{IMAGES, entries};
use crate::data::names::file_name;
use crate::data::pictures::decode::{DecodeError, dimensions};
use crate::data::pictures::exif;
use crate::data::pictures::file::is_picture_name;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

#[derive(Debug)]
pub(crate) struct Bare {
    pub(crate) folder: PathBuf,
    /// Paths of the photographs, sorted by the bytes of their names.
    pub(crate) photographs: Vec<PathBuf>,
    /// Names of files with a picture's extension whose header cannot be read.
    pub(crate) damaged: Vec<String>,
    /// Names of photographs, grouped by camera: by device (from EXIF) and picture size.
    pub(crate) cameras: Vec<Vec<String>>,
}

impl Bare {
    /// Lists the photographs in `folder`, or in its subfolder `images` if there is one; `None` without photographs.
    pub(crate) fn of(folder: &Path) -> Result<Option<Self>, DatasetError> {
        let images = folder.join(IMAGES);
        let folder = if images.is_dir() { images } else { folder.to_owned() };
        let named = |path: &PathBuf| is_picture_name(path) && path.is_file();
        let mut files: Vec<PathBuf> = entries(&folder)?.into_iter().filter(named).collect();
        files.sort();
        let (mut photographs, mut damaged) = (Vec::new(), Vec::new());
        let mut cameras: BTreeMap<_, Vec<String>> = BTreeMap::new();
        for file in files {
            let name = file_name(&file);
            match dimensions(&file) {
                Ok(size) => {
                    cameras.entry((exif::device(&file), size)).or_default().push(name);
                    photographs.push(file);
                }
                Err(error @ DecodeError::Heif { .. }) => return Err(error.into()),
                Err(DecodeError::Read { file, source }) => return Err(DatasetError::io(&file, source)),
                Err(_) => damaged.push(name),
            }
        }
        let cameras = cameras.into_values().collect();
        Ok((!photographs.is_empty()).then_some(Self { folder, photographs, damaged, cameras }))
    }

    /// Makes the error that `folder` has photographs but no poses, with advice on how to find poses.
    pub(crate) fn no_poses(self, folder: &Path) -> DatasetError {
        let sparse = folder.join("sparse");
        // The database is outside of the folder of photographs: COLMAP would take it for a photograph.
        let database = sparse.join("database.db");
        let made = format!("mkdir -p {}", quoted(&sparse));
        let stages = commands::by_hand(&self.folder, &database, &sparse, self.cameras.len() == 1);
        let commands: Vec<String> =
            std::iter::once(made).chain(stages.iter().map(commands::Stage::line)).collect();
        let fault = format!(
            "found {} photographs and no poses of them; `nerf-train poses {}` makes a folder with poses, by COLMAP. By \
             hand: {} ({RENAMED}); then fit {} again",
            self.photographs.len(),
            quoted(folder),
            commands.join(" && "),
            folder.display()
        );
        DatasetError::fault(folder, fault)
    }
}
