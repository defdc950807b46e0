//! Reader of the `transforms*.json` files of Blender, nerfstudio and instant-ngp.

mod camera;

use crate::data::layouts::folders::smaller_copy;
use crate::data::names::{file_name, listed};
use crate::data::pictures::file::{self, Listings};
use crate::data::pictures::found::Found;
use crate::data::pictures::photo::{Fence, Loaded, Photo, Source};
use crate::data::{Axes, DatasetError, Downscale, ReadOptions, View, Watch};
use crate::system::input::{MAX_JSON_BYTES, read_limited, without_mark};
use camera::Place;
use glam::DVec3;
use serde::Deserialize;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// A `transforms*.json` file. `Header`, `FrameCameras` and the `shared` camera fields are each parsed from the whole
/// text: a single struct with serde's `flatten` would lose the line number of an error.
pub(crate) struct Transforms {
    pub(crate) header: Header,
    /// Frames in the file's order, each with its own camera fields.
    frames: Vec<(Frame, CameraFields)>,
    shared: CameraFields,
}

#[derive(Deserialize)]
pub(crate) struct Header {
    frames: Vec<Frame>,
    pub(crate) near: Option<f32>,
    pub(crate) far: Option<f32>,
    pub(crate) train_filenames: Option<Vec<String>>,
    pub(crate) val_filenames: Option<Vec<String>>,
    pub(crate) test_filenames: Option<Vec<String>>,
    pub(crate) aabb_scale: Option<f64>,
    pub(crate) applied_transform: Option<Vec<Vec<f64>>>,
}

#[derive(Deserialize)]
struct Frame {
    file_path: String,
    transform_matrix: Vec<Vec<f64>>,
    mask_path: Option<String>,
}

#[derive(Deserialize)]
struct FrameCameras {
    frames: Vec<CameraFields>,
}

/// Fields of a json that describe a camera, either for the whole file or for one frame.
#[derive(Deserialize)]
struct CameraFields {
    camera_model: Option<String>,
    is_fisheye: Option<bool>,
    camera_angle_x: Option<f64>,
    camera_angle_y: Option<f64>,
    fl_x: Option<f64>,
    fl_y: Option<f64>,
    cx: Option<f64>,
    cy: Option<f64>,
    w: Option<f64>,
    h: Option<f64>,
    k1: Option<f64>,
    k2: Option<f64>,
    k3: Option<f64>,
    k4: Option<f64>,
    k5: Option<f64>,
    k6: Option<f64>,
    p1: Option<f64>,
    p2: Option<f64>,
}

