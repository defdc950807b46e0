//! The CS180 course's `.npz`: arrays named by split, OpenCV poses, one focal length.

use crate::data::cameras::pose::pose_of;
use crate::data::layouts::npz::{self, Archive, Array};
use crate::data::{Axes, Dataset, DatasetError, Format, ReadOptions, View, scene_name};
use glam::DVec3;
use nerf_core::camera::{Camera, Intrinsics, Lens};
use rayon::prelude::*;

/// Reads the arrays `images_{train,val,test}`, `c2ws_{train,val,test}` and `focal`. The training arrays may be missing
/// if [`ReadOptions::to_measure`] is true. `c2ws_test` without `images_test` is read as a camera path to render.
pub(crate) fn read(archive: &mut Archive, options: &ReadOptions) -> Result<Dataset, DatasetError> {
    let axes = options.axes.unwrap_or(Axes::Opencv);
    let focal = archive.scalar("focal")?;
    let mut positions = Vec::new();
    for poses in ["c2ws_train", "c2ws_val", "c2ws_test"] {
        if archive.has(poses) {
            positions.extend(archive.matrices(poses)?.iter().map(position));
        }
    }
    let origin = options.origin_for(positions);
    let world = World { axes, origin };
    let mut split = |images: &str, poses: &str, needed: bool| {
        if !needed && !archive.has(images) {
            return Ok(Vec::new());
        }
        let c2ws = archive.matrices(poses)?;
        let array = archive.array(images)?;
        views(archive, (images, &array), (poses, &c2ws), focal, world)
    };
    let train = split("images_train", "c2ws_train", !options.to_measure)?;
    let val = split("images_val", "c2ws_val", false)?;
    let test = split("images_test", "c2ws_test", false)?;
    let mut warnings = Vec::new();
    if !archive.has("images_val") && !options.to_measure {
        warnings.push("no array `images_val`: no validation views".into());
    }
    let mut test_path = Vec::new();
    if archive.has("c2ws_test")
        && !archive.has("images_test")
        && let Some(like) = train.first().or(val.first())
    {
        let (width, height) = like.size();
        let poses = archive.matrices("c2ws_test")?;
        test_path = cameras(archive, "c2ws_test", &poses, (width, height, focal), world)?;
    }
    let splits = [("images_train", &train), ("images_val", &val), ("images_test", &test)];
    warnings.extend(mixed_alpha(splits));
    Ok(Dataset {
        train,
        val,
        test,
        test_path,
        warnings,
        ..Dataset::empty(scene_name(&archive.file), Format::Cs180, axes)
    }
    .counted_from(origin))
}

#[derive(Clone, Copy)]
struct World {
    axes: Axes,
    origin: DVec3,
}

fn position(rows: &[[f64; 4]; 3]) -> [f64; 3] {
    rows.map(|row| row[3])
}

/// Makes views from an array of pictures `[n, h, w, 3 or 4]` and one camera-to-world matrix for each. `focal`: pixels.
fn views(
    archive: &Archive,
    (images, array): (&str, &Array),
    (poses, c2ws): (&str, &[[[f64; 4]; 3]]),
    focal: f64,
    world: World,
) -> Result<Vec<View>, DatasetError> {
    let (count, width, height, channels) = shape_of(archive, images, array)?;
    if c2ws.len() != count {
        let expected = format!("{count} poses, one for each picture of `{images}`");
        return Err(npz::fault(&archive.file, poses, expected, c2ws.len()));
    }
    let cameras = cameras(archive, images, c2ws, (width, height, focal), world)?;
    let size = width as usize * height as usize * channels;
    let decoded: Vec<Result<View, DatasetError>> = cameras
        .into_par_iter()
        .enumerate()
        .map(|(index, camera)| {
            let name = format!("{images}[{index}]");
            let bytes = match array.display_bytes(index * size, size) {
                Some(Ok(bytes)) => bytes,
                Some(Err(value)) => {
                    return Err(DatasetError::value(&archive.file, name, "colours in [0, 1]", value));
                }
                None => return Err(archive.dtype_error(images, "u1 (0..=255) or f4, f8 ([0, 1])", array)),
            };
            let alpha = |p: &[u8]| p.get(3).copied().unwrap_or(255);
            let pixels = bytes.chunks_exact(channels).map(|p| [p[0], p[1], p[2], alpha(p)]).collect();
            Ok(View::new(name, camera, pixels))
        })
        .collect();
    decoded.into_iter().collect()
}

