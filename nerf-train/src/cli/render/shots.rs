//! Where a rendering looks from.

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
/// Where nothing says what the field of view is.
const DEFAULT_FOV_DEGREES: f32 = 40.0;
/// Frames of an orbit: half a day at 20 a second.
const MAX_FRAMES: usize = 1_000_000;

pub(super) struct Shots {
    /// In order; one unless an orbit or a path is asked for.
    pub cameras: Vec<Camera>,
    pub fps: Option<f64>,
}

impl From<Vec<Camera>> for Shots {
    fn from(cameras: Vec<Camera>) -> Self {
        Self { cameras, fps: None }
    }
}

impl Render {
    pub(super) fn shots(&self, blob: &Blob<'_>, global: &Global) -> anyhow::Result<Shots> {
        if self.frames.is_some() && self.keyframes.is_empty() && self.path.is_none() {
            bail!("{NO_FRAMES}");
        }
        let Some(scene) = blob.scene() else {
            bail!("{}: expected a scene, found a 2D field", self.file.display());
        };
        let width = self.width.unwrap_or(400);
        let height = self.height.unwrap_or(width);
        let orbit = self.around(scene);
        let fov = self.fov_across(width)?;
        if let Some(frames) = self.orbit {
            check_frames("--orbit", frames)?;
            let at = |i| orbit.camera(i as f32 / frames as f32, width, height, fov);
            return Ok((0..frames).map(at).collect::<Result<Vec<_>, _>>()?.into());
        }
        let origin = origin_in_name(blob.provenance().data);
        if let Some(data) = &self.path {
            let is_json = data.is_file() && places::extension(data).as_deref() == Some("json");
            let path = if is_json { read_path(data, origin)? } else { None };
            return match path {
                Some(_) if self.split.is_some() => {
                    bail!("--split: expected with a data set, found the camera path {}", data.display())
                }
                Some(path) => Ok(Shots { cameras: self.along(&path)?, fps: path.fps }),
                None if self.frames.is_some() => bail!("{NO_FRAMES}"),
                None => Ok(self.path_of(data, blob, global)?.into()),
            };
        }
        if let Some(data) = &self.data {
            if !self.keyframes.is_empty() {
                return Ok(self.through(data, blob, global)?.into());
            }
            return Ok(vec![self.view_of(data, blob, global)?].into());
        }
        let camera = match &self.pose {
            Some(rows) => posed(rows, origin, (width, height), fov).context("--pose")?,
            None => orbit.camera(0.0, width, height, fov)?,
        };
        Ok(vec![camera].into())
    }

    /// The field of view across so many pixels, as the flags say, degrees.
    fn fov_across(&self, width: u32) -> anyhow::Result<f32> {
        match self.focal {
            Some(focal) if focal > 0.0 => Ok(2.0 * (0.5 * width as f32 / focal).atan().to_degrees()),
            Some(focal) => bail!("--focal: expected a length above 0, found {focal}"),
            None => Ok(DEFAULT_FOV_DEGREES),
        }
    }

    /// The circle around a scene, as the flags say.
    fn around(&self, scene: &SceneFacts) -> Orbit {
        let orbit = Orbit::of(scene, self.up.map(UpAxis::direction));
        Orbit {
            elevation: self.elevation.unwrap_or(orbit.elevation),
            radius: self.radius.unwrap_or(orbit.radius),
            ..orbit
        }
    }

    /// The cameras of a path, in the size that was asked for or that it states.
    fn along(&self, path: &CameraPath) -> anyhow::Result<Vec<Camera>> {
        let size = self.size_of(path.size.unwrap_or((400, 400)));
        let key = |of: &PathCamera| Keyframe {
            pose: of.pose,
            fov_degrees: of.fov_degrees.unwrap_or(DEFAULT_FOV_DEGREES),
        };
        let keys: Vec<Keyframe> = path.cameras.iter().map(key).collect();
        check_frames("--frames", self.frames.unwrap_or(keys.len()))?;
        let keys = match self.frames {
            Some(frames) => flight(&keys, frames),
            None => keys,
        };
        self.of_keys(keys, size).context("--path")
    }

