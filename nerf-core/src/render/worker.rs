//! Workers. A worker has a renderer, a plan and working memory, set up once for any number of frames and queries.
//!
//! This file is longer than 400 lines, since each way of calling a worker is documented where it is declared.

use super::frame::Frame;
use super::pixel::{CameraRays, OwnRays, Pixels, rays_a_pixel};
use super::{Counters, Limit, RaySegment, Rect, RenderError, Target};
use crate::camera::{Camera, Ray, is_unit};
use crate::plan::Plan;
use crate::volume::Pixel;
use core::ops::Range;
use glam::Vec3;
#[cfg(feature = "instances")]
use {
    super::Renderer,
    super::error::check_memory,
    super::instances::{Instance, Merge, check},
    super::pixel::Placed,
    crate::memory::{Arena, Line, Measure},
    crate::space::Placement,
};

/// Side of the square tiles into which a rectangle is divided, pixels. In a small tile, rays tend to end after similar
/// numbers of samples.
pub const TILE_SIDE: u32 = 16;

/// Object that renders frames with the settings of one [`Plan`], in a workspace of its own; one per thread. Made by
/// [`Renderer::worker`](super::Renderer::worker).
///
/// The workspace is divided into buffers once, when the worker is made. Later calls have almost no overhead.
pub struct Worker<'f> {
    pub(super) fields: Fields<'f>,
    pub(super) pixels: Pixels<'f, 'f>,
}

/// Content of a [`Worker`]'s frames: one field, or several fields in one world.
#[cfg_attr(
    feature = "instances",
    allow(clippy::large_enum_variant, reason = "a worker is one or the other, and there is no heap")
)]
pub(super) enum Fields<'f> {
    One(Frame<'f, 'f>),
    #[cfg(feature = "instances")]
    Several(Merge<'f, 'f>),
}

/// Evaluates `$body` with `$it` bound to the `Frame` of one field or to the `Merge` of several fields.
macro_rules! of_fields {
    ($fields:expr, $it:ident => $body:expr) => {
        match $fields {
            Fields::One($it) => $body,
            #[cfg(feature = "instances")]
            Fields::Several($it) => $body,
        }
    };
}

#[cfg(feature = "instances")]
impl<'f> Worker<'f> {
    /// Number of 64-byte lines of memory that [`Worker::of_instances`] needs. `renderers`: the renderer of each
    /// instance. `plan`: the plan of the last instance.
    pub fn instances_lines<'n>(
        renderers: impl Iterator<Item = &'n Renderer<'n>> + Clone,
        plan: &Plan<'_>,
    ) -> usize {
        let networks = renderers.clone().map(|renderer| renderer.network());
        let merged =
            Measure::lines_of(|it| (Merge::lay_out(it, &[], networks, plan), Pixels::lay_out(it, plan)));
        let mut alone = renderers.map(|renderer| renderer.workspace_lines(plan));
        match (alone.next(), alone.next()) {
            (Some(lines), None) => lines.max(merged),
            _ => merged,
        }
    }

    /// Returns a worker that renders several placed fields in one frame, or one placed field.
    ///
    /// Cameras, rays, points and distances are in the world in which the instances are placed. Where fields overlap,
    /// densities add, and colours are averaged with the densities as weights. Two instances of a field in one place
    /// thus equal the field with twice the density. A field is not evaluated behind an opaque part of another field.
    ///
    /// With deferred shading ([`Shading::PerRay`](crate::network::Shading::PerRay)) each weight along a ray is divided
    /// among the fields in proportion to their densities; each field gets a share of the weight. A field's colour
    /// branch is evaluated once per ray, at the mean of the hidden features `h`, weighted by the field's shares. The
    /// ray's colour is the mean of the fields' colours, each weighted by the sum of the field's shares.
    ///
    /// A single field that is not scaled is rendered in its own coordinates, as fast as by a worker made by
    /// [`Renderer::worker`]. At [`Placement::IDENTITY`], the pixels are also bit-identical to those of that worker.
    ///
    /// # Errors
    /// [`RenderError::NoInstances`] if `instances` is empty. [`RenderError::Instance`] with the index of the first
    /// instance that cannot be rendered with the others. [`RenderError::Memory`] if `memory` has fewer lines than
    /// [`Worker::instances_lines`] returns.
    pub fn of_instances(instances: &'f [Instance<'f>], memory: &'f mut [Line]) -> Result<Self, RenderError> {
        let last = check(instances)?;
        let renderers = instances.iter().map(|instance| instance.renderer);
        check_memory(Self::instances_lines(renderers.clone(), last.plan), memory)?;
        if let [Instance { renderer, plan, placement }] = instances
            && placement.is_rigid()
        {
            let mut worker = renderer.worker(plan, memory)?;
            // The identity is skipped, since applying it would change −0 to 0.
            worker.pixels.placed = Placed(Some(*placement).filter(|it| *it != Placement::IDENTITY));
            return Ok(worker);
        }
        let networks = renderers.map(|renderer| renderer.network());
        let mut arena = Arena::new(memory);
        let fields = Fields::Several(Merge::lay_out(&mut arena, instances, networks, last.plan));
        Ok(Self { fields, pixels: Pixels::lay_out(&mut arena, last.plan) })
    }
}

