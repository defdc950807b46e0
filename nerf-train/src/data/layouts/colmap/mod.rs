//! A COLMAP reconstruction: `cameras`, `images` and perhaps `points3D`, binary or text, with its photographs.

mod binary;
pub(crate) mod commands;
mod model;
mod shared;
mod text;

use crate::data::layouts::folders::{Folders, every_eighth};
use crate::data::names::listed;
use crate::data::pictures::found::Found;
use crate::data::pictures::photo::{Fence, Loaded, Photo, Source};
use crate::data::{
    Axes, Cameras, Dataset, DatasetError, Format, KeyPoint, ReadOptions, SHARED, SparsePoint, Watch,
    scene_name,
};
use glam::{DMat3, DQuat, DVec3};
use model::Camera;
use nerf_core::camera::Pose;
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// Maximum number of sparse points in a data set. Whenever there are more, every second point is removed.
const MAX_POINTS: usize = 1 << 20;

struct Registered {
    /// Path of the photograph relative to the folder of photographs.
    name: String,
    camera: u32,
    /// Rotation from world to camera: quaternion (w, x, y, z) of any length but 0.
    rotation: [f64; 4],
    translation: [f64; 3],
    /// Triangulated key points: x and y in pixels from the top left corner, and the `POINT3D_ID`.
    key_points: Vec<([f64; 2], u64)>,
}

/// `POINT3D_ID` of a key point that was not triangulated.
const NO_POINT: u64 = u64::MAX;

struct Model {
    cameras: HashMap<u32, Camera>,
    images: Vec<Registered>,
}

#[derive(Clone, Copy, PartialEq)]
enum Encoding {
    Binary,
    Text,
}

impl Encoding {
    fn file(self, folder: &Path, stem: &str) -> PathBuf {
        folder.join(format!("{stem}.{}", if self == Self::Binary { "bin" } else { "txt" }))
    }

    fn model(self, folder: &Path) -> Result<Model, DatasetError> {
        match self {
            Self::Binary => binary::model(folder),
            Self::Text => text::model(folder),
        }
    }

    fn of(folder: &Path) -> Option<Self> {
        let whole =
            |encoding: &Self| ["cameras", "images"].iter().all(|s| encoding.file(folder, s).is_file());
        [Self::Binary, Self::Text].into_iter().find(whole)
    }
}

/// Finds the reconstructions in `sparse/0`, `sparse/1`…, `sparse` and `root` itself: folder and encoding of each.
fn models(root: &Path) -> Vec<(PathBuf, Encoding)> {
    let sparse = root.join("sparse");
    let mut numbered: Vec<PathBuf> = crate::data::layouts::folders::entries(&sparse).unwrap_or_default();
    numbered.sort();
    let folders = numbered.into_iter().chain([sparse, root.to_owned()]);
    folders.filter_map(|folder| Encoding::of(&folder).map(|encoding| (folder, encoding))).collect()
}

pub(crate) fn is_here(root: &Path) -> bool {
    !models(root).is_empty()
}

/// Returns the paths of the files of all reconstructions in `root`.
pub(crate) fn files(root: &Path) -> Vec<PathBuf> {
    let folders = models(root).into_iter().map(|(folder, _)| folder).chain([root.to_owned()]);
    let stems = ["cameras", "images", "points3D", "rigs", "frames"];
    let names = stems.into_iter().flat_map(|stem| [format!("{stem}.bin"), format!("{stem}.txt")]);
    let names: Vec<String> = names.collect();
    let all = folders.flat_map(|folder| names.iter().map(move |name| folder.join(name)).collect::<Vec<_>>());
    all.filter(|path| path.is_file()).collect()
}