    /// A flight through views of a data set, in the size of the first.
    fn through(&self, data: &Path, blob: &Blob<'_>, global: &Global) -> anyhow::Result<Vec<Camera>> {
        let frames = self.frames.unwrap_or(120);
        check_frames("--frames", frames)?;
        let dataset = self.data_options.read_for(data, (blob, &self.file), global)?;
        let split = self.split.unwrap_or(Split::Val);
        let cameras = self.keyframes.iter().map(|&i| split.camera("--keyframes", &dataset, i));
        let cameras = cameras.collect::<anyhow::Result<Vec<_>>>()?;
        let key = |camera: &Camera| {
            let size = camera.intrinsics();
            let fov_degrees = 2.0 * (0.5 * size.height as f32 / size.fy).atan().to_degrees();
            Keyframe { pose: *camera.pose(), fov_degrees }
        };
        let keys: Vec<Keyframe> = cameras.iter().map(key).collect();
        self.of_keys(flight(&keys, frames), self.size_for(&cameras[0])).context("--keyframes")
    }

    /// Cameras without distortion, of the focal length that was asked for or of their own fields of view.
    fn of_keys(&self, keys: Vec<Keyframe>, (width, height): (u32, u32)) -> anyhow::Result<Vec<Camera>> {
        let camera = |key: Keyframe| {
            let focal = self.focal.unwrap_or(focal_of(height, key.fov_degrees));
            Camera::new(Intrinsics::centred(width, height, focal), Lens::NONE, key.pose)
        };
        Ok(keys.into_iter().map(camera).collect::<Result<_, _>>()?)
    }

    /// All cameras of a split, in order; frames of a video have one size: that of the first camera.
    fn path_of(&self, data: &Path, blob: &Blob<'_>, global: &Global) -> anyhow::Result<Vec<Camera>> {
        let dataset = self.data_options.read_for(data, (blob, &self.file), global)?;
        let split = self.split.unwrap_or(Split::Test);
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
        let size = self.size_for(first);
        Ok(cameras.iter().map(|camera| self.resized(camera, size)).collect::<Result<_, _>>()?)
    }

    /// The camera of a view, scaled to the size that was asked for.
    fn view_of(&self, data: &Path, blob: &Blob<'_>, global: &Global) -> anyhow::Result<Camera> {
        let dataset = self.data_options.read_for(data, (blob, &self.file), global)?;
        let camera = self.split.unwrap_or(Split::Val).camera("--view", &dataset, self.view)?;
        Ok(self.resized(&camera, self.size_for(&camera))?)
    }

    /// The size that was asked for; what is not given follows from the camera's, pixels.
    fn size_for(&self, camera: &Camera) -> (u32, u32) {
        let size = camera.intrinsics();
        self.size_of((size.width, size.height))
    }

    fn size_of(&self, old: (u32, u32)) -> (u32, u32) {
        let scaled = |side: u32, by: u32, of: u32| (u64::from(side) * u64::from(by) / u64::from(of)) as u32;
        match (self.width, self.height) {
            (Some(width), Some(height)) => (width, height),
            (Some(width), None) => (width, scaled(width, old.1, old.0)),
            (None, Some(height)) => (scaled(height, old.0, old.1), height),
            (None, None) => old,
        }
    }

    fn resized(&self, camera: &Camera, size: (u32, u32)) -> Result<Camera, CameraError> {
        let camera = scaled(camera, size)?;
        let Some(focal) = self.focal else { return Ok(camera) };
        let intrinsics = Intrinsics { fx: focal, fy: focal, ..*camera.intrinsics() };
        Camera::new(intrinsics, *camera.lens(), *camera.pose())
    }
}

/// Refuses a video of no frames, or of more than a film holds.
fn check_frames(flag: &str, frames: usize) -> anyhow::Result<()> {
    match frames {
        0 => bail!("{flag}: expected at least 1 frame, found 0"),
        1..=MAX_FRAMES => Ok(()),
        _ => bail!("{flag}: expected at most {MAX_FRAMES} frames, found {frames}"),
    }
}

/// A camera of the upper rows of a camera-to-world matrix; `fov_degrees` across the width.
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

/// The focal length of a field of view across so many pixels, pixels.
fn focal_of(side: u32, fov_degrees: f32) -> f32 {
    0.5 * side as f32 / (0.5 * fov_degrees.to_radians()).tan()
}
