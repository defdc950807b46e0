//! The ray of a pixel.

use crate::camera::Ray;
use crate::plan::Plan;
use crate::sampling::SampleJitter;
use crate::volume::Accumulator;
use glam::Vec3;

/// The ray of a pixel, and what is composited along it.
#[derive(Clone, Copy)]
pub(in crate::render) struct PixelRay {
    /// The ray, from the point its samples are counted from.
    pub ray: Ray,
    /// Distance of that point along the ray, world units.
    pub start: f32,
    /// Nearest and farthest visible distance along the ray, world units.
    pub range: [f32; 2],
    pub x: u32,
    pub y: u32,
    /// Whether the transmittance is below the threshold.
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

    /// The jitter of the ray's samples in frames of `plan`; `turn`: the ray's index among those of its pixel.
    #[inline]
    pub fn jitter(&self, plan: &Plan<'_>, turn: u32) -> SampleJitter {
        SampleJitter::of(plan.effects.jitter.map(|jitter| jitter.seed), self.x, self.y, turn)
    }
}
