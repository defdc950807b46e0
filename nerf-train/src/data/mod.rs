//! Posed pictures, read from the common layouts of data sets.
//!
//! Each layout has a reader in a file of its own, which converts to the project's conventions: `fx fy cx cy` in pixels,
//! pixel centres at +0.5, straight alpha, and camera-to-world poses that look down −Z with +Y up.
//!
//! | path | reader | convention of the file |
//! | --- | --- | --- |
//! | `*.npz` with `images_train`, `c2ws_train`, `focal` | [`Format::Cs180`] | OpenCV |
//! | `*.npz` with `images`, `poses`, `focal` | [`Format::TinyNerf`] | OpenGL |
//! | a folder (or file of it) with `transforms_train.json` | [`Format::Blender`] | OpenGL |
//! | a folder with `transforms.json`, or any other `.json` | [`Format::Nerfstudio`] | OpenGL |
//! | a folder with a COLMAP reconstruction in `sparse/0`, `sparse/1`…, `sparse` or itself | [`Format::Colmap`] | OpenCV, world to camera |
//! | a folder with `poses_bounds.npy` | [`Format::Llff`] | columns down, right, backward |
//!
//! If several layouts fit a folder, [`ReadOptions::layout`] chooses one. Without a choice, the first layout that fits
//! is read, in the order transforms, COLMAP, LLFF. Coordinates are the file's own, unless the cameras are far from the
//! origin: then the origin is moved near them ([`Dataset::origin`]).

pub mod cameras;
pub mod demo;
mod error;
pub(crate) mod layouts;
pub mod names;
pub mod pictures;
pub mod poses;
pub mod report;
mod view;
mod watch;

pub use error::DatasetError;

pub use cameras::geometry::{LookAt, SceneBounds, frusta_box, scene_bounds};
pub use cameras::origin::origin_in_name;
pub use cameras::refined::{self, RefinedPoses};
pub use layouts::choice::Layout;
pub use layouts::files::{files, reads_data};
pub use pictures::scale::Downscale;
pub use report::Report;
pub use view::{Background, KeyPoint, View, is_blank, mean_colour, over};
pub use watch::Watch;

use crate::data::layouts::{blender, choice, cs180, nerfstudio, npz};
use cameras::origin::{STATED, origin};
use glam::DVec3;
use nerf_core::camera::{Camera, Pose};
use nerf_core::space::BoundsError;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Posed pictures of one scene, by split, in the project's conventions.
#[derive(Clone, Debug)]
pub struct Dataset {
    /// Name of the scene: the file's or folder's name.
    pub name: String,
    pub format: Format,
    /// Pose convention of the file. All poses in this struct have been converted to OpenGL's convention.
    pub axes: Axes,
    /// Training views; at least one, unless the data were read to evaluate a field ([`ReadOptions::to_measure`]).
    pub train: Vec<View>,
    /// Validation views, on which the fit is evaluated as it runs; may be empty.
    pub val: Vec<View>,
    /// Test views, on which the result is evaluated; may be empty.
    pub test: Vec<View>,
    /// Cameras without pictures, such as `c2ws_test`: a path to render.
    pub test_path: Vec<Camera>,
    /// Distance at which rays begin, world units along the ray; `None` if neither file nor caller states it.
    pub near: Option<f32>,
    /// Distance at which rays end, world units along the ray; `None` if neither file nor caller states it.
    pub far: Option<f32>,
    pub background: Background,
    /// Sparse points of a reconstruction, which lie on surfaces; may be empty.
    pub points: Vec<SparsePoint>,
    /// Origin of all coordinates, in the file's world: (0, 0, 0) unless the cameras are far from the file's origin.
    pub origin: [f64; 3],
    pub notes: Vec<String>,
    /// Problems found in the data set or the options that did not prevent reading, one sentence each.
    pub warnings: Vec<String>,
}

/// A point of a structure-from-motion reconstruction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SparsePoint {
    pub position: [f32; 3],
    /// Mean reprojection error, pixels of the unreduced photographs.
    pub error: f32,
    /// Number of photographs that show the point, at least 1.
    pub track: u32,
}

