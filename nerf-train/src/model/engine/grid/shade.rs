//! Where a chunk's colours are worked out: once a sample, or once a ray.

use super::evaluate::RayState;
use super::layers::{LayerSums, Layers};
use super::pass::Job;
use super::samples::Samples;
use super::shade_ray::ShadeRay;
use super::shade_sample::ShadeSample;
use crate::model::engine::BatchRay;
use nerf_core::network::Shading;

/// The chunk whose colours are worked out.
#[derive(Clone, Copy)]
pub(super) struct Shaded<'a> {
    /// Its rays in the batch, and their state.
    pub rays: &'a [BatchRay],
    pub states: &'a [RayState],
    /// The kept samples of all of them.
    pub samples: &'a Samples,
}

/// The colour branch, forward and backward.
pub(super) trait Shade: Send {
    /// Colours of a chunk that has kept samples.
    fn forward(&mut self, job: &Job<'_>, chunk: Shaded<'_>);

    /// What the kept samples of the chunk's ray of this number show.
    fn shown(&self, ray: usize, chunk: Shaded<'_>) -> [f32; 3];

    /// From the gradient by what each ray shows: adds that of the branch to `sums`, that by each kept sample's weight to
    /// `by_weight`, and puts that by its features into `by_features`, `[samples][padded features]`.
    fn backward(
        &mut self,
        job: &Job<'_>,
        chunk: Shaded<'_>,
        by_shown: &[[f32; 3]],
        sums: &mut LayerSums,
        by_weight: &mut [f32],
        by_features: &mut Vec<f32>,
    );
}

/// The one that a field's `shading` asks for.
pub(super) fn shade_of(shading: Shading, layers: &Layers) -> Box<dyn Shade> {
    match shading {
        Shading::PerSample => Box::new(ShadeSample::new(layers)),
        Shading::PerRay => Box::new(ShadeRay::new(layers)),
    }
}
