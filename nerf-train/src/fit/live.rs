//! Folder in which a run keeps its newest blob, for a web page that displays the field.
//!
//! | file | |
//! | --- | --- |
//! | `live.nerf` | blob of the present state, replaced about every second |
//! | `live.json` | steps, seconds, PSNR, and whether the run has ended: written after the blob |
//! | `views.json` | some photographs and their cameras, to compare renderings with: written once |

use crate::data::cameras::optics_by_name;
use crate::data::pictures::thumbnail::Thumbnail;
use crate::data::{Dataset, View};
use crate::fit::finish::Outcome;
use crate::fit::validation::spread_indices;
use crate::system::output::{OutputError, write_atomic};
use anyhow::Context;
use nerf_core::camera::Projection;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Number of photographs in `views.json`, evenly spaced in the validation split or, if it is empty, the training split.
const VIEWS: usize = 8;
/// Longest side of the written photographs, pixels.
const SIDE: usize = 400;
/// Least number of seconds between two writes of the blob.
const EVERY: f64 = 1.0;
/// Fraction of the run's time that exporting and writing blobs may take.
const SHARE: f64 = 0.05;

#[derive(Debug)]
pub(super) struct Live {
    folder: PathBuf,
    last: Instant,
    took: f64,
    warned: bool,
}

#[derive(Clone, Copy, Debug, Serialize)]
pub(super) struct State {
    pub step: u32,
    pub seconds: f64,
    pub train_psnr_db: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub val_psnr_db: Option<f64>,
    pub done: bool,
}

#[derive(Serialize)]
struct Photograph<'d> {
    name: &'d str,
    camera: Camera,
    picture: String,
}

/// Camera of a photograph, with the field names of `nerf_camera` in the C interface.
#[derive(Serialize)]
struct Camera {
    width: u32,
    height: u32,
    fx: f32,
    fy: f32,
    #[serde(flatten)]
    optics: BTreeMap<&'static str, f32>,
    lens_model: u32,
    c2w: [f32; 12],
}

impl Camera {
    fn of(view: &View) -> Self {
        let (i, pose) = (view.camera.intrinsics(), view.camera.pose());
        let (x, y, z, t) = (pose.rotation.x_axis, pose.rotation.y_axis, pose.rotation.z_axis, pose.position);
        Self {
            width: i.width,
            height: i.height,
            fx: i.fx,
            fy: i.fy,
            optics: optics_by_name(&view.camera),
            lens_model: u32::from(view.camera.lens().projection == Projection::Fisheye),
            c2w: [x.x, y.x, z.x, t.x, x.y, y.y, z.y, t.y, x.z, y.z, z.z, t.z],
        }
    }
}

impl Live {
    /// Creates the writer of `folder`, and writes `views.json` there, with photographs composited over `background`.
    pub fn begin(folder: PathBuf, dataset: &Dataset, background: [f32; 3]) -> anyhow::Result<Self> {
        let views = if dataset.val.is_empty() { &dataset.train } else { &dataset.val };
        let photograph = |i: usize| {
            let view = &views[i];
            let picture = Thumbnail::of(view, SIDE, background).data_uri()?;
            Ok(Photograph { name: &view.name, camera: Camera::of(view), picture })
        };
        let views = spread_indices(views.len(), VIEWS).map(photograph).collect::<anyhow::Result<Vec<_>>>()?;
        let text = serde_json::to_vec(&BTreeMap::from([("views", views)])).context("cannot make the JSON")?;
        write_atomic(folder.join("views.json"), &text)?;
        Ok(Self { folder, last: Instant::now(), took: 0.0, warned: false })
    }

    pub fn is_due(&self) -> bool {
        self.last.elapsed().as_secs_f64() >= EVERY.max(self.took / SHARE)
    }

    /// Writes `blob`, whose export began at `begun`, and `live.json` with `state`. A file that cannot be written keeps
    /// its previous contents. Only the first failure returns a warning for the user.
    pub fn write(&mut self, blob: &[u8], state: &State, begun: Instant) -> Option<String> {
        let written = write(&self.folder, blob, state);
        (self.last, self.took) = (Instant::now(), begun.elapsed().as_secs_f64());
        let error = written.err().filter(|_| !std::mem::replace(&mut self.warned, true))?;
        Some(format!("warning: --live: {error}; the one before stays, and the run goes on"))
    }
}

/// Writes the blob of a finished run into the live folder.
pub fn finish(folder: &Path, outcome: &Outcome) -> Result<(), OutputError> {
    let last = outcome.curve.last();
    let state = State {
        step: outcome.steps,
        seconds: outcome.train_seconds,
        train_psnr_db: last.map_or(0.0, |point| point.train_psnr_db),
        val_psnr_db: outcome.scores.psnr_db(),
        done: true,
    };
    write(folder, &outcome.bytes, &state)
}

fn write(folder: &Path, blob: &[u8], state: &State) -> Result<(), OutputError> {
    write_atomic(folder.join("live.nerf"), blob)?;
    let text = serde_json::to_vec(state).unwrap_or_default();
    write_atomic(folder.join("live.json"), &text)
}
