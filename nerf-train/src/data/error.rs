//! What can be wrong with a data set.

use crate::data::layouts::colmap::commands::{RENAMED, quoted};
use crate::data::pictures::decode::{FORMATS, HEIF_ADVICE};
use nerf_core::camera::{BoundsError, CameraError};
use std::path::{Path, PathBuf};

/// A data set that cannot be read: which file, which field, what was expected and found.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DatasetError {
    /// The path, or a file that must be there, does not exist.
    #[error("{}: no such file or folder", path.display())]
    Missing {
        /// What was looked for.
        path: PathBuf,
    },
    /// The operating system failed to read it.
    #[error("{}: cannot be read: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// It exists but is none of the layouts.
    #[error("{}: not a data set: expected {expected}", path.display())]
    NotADataset {
        /// The folder or file.
        path: PathBuf,
        /// What would have been one.
        expected: String,
    },
    /// Photographs without poses.
    #[error(
        "{}: found {photographs} photographs and no poses of them; `nerf-train poses {}` makes a folder with poses, by \
         COLMAP. By hand: {} ({RENAMED}); then fit {} again",
        path.display(), quoted(path), commands.join(" && "), path.display()
    )]
    NoPoses {
        /// The folder.
        path: PathBuf,
        /// How many.
        photographs: usize,
        /// The lines of shell that make poses beside them.
        commands: Vec<String>,
    },
    /// Not a zip archive, or one whose directory is damaged.
    #[error("{}: expected a whole .npz (zip) archive, found {found}", file.display())]
    NotAnArchive {
        /// The file.
        file: PathBuf,
        /// What the unpacker says.
        found: String,
    },
    /// The archive lacks an array.
    #[error("{}: expected an array named `{key}`, found only [{}]", file.display(), present.join(", "))]
    MissingKey {
        /// The archive.
        file: PathBuf,
        /// The array's name.
        key: String,
        /// The arrays it has.
        present: Vec<String>,
    },
    /// An array is damaged: its header makes no sense or its data are cut short.
    #[error("{}: array `{key}`: expected {expected}, found {found}", file.display())]
    Array {
        /// The archive.
        file: PathBuf,
        /// The array's name.
        key: String,
        /// What was expected.
        expected: String,
        /// What was found.
        found: String,
    },
    /// An array holds another type of number.
    #[error("{}: array `{key}`: expected dtype {expected}, found {found}", file.display())]
    Dtype {
        /// The archive.
        file: PathBuf,
        /// The array's name.
        key: String,
        /// The dtypes that would do.
        expected: &'static str,
        /// numpy's name of the one it has.
        found: String,
    },
    /// An array has another shape.
    #[error("{}: array `{key}`: expected shape {expected}, found {found:?}", file.display())]
    Shape {
        /// The archive.
        file: PathBuf,
        /// The array's name.
        key: String,
        /// The shape that would do.
        expected: String,
        /// The shape it has.
        found: Vec<usize>,
    },
    /// An array would unpack to more than the caller allows.
    #[error("{}: array `{key}`: expected at most {limit} bytes, found {bytes}", file.display())]
    TooLarge {
        /// The archive.
        file: PathBuf,
        /// The array's name.
        key: String,
        /// The size it declares, bytes.
        bytes: u64,
        /// `ReadOptions::max_array_bytes`.
        limit: u64,
    },
    /// A number is out of its range.
    #[error("{}: {field}: expected {expected}, found {found}", file.display())]
    Value {
        /// The file.
        file: PathBuf,
        /// Which field of it.
        field: String,
        /// The range.
        expected: String,
        /// The value.
        found: String,
    },
    /// A view's pose or intrinsics make no camera.
    #[error("{}: view `{view}`: {source}", file.display())]
    Camera {
        /// The file the camera stands in.
        file: PathBuf,
        /// The view's name.
        view: String,
        /// What is wrong with it.
        source: CameraError,
    },
    /// `near` and `far` are no range.
    #[error(transparent)]
    Range(#[from] BoundsError),
    /// A picture cannot be decoded.
    #[error("{}: expected a {FORMATS} picture, found {found}", file.display())]
    Picture {
        /// The picture.
        file: PathBuf,
        /// What the decoder says.
        found: String,
    },
    /// A picture of a kind that is not decoded here.
    #[error("{}: expected a {FORMATS} picture, found HEIF (HEIC) or AVIF; {HEIF_ADVICE}", file.display())]
    Heif {
        /// The picture.
        file: PathBuf,
    },
    /// A picture has another shape than the file of its poses says, or a mask than its picture.
    #[error(
        "{}: expected a picture of {}x{} pixels (or scaled evenly), as its poses (or, of a mask, its picture) say, \
         found {}x{}",
        file.display(), expected.0, expected.1, found.0, found.1
    )]
    PictureSize {
        /// The picture.
        file: PathBuf,
        /// Width and height that are stated, pixels.
        expected: (f64, f64),
        /// Its own width and height, pixels.
        found: (u32, u32),
    },
    /// A `file_path` that leads out of the data folder.
    #[error(
        "{}: view `{view}`: expected a picture inside of {}, found {}; --outside-files reads it all the same",
        file.display(), folder.display(), found.display()
    )]
    Outside {
        /// The file that names it.
        file: PathBuf,
        /// The view's name, which is the path there.
        view: String,
        /// The data folder, its links resolved.
        folder: PathBuf,
        /// The picture, its links resolved.
        found: PathBuf,
    },
    /// No training view is left.
    #[error("{}: expected at least one training view, found none{}", path.display(), listed(warnings))]
    Empty {
        /// The data set.
        path: PathBuf,
        /// What was skipped, and why.
        warnings: Vec<String>,
    },
    /// JSON that does not parse, or whose fields are missing or of another type.
    #[error("{}: line {line}, column {column}: {found}", file.display())]
    Json {
        /// The file.
        file: PathBuf,
        /// Line, from 1.
        line: usize,
        /// Column, from 1.
        column: usize,
        /// What the parser says.
        found: String,
    },
    /// A field that this kind of file needs is absent.
    #[error("{}: {place}: expected the field `{field}`, found no such field", file.display())]
    MissingField {
        /// The file.
        file: PathBuf,
        /// The view or the part of the file.
        place: String,
        /// The field.
        field: &'static str,
    },
    /// A camera model that this project does not have.
    #[error("{}: {place}: {field}: expected {expected}, found {found}", file.display())]
    Unsupported {
        /// The file.
        file: PathBuf,
        /// The view or the part of the file.
        place: String,
        /// The field.
        field: &'static str,
        /// What can be done.
        expected: &'static str,
        /// What it says.
        found: String,
    },
}

impl DatasetError {
    /// [`Self::Missing`] or [`Self::Io`].
    pub(crate) fn io(path: &Path, source: std::io::Error) -> Self {
        match source.kind() {
            std::io::ErrorKind::NotFound => Self::Missing { path: path.into() },
            _ => Self::Io { path: path.into(), source },
        }
    }

    pub(super) fn json(file: &Path, error: &serde_json::Error) -> Self {
        let (line, column) = (error.line(), error.column());
        let text = error.to_string();
        // serde_json ends its message with the place, which stands in front here.
        let found = text.rsplit_once(" at line ").map_or(text.as_str(), |(what, _)| what).to_owned();
        Self::Json { file: file.into(), line, column, found }
    }
}

fn listed(warnings: &[String]) -> String {
    warnings.iter().map(|w| format!("; {w}")).collect()
}