/// Reads the reconstruction in `folder` that has the most photographs.
pub(crate) fn read(folder: &Path, options: &ReadOptions, watch: &Watch) -> Result<Dataset, DatasetError> {
    let mut found = Found::default();
    let (model_folder, encoding) = largest(folder, &mut found)?;
    let mut model = encoding.model(&model_folder)?;
    // If `folder` holds the reconstruction itself, such as `sparse/0`, the photographs are in a folder above it.
    let above = model_folder.ancestors().take(3).filter(|above| !above.as_os_str().is_empty());
    let root = match above.clone().find(|above| above.join(crate::data::layouts::folders::IMAGES).is_dir()) {
        Some(above) if model_folder == folder => above,
        _ => folder,
    };
    let folders = Folders::of(root)?;
    let origin = options.origin_for(model.images.iter().filter_map(|image| Some(c2w(image)?.1.into())));
    let file = encoding.file(&model_folder, "images");
    let mut points = read_points(&model_folder, origin)?;
    points.say_unseen(&mut found);
    let of_files = format!("{} cameras ({})", model.cameras.len(), kinds(&model.cameras));
    let shared = options.cameras == Cameras::Shared
        && shared::settle(&mut model, &mut points, &folders, (options, &file), (watch, &mut found))?;
    let numbers = points.numbers();
    let views =
        Reader { model: &model, file: &file, folders: &folders, root, origin, options, points: &numbers }
            .views(watch, &mut found)?;
    let points = points.kept.into_iter().map(|(_, point)| point).collect();
    let axes = options.axes.unwrap_or(Axes::Opencv);
    found.notes.insert(
        0,
        format!(
            "{}: {} of {} registered photographs in {}, {of_files}",
            model_folder.strip_prefix(folder).map_or_else(|_| model_folder.display(), Path::display),
            views.len(),
            model.images.len(),
            folders.names(),
        ),
    );
    let (mut notes, warnings) = found.into_sentences();
    let (train, val) = every_eighth(views, options, &mut notes);
    Ok(Dataset {
        train,
        val,
        points,
        notes,
        warnings,
        ..Dataset::empty(
            if shared { scene_name(root) + SHARED } else { scene_name(root) },
            Format::Colmap,
            axes,
        )
    }
    .counted_from(origin))
}

fn kinds(cameras: &HashMap<u32, Camera>) -> String {
    let mut names: Vec<&str> = cameras.values().map(Camera::name).collect();
    names.sort_unstable();
    names.dedup();
    names.join(", ")
}

/// Returns folder and encoding of the reconstruction with the most photographs; the first one if several have equally
/// many. Fails if there is no reconstruction.
fn largest(folder: &Path, found: &mut Found) -> Result<(PathBuf, Encoding), DatasetError> {
    let mut counted = Vec::new();
    for (model, encoding) in models(folder) {
        let count = match encoding {
            Encoding::Binary => binary::count(&encoding.file(&model, "images"))?,
            Encoding::Text => text::count(&encoding.file(&model, "images"))?,
        };
        counted.push((count, model, encoding));
    }
    let most = counted.iter().map(|(count, ..)| *count).max();
    let several = counted.len() > 1;
    let Some((count, model, encoding)) = counted.into_iter().find(|(count, ..)| Some(*count) == most) else {
        let fault = "not a data set: expected cameras.bin and images.bin (or .txt) in sparse/0, sparse/1, sparse, or the \
                     folder itself";
        return Err(DatasetError::fault(folder, fault));
    };
    if several {
        let shown = model.strip_prefix(folder).unwrap_or(&model).display();
        found.notes.push(format!("of several models the largest is read: {shown}, of {count} photographs"));
    }
    Ok((model, encoding))
}

/// Reads the sparse points of the reconstruction in `folder`, relative to `origin`; may be empty. Points that no
/// photograph sees are left out, with a warning.
pub(crate) fn points_of(
    folder: &Path,
    origin: DVec3,
    found: &mut Found,
) -> Result<Vec<SparsePoint>, DatasetError> {
    let points = read_points(folder, origin)?;
    points.say_unseen(found);
    Ok(points.kept.into_iter().map(|(_, point)| point).collect())
}

fn read_points(folder: &Path, origin: DVec3) -> Result<Points, DatasetError> {
    let [binary, text] = [Encoding::Binary, Encoding::Text].map(|encoding| encoding.file(folder, "points3D"));
    let mut points =
        Points { file: binary.clone(), origin, kept: Vec::new(), stride: 1, seen: 0, unseen: 0, errors: 0.0 };
    if binary.is_file() {
        binary::points(&binary, &mut points)?;
    } else if text.is_file() {
        points.file = text.clone();
        text::points(&text, &mut points)?;
    }
    Ok(points)
}

