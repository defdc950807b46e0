//! Several rays per pixel: the position of each ray in its pixel, and the mean of the rays' results.

use crate::math::Sum;
use crate::memory::Layout;
use crate::plan::Effects;
use crate::sampling::random::{GOLDEN, rank};
use crate::volume::{OPACITY_EPSILON, Pixel, mean_direction};

#[cfg(test)]
mod tests;

/// Number of rays per pixel.
#[inline]
pub(crate) fn rays(effects: &Effects) -> u32 {
    effects.anti_aliasing.into()
}

/// Returns the position of ray `ray` in its pixel: distances from the left and the upper edge, pixels, in `(0, 1)`. A
/// single ray is at the centre.
///
/// Positions are the same in every pixel. `n` rays divide the pixel into `n` columns and `n` rows; each column and each
/// row has one ray. The mean position is therefore the pixel's centre.
#[inline]
pub(crate) fn offset(effects: &Effects, ray: u32) -> (f32, f32) {
    match rays(effects) {
        1 => (0.5, 0.5),
        rays => place_in_pixel(ray, rays),
    }
}

/// Position of ray number `ray` within the pixel: a point of a Fibonacci lattice of `rays` points. The pixel is divided
/// into `rays` × `rays` cells, and the point is the centre of one of them. Its column is `ray`. Its row is the rank of
/// `fract(ray φ)` among the values `fract(i φ)` for `i` in `0..rays`, where φ is the golden ratio.
#[inline(never)]
fn place_in_pixel(ray: u32, rays: u32) -> (f32, f32) {
    let middle = |cell: u32| (cell as f32 + 0.5) / rays as f32;
    (middle(ray), middle(rank(GOLDEN, ray, rays)))
}

/// Sums of colour, opacity and distances of one pixel's finished rays.
#[derive(Clone, Copy, Default)]
struct PixelSum {
    rgb: [Sum; 3],
    opacity: Sum,
    /// Sum of opacity over the rays that meet a surface: rays of opacity above [`OPACITY_EPSILON`]. The sums of
    /// distances are divided by this sum.
    surface: Sum,
    /// Sum of opacity times `ray_distance`, over the rays that meet a surface.
    ray_distance: Sum,
    /// Sum of opacity times `z_depth`, over the rays that meet a surface.
    z_depth: Sum,
}

impl PixelSum {
    fn add(&mut self, pixel: &Pixel) {
        // Destructured in full, so that a new field of [`Pixel`] is not forgotten here.
        let Pixel { rgb, opacity, ray_distance, z_depth, median_distance: _, normal: _ } = *pixel;
        for (sum, c) in self.rgb.iter_mut().zip(rgb) {
            sum.add(c);
        }
        self.opacity.add(opacity);
        if opacity > OPACITY_EPSILON {
            self.surface.add(opacity);
            self.ray_distance.add(opacity * ray_distance);
            self.z_depth.add(opacity * z_depth);
        }
    }

    /// Returns the mean result of the pixel's `rays` rays. Distances are weighted by opacity. If the mean opacity is
    /// too low for a surface, the distances are `far`.
    fn mean(&self, rays: u32, far: f32) -> Pixel {
        let rays = rays as f32;
        let opacity = self.opacity.value / rays;
        // A mean above the epsilon implies, except for rounding, that at least one ray meets a surface.
        let seen = opacity > OPACITY_EPSILON && self.surface.value > 0.0;
        let distance = |sum: Sum| if seen { sum.value / self.surface.value } else { far };
        Pixel {
            rgb: self.rgb.map(|sum| sum.value / rays),
            opacity,
            ray_distance: distance(self.ray_distance),
            z_depth: distance(self.z_depth),
            ..Pixel::BLANK
        }
    }
}

/// Sums of the median distances and normals of a pixel's rays. Not part of [`PixelSum`], since few frames need them.
#[derive(Clone, Copy, Default)]
struct SurfaceSum {
    /// Number of rays that reach an opacity of one half and thus have a median distance.
    halved: u16,
    /// Sum of the median distances of the `halved` rays.
    median_distance: Sum,
    normal: [Sum; 3],
}

impl SurfaceSum {
    fn add(&mut self, pixel: &Pixel, far: f32) {
        if pixel.median_distance < far {
            self.halved += 1;
            self.median_distance.add(pixel.median_distance);
        }
        for (sum, axis) in self.normal.iter_mut().zip(pixel.normal) {
            sum.add(pixel.opacity * axis);
        }
    }

    /// Sets the normal and the median distance of `mean`. The normal is the rays' mean normal, weighted by opacity. The
    /// median distance is the mean of the rays' median distances, or `far` if fewer than half of the rays have one. An
    /// output that was not requested is 0.
    fn finish(&self, rays: u32, far: f32, mean: &mut Pixel) {
        let sum = self.normal.map(|sum| sum.value);
        mean.normal = mean_direction(sum, mean.opacity * rays as f32, mean.opacity);
        let halved = 2 * u32::from(self.halved) >= rays;
        mean.median_distance = if halved { self.median_distance.value / f32::from(self.halved) } else { far };
    }
}

/// Sums of the results of each pixel's finished rays, for the pixels of a tile; empty if a pixel has one ray.
pub(crate) struct Sums<'w> {
    pixels: &'w mut [PixelSum],
    /// Sums of median distances and normals, one element per pixel; empty if neither output is requested.
    surfaces: &'w mut [SurfaceSum],
}

impl<'w> Sums<'w> {
    /// Reserves sums for `pixels` pixels; none if a pixel has only one ray. `surface`: whether a median distance or a
    /// normal is requested.
    pub fn lay_out(layout: &mut impl Layout<'w>, effects: &Effects, surface: bool, pixels: usize) -> Self {
        let pixels = if rays(effects) > 1 { pixels } else { 0 };
        let surfaces = if surface { pixels } else { 0 };
        let pixels = layout.slice(pixels, PixelSum::default());
        Self { pixels, surfaces: layout.slice(surfaces, SurfaceSum::default()) }
    }

    /// Adds `pixel`, the result of ray `ray`, to the sums of pixel `index` of the tile. After the pixel's last ray,
    /// sets `pixel` to the mean of the rays and returns `true`; else returns `false`. `far`: distance, world units,
    /// that is output for a pixel without a surface.
    #[inline]
    pub fn add(&mut self, effects: &Effects, index: usize, ray: u32, pixel: &mut Pixel, far: f32) -> bool {
        let rays = rays(effects);
        rays == 1 || self.add_ray(index, ray, rays, pixel, far)
    }

    #[inline(never)]
    fn add_ray(&mut self, index: usize, ray: u32, rays: u32, pixel: &mut Pixel, far: f32) -> bool {
        let Some(sum) = self.pixels.get_mut(index) else { return false };
        let mut surface = self.surfaces.get_mut(index);
        if ray == 0 {
            *sum = PixelSum::default();
            if let Some(surface) = &mut surface {
                **surface = SurfaceSum::default();
            }
        }
        sum.add(pixel);
        if let Some(surface) = &mut surface {
            surface.add(pixel, far);
        }
        if ray + 1 < rays {
            return false;
        }
        *pixel = sum.mean(rays, far);
        if let Some(surface) = surface {
            surface.finish(rays, far, pixel);
        }
        true
    }
}
