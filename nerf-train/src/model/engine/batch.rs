//! Inputs of a training step: rays, samples and the colours that are asked for.

use glam::Vec3;
use nerf_core::space::Contraction;

/// One ray: what it should show, and how many samples it has.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct BatchRay {
    pub dir: [f32; 3],
    pub rgb: [f32; 3],
    /// What shows where the ray's transmittance is left, display-encoded.
    pub background: [f32; 3],
    /// How many of [`Batch::positions`] are this ray's; it may have none.
    pub samples: u32,
}

/// Known surface of a ray, for depth supervision.
///
/// It adds `weight · (Σ_i w_i min(|along_i − at|, CLIP) + T_end · CLIP)` to the sum over rays that the loss is the mean of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surface {
    /// Position along the ray: 0 at its beginning, 1 at its end.
    pub at: f32,
    /// At least 0.
    pub weight: f32,
}

impl Surface {
    /// Distance along the ray at which the cost of a sample stops growing: a wrong surface cannot move a whole ray.
    pub const CLIP: f32 = 0.25;
}

/// How the loss's gradient by the rays' own origins and directions is asked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RayQuestion {
    /// How the world is contracted into the space that positions are in.
    pub contraction: Contraction,
    /// Standard deviation of the Gaussian around each sample that the gradient is a mean over, units of that space: levels
    /// of the grid that are finer count for less.
    pub blur: f32,
}

/// Gradient of the loss by a ray, whose samples stay at their distances.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RayGradient {
    pub ray: u32,
    /// By the origin, per world unit.
    pub by_origin: Vec3,
    /// By the direction, of which only the part across the ray means anything.
    pub by_dir: Vec3,
}

/// Rays with their live samples, ray after ray, front to back.
///
/// In a 2D field `positions` hold the point in their first two coordinates and every sample is
/// opaque: one sample a ray.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Batch {
    pub rays: Vec<BatchRay>,
    /// Sample positions, world.
    pub positions: Vec<[f32; 3]>,
    /// Length of each sample's bin, world units, at least 0.
    pub deltas: Vec<f32>,
    /// Factor on the gradient of each sample; all are 1 where it is empty. Only the grid's engine reads it.
    pub gradient_scales: Vec<f32>,
    /// Points of culled space, whose density is pushed to zero.
    pub empty: Vec<[f32; 3]>,
    /// Weight of their term in the loss.
    pub empty_weight: f32,
    /// Where samples of little weight are kept by chance, so that fog of them is learned from: the seed and the step of the
    /// draw. Otherwise none of them is. Of a grid's batches only.
    pub roulette: Option<(u64, u64)>,
    /// Known surfaces, one for each of the first rays; empty where none are known. Of a grid's batches only.
    pub surfaces: Vec<Surface>,
    /// Position of each sample of those rays along its ray, 0 to 1 as [`Surface::at`].
    pub along: Vec<f32>,
    /// Index of each ray's photograph. Of a grid's batches only, as what follows.
    pub views: Vec<u32>,
    /// Index of each ray's pixel in its photograph.
    pub pixels: Vec<u32>,
    /// Where each ray begins, world.
    pub origins: Vec<[f32; 3]>,
    /// What is asked of the rays themselves, if anything is: the gradient that is followed leaves out that the colour
    /// depends on the direction, and that the distortion loss depends on distances.
    pub question: Option<RayQuestion>,
    /// Gain of each ray's photograph on what the field shows, red, green, blue; empty: 1. The background has none.
    pub gains: Vec<[f32; 3]>,
    /// Weight of each ray's squared error in the loss; empty: 1.
    pub weights: Vec<f32>,
    /// Weight of the distortion loss, per unit of length of the space that the positions are in; 0 for none. Of a grid's
    /// batches only.
    pub distortion: f32,
}

impl Batch {
    /// Removes rays and points and keeps the memory.
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
    }

    /// Checks lengths and that every number is finite.
    pub fn check(&self) -> Result<(), BatchError> {
        let claimed: u64 = self.rays.iter().map(|ray| u64::from(ray.samples)).sum();
        let scales =
            if self.gradient_scales.is_empty() { self.deltas.len() } else { self.gradient_scales.len() };
        let towards = self.rays.iter().take(self.surfaces.len()).map(|ray| u64::from(ray.samples)).sum();
        let rays = self.rays.len() as u64;
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
            ("origins", if self.question.is_some() { (rays, self.origins.len()) } else { (0, 0) }),
        ] {
            if expected != found as u64 {
                return Err(BatchError::Length { field, expected, found });
            }
        }
        // All of it at once; who it is is asked where one is not.
        let sound = |values: &[f32]| values.iter().fold(true, |all, x| all & x.is_finite());
        if !sound(&self.gradient_scales) {
            let index = self.gradient_scales.iter().position(|x| !x.is_finite());
            return Err(BatchError::NonFinite { field: "gradient_scales", index: index.unwrap_or_default() });
        }
        let of_rays = [("along", &self.along[..]), ("gains", self.gains.as_flattened())];
        let origins = self.origins.as_flattened();
        let of_rays = of_rays.into_iter().chain([("origins", origins), ("weights", &self.weights)]);
        if let Some((field, _)) = { of_rays }.find(|(_, values)| !sound(values)) {
            return Err(BatchError::NonFinite { field, index: 0 });
        }
        let surface_ok = |s: &Surface| s.at.is_finite() && s.weight.is_finite();
        if let Some(index) = self.surfaces.iter().position(|surface| !surface_ok(surface)) {
            return Err(BatchError::NonFinite { field: "surfaces", index });
        }
        let lengths = self.deltas.iter().fold(true, |all, d| all & (*d >= 0.0));
        let points = sound(self.positions.as_flattened()) && sound(self.empty.as_flattened());
        let finite = |v: &[f32; 3]| v.iter().all(|x| x.is_finite());
        let bad = |field, index| Err(BatchError::NonFinite { field, index });
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
        for (field, weight) in [("empty_weight", self.empty_weight), ("distortion", self.distortion)] {
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
    #[error("{field}: the rays claim {expected} samples, found {found}")]
    Length { field: &'static str, expected: u64, found: usize },
    #[error("{field}[{index}] is not finite, or a negative length")]
    NonFinite { field: &'static str, index: usize },
}