impl<'f> Worker<'f> {
    /// Returns the plan of the worker's frames; with several fields, the plan of the last field.
    pub fn plan(&self) -> &'f Plan<'f> {
        self.pixels.plan
    }

    fn counters(&mut self) -> Counters {
        core::mem::take(&mut self.pixels.counters)
    }

    /// Renders the pixels of `rect`, and passes each pixel to `target`. Returns counters of the work.
    ///
    /// With the same kernel and maths backend, pixels are bit-identical: `rect`, the plan's batch, earlier calls and
    /// other threads do not affect them.
    ///
    /// # Errors
    /// [`RenderError::Rect`] on a rectangle outside the image, before anything is written.
    pub fn render(
        &mut self,
        camera: &Camera,
        rect: Rect,
        target: &mut impl Target,
    ) -> Result<Counters, RenderError> {
        self.render_limited(camera, rect, |_, _| Limit::NONE, target)
    }

    /// Renders the pixels of `rect` against a depth buffer: the ray of pixel (x, y) ends at `limit(x, y)`.
    ///
    /// The bin that contains the limit is shortened, not left out: opacity depends continuously on the limit. If a ray
    /// meets no surface before the limit, each output distance is the smaller of two values: the limit, and the result
    /// of [`Plan::far_from`] for the camera's position.
    ///
    /// # Errors
    /// As [`Worker::render`].
    pub fn render_limited(
        &mut self,
        camera: &Camera,
        rect: Rect,
        limit: impl Fn(u32, u32) -> Limit,
        target: &mut impl Target,
    ) -> Result<Counters, RenderError> {
        let i = camera.intrinsics();
        if !rect.fits(i.width, i.height) {
            return Err(RenderError::Rect { rect, width: i.width, height: i.height });
        }
        let plan = self.plan();
        // Lossless cast: a plan's batch has at most `Batch::MAX_RAYS` rays.
        let capacity = plan.batch.rays as u32;
        let width = TILE_SIDE.min(capacity);
        let pixels = &mut self.pixels;
        let camera = &pixels.placed.camera(camera);
        pixels.forward = camera.pose().forward();
        for tile in rect.tiles(width, capacity / width.max(1)) {
            pixels.tile = tile;
            of_fields!(&mut self.fields, it => {
                let far = it.far()(camera.pose().position);
                for turn in 0..rays_a_pixel(&plan.effects) {
                    pixels.turn = turn;
                    let source = CameraRays::new(camera, &plan.effects, turn, &limit, far);
                    it.turn::<false>(pixels, &source, target);
                }
            });
        }
        Ok(self.counters())
    }

