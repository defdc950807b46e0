//! Rays and samples of one training step, made by the code that fills training batches.

use crate::data::{Background, View};
use crate::model::config::Config;
use crate::model::engine::Batch;
use crate::train::occupancy::Occupancy;
use crate::train::rays::{MarchCells, RayBank};
use crate::train::{Bounds, lengthened};
use glam::Vec3;
use nerf_core::Isa;

#[derive(Clone, Debug, PartialEq)]
pub struct ShownRay {
    /// Index of the ray's camera in the cameras of the [scene](super::Scene).
    pub camera: usize,
    /// Position of the camera, world units.
    pub origin: Vec3,
    pub dir: Vec3,
    /// Distance from `origin` at which sampling begins, world units.
    pub near: f32,
    /// Target colour in training, display-encoded.
    pub rgb: [f32; 3],
    /// Distances `t` of the samples in occupied cells, where training evaluates the network: world units, ascending.
    pub live: Vec<f32>,
    /// Distances `t` of the samples in the scene box that the occupancy grid culls: world units, ascending.
    pub culled: Vec<f32>,
}

impl ShownRay {
    pub fn at(&self, t: f32) -> Vec3 {
        self.origin + self.dir * t
    }

    pub fn samples(&self) -> impl Iterator<Item = f32> {
        self.live.iter().chain(&self.culled).copied()
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StepFacts {
    pub step: u32,
    pub seed: u64,
    /// Number of bins from near to far, each with one sample; if `marched`, the largest number of samples of a ray.
    pub bins: u16,
    pub marched: bool,
    /// Number of rays of the training step. The shown rays are the first rays of the step.
    pub rays: usize,
    pub live: usize,
    pub occupancy: bool,
}

/// Source of rays and samples for display. Runs the code that fills training batches.
pub(super) struct Drawer<'a> {
    pub(super) config: &'a Config,
    pub(super) bounds: Bounds,
    pub(super) background: Background,
    pub(super) occupancy: Option<&'a Occupancy>,
    pub(super) step: u32,
}

impl Drawer<'_> {
    /// Returns the first `count` rays of a step on `views`, and facts such as the step's numbers of rays, bins and
    /// samples. `first`: index in the scene of the first view's camera.
    ///
    /// `whole`: whether the step has as many rays as in training. If false, the step has only `count` rays.
    pub(super) fn draw(
        &self,
        views: &[View],
        first: usize,
        count: usize,
        whole: bool,
    ) -> anyhow::Result<(Vec<ShownRay>, StepFacts)> {
        let bank = RayBank::new(views, self.background, self.bounds, self.config)?;
        let s = &self.config.sampling;
        let step = u64::from(self.step);
        let (rays, most) = if whole { (s.rays, s.live_samples) } else { (count, 0) };
        let kept = self.batch(&bank, rays, most, self.occupancy);
        let all = self.batch(&bank, rays, 0, None);
        let longest = all.rays.iter().map(|ray| ray.samples).max().unwrap_or(0);
        let facts = StepFacts {
            step: self.step,
            seed: self.config.seed,
            bins: if self.is_marched() { longest.min(u16::MAX.into()) as u16 } else { s.samples },
            marched: self.is_marched(),
            rays: kept.rays.len(),
            live: kept.positions.len(),
            occupancy: self.occupancy.is_some(),
        };
        let (mut live, mut inside) = (kept.positions.as_slice(), all.positions.as_slice());
        let pairs = kept.rays.iter().zip(&all.rays).enumerate().take(count);
        let shown = pairs.map(|(index, (ray, whole))| {
            let (view, _) = bank.source(step, index as u64, rays);
            let (origin, dir) = (views[view].camera.pose().position, Vec3::from(ray.dir));
            let live = take(&mut live, ray.samples);
            // Samples in occupied cells are a subset of all samples in the box, bit for bit and in the same order.
            let mut next = live.iter().peekable();
            let culled = take(&mut inside, whole.samples).iter().filter(|p| next.next_if_eq(p).is_none());
            let t = |p: &[f32; 3]| {
                let p = Vec3::from(*p);
                let p = self.bounds.contraction.map_or(p, |contraction| contraction.in_world(p));
                (p - origin).dot(dir)
            };
            // In an unbounded scene, samples after the far plane are not drawn.
            let drawn = |t: &f32| self.bounds.contraction.is_none() || *t <= self.bounds.far;
            ShownRay {
                camera: first + view,
                origin,
                dir,
                near: self.bounds.near,
                rgb: ray.rgb,
                live: live.iter().map(t).filter(drawn).collect(),
                culled: culled.map(t).filter(drawn).collect(),
            }
        });
        Ok((shown.collect(), facts))
    }

    /// Returns the step's batch of `rays` rays. The samples are in the occupied cells of `cells`; if `None`, in the
    /// whole scene box. `most`: number of samples at which the batch ends (0: no limit); ignored if rays are marched.
    fn batch(&self, bank: &RayBank<'_>, rays: usize, most: usize, cells: Option<&Occupancy>) -> Batch {
        let (mut batch, step) = (Batch::default(), u64::from(self.step));
        if !self.is_marched() {
            bank.fill(&mut batch, step, rays, most, cells.map(Occupancy::lookup).as_ref());
            return batch;
        }
        let share = f64::from(self.step) / f64::from(self.config.optimiser.steps.max(1));
        let longer = lengthened(share, self.bounds.contraction.is_some());
        let width = longer * self.bounds.step(self.config.sampling.steps_across);
        let cells = match cells {
            Some(cells) => MarchCells::new(cells.live()),
            None => MarchCells::new(Occupancy::full(self.bounds.scene_box, 1).live()),
        };
        bank.fill_marched(Isa::Portable, &mut batch, step, rays, &cells, width);
        batch
    }

    /// Returns whether rays are marched: true if the field has a learned grid and there is an occupancy grid.
    fn is_marched(&self) -> bool {
        self.occupancy.is_some() && self.config.network.grid.is_some()
    }
}

fn take<'p>(positions: &mut &'p [[f32; 3]], count: u32) -> &'p [[f32; 3]] {
    let (taken, rest) = positions.split_at((count as usize).min(positions.len()));
    *positions = rest;
    taken
}
