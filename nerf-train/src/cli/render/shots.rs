//! Cameras of a rendering, from the command line.

use super::Render;
use crate::cli::common::Global;
use crate::cli::eval::Split;
use crate::cli::options::UpAxis;
use crate::cli::places;
use crate::data::cameras::path::{CameraPath, PathCamera, read_path};
use crate::data::cameras::scaled;
use crate::data::origin_in_name;
use crate::show::keyframes::{Keyframe, flight};
use crate::show::orbit::Orbit;
use anyhow::{Context, bail};
use nerf_core::blob::{Blob, SceneFacts};
use nerf_core::camera::{Camera, CameraError, Intrinsics, Lens, Pose};
use std::path::Path;

const NO_FRAMES: &str =
    "--frames: expected with --keyframes, or with --path and a camera path, found neither";
const DEFAULT_FOV_DEGREES: f32 = 40.0;
/// Largest number of frames of a video: half a day at 20 per second.
const MAX_FRAMES: usize = 1_000_000;

pub(super) struct Shots {
    /// Cameras of the frames, in order; a single camera unless a video is rendered.
    pub cameras: Vec<Camera>,
    pub fps: Option<f64>,
}

impl From<Vec<Camera>> for Shots {
    fn from(cameras: Vec<Camera>) -> Self {
        Self { cameras, fps: None }
    }
}

pub(super) fn shots(render: &Render, blob: &Blob<'_>, global: &Global) -> anyhow::Result<Shots> {
    if render.frames.is_some() && render.keyframes.is_empty() && render.path.is_none() {
        bail!("{NO_FRAMES}");
    }
    let Some(scene) = blob.scene() else {
        bail!("{}: expected a scene, found a 2D field", render.file.display());
    };
    let width = render.width.unwrap_or(400);
    let height = render.height.unwrap_or(width);
    let orbit = around(render, scene);
    let fov = fov_across(render, width)?;
    if let Some(frames) = render.orbit {
        check_frames("--orbit", frames)?;
        let at = |i| orbit.camera(i as f32 / frames as f32, width, height, fov);
        return Ok((0..frames).map(at).collect::<Result<Vec<_>, _>>()?.into());
    }
    let origin = origin_in_name(blob.provenance().data);
    if let Some(data) = &render.path {
        let is_json = data.is_file() && places::extension(data).as_deref() == Some("json");
        let path = if is_json { read_path(data, origin)? } else { None };
        return match path {
            Some(_) if render.split.is_some() => {
                bail!("--split: expected with a data set, found the camera path {}", data.display())
            }
            Some(path) => Ok(Shots { cameras: along(render, &path)?, fps: path.fps }),
            None if render.frames.is_some() => bail!("{NO_FRAMES}"),
            None => Ok(path_of(render, data, blob, global)?.into()),
        };
    }
    if let Some(data) = &render.data {
        if !render.keyframes.is_empty() {
            return Ok(through(render, data, blob, global)?.into());
        }
        return Ok(vec![view_of(render, data, blob, global)?].into());
    }
    let camera = match &render.pose {
        Some(rows) => posed(rows, origin, (width, height), fov).context("--pose")?,
        None => orbit.camera(0.0, width, height, fov)?,
    };
    Ok(vec![camera].into())
}

/// Returns the horizontal field of view, degrees, of an image `width` pixels wide: from `--focal`, or the default.
fn fov_across(render: &Render, width: u32) -> anyhow::Result<f32> {
    match render.focal {
        Some(focal) if focal > 0.0 => Ok(2.0 * (0.5 * width as f32 / focal).atan().to_degrees()),
        Some(focal) => bail!("--focal: expected a length above 0, found {focal}"),
        None => Ok(DEFAULT_FOV_DEGREES),
    }
}

/// Returns the default orbit around a scene, with the changes that `--up`, `--elevation` and `--radius` request.
fn around(render: &Render, scene: &SceneFacts) -> Orbit {
    let orbit = Orbit::of(scene, render.up.map(UpAxis::direction));
    Orbit {
        elevation: render.elevation.unwrap_or(orbit.elevation),
        radius: render.radius.unwrap_or(orbit.radius),
        ..orbit
    }
}

/// Returns the cameras of a camera path, interpolated if `--frames` is given. Image size: by flags, else the path's.
fn along(render: &Render, path: &CameraPath) -> anyhow::Result<Vec<Camera>> {
    let size = size_of(render, path.size.unwrap_or((400, 400)));
    let key = |of: &PathCamera| Keyframe {
        pose: of.pose,
        fov_degrees: of.fov_degrees.unwrap_or(DEFAULT_FOV_DEGREES),
    };
    let keys: Vec<Keyframe> = path.cameras.iter().map(key).collect();
    check_frames("--frames", render.frames.unwrap_or(keys.len()))?;
    let keys = match render.frames {
        Some(frames) => flight(&keys, frames),
        None => keys,
    };
    of_keys(render, keys, size).context("--path")
}