/// Summary of the largest of the reconstructions that COLMAP has just made.
#[derive(Debug)]
pub(crate) struct Facts {
    pub(crate) folder: PathBuf,
    /// For each smaller reconstruction, the names of its photographs that are not in the largest one.
    pub(crate) others: Vec<Vec<String>>,
    pub(crate) names: Vec<String>,
    pub(crate) points: usize,
    /// Mean of the reprojection errors that COLMAP states for the points, in pixels.
    pub(crate) mean_error: f64,
}

/// Summarises the largest reconstruction in `folder`; `None` if there is none.
pub(crate) fn facts(folder: &Path) -> Result<Option<Facts>, DatasetError> {
    if !is_here(folder) {
        return Ok(None);
    }
    let (largest, encoding) = largest(folder, &mut Found::default())?;
    let names_of = |folder: &Path, encoding: Encoding| {
        let model = encoding.model(folder)?;
        Ok::<_, DatasetError>(model.images.into_iter().map(|image| image.name).collect::<Vec<_>>())
    };
    let names = names_of(&largest, encoding)?;
    let mut others = Vec::new();
    for (other, encoding) in models(folder).into_iter().filter(|(other, _)| *other != largest) {
        let mut other = names_of(&other, encoding)?;
        other.retain(|name| !names.contains(name));
        others.push(other);
    }
    let points = read_points(&largest, DVec3::ZERO)?;
    Ok(Some(Facts {
        folder: largest,
        others,
        names,
        points: points.seen,
        mean_error: points.errors / points.seen.max(1) as f64,
    }))
}

struct Points {
    file: PathBuf,
    origin: DVec3,
    /// Sparse points that were kept, each with its `POINT3D_ID`.
    kept: Vec<(u64, SparsePoint)>,
    /// Interval between the points in `kept`, counted in points of the file that photographs see: 1, 2, 4, ….
    stride: usize,
    seen: usize,
    unseen: usize,
    /// Sum of the mean reprojection errors of all points that photographs see, pixels.
    errors: f64,
}

impl Points {
    /// Returns the index in `kept` of each point, by its `POINT3D_ID`.
    fn numbers(&self) -> HashMap<u64, u32> {
        self.kept.iter().enumerate().map(|(place, &(number, _))| (number, place as u32)).collect()
    }

    fn say_unseen(&self, found: &mut Found) {
        if self.unseen > 0 {
            found.warnings.push(format!(
                "{}: skipped {} points that no photograph sees",
                self.file.file_name().unwrap_or_default().to_string_lossy(),
                self.unseen
            ));
        }
    }

    /// Adds a point, if any photograph sees it. `number`: `POINT3D_ID`. `error`: mean reprojection error, pixels.
    /// `track`: number of photographs that see the point. Fails if `position` is not finite.
    fn push(&mut self, number: u64, position: [f64; 3], error: f64, track: u64) -> Result<(), DatasetError> {
        let point = (DVec3::from(position) - self.origin).as_vec3().to_array();
        if !point.iter().all(|v| v.is_finite()) {
            let place = format!("point number {}", self.seen + self.unseen);
            let found = format!("{position:?}");
            return Err(DatasetError::value(&self.file, place, "a finite position", found));
        }
        if track == 0 {
            self.unseen += 1;
            return Ok(());
        }
        if self.seen.is_multiple_of(self.stride) {
            let track = track.min(u64::from(u32::MAX)) as u32;
            self.kept.push((number, SparsePoint { position: point, error: error as f32, track }));
        }
        self.seen += 1;
        self.errors += error;
        if self.kept.len() > MAX_POINTS {
            let mut index = 0;
            self.kept.retain(|_| {
                index += 1;
                index % 2 == 1
            });
            self.stride *= 2;
        }
        Ok(())
    }
}

struct Reader<'a> {
    model: &'a Model,
    file: &'a Path,
    folders: &'a Folders,
    root: &'a Path,
    origin: DVec3,
    options: &'a ReadOptions,
    /// Index in [`Dataset::points`] of each sparse point, by its `POINT3D_ID`.
    points: &'a HashMap<u64, u32>,
}

