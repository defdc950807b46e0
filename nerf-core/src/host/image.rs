//! A rendered image.

use crate::plan::Outputs;
use crate::render::{Counters, RenderError};
use crate::volume::Pixel;
use std::vec::Vec;

/// One value for each pixel of an image.
///
/// # Errors
/// [`RenderError::ImageMemory`] where there is not enough for them.
pub(super) fn plane<T: Clone>(width: usize, height: usize, value: T) -> Result<Vec<T>, RenderError> {
    let error = RenderError::ImageMemory { width, height };
    let (count, mut values) = (width.checked_mul(height).ok_or(error)?, Vec::new());
    values.try_reserve_exact(count).map_err(|_| error)?;
    values.resize(count, value);
    Ok(values)
}

/// A rendered image, plane by plane, each row by row from the top left; empty where its output was not asked for.
#[derive(Clone, Debug, PartialEq)]
pub struct Image {
    /// Width, pixels.
    pub width: usize,
    /// Height, pixels.
    pub height: usize,
    /// Colour over the background: display-encoded in `[0, 1]`, unless linear output was asked for.
    pub rgb: Vec<[f32; 3]>,
    /// `[0, 1]`.
    pub opacity: Vec<f32>,
    /// World units along the ray.
    pub ray_distance: Vec<f32>,
    /// World units along the view axis.
    pub z_depth: Vec<f32>,
    /// World units along the ray.
    pub median_distance: Vec<f32>,
    /// World space, unit length, or 0 where there is no surface.
    pub normals: Vec<[f32; 3]>,
    /// The work it took.
    pub counters: Counters,
}

impl Image {
    /// A black image with the planes of `outputs`.
    ///
    /// # Errors
    /// [`RenderError::ImageMemory`] where there is not enough for them.
    pub(super) fn new(width: usize, height: usize, outputs: &Outputs) -> Result<Self, RenderError> {
        let plane = |asked: bool| if asked { plane(width, height, 0.0) } else { Ok(Vec::new()) };
        let triples = |asked: bool| if asked { self::plane(width, height, [0.0; 3]) } else { Ok(Vec::new()) };
        Ok(Self {
            width,
            height,
            rgb: triples(outputs.rgb)?,
            opacity: plane(outputs.opacity)?,
            ray_distance: plane(outputs.ray_distance)?,
            z_depth: plane(outputs.z_depth)?,
            median_distance: plane(outputs.median_distance)?,
            normals: triples(outputs.normals)?,
            counters: Counters::default(),
        })
    }

    /// Takes pixel `i`.
    pub(super) fn put(&mut self, i: usize, pixel: &Pixel) {
        let planes = [
            (&mut self.opacity, pixel.opacity),
            (&mut self.ray_distance, pixel.ray_distance),
            (&mut self.z_depth, pixel.z_depth),
            (&mut self.median_distance, pixel.median_distance),
        ];
        for (plane, value) in planes {
            if let Some(place) = plane.get_mut(i) {
                *place = value;
            }
        }
        for (plane, value) in [(&mut self.rgb, pixel.rgb), (&mut self.normals, pixel.normal)] {
            if let Some(place) = plane.get_mut(i) {
                *place = value;
            }
        }
    }

    /// Its colours as bytes, red, green, blue, row by row: what picture files take.
    pub fn rgb8(&self) -> Vec<u8> {
        self.rgb.iter().flatten().map(|c| (c.clamp(0.0, 1.0) * 255.0 + 0.5) as u8).collect()
    }
}