/// Returns the number of pictures in `array`, their width and height in pixels, and their number of channels.
fn shape_of(archive: &Archive, key: &str, array: &Array) -> Result<(usize, u32, u32, usize), DatasetError> {
    if let &[count, height, width, channels @ (3 | 4)] = array.shape.as_slice()
        && let (Ok(width @ 1..=65_535), Ok(height @ 1..=65_535)) =
            (u32::try_from(width), u32::try_from(height))
    {
        return Ok((count, width, height, channels));
    }
    Err(archive.shape_error(key, "[n, height, width, 3 or 4]", array))
}

fn cameras(
    archive: &Archive,
    key: &str,
    c2ws: &[[[f64; 4]; 3]],
    (width, height, focal): (u32, u32, f64),
    world: World,
) -> Result<Vec<Camera>, DatasetError> {
    let intrinsics = Intrinsics::centred(width, height, focal as f32);
    let make = |(index, rows): (usize, &[[f64; 4]; 3])| {
        let pose = world.axes.to_opengl(pose_of(*rows, world.origin));
        Camera::new(intrinsics, Lens::NONE, pose)
            .map_err(|error| DatasetError::camera(&archive.file, &format!("{key}[{index}]"), &error))
    };
    c2ws.iter().enumerate().map(make).collect()
}

/// Returns one warning for each array of pictures without alpha, if another array has alpha; otherwise none.
fn mixed_alpha(splits: [(&str, &Vec<View>); 3]) -> Vec<String> {
    let alpha = |views: &[View]| views.iter().any(View::has_alpha);
    let read = || splits.iter().filter(|(_, views)| !views.is_empty());
    if !read().any(|(_, views)| alpha(views)) {
        return Vec::new();
    }
    let opaque = read().filter(|(_, views)| !alpha(views));
    opaque
        .map(|(array, _)| {
            format!("alpha in only some of the arrays: `{array}` has none and counts as opaque")
        })
        .collect()
}

/// Number of views in the file of the original NeRF notebook. The notebook fits the first 100 of them.
const NOTEBOOK_VIEWS: usize = 106;
/// Index of the first validation view of the notebook's file: the view that the notebook plots.
const NOTEBOOK_VALIDATION: usize = 101;
/// Number of validation views, taken from the end, if a file does not have the notebook's number of views.
const LAST: usize = 6;

/// Reads `tiny_nerf_data.npz` of the original NeRF notebook: the arrays `images` and `poses` (OpenGL), and `focal`.
///
/// Of the notebook's 106 views, 0..100 are for training and 101..106 for validation; 100 is unused, as in the notebook.
/// In other files, the last six views are for validation, unless no training view would remain.
pub(crate) fn read_tiny_nerf(archive: &mut Archive, options: &ReadOptions) -> Result<Dataset, DatasetError> {
    let axes = options.axes.unwrap_or(Axes::Opengl);
    let focal = archive.scalar("focal")?;
    let c2ws = archive.matrices("poses")?;
    let origin = options.origin_for(c2ws.iter().map(position));
    let world = World { axes, origin };
    let array = archive.array("images")?;
    let mut train = views(archive, ("images", &array), ("poses", &c2ws), focal, world)?;
    let mut warnings = Vec::new();
    let val = if train.len() == NOTEBOOK_VIEWS {
        let val = train.split_off(NOTEBOOK_VALIDATION);
        train.truncate(100);
        val
    } else if train.len() > LAST {
        train.split_off(train.len() - LAST)
    } else {
        warnings.push(format!("only {} views: no validation views", train.len()));
        Vec::new()
    };
    Ok(Dataset { train, val, warnings, ..Dataset::empty(scene_name(&archive.file), Format::TinyNerf, axes) }
        .counted_from(origin))
}