/// Returns cameras along a path through the views `--keyframes`. Image size: from the flags, or else the first view.
fn through(render: &Render, data: &Path, blob: &Blob<'_>, global: &Global) -> anyhow::Result<Vec<Camera>> {
    let frames = render.frames.unwrap_or(120);
    check_frames("--frames", frames)?;
    let dataset = render.data_options.read_for(data, (blob, &render.file), global)?;
    let split = render.split.unwrap_or(Split::Val);
    let cameras = render.keyframes.iter().map(|&i| split.camera("--keyframes", &dataset, i));
    let cameras = cameras.collect::<anyhow::Result<Vec<_>>>()?;
    let key = |camera: &Camera| {
        let size = camera.intrinsics();
        let fov_degrees = 2.0 * (0.5 * size.height as f32 / size.fy).atan().to_degrees();
        Keyframe { pose: *camera.pose(), fov_degrees }
    };
    let keys: Vec<Keyframe> = cameras.iter().map(key).collect();
    of_keys(render, flight(&keys, frames), size_for(render, &cameras[0])).context("--keyframes")
}

/// Returns each keyframe's camera for `width` × `height` pixels, undistorted. `--focal` overrides its field of view.
fn of_keys(render: &Render, keys: Vec<Keyframe>, (width, height): (u32, u32)) -> anyhow::Result<Vec<Camera>> {
    let camera = |key: Keyframe| {
        let focal = render.focal.unwrap_or(focal_of(height, key.fov_degrees));
        Camera::new(Intrinsics::centred(width, height, focal), Lens::NONE, key.pose)
    };
    Ok(keys.into_iter().map(camera).collect::<Result<_, _>>()?)
}

/// Returns all cameras of a split, in order, with one image size: from the flags, or else from the first camera.
fn path_of(render: &Render, data: &Path, blob: &Blob<'_>, global: &Global) -> anyhow::Result<Vec<Camera>> {
    let dataset = render.data_options.read_for(data, (blob, &render.file), global)?;
    let split = render.split.unwrap_or(Split::Test);
    let cameras = split.cameras(&dataset);
    let Some(first) = cameras.first() else {
        bail!(
            "--path: expected cameras in the split `{}` of {}, found none; it has {} train and {} val: \
             choose with --split",
            split.name(),
            data.display(),
            dataset.train.len(),
            dataset.val.len()
        );
    };
    let size = size_for(render, first);
    Ok(cameras.iter().map(|camera| resized(render, camera, size)).collect::<Result<_, _>>()?)
}

/// Returns the camera of `--view`, scaled to the image size that the flags set.
fn view_of(render: &Render, data: &Path, blob: &Blob<'_>, global: &Global) -> anyhow::Result<Camera> {
    let dataset = render.data_options.read_for(data, (blob, &render.file), global)?;
    let camera = render.split.unwrap_or(Split::Val).camera("--view", &dataset, render.view)?;
    Ok(resized(render, &camera, size_for(render, &camera))?)
}

/// Returns width and height, pixels, as set by the flags. Without flags, returns the size of `camera`'s image. With one
/// flag, keeps the aspect ratio.
fn size_for(render: &Render, camera: &Camera) -> (u32, u32) {
    let size = camera.intrinsics();
    size_of(render, (size.width, size.height))
}

fn size_of(render: &Render, old: (u32, u32)) -> (u32, u32) {
    let scaled = |side: u32, by: u32, of: u32| (u64::from(side) * u64::from(by) / u64::from(of)) as u32;
    match (render.width, render.height) {
        (Some(width), Some(height)) => (width, height),
        (Some(width), None) => (width, scaled(width, old.1, old.0)),
        (None, Some(height)) => (scaled(height, old.0, old.1), height),
        (None, None) => old,
    }
}

fn resized(render: &Render, camera: &Camera, size: (u32, u32)) -> Result<Camera, CameraError> {
    let camera = scaled(camera, size)?;
    let Some(focal) = render.focal else { return Ok(camera) };
    let intrinsics = Intrinsics { fx: focal, fy: focal, ..*camera.intrinsics() };
    Camera::new(intrinsics, *camera.lens(), *camera.pose())
}

fn check_frames(flag: &str, frames: usize) -> anyhow::Result<()> {
    match frames {
        0 => bail!("{flag}: expected at least 1 frame, found 0"),
        1..=MAX_FRAMES => Ok(()),
        _ => bail!("{flag}: expected at most {MAX_FRAMES} frames, found {frames}"),
    }
}

/// Returns a camera without distortion. `rows`: 3×4 camera-to-world matrix, row by row, in the data set's coordinates.
/// `origin`: the scene's origin in these coordinates. `fov_degrees`: horizontal field of view.
fn posed(
    rows: &[f64; 12],
    origin: [f64; 3],
    (width, height): (u32, u32),
    fov_degrees: f32,
) -> Result<Camera, CameraError> {
    let row =
        |i: usize| [0, 1, 2, 3].map(|j| (rows[4 * i + j] - if j == 3 { origin[i] } else { 0.0 }) as f32);
    let intrinsics = Intrinsics::centred(width, height, focal_of(width, fov_degrees));
    Camera::new(intrinsics, Lens::NONE, Pose::from_rows([row(0), row(1), row(2)]))
}

/// Returns the focal length, pixels, at which `side` pixels span the field of view `fov_degrees`.
fn focal_of(side: u32, fov_degrees: f32) -> f32 {
    0.5 * side as f32 / (0.5 * fov_degrees.to_radians()).tan()
}
