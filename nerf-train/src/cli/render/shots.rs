//! Where a rendering looks from.

use super::Render;
use crate::cli::common::Global;
use crate::cli::eval::Split;
use crate::data::Dataset;
use crate::show::orbit::Orbit;
use crate::show::render::scaled;
use anyhow::{Context, bail};
use nerf_core::blob::Blob;
use nerf_core::camera::{Camera, CameraError, Intrinsics, Lens, Pose};
use std::path::Path;

/// Frames of an orbit: half a day at 20 a second.
const MAX_FRAMES: usize = 1_000_000;

impl Render {
    /// The cameras, in order; one unless an orbit or a path is asked for.
    pub(super) fn cameras(&self, blob: &Blob<'_>, global: &Global) -> anyhow::Result<Vec<Camera>> {
        let (Some(scene), Some(bounds)) = (blob.scene(), blob.scene_box()) else {
            bail!("{}: expected a scene, found a 2D field", self.file.display());
        };
        let width = self.width.unwrap_or(400);
        let height = self.height.unwrap_or(width);
        let orbit = Orbit::around(bounds, scene.near, scene.far);
        let orbit = Orbit {
            elevation: self.elevation,
            up: self.up.direction(),
            radius: self.radius.unwrap_or(orbit.radius),
            ..orbit
        };
        let fov = match self.focal {
            Some(focal) if focal > 0.0 => 2.0 * (0.5 * width as f32 / focal).atan().to_degrees(),
            Some(focal) => bail!("--focal: expected a length above 0, found {focal}"),
            None => 40.0,
        };
        if let Some(frames) = self.orbit {
            check_frames(frames)?;
            let at = |i| orbit.camera(i as f32 / frames as f32, width, height, fov);
            return Ok((0..frames).map(at).collect::<Result<_, _>>()?);
        }
        if let Some(data) = &self.path {
            return self.path_of(data, blob, global);
        }
        if let Some(data) = &self.data {
            return Ok(vec![self.view_of(data, blob, global)?]);
        }
        match &self.pose {
            Some(m) => {
                let rows = [[m[0], m[1], m[2], m[3]], [m[4], m[5], m[6], m[7]], [m[8], m[9], m[10], m[11]]];
                let focal = 0.5 * width as f32 / (0.5 * fov.to_radians()).tan();
                let intrinsics = Intrinsics::centred(width, height, focal);
                Ok(vec![Camera::new(intrinsics, Lens::NONE, Pose::from_rows(rows)).context("--pose")?])
            }
            None => Ok(vec![orbit.camera(0.0, width, height, fov)?]),
        }
    }

    /// All cameras of a split, in order; frames of a video have one size: that of the first camera.
    fn path_of(&self, data: &Path, blob: &Blob<'_>, global: &Global) -> anyhow::Result<Vec<Camera>> {
        let dataset = self.data_options.read_for(data, blob, global)?;
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
        let dataset = self.data_options.read_for(data, blob, global)?;
        let split = self.split.unwrap_or(Split::Val);
        let cameras = split.cameras(&dataset);
        let Some(camera) = cameras.get(self.view) else {
            bail!(
                "--view: expected less than {} (split `{}`), found {}",
                cameras.len(),
                split.name(),
                self.view
            );
        };
        Ok(self.resized(camera, self.size_for(camera))?)
    }

    /// The size that was asked for; what is not given follows from the camera's, pixels.
    fn size_for(&self, camera: &Camera) -> (u32, u32) {
        let old = camera.intrinsics();
        let scaled = |side: u32, by: u32, of: u32| (u64::from(side) * u64::from(by) / u64::from(of)) as u32;
        match (self.width, self.height) {
            (Some(width), Some(height)) => (width, height),
            (Some(width), None) => (width, scaled(width, old.height, old.width)),
            (None, Some(height)) => (scaled(height, old.width, old.height), height),
            (None, None) => (old.width, old.height),
        }
    }

    fn resized(&self, camera: &Camera, size: (u32, u32)) -> Result<Camera, CameraError> {
        let camera = scaled(camera, size)?;
        let Some(focal) = self.focal else { return Ok(camera) };
        let intrinsics = Intrinsics { fx: focal, fy: focal, ..*camera.intrinsics() };
        Camera::new(intrinsics, *camera.lens(), *camera.pose())
    }
}

/// Refuses an orbit of no frames, or of more than a film holds.
fn check_frames(frames: usize) -> anyhow::Result<()> {
    match frames {
        0 => bail!("--orbit: expected at least 1 frame, found 0"),
        1..=MAX_FRAMES => Ok(()),
        _ => bail!("--orbit: expected at most {MAX_FRAMES} frames, found {frames}"),
    }
}

impl Split {
    /// Its cameras; of a test split without pictures its poses.
    fn cameras(self, dataset: &Dataset) -> Vec<Camera> {
        let views = self.of(dataset);
        if self == Self::Test && views.is_empty() {
            return dataset.test_path.clone();
        }
        views.iter().map(|view| view.camera).collect()
    }
}
