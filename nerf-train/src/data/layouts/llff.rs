//! LLFF's `poses_bounds.npy`, with the photographs in `images` or `images_N` of its folder.

use crate::data::cameras::pose::pose_of;
use crate::data::layouts::colmap;
use crate::data::layouts::folders::{Folders, Located, every_eighth};
use crate::data::layouts::npz::{self, read_npy};
use crate::data::pictures::found::Found;
use crate::data::pictures::photo::{Fence, Optics, Photo, Source};
use crate::data::{Axes, Dataset, DatasetError, Format, ReadOptions, SparsePoint, Watch, scene_name};
use glam::DVec3;
use nerf_core::camera::{Lens, Pose};
use std::path::Path;

pub(crate) const FILE: &str = "poses_bounds.npy";
/// Number of values per photograph: three rows of a 3×5 matrix, near and far.
const NUMBERS: usize = 17;
/// Factor by which the smallest near bound is multiplied to get the distance at which rays begin, as in LLFF's loader.
const NEAR_MARGIN: f64 = 0.9;

/// Values of one photograph in `poses_bounds.npy`.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Row {
    /// Camera-to-world pose. In its axes, the camera looks along −Z, and +Y points up.
    pose: Pose,
    size: (f64, f64),
    /// Focal length in pixels of a picture whose width and height are `size`.
    focal: f64,
    /// Nearest and farthest visible depth, world units along the view axis.
    bounds: [f64; 2],
}

impl Row {
    /// Parses the 17 numbers `n` of a photograph: a row-major 3×5 matrix, then the bounds. The matrix's columns are
    /// down, right, backward, centre, and (height, width, focal). The position becomes relative to `origin`.
    fn new(n: &[f64], origin: DVec3) -> Self {
        let rows = [0, 1, 2].map(|i| [n[5 * i + 1], -n[5 * i], n[5 * i + 2], n[5 * i + 3]]);
        Self { pose: pose_of(rows, origin), size: (n[9], n[4]), focal: n[14], bounds: [n[15], n[16]] }
    }
}

/// Reads `poses_bounds.npy` and the photographs. The poses are in the order of the photographs' names, sorted by bytes.
pub(crate) fn read(folder: &Path, options: &ReadOptions, watch: &Watch) -> Result<Dataset, DatasetError> {
    let file = folder.join(FILE);
    let (rows, origin) = rows(&file, options)?;
    let folders = Folders::of(folder)?;
    let size = rows.first().map_or((1.0, 1.0), |row| row.size);
    let pictures = folders.list(options.downscale, size)?;
    if pictures.len() != rows.len() {
        let place = folder_of(&pictures).unwrap_or_else(|| folders.names());
        let expected = format!("as many as there are photographs in {place}, {}", pictures.len());
        return Err(DatasetError::value(&file, "number of poses", expected, rows.len()));
    }
    let mut found = Found::default();
    watch.expect(pictures.len());
    let (fence, source) = (Fence::around(folder, options)?, Source { file: &file, says: FILE });
    let axes = options.axes.unwrap_or(Axes::Opengl);
    let views = source.load_all(rows.len(), watch, &mut found, |index| {
        let ((name, place), row) = (&pictures[index], rows[index]);
        fence.check(&file, name, &place.path)?;
        let photo = Photo {
            name,
            path: place.path.clone(),
            mask: folders.mask(name),
            stated: (Some(row.size.0), Some(row.size.1)),
            downscale: place.downscale,
            reduced: place.reduced,
            pose: axes.to_opengl(row.pose),
        };
        let (w, h) = row.size;
        let optics = Optics {
            width: w,
            height: h,
            fx: row.focal,
            fy: row.focal,
            cx: 0.5 * w,
            cy: 0.5 * h,
            lens: Lens::NONE,
        };
        source.load(photo, |_, _| Ok(optics)).map(Some)
    })?;
    let read = folder_of(&pictures).unwrap_or_default();
    found.notes.insert(0, format!("{FILE}: {} photographs of {read}", views.len()));
    let points = points(folder, origin, &mut found)?;
    if !points.is_empty() {
        found.notes.push("its points are those of COLMAP's points3D beside it".into());
    }
    let (mut notes, warnings) = found.into_sentences();
    let near = rows.iter().map(|row| row.bounds[0]).fold(f64::INFINITY, f64::min);
    let far = rows.iter().map(|row| row.bounds[1]).fold(0.0, f64::max);
    let (train, val) = every_eighth(views, options, &mut notes);
    Ok(Dataset {
        train,
        val,
        near: Some((NEAR_MARGIN * near) as f32),
        far: Some(far as f32),
        points,
        notes,
        warnings,
        ..Dataset::empty(scene_name(folder), Format::Llff, axes)
    }
    .counted_from(origin))
}

/// Reads the sparse points of a COLMAP reconstruction in `folder`, relative to `origin`; empty if there is none.
fn points(folder: &Path, origin: DVec3, found: &mut Found) -> Result<Vec<SparsePoint>, DatasetError> {
    for place in [folder.join("sparse/0"), folder.join("sparse"), folder.to_owned()] {
        let points = colmap::points_of(&place, origin, found)?;
        if !points.is_empty() {
            return Ok(points);
        }
    }
    Ok(Vec::new())
}

fn folder_of(pictures: &[(String, Located)]) -> Option<String> {
    let folder = pictures.first()?.1.path.parent()?;
    Some(folder.file_name()?.to_string_lossy().into_owned())
}

fn rows(file: &Path, options: &ReadOptions) -> Result<(Vec<Row>, DVec3), DatasetError> {
    let array = read_npy(file, options.max_array_bytes)?;
    let fault = |expected: &str, found: String| npz::fault(file, "poses_bounds", expected, found);
    let &[_, NUMBERS] = array.shape.as_slice() else {
        return Err(fault("shape [n, 17]", format!("{:?}", array.shape)));
    };
    let numbers = array.numbers().filter(|_| array.is_float());
    let numbers = numbers.ok_or_else(|| fault("dtype f8 (or f4)", "another".into()))?;
    let origin = options.origin_for(numbers.chunks_exact(NUMBERS).map(|n| [n[3], n[8], n[13]]));
    let rows: Vec<Row> = numbers.chunks_exact(NUMBERS).map(|n| Row::new(n, origin)).collect();
    for (index, row) in rows.iter().enumerate() {
        let value = |field: &str, expected: &str, found: String| {
            DatasetError::value(file, format!("pose number {index}, {field}"), expected, found)
        };
        let (w, h) = row.size;
        if !(1.0..=1e6).contains(&w) || !(1.0..=1e6).contains(&h) {
            return Err(value("width and height", "1 to 1000000 pixels", format!("{w}x{h}")));
        }
        let [near, far] = row.bounds;
        if !(near >= 0.0 && near < far && (far as f32).is_finite()) {
            return Err(value("bounds", "0 <= near < far, both finite", format!("{near}, {far}")));
        }
    }
    Ok((rows, origin))
}