/// Values of `camera_model` that select polynomial distortion, or fisheye distortion if the field `is_fisheye` is true.
const MODELS: &[&str] = &["OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "PERSPECTIVE"];

/// The k4 of a polynomial lens is ignored, not refused, if it shifts the farthest corner by at most this many pixels.
const NEGLIGIBLE_SHIFT: f64 = 0.5;

impl Transforms {
    pub(crate) fn read(file: &Path) -> Result<Self, DatasetError> {
        let bytes = read_limited(file, MAX_JSON_BYTES).map_err(|source| DatasetError::io(file, source))?;
        let bytes = without_mark(&bytes);
        let json =
            |error| number_fault(file, bytes, &error).unwrap_or_else(|| DatasetError::json(file, &error));
        let mut header: Header = serde_json::from_slice(bytes).map_err(json)?;
        let cameras: FrameCameras = serde_json::from_slice(bytes).map_err(json)?;
        let shared = serde_json::from_slice(bytes).map_err(json)?;
        let frames = std::mem::take(&mut header.frames).into_iter().zip(cameras.frames).collect();
        Ok(Self { header, frames, shared })
    }

    /// Returns the number of frames in the file, with or without a picture.
    pub(crate) fn len(&self) -> usize {
        self.frames.len()
    }

    /// Returns the cameras' positions, to choose an origin; leaves out frames whose matrix lacks rows or columns.
    pub(crate) fn positions(&self) -> impl Iterator<Item = [f64; 3]> {
        self.frames.iter().filter_map(|(frame, _)| match frame.transform_matrix.as_slice() {
            [x, y, z, ..] => Some([*x.get(3)?, *y.get(3)?, *z.get(3)?]),
            _ => None,
        })
    }

    /// Reads all views whose picture exists, in the file's order; adds notes and warnings to `found`.
    pub(crate) fn views(
        &self,
        file: &Path,
        options: &ReadOptions,
        (downscale, origin): (Option<Downscale>, DVec3),
        watch: &Watch,
        found: &mut Found,
    ) -> Result<Vec<View>, DatasetError> {
        let path = file.parent().filter(|path| !path.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let axes = options.axes.unwrap_or(Axes::Opengl);
        let folder = Folder { path, fence: Fence::around(path, options)?, axes, downscale, origin };
        let source = Source { file, says: "the json" };
        let mut listings = Listings::default();
        let locate = |(frame, _): &(Frame, _)| listings.locate(path, &frame.file_path);
        let pictures: Vec<_> = self.frames.iter().map(locate).collect();
        let views = source.load_all(self.frames.len(), watch, found, |index| {
            let (frame, own) = &self.frames[index];
            pictures[index]
                .clone()
                .map(|picture| self.view(&source, &folder, frame, own, picture))
                .transpose()
        })?;
        let sizes: BTreeSet<_> = views.iter().map(View::size).collect();
        let shared = self.shared.fl_x.is_some() && self.shared.w.or(self.shared.h).is_none();
        let own = self.frames.iter().all(|(_, own)| own.fl_x.or(own.w).or(own.h).is_some());
        if sizes.len() > 1 && shared && !own {
            found.warnings.push(format!(
                "{}: pictures of {} sizes with one fl_x and no w and h that say which size it is of",
                file_name(file),
                sizes.len()
            ));
        }
        let without = self.frames.iter().zip(&pictures).filter(|(_, picture)| picture.is_none());
        let missing: Vec<&str> = without.map(|((frame, _), _)| frame.file_path.as_str()).collect();
        if !missing.is_empty() {
            found.warnings.push(format!(
                "{}: skipped {} of {} frames, whose picture is missing: {}",
                file_name(file),
                missing.len(),
                self.frames.len(),
                listed(&missing)
            ));
        }
        Ok(views)
    }

    fn view(
        &self,
        source: &Source<'_>,
        folder: &Folder<'_>,
        frame: &Frame,
        own: &CameraFields,
        picture: PathBuf,
    ) -> Result<Loaded, DatasetError> {
        let (file, name) = (source.file, &frame.file_path);
        let at = Place { file, view: name };
        folder.fence.check(file, name, &picture)?;
        let pose = at.pose(&frame.transform_matrix, folder.origin)?;
        let fields = own.over(&self.shared);
        let stated = at.size(&fields)?;
        let mask = match &frame.mask_path {
            Some(mask) => {
                let path = file::locate(folder.path, mask).ok_or_else(|| {
                    at.value("mask_path", "the name of a picture", format!("{mask}, which is missing"))
                })?;
                folder.fence.check(file, name, &path)?;
                Some(path)
            }
            None => None,
        };
        // The factor applies to the stated size. If no size is stated, no smaller copy is looked for.
        let factor = match (folder.downscale, stated) {
            (Some(downscale), (Some(w), Some(h))) => downscale.factor((w, h)),
            _ => 1,
        };
        let copy = if factor > 1 { smaller_copy(folder.path, name, factor) } else { None };
        if let Some(copy) = &copy {
            folder.fence.check(file, name, copy)?;
        }
        let reduced = copy.is_some();
        let photo = Photo {
            name,
            path: copy.unwrap_or(picture),
            mask,
            stated,
            downscale: folder.downscale.filter(|_| !reduced),
            reduced,
            pose: folder.axes.to_opengl(pose),
        };
        source.load(photo, |size, notes| at.optics(&fields, size, notes))
    }
}

/// Maximum size, bytes, of a file that is searched for NaN and Infinity after a parse error.
const MAX_EXPLAINED_BYTES: usize = 16 << 20;

/// Makes the error that names the first frame and field with NaN or Infinity, which some programs write. `None` if
/// parsing `bytes`, the content of `file`, failed with `error` for another reason, or if it is too large to search.
fn number_fault(file: &Path, bytes: &[u8], error: &serde_json::Error) -> Option<DatasetError> {
    // A larger file is no list of photographs, and its parsed form would take many times its size in memory.
    let text = std::str::from_utf8(bytes).ok().filter(|text| text.len() <= MAX_EXPLAINED_BYTES)?;
    let mut cleared = text.to_owned();
    for word in ["-Infinity", "Infinity", "NaN"] {
        let text = std::mem::take(&mut cleared);
        for (index, part) in text.split(word).enumerate() {
            // Replaces NaN or Infinity only where it is a JSON value, not within a name.
            let value = cleared.trim_end().ends_with(['[', ',', ':'])
                && part.trim_start().starts_with([']', ',', '}']);
            match (index, value) {
                (0, _) => {}
                (_, true) => cleared += &format!("\"{NO_NUMBER}\""),
                (_, false) => cleared += word,
            }
            cleared += part;
        }
    }
    let value: serde_json::Value = serde_json::from_str(&cleared).ok()?;
    let frames = value.get("frames")?.as_array()?;
    let place = frames.iter().find_map(|frame| {
        let (field, _) = frame.as_object()?.iter().find(|(_, value)| lacks_number(value))?;
        let name = frame.get("file_path").and_then(serde_json::Value::as_str).unwrap_or("?");
        Some(format!("view `{name}`, {field}"))
    })?;
    let place = format!("line {}, {place}", error.line());
    Some(DatasetError::value(file, place, "finite numbers", "NaN or Infinity"))
}

/// Content of the JSON string that replaces NaN or Infinity, so that the file can be parsed.
const NO_NUMBER: &str = "(no number)";

fn lacks_number(value: &serde_json::Value) -> bool {
    value == NO_NUMBER || value.as_array().is_some_and(|values| values.iter().any(lacks_number))
}

/// Folder of the pictures, and settings for reading them and their poses.
struct Folder<'a> {
    path: &'a Path,
    fence: Fence,
    axes: Axes,
    downscale: Option<Downscale>,
    origin: DVec3,
}

impl CameraFields {
    /// Returns `self`, the fields of a frame, with missing fields taken from `shared`, the fields of the whole file.
    fn over(&self, shared: &Self) -> Self {
        macro_rules! first {
            ($($field:ident)*) => { Self { $($field: Clone::clone(&self.$field).or(Clone::clone(&shared.$field)),)* } };
        }
        first!(camera_model is_fisheye camera_angle_x camera_angle_y fl_x fl_y cx cy w h k1 k2 k3 k4 k5 k6 p1 p2)
    }
}
