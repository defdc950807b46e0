//! The state of the rays in flight, and their march to the next occupied sample.

use super::coarse::CandidateBins;
use super::window::{LookUp, Window};
use crate::camera::Ray;
use crate::memory::{at, put};
use crate::plan::{Plan, Span};
use crate::render::pixel::PixelRay;
use crate::sampling::{Bins, Ends, OccupancyGrid, SampleJitter};
use crate::simd::{Isa, Lanes, Op, VECTORS};
use crate::space::Contraction;
use glam::Vec3;

/// A ray's march through one field.
#[derive(Clone, Copy)]
pub(in crate::render) struct RayState {
    pub pixel: PixelRay,
    /// Cuts of the ray's outermost bins.
    pub ends: Ends,
    /// Index of the next bin or drawn sample.
    pub next: u32,
    /// Index behind the last bin or drawn sample.
    pub end: u32,
    /// The bins that were looked up in the occupancy grid.
    pub window: Window,
    /// The bins that may have a sample in an occupied cell; empty without vectors, where all may have one.
    pub candidates: [CandidateBins; VECTORS as usize],
    /// Samples that the network was evaluated at.
    pub kept: u32,
}

impl Default for RayState {
    fn default() -> Self {
        Self::NONE
    }
}

impl RayState {
    pub const NONE: Self = Self {
        pixel: PixelRay::NONE,
        ends: Ends::NONE,
        next: 0,
        end: 0,
        window: Window::NONE,
        candidates: [CandidateBins::ALL; VECTORS as usize],
        kept: 0,
    };

    /// The state of a single queried point in the network's space, number `index`.
    pub fn of_point(origin: Vec3, dir: Vec3, index: usize) -> Self {
        Self { pixel: PixelRay { ray: Ray { origin, dir }, x: index as u32, ..PixelRay::NONE }, ..Self::NONE }
    }

    /// Starts the ray of a pixel, before its first sample; `span`: the part of it that is sampled.
    #[inline]
    pub fn begin(&mut self, (x, y): (u32, u32), ray: Ray, range: [f32; 2], span: Option<Span>) {
        *self = Self { pixel: PixelRay { ray, range, x, y, done: false, ..PixelRay::NONE }, ..Self::NONE };
        if let Some(Span { ray, start, bins, ends }) = span {
            (self.pixel.ray, self.pixel.start, self.ends) = (ray, start, ends);
            (self.next, self.end) = (bins.start, bins.end);
        }
    }

    /// Moves `next` to the first occupied bin at or after it; `false` if there is none.
    #[cfg_attr(target_os = "none", inline(never))]
    pub fn march(&mut self, isa: Isa, plan: &Plan<'_>, bins: &Bins, jitter: SampleJitter) -> bool {
        if VECTORS && self.march_looked_up() {
            return true;
        }
        match windows(isa, plan) {
            Some(occupancy) => {
                let (contraction, rays) = (plan.contraction.as_ref(), core::slice::from_mut(self));
                isa.run(MarchAll { occupancy, contraction, bins, rays, list: &[0], inner: false });
            }
            None => {
                let (bins, next, end) = (bins.with(self.ends), self.next, self.end);
                self.next = plan.first_occupied(&bins, &self.pixel.ray, jitter, next, end);
            }
        }
        self.next < self.end
    }

    /// Moves `next` on to the first occupied bin among those already looked up; `false` if there is none.
    #[inline]
    pub fn march_looked_up(&mut self) -> bool {
        let found = self.window.left(self.next).filter(|&bin| bin < self.end);
        self.next = found.unwrap_or(self.next);
        found.is_some()
    }
}

/// The occupancy grid, if it is looked up in windows.
#[inline]
pub(super) fn windows<'p>(isa: Isa, plan: &'p Plan<'_>) -> Option<&'p OccupancyGrid<'p>> {
    plan.occupancy.as_ref().filter(|_| VECTORS && isa != Isa::Portable && plan.effects.jitter.is_none())
}

/// [`RayState::march`] of several rays, with samples in the middle of bins.
pub(super) struct MarchAll<'a> {
    pub occupancy: &'a OccupancyGrid<'a>,
    pub contraction: Option<&'a Contraction>,
    pub bins: &'a Bins,
    pub rays: &'a mut [RayState],
    /// Indices of the rays to march.
    pub list: &'a [u32],
    /// Whether no occupied cell lies at a face of the box.
    pub inner: bool,
}

impl Op for MarchAll<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: Lanes>(self) {
        let Self { occupancy, contraction, inner, .. } = self;
        let lanes = occupancy.lanes::<V>();
        for &ray in self.list {
            let Some(state) = self.rays.get_mut(ray as usize) else { return };
            let candidates = state.candidates.first().unwrap_or(&CandidateBins::ALL);
            let (ray, bins) = (&state.pixel.ray, &self.bins.with(state.ends));
            let look_up = LookUp { occupancy, contraction, ray, bins, candidates, inner };
            state.next = look_up.first_occupied(&lanes, &mut state.window, state.next, state.end);
        }
    }
}

/// The rays whose next sample is occupied, each at most once: a queue in a ring buffer.
pub(in crate::render) struct ActiveRays<'w> {
    ring: &'w mut [u32],
    first: usize,
    count: usize,
}

impl<'w> ActiveRays<'w> {
    /// An empty queue; `ring` has room for every ray.
    pub fn new(ring: &'w mut [u32]) -> Self {
        Self { ring, first: 0, count: 0 }
    }

    pub fn len(&self) -> usize {
        self.count
    }

    pub fn push(&mut self, ray: u32) {
        let (capacity, end) = (self.ring.len(), self.first + self.count);
        put(self.ring, if end < capacity { end } else { end - capacity }, ray);
        self.count += 1;
    }

    pub fn pop(&mut self) -> Option<u32> {
        self.count = self.count.checked_sub(1)?;
        let ray = at(self.ring, self.first);
        self.first = if self.first + 1 < self.ring.len() { self.first + 1 } else { 0 };
        Some(ray)
    }
}
