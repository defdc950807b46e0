//! The pixels of a tile, before they are copied into the planes.

use nerf_core::memory::{Layout, Measure};
use nerf_core::plan::Outputs;
use nerf_core::volume::Pixel;

/// Values of a pixel that are stored even if not requested.
#[derive(Clone, Copy, Default)]
struct Plain {
    rgb: [f32; 3],
    opacity: f32,
    ray_distance: f32,
    z_depth: f32,
}

/// A tile's pixels, row by row. Median distances and normals take no memory unless requested.
pub(crate) struct TilePixels<'w> {
    plain: &'w mut [Plain],
    /// Median distances, `[pixels]`, world units; empty if not requested.
    median_distance: &'w mut [f32],
    /// Normals, `[pixels]`; empty if not requested.
    normals: &'w mut [[f32; 3]],
}

fn if_asked(asked: bool, pixels: usize) -> usize {
    if asked { pixels } else { 0 }
}

impl<'w> TilePixels<'w> {
    pub fn lines(pixels: usize, outputs: Outputs) -> usize {
        let mut measure = Measure::default();
        Self::lay_out(&mut measure, pixels, outputs);
        measure.lines
    }

    /// Allocates a tile of `pixels` pixels from `layout`; all values are 0.
    pub fn lay_out(layout: &mut impl Layout<'w>, pixels: usize, outputs: Outputs) -> Self {
        Self {
            plain: layout.slice(pixels, Plain::default()),
            median_distance: layout.slice(if_asked(outputs.median_distance, pixels), 0.0),
            normals: layout.slice(if_asked(outputs.normals, pixels), [0.0; 3]),
        }
    }

    pub fn put(&mut self, i: usize, pixel: &Pixel) {
        let Pixel { rgb, opacity, ray_distance, z_depth, .. } = *pixel;
        if let Some(plain) = self.plain.get_mut(i) {
            *plain = Plain { rgb, opacity, ray_distance, z_depth };
        }
        if let Some(median_distance) = self.median_distance.get_mut(i) {
            *median_distance = pixel.median_distance;
        }
        if let Some(normal) = self.normals.get_mut(i) {
            *normal = pixel.normal;
        }
    }

    /// Returns pixel `i`. Median distance and normal are 0 if not requested; all values are 0 if `i` is out of range.
    pub fn get(&self, i: usize) -> Pixel {
        let Plain { rgb, opacity, ray_distance, z_depth } = self.plain.get(i).copied().unwrap_or_default();
        let median_distance = self.median_distance.get(i).copied().unwrap_or_default();
        let normal = self.normals.get(i).copied().unwrap_or_default();
        Pixel { rgb, opacity, ray_distance, z_depth, median_distance, normal }
    }
}
