//! Whole frames through nerf-core, tile by tile on all cores.

use crate::report::colour_map::depth_picture_with_legend;
use crate::report::error::ReportError;
use crate::report::picture::Picture;
use nerf_core::camera::Camera;
use nerf_core::kernels::Line;
use nerf_core::math::MathBackend;
use nerf_core::plan::{Batch, Plan};
use nerf_core::render::{Counters, Rect, RenderError, Renderer};
use nerf_core::volume::Pixel;
use rayon::prelude::*;

/// Side of the tiles that threads take, pixels.
const TILE: u32 = 16;
/// Rows of a picture that threads take.
const BAND: usize = 8;
/// Bands between two reports of progress.
const SLAB: usize = 16;

/// A rendered view, row by row from the top left.
#[derive(Clone, Debug)]
pub struct Frame {
    /// Width, pixels.
    pub width: usize,
    /// Height, pixels.
    pub height: usize,
    /// Over the plan's background, display-encoded.
    pub rgb: Vec<[f32; 3]>,
    /// 0..=1.
    pub opacity: Vec<f32>,
    /// World units along the ray.
    pub ray_distance: Vec<f32>,
    /// World units along the view axis.
    pub z_depth: Vec<f32>,
    /// World units along the ray; empty if the plan does not ask for it.
    pub median_distance: Vec<f32>,
    /// World space, unit length or 0; empty if the plan does not ask for them.
    pub normals: Vec<[f32; 3]>,
    /// The work it took.
    pub counters: Counters,
}

impl Frame {
    /// Its z_depth in colours, with a legend, from the nearest to the farthest it shows.
    ///
    /// # Errors
    /// None for a frame that was rendered.
    pub fn z_depth_picture(&self) -> Result<Picture, ReportError> {
        let (values, title) = (&self.z_depth, "z_depth, world units");
        depth_picture_with_legend(values, &self.opacity, self.width, self.height, None, title)
    }

    /// Its colours as a picture.
    pub fn picture(&self) -> Picture {
        Picture { width: self.width, height: self.height, rgb: self.rgb.clone() }
    }
}

/// Renders all of `camera`'s image on rayon's threads.
///
/// # Errors
/// [`RenderError`], which a camera's own full rectangle and an own workspace do not cause.
pub fn render(renderer: &Renderer<'_>, plan: &Plan<'_>, camera: &Camera) -> Result<Frame, RenderError> {
    let full = Rect::full(camera);
    let (width, height) = (full.width as usize, full.height as usize);
    let lines = renderer.workspace_lines(plan);
    let tiles: Vec<Rect> = full.tiles(TILE, TILE).collect();
    let rendered: Result<Vec<_>, RenderError> = tiles
        .par_iter()
        .map_init(
            || vec![Line::UNINIT; lines],
            |workspace, &tile| {
                let mut pixels = Vec::with_capacity((tile.width * tile.height) as usize);
                let mut take = |x: u32, y: u32, pixel: &Pixel| pixels.push((x, y, *pixel));
                let counters = renderer.render(plan, camera, tile, workspace, &mut take)?;
                Ok((pixels, counters))
            },
        )
        .collect();
    let (n, outputs) = (width * height, plan.outputs());
    let mut frame = Frame {
        width,
        height,
        rgb: vec![[0.0; 3]; n],
        opacity: vec![0.0; n],
        ray_distance: vec![0.0; n],
        z_depth: vec![0.0; n],
        median_distance: vec![0.0; if outputs.median_distance { n } else { 0 }],
        normals: vec![[0.0; 3]; if outputs.normals { n } else { 0 }],
        counters: Counters::default(),
    };
    for (pixels, counters) in rendered? {
        frame.counters += counters;
        for (x, y, pixel) in pixels {
            let i = y as usize * width + x as usize;
            frame.rgb[i] = pixel.rgb;
            frame.opacity[i] = pixel.opacity;
            frame.ray_distance[i] = pixel.ray_distance;
            frame.z_depth[i] = pixel.z_depth;
            if let Some(median_distance) = frame.median_distance.get_mut(i) {
                *median_distance = pixel.median_distance;
            }
            if let Some(normal) = frame.normals.get_mut(i) {
                *normal = pixel.normal;
            }
        }
    }
    Ok(frame)
}

/// Renders the 2D field of `renderer` as a picture of `size` (width, height) on rayon's threads.
///
/// `each` is told, now and then, how many rows are done.
///
/// # Errors
/// [`RenderError`] if the blob is a scene, and on a size beyond the format's.
pub fn render_picture(
    renderer: &Renderer<'_>,
    math: MathBackend,
    size: [u32; 2],
    mut each: impl FnMut(u64),
) -> Result<(Picture, Counters), RenderError> {
    let [width, height] = size;
    let batch = Batch::for_tier(renderer.network().tier());
    renderer.check_picture(batch, size, Rect { x: 0, y: 0, width, height })?;
    let lines = renderer.picture_workspace_lines(batch);
    let row = width as usize;
    let mut picture = Picture::filled(row, height as usize, [0.0; 3]);
    let mut counters = Counters::default();
    for (slab, pixels) in picture.rgb.chunks_mut(SLAB * BAND * row).enumerate() {
        let bands: Result<Vec<Counters>, RenderError> = pixels
            .par_chunks_mut(BAND * row)
            .enumerate()
            .map_init(
                || vec![Line::UNINIT; lines],
                |workspace, (band, pixels)| {
                    let (y, rows) = ((slab * SLAB + band) * BAND, pixels.len() / row);
                    let rect = Rect { x: 0, y: y as u32, width, height: rows as u32 };
                    let mut put = |px: u32, py: u32, rgb| pixels[(py as usize - y) * row + px as usize] = rgb;
                    renderer.render_picture(math, batch, size, rect, workspace, &mut put)
                },
            )
            .collect();
        bands?.into_iter().for_each(|band| counters += band);
        each(((slab + 1) * SLAB * BAND).min(height as usize) as u64);
    }
    Ok((picture, counters))
}