impl Dataset {
    /// Returns a data set without views.
    pub fn empty(name: String, format: Format, axes: Axes) -> Self {
        Self {
            name,
            format,
            axes,
            train: Vec::new(),
            val: Vec::new(),
            test: Vec::new(),
            test_path: Vec::new(),
            near: None,
            far: None,
            background: Background::Unknown,
            points: Vec::new(),
            origin: [0.0; 3],
            notes: Vec::new(),
            warnings: Vec::new(),
        }
    }

    /// Moves the test views to `val` if there are no validation views; returns whether views were moved. Results on the
    /// moved views are still test results, because a fit makes no choice that depends on validation results.
    pub fn validate_on_test(&mut self) -> bool {
        let instead = self.val.is_empty() && !self.test.is_empty();
        if instead {
            self.val = std::mem::take(&mut self.test);
        }
        instead
    }

    /// Removes the photographs with these `names` from all splits. Fails, without a change, if no photograph has one of
    /// the names, or if no training photograph would be left.
    pub fn leave_out(&mut self, names: &BTreeSet<&str>) -> Result<(), DatasetError> {
        let fault = |expected: &str, found: &str| {
            Err(DatasetError::value(Path::new(&self.name), "names to leave out", expected, found))
        };
        let views = || [&self.train, &self.val, &self.test].into_iter().flatten();
        if let Some(unknown) = names.iter().find(|name| !views().any(|view| view.name == **name)) {
            return fault("names of photographs", unknown);
        }
        let is_left_out = |view: &View| names.contains(&*view.name);
        if !self.train.is_empty() && self.train.iter().all(is_left_out) {
            return fault("some training photographs to be left", "the names of all");
        }
        for views in [&mut self.train, &mut self.val, &mut self.test] {
            views.retain(|view| !is_left_out(view));
        }
        Ok(())
    }

    /// Records `origin` in [`Self::origin`], in the name and in a note. All coordinates must be relative to `origin`
    /// already. An origin of 0 changes nothing.
    pub(crate) fn counted_from(mut self, origin: DVec3) -> Self {
        if origin == DVec3::ZERO {
            return self;
        }
        let DVec3 { x, y, z } = origin;
        self.name = format!("{}{STATED}{x}, {y}, {z})", self.name);
        self.notes.push(format!(
            "the cameras are far from the origin: all coordinates here, and those of a blob, count from ({x}, {y}, {z}) in \
             the file's world; distances are the file's own"
        ));
        self.origin = origin.into();
        self
    }

    /// Returns all cameras that have a picture: training, validation, test.
    pub fn cameras(&self) -> impl Iterator<Item = &Camera> {
        [&self.train, &self.val, &self.test].into_iter().flatten().map(|view| &view.camera)
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Format {
    Cs180,
    /// `tiny_nerf_data.npz` of the original NeRF notebook.
    TinyNerf,
    /// `transforms_{train,val,test}.json`, as in NeRF-synthetic.
    Blender,
    /// `transforms.json`, as nerfstudio and instant-ngp write it.
    Nerfstudio,
    Colmap,
    /// `poses_bounds.npy` of LLFF.
    Llff,
    Demo,
}

impl std::fmt::Display for Format {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Cs180 => "CS180 npz",
            Self::TinyNerf => "tiny_nerf npz",
            Self::Blender => "Blender transforms",
            Self::Nerfstudio => "nerfstudio transforms",
            Self::Colmap => "COLMAP model",
            Self::Llff => "LLFF poses_bounds",
            Self::Demo => "demo scene",
        })
    }
}

/// Viewing direction and up direction of the cameras in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Axes {
    /// Cameras look down −Z, with +Y up.
    Opengl,
    /// Cameras look down +Z, with +Y down.
    Opencv,
}

impl Axes {
    pub fn other(self) -> Self {
        match self {
            Self::Opengl => Self::Opencv,
            Self::Opencv => Self::Opengl,
        }
    }

