//! A rendered image: one list of values for each requested output, and counters of the work.

use crate::plan::Outputs;
use crate::render::{Counters, RenderError};
use crate::volume::Pixel;
use std::vec::Vec;

/// Makes a plane of an image (a list of one value per pixel), with `value` in each pixel.
///
/// # Errors
/// [`RenderError::ImageMemory`] if there is not enough memory.
pub(super) fn plane<T: Clone>(width: usize, height: usize, value: T) -> Result<Vec<T>, RenderError> {
    let error = RenderError::ImageMemory { width, height };
    let (count, mut values) = (width.checked_mul(height).ok_or(error)?, Vec::new());
    values.try_reserve_exact(count).map_err(|_| error)?;
    values.resize(count, value);
    Ok(values)
}

/// A rendered image. Each output has a plane: a list of one value per pixel, row by row from the top left. A plane is
/// empty if its output was not requested.
#[derive(Clone, Debug, PartialEq)]
pub struct Image {
    /// Width, pixels.
    pub width: usize,
    /// Height, pixels.
    pub height: usize,
    /// Colour over the background (red, green, blue), sRGB-encoded, in `[0, 1]`. If linear output was requested, the
    /// colour is linear light instead.
    pub rgb: Vec<[f32; 3]>,
    /// Opacity, the sum of the compositing weights, `[0, 1]`.
    pub opacity: Vec<f32>,
    /// Mean of the samples' distances along the ray, weighted by compositing weight, world units. In a pixel without a
    /// surface, the background distance ([`Plan::far_from`](crate::plan::Plan::far_from)).
    pub ray_distance: Vec<f32>,
    /// Mean distance along the view axis, world units: `ray_distance` times the cosine between ray and view axis. In a
    /// pixel without a surface, the background distance ([`Plan::far_from`](crate::plan::Plan::far_from)).
    pub z_depth: Vec<f32>,
    /// First distance along the ray at which the transmittance is below one half, world units. If the transmittance
    /// stays at or above one half, the background distance ([`Plan::far_from`](crate::plan::Plan::far_from)).
    pub median_distance: Vec<f32>,
    /// Normals in world space, unit length; 0 in a pixel without a surface.
    pub normals: Vec<[f32; 3]>,
    /// Numbers of rays, samples and network evaluations, summed over the whole image.
    pub counters: Counters,
}

impl Image {
    /// Makes an image with a plane of zeros for each output in `outputs`.
    ///
    /// # Errors
    /// [`RenderError::ImageMemory`] if there is not enough memory.
    pub(super) fn new(width: usize, height: usize, outputs: &Outputs) -> Result<Self, RenderError> {
        let rows = |asked: bool| if asked { height } else { 0 };
        Ok(Self {
            width,
            height,
            rgb: plane(width, rows(outputs.rgb), [0.0; 3])?,
            opacity: plane(width, rows(outputs.opacity), 0.0)?,
            ray_distance: plane(width, rows(outputs.ray_distance), 0.0)?,
            z_depth: plane(width, rows(outputs.z_depth), 0.0)?,
            median_distance: plane(width, rows(outputs.median_distance), 0.0)?,
            normals: plane(width, rows(outputs.normals), [0.0; 3])?,
            counters: Counters::default(),
        })
    }

    /// Stores `pixel` in the planes that the image has; `i`: index of the pixel, row by row.
    pub(super) fn put(&mut self, i: usize, pixel: &Pixel) {
        fn set<T>(plane: &mut [T], i: usize, value: T) {
            if let Some(place) = plane.get_mut(i) {
                *place = value;
            }
        }
        set(&mut self.rgb, i, pixel.rgb);
        set(&mut self.opacity, i, pixel.opacity);
        set(&mut self.ray_distance, i, pixel.ray_distance);
        set(&mut self.z_depth, i, pixel.z_depth);
        set(&mut self.median_distance, i, pixel.median_distance);
        set(&mut self.normals, i, pixel.normal);
    }

    /// Returns the colours as bytes, 0 to 255: red, green, blue of each pixel, row by row; empty if not requested.
    pub fn rgb8(&self) -> Vec<u8> {
        self.rgb.iter().flatten().map(|c| (c.clamp(0.0, 1.0) * 255.0 + 0.5) as u8).collect()
    }
}