    /// Sets whether colour is composited over the plan's background (`true`, the default) or over black (`false`).
    pub fn show_background(&mut self, shown: bool) {
        self.pixels.background = shown;
    }

    /// Renders rays of the caller, one pixel per ray: `target` receives the index and the pixel of each ray.
    ///
    /// A ray may begin inside or outside of the scene. If a ray meets no surface, each output distance is the smaller
    /// of `t_max` and the result of [`Plan::far_from`](crate::plan::Plan::far_from) for the ray's origin. `z_depth` is
    /// measured along `axis`, of unit length; without an axis, `z_depth` is 0. For a camera's rays, the pixels are
    /// bit-identical to those of [`Worker::render`] if the plan has no jitter. With jitter, the ray at index `i` has
    /// the random sample positions of the pixel in column `i`, row 0.
    ///
    /// # Errors
    /// Errors are found before anything is written:
    /// - [`RenderError::CameraEffects`] if the plan has several rays per pixel or an aperture, which need a camera
    /// - [`RenderError::Axis`] if `axis` is not of unit length
    /// - [`RenderError::Ray`] with the index of the first ray whose origin is not finite or whose direction is not of
    ///   unit length
    /// - [`RenderError::RayRange`] with the index of the first ray without `0 <= t_min <= t_max` or with an infinite
    ///   `t_min`
    pub fn render_rays(
        &mut self,
        rays: &[RaySegment],
        axis: Option<Vec3>,
        target: &mut impl FnMut(usize, &Pixel),
    ) -> Result<Counters, RenderError> {
        self.render_rays_with(rays.len(), &|i| ray_at(rays, i), axis, target)
    }

    /// Renders rays as [`Worker::render_rays`] does, but takes them from a function: `ray(i)` returns the `i`-th of
    /// `count` rays, and must always return the same ray for the same `i`.
    ///
    /// # Errors
    /// As [`Worker::render_rays`].
    pub fn render_rays_with(
        &mut self,
        count: usize,
        ray: &impl Fn(usize) -> RaySegment,
        axis: Option<Vec3>,
        target: &mut impl FnMut(usize, &Pixel),
    ) -> Result<Counters, RenderError> {
        self.check_rays(0..count, ray, axis)?;
        Ok(self.rows_of_rays::<false>(0..count, ray, &|_| 0.0, axis, target))
    }

    /// Renders the rays `rays[range]`. The pixels equal those of one [`Worker::render_rays`] call with all `rays`.
    #[cfg(feature = "std")]
    pub(crate) fn render_range_of_rays(
        &mut self,
        rays: &[RaySegment],
        range: Range<usize>,
        axis: Option<Vec3>,
        target: &mut impl FnMut(usize, &Pixel),
    ) -> Result<Counters, RenderError> {
        let ray = |i| ray_at(rays, i);
        self.check_rays(range.clone(), &ray, axis)?;
        Ok(self.rows_of_rays::<false>(range, &ray, &|_| 0.0, axis, target))
    }