    /// Converts a pose from this convention to the project's (OpenGL). The conversion is its own inverse.
    pub fn to_opengl(self, pose: Pose) -> Pose {
        let mut pose = pose;
        if self == Self::Opencv {
            pose.rotation.y_axis = -pose.rotation.y_axis;
            pose.rotation.z_axis = -pose.rotation.z_axis;
        }
        pose
    }
}

impl std::fmt::Display for Axes {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Opengl => "opengl",
            Self::Opencv => "opencv",
        })
    }
}

impl std::str::FromStr for Axes {
    type Err = String;

    fn from_str(s: &str) -> Result<Self, String> {
        match s.to_ascii_lowercase().as_str() {
            "opengl" => Ok(Self::Opengl),
            "opencv" => Ok(Self::Opencv),
            _ => Err(format!("axes: expected opengl or opencv, found {s:?}")),
        }
    }
}

/// Choice between the cameras (sets of intrinsics) of a COLMAP reconstruction and one camera per device (`--cameras`).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Cameras {
    /// One camera for each device. If the reconstruction has one camera per photograph, the cameras of each device are
    /// merged, and bundle adjustment is repeated.
    #[default]
    Shared,
    /// The cameras of the reconstruction, unchanged.
    Own,
}

impl std::str::FromStr for Cameras {
    type Err = String;

    fn from_str(s: &str) -> Result<Self, String> {
        match s {
            "shared" => Ok(Self::Shared),
            "own" => Ok(Self::Own),
            _ => Err(format!("expected shared or own, found {s:?}")),
        }
    }
}

/// Suffix of the name of a data set with shared cameras (one camera for each device).
const SHARED: &str = ", shared cameras";

/// Returns the choice of cameras with which a scene was trained. `name`: the data set's name in the `.nerf` blob.
pub fn cameras_in_name(name: &str) -> Cameras {
    let shared = name.ends_with(SHARED) || name.contains(&format!("{SHARED}{STATED}"));
    if shared { Cameras::Shared } else { Cameras::Own }
}

/// Options for reading a data set, which override what its files state.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ReadOptions {
    /// Pose convention (`--axes`) that replaces the usual one of the layout.
    pub axes: Option<Axes>,
    /// Distance at which rays begin, world units; overrides the data set's.
    pub near: Option<f32>,
    /// Distance at which rays end, world units; overrides the data set's.
    pub far: Option<f32>,
    /// Size limit of an unpacked array of an archive, bytes, against zip bombs; `None`: 4 GiB.
    pub max_array_bytes: Option<u64>,
    /// Whether pictures outside of the data set's folder are read (`--outside-files`). A path or a link may lead to
    /// such pictures.
    pub outside_files: bool,
    /// Layout to read if several layouts fit a folder (`--layout`); `None`: the first that fits.
    pub layout: Option<Layout>,
    /// Factor by which photographs are reduced (`--downscale`). [`Downscale::Auto`] does not reduce Blender pictures.
    pub downscale: Downscale,
    /// Index, 0 to 7, of the validation view in each group of eight; the views are first sorted by name. Unused if the
    /// data set states splits.
    pub hold_offset: usize,
    pub cameras: Cameras,
    /// File that stores shared cameras. The file is read if it was made from the same reconstruction. Otherwise it is
    /// written, unless `to_measure` is true. `None`: shared cameras are not stored.
    pub shared_cameras: Option<PathBuf>,
    /// Origin of all coordinates, in the world of the data set's files ([`Dataset::origin`]); to evaluate a `.nerf`
    /// blob, the blob's origin. `None`: the files' origin or, if the cameras are far from it, a point near the cameras.
    pub origin: Option<[f64; 3]>,
    /// Whether the data are read to evaluate an existing field. Training views are then optional.
    pub to_measure: bool,
}

impl ReadOptions {
    /// Returns `origin` if given, else the origin chosen from the positions `cameras`.
    pub(crate) fn origin_for(&self, cameras: impl IntoIterator<Item = [f64; 3]>) -> DVec3 {
        self.origin.map_or_else(|| origin(cameras), DVec3::from)
    }
}

