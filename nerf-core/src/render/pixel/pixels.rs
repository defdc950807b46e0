//! Pixels of the current tile. The results of each pixel's rays become one pixel, which is passed to the target.

use super::anti_aliasing::Sums;
use super::placed::Placed;
use super::tone;
use super::{Medians, PixelRay, Rect, Surface, Target};
use crate::memory::Layout;
use crate::plan::Plan;
use crate::render::Counters;
use crate::volume::Pixel;
use glam::Vec3;

pub(in crate::render) struct Pixels<'f, 'w> {
    pub plan: &'f Plan<'f>,
    sums: Sums<'w>,
    /// Index, within its pixel, of the ray that is currently rendered. The pixels of a tile all have the same current
    /// index.
    pub turn: u32,
    pub tile: Rect,
    /// Whether colour is composited over the plan's background (`true`) or over black (`false`).
    pub background: bool,
    /// Axis along which z_depth is measured, a unit vector in the coordinates of the rays; 0 if the caller gives no
    /// axis.
    pub forward: Vec3,
    pub placed: Placed,
    pub counters: Counters,
}

impl<'f, 'w> Pixels<'f, 'w> {
    pub fn lay_out(layout: &mut impl Layout<'w>, plan: &'f Plan<'f>) -> Self {
        Self {
            plan,
            sums: Sums::lay_out(layout, &plan.effects, plan.outputs.surface(), plan.batch.rays),
            turn: 0,
            tile: Rect { x: 0, y: 0, width: 0, height: 0 },
            background: true,
            forward: Vec3::ZERO,
            placed: Placed::NONE,
            counters: Counters::default(),
        }
    }

    /// Adds the result of `ray` to the ray's pixel. `hit`: median distances and normals of all rays of the tile, and
    /// the index of `ray` among these rays; `None` if the ray has no samples in occupied cells.
    #[inline(never)]
    pub fn finish(&mut self, ray: &PixelRay, hit: Option<(&Surface<'_>, usize)>, target: &mut dyn Target) {
        let [_, far] = ray.range;
        let cosine = ray.ray.dir.dot(self.forward);
        let background = self.background();
        let mut seen = ray.gathered.finish_from(ray.start, ray.done, background, far, cosine);
        match hit {
            Some((surface, index)) => surface.finish(index, ray.start, far, &mut seen),
            None => seen.median_distance = self.median_of_missed(far),
        }
        seen.normal = self.placed.normal(seen.normal);
        self.put((ray.x, ray.y), seen, far, target);
    }

    /// Adds the result of a ray without samples to pixel `(x, y)`. `far`: the distance that is output, world units.
    pub fn miss(&mut self, (x, y): (u32, u32), far: f32, target: &mut dyn Target) {
        self.counters.samples_skipped += u64::from(self.plan.samples_per_ray());
        let median_distance = self.median_of_missed(far);
        let rgb = self.background();
        let seen = Pixel { rgb, ray_distance: far, z_depth: far, median_distance, ..Pixel::BLANK };
        self.put((x, y), seen, far, target);
    }

    fn median_of_missed(&self, far: f32) -> f32 {
        if Medians::BUILT && self.plan.outputs.median_distance { far } else { 0.0 }
    }

    /// Returns the colour behind a ray: the plan's background, or black if the background is not shown.
    fn background(&self) -> [f32; 3] {
        let shown = self.plan.outputs.rgb && self.background;
        tone::background(
            &self.plan.effects.tone,
            self.plan.math,
            if shown { self.plan.background } else { [0.0; 3] },
        )
    }

    /// Adds `seen`, the result of a ray, to pixel `(x, y)`. After the pixel's last ray, passes the pixel to `target`.
    /// `far`: distance, world units, that is output if the pixel shows no surface.
    fn put(&mut self, (x, y): (u32, u32), mut seen: Pixel, far: f32, target: &mut dyn Target) {
        let (effects, math, tile) = (&self.plan.effects, self.plan.math, self.tile);
        seen.rgb = tone::to_light(&effects.tone, math, seen.rgb);
        let index = (y - tile.y) as usize * tile.width as usize + (x - tile.x) as usize;
        if self.sums.add(effects, index, self.turn, &mut seen, far) {
            // Without an axis there is no z_depth, not even of a miss.
            if self.forward == Vec3::ZERO {
                seen.z_depth = 0.0;
            }
            seen.rgb = tone::to_display(&effects.tone, math, seen.rgb);
            target.put(x, y, &seen);
        }
    }
}
