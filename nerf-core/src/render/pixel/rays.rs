//! Sources of a tile's rays: a camera, with or without a depth buffer at which rays end, or rays given by the caller.

use super::placed::Placed;
use super::{Rect, anti_aliasing, depth_of_field};
use crate::camera::{Camera, Lens, PinholeRays, Ray};
use crate::math::log1p;
use crate::plan::{Effects, Plan};
use crate::sampling::SampleJitter;
use crate::simd::{Isa, MAX_LANES, VECTORS};
use crate::volume::Accumulator;
use glam::Vec3;

/// Source of the rays of a tile. For each pixel, returns the ray, the visible range of the ray, and the distance that
/// is output if the pixel shows no surface.
pub(in crate::render) trait RaySource {
    fn ray(&self, x: u32, y: u32) -> Ray;
    /// Writes the rays of the pixels of `part` to `to`, row by row. `part` must have at most [`MAX_LANES`] pixels.
    fn rays(&self, _isa: Isa, part: Rect, to: &mut [Ray]) {
        one_by_one(self, part, to);
    }
    /// Returns the nearest and the farthest visible distance along `ray`, the ray of pixel `(x, y)`, world units.
    fn range(&self, x: u32, y: u32, ray: &Ray) -> [f32; 2];
    /// Returns the far distance of a pixel's `ray`, world units. If the pixel shows no surface, the caller outputs this
    /// distance or the ray's farthest visible distance, whichever is smaller.
    fn far(&self, ray: &Ray) -> f32;
    /// Returns the optical thickness at which the photon of column `x`'s ray collides; infinity without collisions.
    fn until(&self, _x: u32) -> f32 {
        f32::INFINITY
    }
}

fn one_by_one<S: RaySource + ?Sized>(source: &S, part: Rect, to: &mut [Ray]) {
    to.iter_mut().zip(part.pixels()).for_each(|(to, (x, y))| *to = source.ray(x, y));
}

/// Source of a camera's rays, one per pixel. If pixels have several rays, there is one source for each ray index.
pub(in crate::render) struct CameraRays<'a, L> {
    camera: &'a Camera,
    effects: &'a Effects,
    /// Position of the ray in every pixel: distances from the pixel's left and upper edge, in pixels, between 0 and 1.
    offset: (f32, f32),
    /// Index of the ring of the aperture through which the rays pass. The aperture is divided into rings of equal area,
    /// one for each ray of a pixel.
    area: u32,
    limit: &'a L,
    far: f32,
    forward: Vec3,
}

impl<'a, L> CameraRays<'a, L> {
    /// Makes the source of the rays that have index `turn` in their pixels. `limit`: function that takes a pixel's x
    /// and y and returns the end of the pixel's ray. `far`: distance, world units, that is output for pixels without a
    /// surface.
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

    fn rays(&self, isa: Isa, part: Rect, to: &mut [Ray]) {
        let (camera, offset) = (self.camera, self.offset);
        let is_pinhole = self.effects.depth_of_field.is_none() && *camera.lens() == Lens::NONE;
        if !VECTORS || !is_pinhole {
            return one_by_one(self, part, to);
        }
        let mut points = [[0.0; MAX_LANES]; 2];
        for (i, (x, y)) in part.pixels().enumerate().take(MAX_LANES) {
            (points[0][i], points[1][i]) = (x as f32 + offset.0, y as f32 + offset.1);
        }
        isa.run(PinholeRays { camera, points: &points, to });
    }

    #[inline]
    fn range(&self, x: u32, y: u32, ray: &Ray) -> [f32; 2] {
        [0.0, (self.limit)(x, y).along(ray, self.forward)]
    }

    fn far(&self, _: &Ray) -> f32 {
        self.far
    }
}

/// Source of rays that the caller gives. The tile is one row of pixels; the pixel in column `x` has the caller's ray of
/// index `before + x`.
pub(in crate::render) struct OwnRays<'a, R, U, F> {
    /// Index of the caller's ray in column 0: the largest multiple of 2^31 that is not above the index of the tile's
    /// first ray. Columns start again at 0 after every 2^31 rays, so that no column overflows.
    pub before: usize,
    pub ray: &'a R,
    pub placed: Placed,
    /// Function that takes a ray's index and returns a random number in `[0, 1]`, which decides where the ray collides.
    pub random: &'a U,
    /// Function that takes a ray's origin and returns the output distance, world units, of a ray that meets no surface.
    pub far: F,
}