/// Reads the data set at `path`: a folder, a `transforms*.json` or a `.npz`. A json may name pictures that do not
/// exist, if at least one training view exists. With [`ReadOptions::to_measure`], one view of any split is enough.
pub fn read(path: &Path, options: &ReadOptions) -> Result<Dataset, DatasetError> {
    read_watched(path, options, &Watch::default())
}

/// Reads a data set as [`read`] does, and counts the pictures in `watch`, so that another thread can show the progress.
pub fn read_watched(path: &Path, options: &ReadOptions, watch: &Watch) -> Result<Dataset, DatasetError> {
    check_range(options.near, options.far)?;
    let kind = std::fs::metadata(path).map_err(|source| DatasetError::io(path, source))?;
    let mut dataset = if kind.is_dir() {
        choice::read(path, options, watch)?
    } else if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("json")) {
        read_json(path, options, watch)?
    } else {
        read_npz(path, options)?
    };
    let read = [&dataset.train, &dataset.val, &dataset.test];
    let Some(first) =
        read.into_iter().take(if options.to_measure { 3 } else { 1 }).find(|views| !views.is_empty())
    else {
        let warnings: String = dataset.warnings.iter().map(|warning| format!("; {warning}")).collect();
        let fault = format!("expected at least one training view, found none{warnings}");
        return Err(DatasetError::fault(path, fault));
    };
    let background = Background::of(first);
    dataset.near = options.near.or(dataset.near);
    dataset.far = options.far.or(dataset.far);
    if check_range(dataset.near, dataset.far).is_err() {
        let shown = |t: Option<f32>| t.map_or_else(|| "none".into(), |t| t.to_string());
        let found = format!("near {}, far {}", shown(dataset.near), shown(dataset.far));
        return Err(DatasetError::value(path, "near, far", "0 <= near < far, both finite", found));
    }
    let archive = matches!(dataset.format, Format::Cs180 | Format::TinyNerf);
    if archive && !matches!(options.downscale, Downscale::Auto | Downscale::By(1)) {
        dataset
            .warnings
            .push("--downscale changes nothing: the pictures of an .npz are read as they are".into());
    }
    dataset.background = background;
    cameras::geometry::set_near(&mut dataset);
    Ok(dataset)
}

fn read_json(path: &Path, options: &ReadOptions, watch: &Watch) -> Result<Dataset, DatasetError> {
    let folder = path.parent().unwrap_or(Path::new(""));
    let name = path.file_name().and_then(|n| n.to_str()).unwrap_or_default();
    if blender::SPLITS.contains(&name) && (folder.join(blender::TRAIN).is_file() || options.to_measure) {
        return blender::read(folder, options, watch);
    }
    nerfstudio::read(path, options, watch)
}

fn read_npz(path: &Path, options: &ReadOptions) -> Result<Dataset, DatasetError> {
    let mut archive = npz::Archive::open(path, options.max_array_bytes)?;
    if archive.has("images") && archive.has("poses") && !archive.has("images_train") {
        cs180::read_tiny_nerf(&mut archive, options)
    } else {
        cs180::read(&mut archive, options)
    }
}

fn check_range(near: Option<f32>, far: Option<f32>) -> Result<(), DatasetError> {
    let (low, high) = (near.unwrap_or(0.0), far.unwrap_or(f32::MAX));
    if low >= 0.0 && low < high && high.is_finite() {
        Ok(())
    } else {
        Err(DatasetError::Range(BoundsError::Range { near: low, far: high }))
    }
}

/// Returns the name of the scene: the folder's name, or the file's stem.
fn scene_name(path: &Path) -> String {
    let path = std::path::absolute(path).unwrap_or(path.into());
    let name = if path.is_dir() { path.file_name() } else { path.file_stem() };
    name.map_or_else(|| "scene".into(), |n| n.to_string_lossy().into_owned())
}