    /// Draws the point on each ray at which a photon collides with the field, for path tracers. Passes each ray's index
    /// and pixel to `target`. `axis`: as in [`Worker::render_rays`].
    ///
    /// `random`: a number in `[0, 1]` for each ray. The number 1 is replaced by the largest f32 below 1, since rounding
    /// to f32 may have changed a smaller number to 1. A ray collides where its opacity reaches its random number. The
    /// pixel of a ray that collides has opacity 1, the distances of the collision point, and the colour and normal of
    /// the sample in whose interval the ray collides. The pixel of a ray without a collision has opacity 0, infinite
    /// distances and the background's colour.
    ///
    /// The probability of a collision in a sample's interval is the sample's weight in [`Worker::render_rays`]. With
    /// uniform random numbers, the mean colour is therefore the colour that [`Worker::render_rays`] composites if the
    /// plan's transmittance cut and colour cut are 0. This function ignores both cuts.
    ///
    /// With deferred shading ([`Shading::PerRay`](crate::network::Shading::PerRay)) the colour branch is evaluated for
    /// the collision's sample alone, as by [`Worker::query`]. Since a network is not linear, the mean of these colours
    /// is *not* the colour that [`Worker::render_rays`] composites. To reproduce the field's own image, a path tracer
    /// takes the point from this function and the colour of the same ray from [`Worker::render_rays`]. The mean
    /// opacity, however, equals the composited opacity. Over the collisions, the mean distance equals the composited
    /// distance to within one sample interval, and the mean normal has the direction of the composited normal.
    ///
    /// # Errors
    /// As [`Worker::render_rays`]; [`RenderError::Random`] with the index of the first number that is not in `[0, 1]`,
    /// or the first index at which only a ray or only a number is given.
    pub fn sample_rays(
        &mut self,
        rays: &[RaySegment],
        random: &[f32],
        axis: Option<Vec3>,
        target: &mut impl FnMut(usize, &Pixel),
    ) -> Result<Counters, RenderError> {
        if random.len() > rays.len() {
            return Err(RenderError::Random { index: rays.len() });
        }
        let number = |i: usize| random.get(i).copied().unwrap_or(f32::NAN);
        self.sample_rays_with(rays.len(), &|i| ray_at(rays, i), &number, axis, target)
    }

    /// Draws collisions as [`Worker::sample_rays`] does. `ray(i)` returns ray `i`, and `random(i)` the random number of
    /// ray `i`; each function must always return the same value for the same `i`.
    ///
    /// # Errors
    /// As [`Worker::sample_rays`].
    pub fn sample_rays_with(
        &mut self,
        count: usize,
        ray: &impl Fn(usize) -> RaySegment,
        random: &impl Fn(usize) -> f32,
        axis: Option<Vec3>,
        target: &mut impl FnMut(usize, &Pixel),
    ) -> Result<Counters, RenderError> {
        self.check_rays(0..count, ray, axis)?;
        if let Some(index) = (0..count).find(|&i| !(0.0..=1.0).contains(&random(i))) {
            return Err(RenderError::Random { index });
        }
        let below_one = |i: usize| random(i).min(1.0 - f32::EPSILON / 2.0);
        let mut put = |index: usize, pixel: &Pixel| {
            let t = if pixel.opacity > 0.0 { pixel.ray_distance } else { f32::INFINITY };
            let z_depth = match axis {
                Some(_) if pixel.opacity == 0.0 => f32::INFINITY,
                _ => pixel.z_depth,
            };
            target(index, &Pixel { ray_distance: t, z_depth, median_distance: t, ..*pixel });
        };
        Ok(self.rows_of_rays::<true>(0..count, ray, &below_one, axis, &mut put))
    }

    fn check_rays(
        &self,
        range: Range<usize>,
        ray: &impl Fn(usize) -> RaySegment,
        axis: Option<Vec3>,
    ) -> Result<(), RenderError> {
        let effects = &self.plan().effects;
        if effects.anti_aliasing > 1 || effects.depth_of_field.is_some() {
            return Err(RenderError::CameraEffects);
        }
        if let Some(found) = axis.filter(|axis| !is_unit(*axis)) {
            return Err(RenderError::Axis { found: found.into() });
        }
        for index in range {
            let RaySegment { ray, t_min, t_max } = ray(index);
            if !(ray.origin.is_finite() && is_unit(ray.dir)) {
                return Err(RenderError::Ray { index });
            }
            if !(t_min >= 0.0 && t_min <= t_max && t_min.is_finite()) {
                return Err(RenderError::RayRange { index, t_min, t_max });
            }
        }
        Ok(())
    }