impl Reader<'_> {
    fn views(&self, watch: &Watch, found: &mut Found) -> Result<Vec<crate::data::View>, DatasetError> {
        let images = &self.model.images;
        watch.expect(images.len());
        let fence = Fence::around(self.root, self.options)?;
        let mut names: Vec<&str> = images.iter().map(|image| image.name.as_str()).collect();
        names.sort_unstable();
        if let Some(twice) = names.windows(2).find(|pair| pair[0] == pair[1]) {
            let place = format!("photograph `{}`", twice[0]);
            return Err(DatasetError::value(self.file, place, "one pose for each photograph", "two"));
        }
        let source = Source { file: self.file, says: "the model" };
        let views = source
            .load_all(images.len(), watch, found, |index| self.view(&source, &fence, &images[index]))?;
        let missing: Vec<&str> =
            images.iter().filter(|image| !self.exists(image)).map(|image| image.name.as_str()).collect();
        if !missing.is_empty() {
            found.warnings.push(format!(
                "skipped {} of {} registered photographs, which are missing in {}: {}",
                missing.len(),
                images.len(),
                self.folders.names(),
                listed(&missing)
            ));
        }
        Ok(views)
    }

    fn exists(&self, image: &Registered) -> bool {
        let size = self.model.cameras.get(&image.camera).map_or((1.0, 1.0), Camera::size);
        self.folders.locate(&image.name, self.options.downscale, size).is_some()
    }

    fn view(
        &self,
        source: &Source<'_>,
        fence: &Fence,
        image: &Registered,
    ) -> Result<Option<Loaded>, DatasetError> {
        let value = |field: &str, expected: &str, found: String| {
            DatasetError::value(self.file, format!("photograph `{}`, {field}", image.name), expected, found)
        };
        let camera = self.model.cameras.get(&image.camera).ok_or_else(|| {
            value("camera", "one of the model's cameras", format!("number {}", image.camera))
        })?;
        let (w, h) = camera.size();
        let Some(place) = self.folders.locate(&image.name, self.options.downscale, (w, h)) else {
            return Ok(None);
        };
        fence.check(self.file, &image.name, &place.path)?;
        let (rotation, position) = c2w(image).ok_or_else(|| {
            value("pose", "finite numbers and a quaternion above 0", format!("{:?}", image.rotation))
        })?;
        let pose = Pose { rotation: rotation.as_mat3(), position: (position - self.origin).as_vec3() };
        let optics = camera.optics(self.file, &image.name)?;
        let photo = Photo {
            name: &image.name,
            mask: self.folders.mask(&image.name),
            path: place.path,
            stated: (Some(w), Some(h)),
            downscale: place.downscale,
            reduced: place.reduced,
            pose: self.options.axes.unwrap_or(Axes::Opencv).to_opengl(pose),
        };
        let mut loaded = source.load(photo, |_, _| Ok(optics))?;
        let (width, height) = loaded.view.size();
        let scale = [f64::from(width) / w, f64::from(height) / h];
        let key_point = |&([x, y], number): &([f64; 2], u64)| {
            let (x, y) = ((x * scale[0]) as f32, (y * scale[1]) as f32);
            let &point = self.points.get(&number)?;
            (x.is_finite() && y.is_finite()).then_some(KeyPoint { x, y, point })
        };
        loaded.view.key_points = image.key_points.iter().filter_map(key_point).collect();
        Ok(Some(loaded))
    }
}

/// Returns the camera-to-world rotation and camera position, in COLMAP's axes; `None` if the numbers give no pose.
fn c2w(image: &Registered) -> Option<(DMat3, DVec3)> {
    let [w, x, y, z] = image.rotation;
    let rotation = DQuat::from_xyzw(x, y, z, w);
    let length = rotation.length();
    if !(length.is_finite() && length > 1e-9) {
        return None;
    }
    let c2w = DMat3::from_quat(rotation * (1.0 / length)).transpose();
    let position = -(c2w * DVec3::from(image.translation));
    position.is_finite().then_some((c2w, position))
}
