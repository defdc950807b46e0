//! Batch of a training step (rays, samples and target colours), and its division into chunks.

use glam::Vec3;
use nerf_core::space::Contraction;
use std::ops::Range;

/// Number of samples at which a chunk is full. The activations of this many samples fit the caches.
pub(super) const SAMPLES: usize = 512;
/// Number of rays at which a chunk is full even with few samples: rays without samples take time, too.
const RAYS: usize = 2048;

/// Number of consecutive rays of a line. The smoothness loss acts on lines ([`Batch::lines`]). Chunks hold whole lines.
pub const LINE: usize = 4;

/// Entry of a ray in a batch: direction, target colour, background and number of samples.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct BatchRay {
    pub dir: [f32; 3],
    pub rgb: [f32; 3],
    /// Background colour behind the ray's last sample, composited with the remaining transmittance; display-encoded.
    pub background: [f32; 3],
    /// Number of this ray's samples in [`Batch::positions`]; may be 0.
    pub samples: u32,
}

/// Known surface of a ray, for depth supervision.
///
/// The depth loss of the ray is `weight · (Σ_i w_i min(|along_i − at|, CLIP) + T_end · CLIP)`. `w_i`: compositing
/// weight of sample `i`; `along_i`: its entry in [`Batch::along`]; `T_end`: transmittance after the last sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surface {
    /// Position of the surface along the ray: 0 at the near end of the sampled interval, 1 at its far end.
    pub at: f32,
    /// Weight of the ray's depth loss, at least 0.
    pub weight: f32,
}

impl Surface {
    /// Distance between sample and surface, in units of [`Surface::at`], beyond which the sample's term in the depth
    /// loss is constant. This bounds the effect of a wrong surface on the ray.
    pub const CLIP: f32 = 0.25;
}

/// Request for the gradients of the loss with respect to the rays' origins and directions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RayQuestion {
    /// Contraction of the world into the space of [`Batch::positions`].
    pub contraction: Contraction,
    /// Standard deviation, in units of contracted space, of the Gaussian that smooths the gradient by position.
    pub blur: f32,
}

/// Gradient of the loss with respect to a ray's origin and direction, for constant distances of the samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RayGradient {
    pub ray: u32,
    /// Gradient of the loss with respect to the origin, per world unit.
    pub by_origin: Vec3,
    /// Gradient of the loss with respect to the direction; only the component perpendicular to the ray is meaningful.
    pub by_dir: Vec3,
}

/// Input of a training step: rays, and their samples in occupied cells, in the order of the rays, front to back.
/// For a 2D field, each ray has one opaque sample. The sample's first two coordinates are its position in the image.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Batch {
    pub rays: Vec<BatchRay>,
    /// Positions of the samples in world space or, in an unbounded scene, in contracted space.
    pub positions: Vec<[f32; 3]>,
    /// Length of each sample's bin, world units, at least 0.
    pub deltas: Vec<f32>,
    /// Factor on each sample's gradients, less than 1 near the cameras. Empty: all are 1. Used with a grid only.
    pub gradient_scales: Vec<f32>,
    /// Points in empty cells, whose density is pushed to zero.
    pub empty: Vec<[f32; 3]>,
    /// Weight of the loss term that pushes the density at the `empty` points to 0.
    pub empty_weight: f32,
    /// Seed and training step of the random numbers of Russian roulette: a random subset of the samples of small
    /// compositing weight is trained. `None`: no sample of small weight is trained. Used with a grid only.
    pub roulette: Option<(u64, u64)>,
    /// Known surfaces of the batch's first rays, one per ray; later rays have none. Used with a grid only.
    pub surfaces: Vec<Surface>,
    /// Position along the ray, in the units of [`Surface::at`], of each sample on a ray with a known surface.
    pub along: Vec<f32>,
    /// Index of each ray's photograph; empty if unknown. This field and all fields after it are used with a grid only.
    pub views: Vec<u32>,
    /// Index of each ray's pixel in the photograph, row · width + column; empty if unknown.
    pub pixels: Vec<u32>,
    /// Origin of each ray, world units. May be empty if `question` and `smoothness` are `None`.
    pub origins: Vec<[f32; 3]>,
    /// Request for gradients with respect to the rays ([`RayGradient`]); `None` if they are not needed.
    pub question: Option<RayQuestion>,
    /// Gain of each ray's photograph: factors on red, green, blue before the background is added. Empty: all are 1.
    pub gains: Vec<[f32; 3]>,
    /// Weight of each ray's squared error in the loss; empty for weights of 1.
    pub weights: Vec<f32>,
    /// Weight of the distortion loss, per unit of length in the space of `positions`; 0 for none.
    pub distortion: f32,
    /// Index of each line's first ray, a multiple of [`LINE`]; ascending. A line is [`LINE`] consecutive rays through
    /// equally spaced pixels on a row or column of a photograph.
    pub lines: Vec<u32>,
    /// Weight of the smoothness loss on `lines`, and contraction into the space of `positions`. `None`: no such loss.
    pub smoothness: Option<(f32, Contraction)>,
}

impl Batch {
    /// Empties all lists but keeps their memory; sets `question` and `smoothness` to `None`; changes no other field.
    pub fn clear(&mut self) {
        self.rays.clear();
        self.positions.clear();
        self.deltas.clear();
        self.gradient_scales.clear();
        self.empty.clear();
        self.surfaces.clear();
        self.along.clear();
        self.views.clear();
        self.pixels.clear();
        self.origins.clear();
        self.question = None;
        self.gains.clear();
        self.weights.clear();
        self.lines.clear();
        self.smoothness = None;
    }

