//! Which part of a ray is sampled, and where.

use super::Plan;
use crate::camera::Ray;
use crate::sampling::Ends;
use crate::space::{Contraction, SceneBox};
use core::ops::Range;
use glam::Vec3;

/// How the samples of a ray are found from a plan's bins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Lattice {
    /// The bins are the scene's, from near to far, and there are no others.
    Own,
    /// The scene's bins go on in front of near and behind far: a ray takes those it needs.
    Extended,
    /// The first bin begins where the ray enters the scene box.
    March,
    /// The scene has no end: bins count the steps of its contraction, from the point of the ray nearest to its middle.
    Contracted,
}

/// The part of a ray that is sampled.
pub(crate) struct Span {
    /// The ray, from the point its samples are counted from.
    pub ray: Ray,
    /// How far that is along the ray, world units.
    pub start: f32,
    /// The bins that may have a sample worth asking for.
    pub bins: Range<u32>,
    /// How the outermost bins of the ray are cut.
    pub ends: Ends,
}

/// What rounding may move a point by, that is so far away: the slab test and the way to the point.
pub(super) const ROUNDING: f32 = 4.0 * f32::EPSILON;

impl Plan<'_> {
    /// What is sampled of `ray` within a `range` of distances ([`Plan::range_of`]); nothing outside of `around` is worth it.
    ///
    /// Distances within the scene are small, whatever the way there: samples are counted from a point at the box, and
    /// only what leaves the frame has the way there added.
    pub(crate) fn span(&self, around: &SceneBox, ray: &Ray, range: [f32; 2]) -> Option<Span> {
        if range[0] >= range[1] {
            return None;
        }
        if let Some(contraction) = &self.contraction {
            return self.contracted_span(contraction, ray, range);
        }
        let walk = self.proposal.as_ref().unwrap_or(&self.bins);
        // What of a proposal's samples counts is cut when they are drawn.
        let (t_min, t_max) = if self.proposal.is_some() { (0.0, f32::MAX) } else { range.into() };
        let (near, far) = match self.lattice {
            Lattice::Own => (self.near.max(t_min), self.far.min(t_max)),
            Lattice::Extended | Lattice::March | Lattice::Contracted => (t_min, t_max),
        };
        // The sample of a bin that is cut may lie beyond the cut.
        let margin = if self.lattice == Lattice::March { 0.0 } else { walk.delta() };
        let (enter, exit) = around.clip(ray, near - margin, far + margin)?;
        let (origin, start, end) = match self.lattice {
            Lattice::Own | Lattice::Contracted => (ray.origin, 0.0, f32::MAX),
            Lattice::Extended => {
                let start = walk.shift(enter, exit);
                (ray.at(start), start, f32::MAX)
            }
            Lattice::March => {
                // Once more, from beside the box: the first answer is as exact as the way is short.
                let beside = Ray { origin: ray.at(enter), ..*ray };
                let (first, last) = self.bounds.clip(&beside, near - enter, f32::MAX)?;
                (beside.at(first), enter + first, last - first)
            }
        };
        let slack = ROUNDING * start.abs();
        let seen = walk.overlapping(enter - start - slack, exit - start + slack);
        let (walk, own) = walk.cut(near - start, end, far - start);
        let bins = seen.start.max(own.start)..seen.end.min(own.end);
        Some(Span { ray: Ray { origin, ..*ray }, start, bins, ends: walk.ends() })
    }

    /// What is sampled of a ray through an unbounded scene: from near on, where the caller does not begin behind it.
    #[inline(never)]
    fn contracted_span(
        &self,
        contraction: &Contraction,
        ray: &Ray,
        [t_min, t_max]: [f32; 2],
    ) -> Option<Span> {
        // What is as far away as f32 goes has no point nearest to the middle.
        let (centred, start) = contraction.centred(ray);
        if !(ray.origin.is_finite() && ray.dir.is_finite() && centred.origin.is_finite()) {
            return None;
        }
        let enter = contraction.step_at(self.near.max(t_min) - start);
        let far = contraction.step_at(self.far);
        let stop = contraction.step_at(t_max - start);
        let (walk, bins) = self.bins.cut(enter, far, stop);
        Some(Span { ray: centred, start, bins, ends: walk.ends() }).filter(|_| enter < far.min(stop))
    }

    /// The distances that are seen of a ray whose own range is `t_min` to `t_max`.
    #[inline]
    pub(crate) fn range_of(&self, t_min: f32, t_max: f32) -> [f32; 2] {
        [self.t_min.max(t_min), self.t_max.min(t_max)]
    }

    /// The distance of pixels without a surface in a frame seen from `eye`: at least that of anything in the scene, and
    /// the same for all of them.
    pub fn far_from(&self, eye: Vec3) -> f32 {
        if self.lattice == Lattice::Own {
            return self.far.min(self.t_max);
        }
        if let Some(contraction) = &self.contraction {
            return ((eye - contraction.centre()).length() + self.far).min(self.t_max);
        }
        let reach: [f32; 3] = core::array::from_fn(|axis| {
            let (eye, low, high) = (eye[axis], self.bounds.min[axis], self.bounds.max[axis]);
            (eye - low).abs().max((eye - high).abs())
        });
        self.far.max(Vec3::from(reach).length()).min(self.t_max)
    }
}
