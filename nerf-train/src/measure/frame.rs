//! Whole frames rendered by nerf-core, on as many threads as rayon has.

use crate::data::pictures::rgb::Picture;
use nerf_core::camera::Camera;
use nerf_core::host;
use nerf_core::math::MathBackend;
use nerf_core::plan::Plan;
use nerf_core::render::{Counters, RenderError, Renderer};
use serde::Serialize;
use std::num::NonZeroUsize;

pub type Frame = host::Image;

pub fn picture(frame: &Frame) -> Picture {
    Picture { width: frame.width, height: frame.height, rgb: frame.rgb.clone() }
}

pub fn render(renderer: &Renderer<'_>, plan: &Plan<'_>, camera: &Camera) -> Result<Frame, RenderError> {
    host::render(renderer, plan, camera, threads())
}

/// Renders the 2D field of `renderer`'s blob as a picture of `size`, pixels. `each` gets the number of rows done.
pub fn render_picture(
    renderer: &Renderer<'_>,
    math: MathBackend,
    size: [u32; 2],
    mut each: impl FnMut(u64) + Send,
) -> Result<(Picture, Counters), RenderError> {
    let mut done = 0;
    let (rgb, counters) = host::render_picture(renderer, math, size, threads(), |rows| {
        done += u64::from(rows);
        each(done);
    })?;
    let [width, height] = size.map(|side| side as usize);
    Ok((Picture { width, height, rgb }, counters))
}

pub(super) fn threads() -> NonZeroUsize {
    NonZeroUsize::new(rayon::current_num_threads()).unwrap_or(NonZeroUsize::MIN)
}

/// Summary of a rendered 2D field, printed by `image render --json`.
#[derive(Debug, Serialize)]
pub struct PictureSummary {
    pub file: String,
    pub width_px: u32,
    pub height_px: u32,
    pub colour_evaluations: u64,
    pub macs: u64,
    pub invalid_samples: u64,
}