    /// Checks that all lengths match, numbers are finite, `deltas` not negative, and `lines` in the documented form.
    pub fn check(&self) -> Result<(), BatchError> {
        let claimed: u64 = self.rays.iter().map(|ray| u64::from(ray.samples)).sum();
        let scales =
            if self.gradient_scales.is_empty() { self.deltas.len() } else { self.gradient_scales.len() };
        let towards = self.rays.iter().take(self.surfaces.len()).map(|ray| u64::from(ray.samples)).sum();
        let rays = self.rays.len() as u64;
        let origins = self.question.is_some() || self.smoothness.is_some();
        let a_ray = |found: usize| (if found == 0 { 0 } else { rays }, found);
        for (field, (expected, found)) in [
            ("positions", (claimed, self.positions.len())),
            ("deltas", (claimed, self.deltas.len())),
            ("gradient_scales", (claimed, scales)),
            ("along", (towards, self.along.len())),
            ("surfaces", (rays.min(self.surfaces.len() as u64), self.surfaces.len())),
            ("views", a_ray(self.views.len())),
            ("pixels", a_ray(self.pixels.len())),
            ("gains", a_ray(self.gains.len())),
            ("weights", a_ray(self.weights.len())),
            ("origins", if origins { (rays, self.origins.len()) } else { (0, 0) }),
        ] {
            if expected != found as u64 {
                return Err(BatchError::Length { field, expected, found });
            }
        }
        // Tests all values at once; searches for the index only after a failure.
        let sound = |values: &[f32]| values.iter().fold(true, |all, x| all & x.is_finite());
        let bad = |field, index| Err(BatchError::NonFinite { field, index });
        if !sound(&self.gradient_scales) {
            let index = self.gradient_scales.iter().position(|x| !x.is_finite());
            return bad("gradient_scales", index.unwrap_or_default());
        }
        let (gains, origins) = (self.gains.as_flattened(), self.origins.as_flattened());
        let of_rays =
            [("along", &self.along[..]), ("gains", gains), ("origins", origins), ("weights", &self.weights)];
        if let Some((field, _)) = of_rays.into_iter().find(|(_, values)| !sound(values)) {
            return bad(field, 0);
        }
        if let Some(index) = self.surfaces.iter().position(|s| !(s.at.is_finite() && s.weight.is_finite())) {
            return bad("surfaces", index);
        }
        let lengths = self.deltas.iter().fold(true, |all, d| all & (*d >= 0.0));
        let points = sound(self.positions.as_flattened()) && sound(self.empty.as_flattened());
        let finite = |v: &[f32; 3]| v.iter().all(|x| x.is_finite());
        let ray_ok = |ray: &BatchRay| finite(&ray.dir) && finite(&ray.rgb) && finite(&ray.background);
        if let Some(index) = self.rays.iter().position(|ray| !ray_ok(ray)) {
            return bad("rays", index);
        }
        if !(points && lengths && sound(&self.deltas)) {
            if let Some(index) = self.positions.iter().position(|x| !finite(x)) {
                return bad("positions", index);
            }
            if let Some(index) = self.deltas.iter().position(|d| !(d.is_finite() && *d >= 0.0)) {
                return bad("deltas", index);
            }
            if let Some(index) = self.empty.iter().position(|x| !finite(x)) {
                return bad("empty", index);
            }
        }
        let whole =
            |&line: &u32| (line as usize).is_multiple_of(LINE) && u64::from(line) + LINE as u64 <= rays;
        if !(self.lines.iter().all(whole) && self.lines.is_sorted_by(|a, b| a < b)) {
            return Err(BatchError::Lines);
        }
        let smoothness = self.smoothness.map_or(0.0, |(weight, _)| weight);
        for (field, weight) in
            [("empty_weight", self.empty_weight), ("distortion", self.distortion), ("smoothness", smoothness)]
        {
            if !weight.is_finite() {
                return bad(field, 0);
            }
        }
        Ok(())
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum BatchError {
    #[error("{field}: expected {expected} values by the batch's rays, found {found}")]
    Length { field: &'static str, expected: u64, found: usize },
    #[error("{field}[{index}] is not finite, or a negative length")]
    NonFinite { field: &'static str, index: usize },
    #[error("lines: expected ascending multiples of {LINE}, each the first of {LINE} of the batch's rays")]
    Lines,
}

/// Part of a batch that one thread evaluates as a unit: rays with their samples, or points in empty cells.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Chunk {
    Rays { rays: Range<usize>, samples: Range<usize> },
    Empty(Range<usize>),
}

/// Fills `chunks` with parts of the batch of about equal size, in order. The number of parts is even if possible: two
/// threads then finish together. A chunk with `most` samples gets no further rays, except to complete a line.
pub(super) fn cut(batch: &Batch, most: usize, chunks: &mut Vec<Chunk>) {
    chunks.clear();
    let total = batch.positions.len();
    let share = total.div_ceil(total.div_ceil(most).next_multiple_of(2).max(1));
    let (mut rays, mut samples) = (0..0usize, 0..0);
    for BatchRay { samples: more, .. } in &batch.rays {
        let within = !batch.lines.is_empty() && !rays.end.is_multiple_of(LINE);
        let full = (samples.len() >= share.max(1) || rays.len() == RAYS) && !within;
        if full && !rays.is_empty() {
            chunks.push(Chunk::Rays { rays: rays.clone(), samples: samples.clone() });
            (rays, samples) = (rays.end..rays.end, samples.end..samples.end);
        }
        rays.end += 1;
        samples.end += *more as usize;
    }
    if !rays.is_empty() {
        chunks.push(Chunk::Rays { rays, samples });
    }
    let points = batch.empty.len();
    chunks.extend((0..points).step_by(most).map(|i| Chunk::Empty(i..points.min(i + most))));
}