    fn rows_of_rays<const COLLIDE: bool>(
        &mut self,
        range: Range<usize>,
        ray: &impl Fn(usize) -> RaySegment,
        random: &impl Fn(usize) -> f32,
        axis: Option<Vec3>,
        target: &mut impl FnMut(usize, &Pixel),
    ) -> Counters {
        let (plan, placed) = (self.plan(), self.pixels.placed);
        let capacity = plan.batch.rays.max(1);
        for first in range.clone().step_by(capacity) {
            // A ray's column is its index, which selects its random numbers whatever the batch. Columns begin anew
            // after 2^31 rays, so that none overflows.
            let x = (first % (1 << 31)) as u32;
            let before = first - x as usize;
            let mut put = |x: u32, _: u32, pixel: &Pixel| target(before + x as usize, pixel);
            // Lossless cast: a plan's batch has at most `Batch::MAX_RAYS` rays.
            self.pixels.tile = Rect { x, y: 0, width: capacity.min(range.end - first) as u32, height: 1 };
            (self.pixels.forward, self.pixels.turn) = (axis.map_or(Vec3::ZERO, |axis| placed.dir(axis)), 0);
            of_fields!(&mut self.fields, it => {
                let source = OwnRays { before, ray, placed, random, far: it.far() };
                it.turn::<COLLIDE>(&mut self.pixels, &source, &mut put);
            });
        }
        self.counters()
    }

    /// Evaluates density and colour at points that are seen along given directions.
    ///
    /// `positions` and unit vectors `dirs`: `[n]`, world space. `sigma`: `[n]`, 1/world unit. `rgb`: `[n]`,
    /// display-encoded, or empty if no colour is requested. Points outside the box of a bounded scene, points in an
    /// empty cell of the plan's occupancy grid, and points whose density is NaN get density 0 and black colour. A
    /// colour that is NaN becomes black ([`Counters::invalid_samples`]). With deferred shading, a point gets the colour
    /// of a ray that has the point as its only sample.
    ///
    /// # Errors
    /// [`RenderError`] on lengths that differ, and on a direction that is not of unit length if colour is requested.
    pub fn query(
        &mut self,
        positions: &[[f32; 3]],
        dirs: &[[f32; 3]],
        sigma: &mut [f32],
        rgb: &mut [[f32; 3]],
    ) -> Result<Counters, RenderError> {
        let n = positions.len();
        if dirs.len() != n || sigma.len() != n || !(rgb.len() == n || rgb.is_empty()) {
            return Err(RenderError::Lengths {
                positions: n,
                dirs: dirs.len(),
                sigma: sigma.len(),
                rgb: rgb.len(),
            });
        }
        let plan = self.plan();
        // Neither positions outside the box nor directions that are not of unit length are ever encoded.
        if plan.outputs.rgb
            && !rgb.is_empty()
            && let Some((index, &found)) =
                dirs.iter().enumerate().find(|(_, dir)| !is_unit(Vec3::from(**dir)))
        {
            return Err(RenderError::Direction { index, found });
        }
        let capacity = plan.batch.rays.min(plan.batch.samples).max(1);
        let placed = self.pixels.placed;
        let in_field = |(&origin, &dir): (&[f32; 3], &[f32; 3])| {
            let Ray { origin, dir } = placed.ray(Ray { origin: origin.into(), dir: dir.into() });
            (origin, dir)
        };
        let points = positions.chunks(capacity).zip(dirs.chunks(capacity));
        let mut colours = rgb.chunks_mut(capacity);
        for ((positions, dirs), sigma) in points.zip(sigma.chunks_mut(capacity)) {
            let rgb = colours.next().unwrap_or_default();
            sigma.fill(0.0);
            rgb.fill([0.0; 3]);
            let (points, counters) = (positions.iter().zip(dirs).map(in_field), &mut self.pixels.counters);
            of_fields!(&mut self.fields, it => it.points(points, sigma, rgb, counters));
        }
        Ok(self.counters())
    }
}

/// Returns `rays[i]`, without code that can panic. Callers pass only valid indices; for an index out of range, the
/// result is an arbitrary ray.
fn ray_at(rays: &[RaySegment], i: usize) -> RaySegment {
    rays.get(i).copied().unwrap_or(Ray { origin: Vec3::ZERO, dir: Vec3::NEG_Z }.into())
}
