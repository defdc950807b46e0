//! Source of the rays of a tile's pixels: a camera, or the caller.

use super::{Limit, RaySegment, Rect, anti_aliasing, depth_of_field};
use crate::camera::{Camera, Lens, PinholeRays, Ray};
use crate::math::log1p;
use crate::plan::Effects;
use crate::simd::{Isa, MAX_LANES};
use glam::Vec3;

/// Source of the rays of a tile's pixels.
pub(in crate::render) trait RaySource {
    /// The ray of a pixel.
    fn ray(&self, x: u32, y: u32) -> Ray;
    /// The camera, and the position of the rays in their pixels, if the rays are those of a pinhole camera.
    fn pinhole(&self) -> Option<(&Camera, (f32, f32))> {
        None
    }
    /// The rays of the pixels of `part`, up to [`MAX_LANES`] of them, row by row.
    fn rays(&self, isa: Isa, part: Rect, to: &mut [Ray]) {
        let Some((camera, offset)) = self.pinhole() else {
            return to.iter_mut().zip(part.pixels()).for_each(|(to, (x, y))| *to = self.ray(x, y));
        };
        let mut points = [[0.0; MAX_LANES]; 2];
        for (i, (x, y)) in part.pixels().enumerate().take(MAX_LANES) {
            (points[0][i], points[1][i]) = (x as f32 + offset.0, y as f32 + offset.1);
        }
        isa.run(PinholeRays { camera, points: &points, to });
    }
    /// Nearest and farthest visible distance along a pixel's ray, world units.
    fn range(&self, x: u32, y: u32, ray: &Ray) -> [f32; 2];
    /// Distance of a pixel of column `x` whose ray meets no surface, before it is limited to the ray's range.
    fn far(&self, x: u32) -> f32;
    /// The optical thickness at which the ray of column `x` collides.
    fn until(&self, x: u32) -> f32;
}

/// The `turn`-th rays of a camera's pixels.
pub(in crate::render) struct CameraRays<'a, L> {
    camera: &'a Camera,
    effects: &'a Effects,
    /// Position of each ray in its pixel.
    offset: (f32, f32),
    /// Index of the aperture's area that the rays go through.
    area: u32,
    limit: &'a L,
    far: f32,
    forward: Vec3,
}

impl<'a, L> CameraRays<'a, L> {
    /// `limit` says where the ray of a pixel ends; `far` is the distance of pixels without a surface.
    pub fn new(camera: &'a Camera, effects: &'a Effects, turn: u32, limit: &'a L, far: f32) -> Self {
        let (offset, area) = (anti_aliasing::offset(effects, turn), depth_of_field::area(effects, turn));
        Self { camera, effects, offset, area, limit, far, forward: camera.pose().forward() }
    }
}

impl<L: Fn(u32, u32) -> Limit> RaySource for CameraRays<'_, L> {
    #[inline]
    fn ray(&self, x: u32, y: u32) -> Ray {
        let ray = self.camera.ray(x as f32 + self.offset.0, y as f32 + self.offset.1);
        depth_of_field::through_lens(self.effects, self.camera.pose(), ray, (x, y), self.area)
    }

    fn pinhole(&self) -> Option<(&Camera, (f32, f32))> {
        let pinhole = self.effects.depth_of_field.is_none() && *self.camera.lens() == Lens::NONE;
        pinhole.then_some((self.camera, self.offset))
    }

    #[inline]
    fn range(&self, x: u32, y: u32, ray: &Ray) -> [f32; 2] {
        [0.0, (self.limit)(x, y).along(ray, self.forward)]
    }

    fn far(&self, _: u32) -> f32 {
        self.far
    }

    fn until(&self, _: u32) -> f32 {
        f32::INFINITY
    }
}

/// Rays of the caller's, with any origins: those from index `first` on are the pixels of a row.
pub(in crate::render) struct OwnRays<'a, R, U, F> {
    pub first: usize,
    pub ray: &'a R,
    /// The random number of a ray.
    pub random: &'a U,
    /// The distance of a ray that meets no surface, by its origin.
    pub far: F,
}

impl<R: Fn(usize) -> RaySegment, U: Fn(usize) -> f32, F: Fn(Vec3) -> f32> RaySource for OwnRays<'_, R, U, F> {
    #[inline]
    fn ray(&self, x: u32, _: u32) -> Ray {
        (self.ray)(self.first + x as usize).ray
    }

    #[inline]
    fn range(&self, x: u32, _: u32, _: &Ray) -> [f32; 2] {
        let RaySegment { t_min, t_max, .. } = (self.ray)(self.first + x as usize);
        [t_min, t_max]
    }

    fn far(&self, x: u32) -> f32 {
        (self.far)(self.ray(x, 0).origin)
    }

    fn until(&self, x: u32) -> f32 {
        -log1p(-(self.random)(self.first + x as usize))
    }
}