impl<R: Fn(usize) -> RaySegment, U: Fn(usize) -> f32, F: Fn(Vec3) -> f32> RaySource for OwnRays<'_, R, U, F> {
    #[inline]
    fn ray(&self, x: u32, _: u32) -> Ray {
        self.placed.ray((self.ray)(self.before + x as usize).ray)
    }

    fn rays(&self, _: Isa, part: Rect, to: &mut [Ray]) {
        // Transformed in place: the copies of `one_by_one` take 3 % of a batch's time.
        for (to, (x, _)) in to.iter_mut().zip(part.pixels()) {
            *to = (self.ray)(self.before + x as usize).ray;
        }
        self.placed.rays(to);
    }

    #[inline]
    fn range(&self, x: u32, _: u32, _: &Ray) -> [f32; 2] {
        let RaySegment { t_min, t_max, .. } = (self.ray)(self.before + x as usize);
        [t_min, t_max]
    }

    fn far(&self, ray: &Ray) -> f32 {
        (self.far)(ray.origin)
    }

    fn until(&self, x: u32) -> f32 {
        -log1p(-(self.random)(self.before + x as usize))
    }
}

/// A ray given by the caller, with its nearest and farthest visible distance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RaySegment {
    /// The ray; the origin must be finite, and the direction must have unit length.
    pub ray: Ray,
    /// Nearest visible distance, world units along the ray; must be finite and at least 0.
    pub t_min: f32,
    /// Farthest visible distance, world units along the ray; must be at least `t_min`, may be infinite. The sampling
    /// interval (bin) that contains `t_max` is shortened to end there, so that opacity is continuous in `t_max`.
    pub t_max: f32,
}

impl From<Ray> for RaySegment {
    fn from(ray: Ray) -> Self {
        Self { ray, t_min: 0.0, t_max: f32::INFINITY }
    }
}

/// End of a pixel's ray, for example the depth in a depth buffer. With a distance of infinity or NaN, the ray has no
/// end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Limit {
    /// The ray ends at this distance along the ray, world units.
    RayDistance(f32),
    /// The ray ends at this distance along the view axis, world units.
    ZDepth(f32),
}

impl Limit {
    /// No end: the whole ray is visible.
    pub const NONE: Self = Self::RayDistance(f32::INFINITY);

    /// Converts the limit to a distance along `ray`, world units; infinite if the ray never reaches the limit's
    /// z_depth. `forward`: view direction of the camera.
    #[inline]
    pub(crate) fn along(self, ray: &Ray, forward: Vec3) -> f32 {
        match self {
            Self::RayDistance(t) => t,
            Self::ZDepth(z) => {
                let cosine = ray.dir.dot(forward);
                if cosine > 0.0 { z / cosine } else { f32::INFINITY }
            }
        }
    }
}

/// The ray of a pixel, and the sums composited along the ray so far.
#[derive(Clone, Copy)]
pub(in crate::render) struct PixelRay {
    /// The pixel's ray. In a frame of one field, the origin is moved to the point from which distances of samples are
    /// counted.
    pub ray: Ray,
    /// Distance, world units, from the ray's original origin to the point from which sample distances are counted.
    pub start: f32,
    /// Nearest visible distance, and the distance that is output if the ray meets no surface: the smaller of the
    /// ray's farthest visible distance and [`RaySource::far`]. World units from the ray's original origin. In the state
    /// of one field of a `Merge`: nearest and farthest visible distance, in the field's units.
    pub range: [f32; 2],
    pub x: u32,
    pub y: u32,
    /// Whether the ray has ended: its transmittance is below the plan's transmittance cut
    /// ([`Quality::transmittance_cut`](crate::plan::Quality::transmittance_cut)), or it has collided.
    pub done: bool,
    pub gathered: Accumulator,
}

impl PixelRay {
    pub const NONE: Self = Self {
        ray: Ray { origin: Vec3::ZERO, dir: Vec3::NEG_Z },
        start: 0.0,
        range: [0.0, f32::MAX],
        x: 0,
        y: 0,
        done: true,
        gathered: Accumulator::NONE,
    };

    /// Returns the jitter of the ray's samples in frames of `plan`. `turn`: index of the ray within its pixel.
    #[inline]
    pub fn jitter(&self, plan: &Plan<'_>, turn: u32) -> SampleJitter {
        SampleJitter::of(plan.effects.jitter.map(|jitter| jitter.seed), self.x, self.y, turn)
    }
}
