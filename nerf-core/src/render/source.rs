//! Where the rays of a tile's pixels come from: a camera, or the caller.

use super::{Limit, RaySegment, anti_aliasing, depth_of_field};
use crate::camera::{Camera, Ray};
use crate::math::log1p;
use crate::plan::Effects;
use glam::Vec3;

/// Where the rays of a tile's pixels come from.
pub(super) trait RaySource {
    /// The ray of a pixel.
    fn ray(&self, x: u32, y: u32) -> Ray;
    /// The distances that are asked for of it, world units along it.
    fn range(&self, x: u32, y: u32, ray: &Ray) -> [f32; 2];
    /// The distance of a pixel of that column where its ray meets no surface, but for its own range.
    fn far(&self, x: u32) -> f32;
    /// The optical thickness at which the ray of that column collides.
    fn until(&self, x: u32) -> f32;
}

/// The `turn`-th rays of a camera's pixels.
pub(super) struct CameraRays<'a, L> {
    camera: &'a Camera,
    effects: &'a Effects,
    /// Where in its pixel each ray lies, and where on the aperture.
    offset: (f32, f32),
    area: u32,
    limit: &'a L,
    far: f32,
}

impl<'a, L> CameraRays<'a, L> {
    /// `limit` says where the ray of a pixel ends; `far` is the distance of pixels without a surface.
    pub fn new(camera: &'a Camera, effects: &'a Effects, turn: u32, limit: &'a L, far: f32) -> Self {
        let (offset, area) = (anti_aliasing::offset(effects, turn), depth_of_field::area(effects, turn));
        Self { camera, effects, offset, area, limit, far }
    }
}

impl<L: Fn(u32, u32) -> Limit> RaySource for CameraRays<'_, L> {
    #[inline]
    fn ray(&self, x: u32, y: u32) -> Ray {
        let ray = self.camera.ray(x as f32 + self.offset.0, y as f32 + self.offset.1);
        depth_of_field::through_lens(self.effects, self.camera.pose(), ray, (x, y), self.area)
    }

    #[inline]
    fn range(&self, x: u32, y: u32, ray: &Ray) -> [f32; 2] {
        [0.0, (self.limit)(x, y).along(ray, self.camera.pose().forward())]
    }

    fn far(&self, _: u32) -> f32 {
        self.far
    }

    fn until(&self, _: u32) -> f32 {
        f32::INFINITY
    }
}

/// Rays of the caller's own, each from where it likes: `first` and those behind it, the pixels of a row.
pub(super) struct OwnRays<'a, R, U, F> {
    pub first: usize,
    pub ray: &'a R,
    /// The random number of a ray.
    pub random: &'a U,
    /// The distance of rays from a point that meet no surface.
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
