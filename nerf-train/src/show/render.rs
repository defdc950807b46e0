//! Renders views of a scene, one after the other, to their files.

use crate::data::cameras::scaled;
use crate::measure::frame;
use crate::show::colour_map::robust_range;
use crate::show::view::Output;
use crate::show::writer::Writer;
use crate::system::summary::Short;
use anyhow::Context;
use nerf_core::camera::{Camera, CameraError};
use nerf_core::plan::Plan;
use nerf_core::render::{Counters, Renderer};
use serde::Serialize;
use std::path::PathBuf;

/// Distances at the two ends of the colour map, for each distance output, world units.
pub type Ranges = Vec<(Output, (f32, f32))>;

/// Smallest side of a view in the coarse pass, pixels. The pass reduces a side to a quarter, but not below this limit.
const COARSE: u32 = 64;

/// Renders every camera's view and passes the frame to all writers. The callback `each` gets the number of finished
/// views, before each view and at the end.
///
/// If a view fails, no half-written file remains after the writers are dropped.
pub fn render(
    renderer: &Renderer<'_>,
    plan: &Plan<'_>,
    cameras: &[Camera],
    writers: &mut [Writer],
    mut each: impl FnMut(usize),
) -> anyhow::Result<Counters> {
    let mut counters = Counters::default();
    for (i, camera) in cameras.iter().enumerate() {
        each(i);
        let frame = frame::render(renderer, plan, camera)?;
        counters += frame.counters;
        writers.iter_mut().try_for_each(|writer| writer.push(&frame))?;
    }
    each(cameras.len());
    Ok(counters)
}

/// Finds distances at the ends of the colour map, world units: one range per distance output for all frames of a video.
///
/// The ranges are needed before the first frame is written. A coarse pass finds the ranges with a sixteenth of the
/// work; otherwise, all frames would have to be kept in memory. The callback `each` gets the number of finished frames.
pub fn ranges(
    renderer: &Renderer<'_>,
    plan: &Plan<'_>,
    cameras: &[Camera],
    distances: &[Output],
    mut each: impl FnMut(usize),
) -> anyhow::Result<Ranges> {
    let mut opacity = Vec::new();
    let mut values = vec![Vec::new(); distances.len()];
    for (i, camera) in cameras.iter().enumerate() {
        let frame = frame::render(renderer, plan, &coarse(camera).context("camera")?)?;
        opacity.extend_from_slice(&frame.opacity);
        for (output, values) in distances.iter().zip(&mut values) {
            values.extend_from_slice(output.distances(&frame));
        }
        each(i + 1);
    }
    // Without pixels of opacity above 1/2 no colour is shown, but all frames need the same legend.
    let range = |values: &Vec<f32>| robust_range(values, &opacity).unwrap_or((0.0, 1.0));
    Ok(distances.iter().copied().zip(values.iter().map(range)).collect())
}

/// Returns a camera of the same view in fewer pixels, for [`ranges`].
pub fn coarse(camera: &Camera) -> Result<Camera, CameraError> {
    let side = |pixels: u32| (pixels / 4).max(COARSE).min(pixels);
    scaled(camera, (side(camera.intrinsics().width), side(camera.intrinsics().height)))
}

/// Summary of a rendering, printed by `render --json`. The fields `…_range` are the smallest and largest distance in
/// a video's colour map, world units.
#[derive(Debug, Serialize)]
pub struct Rendering {
    pub files: Vec<String>,
    pub frames: usize,
    pub width_px: u32,
    pub height_px: u32,
    pub total_seconds: f64,
    pub density_evaluations_per_ray: f64,
    pub colour_evaluations_per_ray: f64,
    pub normal_evaluations_per_ray: f64,
    pub invalid_samples: u64,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ray_distance_range: Option<[Short; 2]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub z_depth_range: Option<[Short; 2]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub median_distance_range: Option<[Short; 2]>,
}

impl Rendering {
    pub fn of(
        files: &[PathBuf],
        cameras: &[Camera],
        counters: Counters,
        ranges: &Ranges,
        seconds: f64,
    ) -> Self {
        let a_ray = |count: u64| count as f64 / counters.rays.max(1) as f64;
        let size = cameras.first().map(|camera| *camera.intrinsics());
        let range = |output| {
            ranges.iter().find(|(of, _)| *of == output).map(|&(_, (near, far))| [Short(near), Short(far)])
        };
        Self {
            files: files.iter().map(|file| file.display().to_string()).collect(),
            frames: cameras.len(),
            width_px: size.map_or(0, |size| size.width),
            height_px: size.map_or(0, |size| size.height),
            total_seconds: seconds,
            density_evaluations_per_ray: a_ray(counters.density_evaluations),
            colour_evaluations_per_ray: a_ray(counters.colour_evaluations),
            normal_evaluations_per_ray: a_ray(counters.normal_evaluations),
            invalid_samples: counters.invalid_samples,
            ray_distance_range: range(Output::RayDistance),
            z_depth_range: range(Output::ZDepth),
            median_distance_range: range(Output::MedianDistance),
        }
    }
}
