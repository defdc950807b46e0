//! Batches: the pixels of a step, their rays, and the samples along the rays.

mod march;
mod pixels;

use crate::capture::sights::{Sight, Sights};
use crate::data::{Background, View};
use crate::model::config::{Config, Jitter, SamplingConfig};
use crate::model::engine::{Batch, BatchRay, LINE, Surface};
use crate::train::Bounds;
use glam::Vec3;
pub use march::MarchCells;
use march::{March, MarchContracted, Samples};
use nerf_core::camera::{Camera, Ray};
use nerf_core::sampling::{Bins, OccupancyGrid, Purpose, uniform, uniform_u32};
use nerf_core::simd::Isa;
use nerf_core::space::Contraction;
use pixels::{counting, near_foreground, pixels_on_line, rays_on_lines};
use rayon::prelude::*;
use std::ops::Range;
use std::time::{Duration, Instant};

const CHUNK: usize = 128;
/// Number of rays that one task marches in an unbounded scene. Batches have fewer, longer rays than in a bounded scene.
const CONTRACTED_CHUNK: usize = 16;

/// Number of rays of a batch per ray that is cast along a line of sight, in an unbounded scene.
const SIGHT_SHARE: usize = 8;

/// Pixels of all training views, from which batches are drawn, and the settings by which their rays are sampled.
pub struct RayBank<'d> {
    views: &'d [View],
    cameras: Vec<Camera>,
    /// For each view, the index of its first pixel among the pixels of all views; last, the number of all pixels.
    starts: Vec<u64>,
    /// Indices, among the pixels of all views, of the pixels that batches are drawn from. They are unmasked and, if
    /// photographs show what is foreground, near the foreground. `None`: batches are drawn from all pixels.
    drawn: Option<Vec<u32>>,
    /// For each view, the indices of its unmasked pixels; `None` if the view has no mask. The outer list is empty
    /// unless batches draw a view first, and then a pixel of this view.
    unmasked: Vec<Option<Vec<u32>>>,
    background: Background,
    bins: Bins,
    bounds: Bounds,
    sampling: SamplingConfig,
    /// Lines of sight along which one in eight rays of an unbounded scene is cast, each with the index of its view.
    sights: Vec<(usize, Sight)>,
    /// Weight of the depth loss, which applies to the rays along `sights`.
    depth: f32,
    seed: u64,
}

#[derive(Default)]
struct Marched {
    rays: Vec<BatchRay>,
    samples: Samples,
    /// Surface that the depth loss expects, for each ray along a line of sight. Rays along lines of sight come first.
    surfaces: Vec<Surface>,
    /// Position of each sample along lines of sight, 0 at near, 1 at far, linear in `s` of [`Contraction::distance`].
    along: Vec<f32>,
    views: Vec<u32>,
    /// Index of each ray's pixel in its view.
    pixels: Vec<u32>,
    /// Origin of each ray, world units.
    origins: Vec<[f32; 3]>,
    lines: Vec<u32>,
    time: Duration,
}

impl<'d> RayBank<'d> {
    pub fn new(
        views: &'d [View],
        background: Background,
        bounds: Bounds,
        config: &Config,
    ) -> Result<Self, nerf_core::space::BoundsError> {
        let mut starts = vec![0u64];
        for view in views {
            starts.push(starts[starts.len() - 1] + view.pixels.len() as u64);
        }
        let total = starts[views.len()];
        // Without an occupancy grid every ray is needed: the network itself must learn what is empty.
        let near_foreground =
            if config.occupancy.skip && config.occupancy.hull && total <= u64::from(u32::MAX) {
                near_foreground(views, &starts, background).filter(|pixels| !pixels.is_empty())
            } else {
                None
            };
        let drawn = near_foreground.or_else(|| counting(views, &starts));
        let unmasked = match config.sampling.images {
            0 => Vec::new(),
            _ => views.iter().map(|view| counting(std::slice::from_ref(view), &[0])).collect(),
        };
        Ok(Self {
            views,
            cameras: views.iter().map(|view| view.camera).collect(),
            starts,
            drawn,
            unmasked,
            background,
            bins: Bins::new(bounds.near, bounds.far, u32::from(config.sampling.samples))?,
            bounds,
            sampling: config.sampling.clone(),
            sights: Vec::new(),
            depth: config.capture.depth,
            seed: config.seed,
        })
    }

    /// Makes the bank cast one in eight rays along lines of sight. `sights`: lines of sight of each view.
    #[must_use]
    pub fn with_sights(mut self, sights: &Sights) -> Self {
        let of_view = |(view, sights): (usize, &Vec<Sight>)| {
            // A point outside of the photograph has no pixel that shows it.
            let (width, height) = self.views[view].size();
            let inside = move |sight: &Sight| {
                let [x, y] = sight.at;
                (0.0..width as f32).contains(&x) && (0.0..height as f32).contains(&y)
            };
            sights.iter().copied().filter(inside).map(move |sight| (view, sight)).collect::<Vec<_>>()
        };
        self.sights = sights.of_views.iter().enumerate().flat_map(of_view).collect();
        self
    }

    /// Replaces the cameras from which rays are cast; one per view, in the order of the views.
    pub fn set_cameras(&mut self, cameras: Vec<Camera>) {
        self.cameras = cameras;
    }

    /// Returns the index of a view and a line of sight of this view, drawn for ray `index`. Only the first eighth of a
    /// batch follows lines of sight; other rays have `None`.
    fn sight(&self, step: u64, index: u64, rays: usize) -> Option<&(usize, Sight)> {
        if self.sights.is_empty() || index >= (rays / SIGHT_SHARE) as u64 {
            return None;
        }
        let bits = uniform_u32(self.seed, Purpose::Pixel, step, index);
        self.sights.get(scale(bits, self.sights.len() as u64) as usize)
    }

    /// Returns the line of pixels to which ray `index` belongs: index of the view, and indices of [`LINE`] equally
    /// spaced pixels in a row or column of this view. `None` if the ray belongs to no line.
    fn line(&self, step: u64, index: u64, rays: usize) -> Option<(usize, [usize; LINE])> {
        let first = index - index % LINE as u64;
        let on_lines = rays_on_lines(rays / SIGHT_SHARE, rays);
        if self.bounds.contraction.is_none()
            || self.sampling.smoothness == 0.0
            || !on_lines.contains(&(first as usize))
        {
            return None;
        }
        let (view, pixel) = self.random_pixel(step, first, rays);
        let bits = uniform_u32(self.seed, Purpose::Line, step, first);
        let pixels = pixels_on_line(self.views[view].size(), pixel, bits)?;
        pixels.iter().all(|&pixel| self.views[view].counts(pixel)).then_some((view, pixels))
    }

    pub fn pixels(&self) -> u64 {
        self.drawn.as_ref().map_or(self.starts[self.views.len()], |pixels| pixels.len() as u64)
    }

    /// Fills `batch` with at most `rays` rays of step `step`. The batch ends before a ray that would exceed `live`
    /// samples (0: no limit). Samples lie in occupied cells; if `occupancy` is `None`, in the whole scene box.
    pub fn fill(
        &self,
        batch: &mut Batch,
        step: u64,
        rays: usize,
        live: usize,
        occupancy: Option<&OccupancyGrid<'_>>,
    ) {
        batch.clear();
        let chunks: Vec<Vec<(BatchRay, Vec<[f32; 3]>)>> = (0..rays.div_ceil(CHUNK))
            .into_par_iter()
            .map(|chunk| {
                let range = chunk * CHUNK..rays.min((chunk + 1) * CHUNK);
                let targets = self.targets(step, range, rays);
                targets
                    .map(|(index, _, ray, target)| self.samples(step, index, ray, target, occupancy))
                    .collect()
            })
            .collect();
        for (ray, positions) in chunks.into_iter().flatten() {
            if live > 0 && batch.positions.len() + positions.len() > live && !batch.rays.is_empty() {
                break;
            }
            batch.positions.extend(positions);
            batch.rays.push(ray);
        }
        batch.deltas.resize(batch.positions.len(), self.bins.delta());
    }

    /// Fills `batch` with the `rays` rays of training step `step`. Samples lie in occupied cells, `width` world units
    /// apart along a ray. In a bounded scene, near and far planes are ignored. Returns the time, summed over threads.
    pub fn fill_marched(
        &self,
        isa: Isa,
        batch: &mut Batch,
        step: u64,
        rays: usize,
        cells: &MarchCells,
        width: f32,
    ) -> Duration {
        if let Some(contraction) = &self.bounds.contraction {
            let width = width / contraction.radius();
            return self.fill_contracted(isa, batch, (step, rays), cells, contraction, width);
        }
        batch.clear();
        let time = marched(batch, rays, CHUNK, |range, found| {
            found.samples.positions.reserve(16 * CHUNK);
            for (index, (view, _), ray, mut batch_ray) in self.targets(step, range, rays) {
                let positions = &mut found.samples.positions;
                let before = positions.len();
                if let Some((enter, exit)) = self.bounds.scene_box.clip(&ray, 0.0, f32::MAX) {
                    let u = uniform(self.seed, Purpose::Jitter, step, index);
                    let (first, count) = (enter + u * width, ((exit - enter) / width).ceil() as u32);
                    isa.run(March { cells, ray: &ray, first, step: width, count, positions });
                }
                batch_ray.samples = (positions.len() - before) as u32;
                found.rays.push(batch_ray);
                found.views.push(view as u32);
            }
        });
        batch.deltas.resize(batch.positions.len(), width);
        time
    }

    /// Does [`Self::fill_marched`] if the scene is unbounded. `width`: step length, radii of the uncontracted ball.
    fn fill_contracted(
        &self,
        isa: Isa,
        batch: &mut Batch,
        (step, rays): (u64, usize),
        cells: &MarchCells,
        contraction: &Contraction,
        width: f32,
    ) -> Duration {
        batch.clear();
        batch.roulette = Some((self.seed, step));
        batch.distortion =
            self.sampling.distortion / (self.bounds.scene_box.max - self.bounds.scene_box.min).max_element();
        batch.smoothness =
            (self.sampling.smoothness > 0.0).then_some((self.sampling.smoothness, *contraction));
        let far = contraction.step_at(self.bounds.far);
        marched(batch, rays, CONTRACTED_CHUNK, |range, found| {
            for (index, (view, pixel), ray, mut batch_ray) in self.targets(step, range, rays) {
                let before = found.samples.positions.len();
                found.origins.push(ray.origin.to_array());
                if index.is_multiple_of(LINE as u64) && self.line(step, index, rays).is_some() {
                    found.lines.push(index as u32);
                }
                let (ray, start) = contraction.centred(&ray);
                let first = contraction.step_at(self.bounds.near - start);
                let u = uniform(self.seed, Purpose::Jitter, step, index);
                let count = ((far - first) / width).ceil().max(0.0) as u32;
                isa.run(MarchContracted {
                    cells,
                    contraction,
                    ray: &ray,
                    first: first + u * width,
                    step: width,
                    count,
                    start,
                    samples: &mut found.samples,
                });
                batch_ray.samples = (found.samples.positions.len() - before) as u32;
                found.rays.push(batch_ray);
                found.views.push(view as u32);
                found.pixels.push(pixel as u32);
                if let Some((_, sight)) = self.sight(step, index, rays) {
                    let of_ray = |s: f32| (s - first) / (far - first);
                    found.along.extend(found.samples.steps[before..].iter().map(|&s| of_ray(s)));
                    let at = of_ray(contraction.step_at(sight.distance - start));
                    // Divided by 3, since the colour loss is a mean over three channels.
                    found.surfaces.push(Surface { at, weight: self.depth * sight.confidence / 3.0 });
                }
            }
        })
    }

    /// Adds to `batch` at most `count` points in empty cells, at which the loss penalises density. Points are drawn
    /// alternately on rays and anywhere in the scene box.
    pub fn fill_empty(&self, batch: &mut Batch, step: u64, count: usize, occupancy: &OccupancyGrid<'_>) {
        let extent = self.bounds.scene_box.max - self.bounds.scene_box.min;
        for try_index in 0..4 * count as u64 {
            if batch.empty.len() == count {
                break;
            }
            let draw = |i: u64| uniform(self.seed, Purpose::Empty, step, 4 * try_index + i);
            let p = if try_index % 2 == 0 {
                let (view, pixel) = self.any_pixel(step, u64::MAX - try_index);
                let ray = ray_of(&self.cameras[view], pixel);
                let clipped = self.bounds.scene_box.clip(&ray, self.bounds.near, self.bounds.far);
                let Some((enter, exit)) = clipped else { continue };
                ray.at(enter + draw(0) * (exit - enter))
            } else {
                self.bounds.scene_box.min + extent * Vec3::new(draw(0), draw(1), draw(2))
            };
            if self.bounds.scene_box.contains(p) && !occupancy.occupied(p) {
                batch.empty.push(p.to_array());
            }
        }
    }

    /// Returns the indices of a random view and of a pixel in it, drawn from all pixels of all views.
    fn any_pixel(&self, step: u64, index: u64) -> (usize, usize) {
        let total = self.starts[self.views.len()];
        let bits = uniform_u32(self.seed, Purpose::Pixel, step, index);
        self.locate(scale(bits, total))
    }

    fn locate(&self, pixel: u64) -> (usize, usize) {
        // Most views have one size, so the first guess is right. Branches of a binary search would be mispredicted.
        let views = self.views.len();
        let share = pixel as f64 / self.starts[views] as f64;
        let mut view = ((share * views as f64) as usize).min(views - 1);
        while pixel < self.starts[view] {
            view -= 1;
        }
        while pixel >= self.starts[view + 1] {
            view += 1;
        }
        (view, (pixel - self.starts[view]) as usize)
    }

    /// Returns the source of ray `index` in a step of `rays` rays: index of its view, and row-major index of its pixel.
    pub fn source(&self, step: u64, index: u64, rays: usize) -> (usize, usize) {
        if let Some(&(view, Sight { at: [x, y], .. })) = self.sight(step, index, rays) {
            return (view, y as usize * self.views[view].size().0 as usize + x as usize);
        }
        match self.line(step, index, rays) {
            Some((view, pixels)) => (view, pixels[index as usize % LINE]),
            None => self.random_pixel(step, index, rays),
        }
    }

    /// Returns the indices of a random view and of an unmasked pixel in it, drawn as [`SamplingConfig::images`] states.
    fn random_pixel(&self, step: u64, index: u64, rays: usize) -> (usize, usize) {
        let bits = uniform_u32(self.seed, Purpose::Pixel, step, index);
        if self.sampling.images > 0 {
            let group = index / (rays.div_ceil(self.sampling.images) as u64);
            let chosen = uniform_u32(self.seed, Purpose::Image, step, group);
            let view = scale(chosen, self.views.len() as u64) as usize;
            return match &self.unmasked[view] {
                Some(pixels) => (view, pixels[scale(bits, pixels.len() as u64) as usize] as usize),
                None => (view, scale(bits, self.views[view].pixels.len() as u64) as usize),
            };
        }
        match &self.drawn {
            Some(pixels) => self.locate(u64::from(pixels[scale(bits, pixels.len() as u64) as usize])),
            None => self.locate(scale(bits, self.starts[self.views.len()])),
        }
    }

    /// Iterates over the rays with indices `range`, of the `rays` rays of a step. Each item holds the ray's index, the
    /// indices of its view and pixel, the ray, and its entry for a batch.
    fn targets(
        &self,
        step: u64,
        range: Range<usize>,
        rays: usize,
    ) -> impl Iterator<Item = (u64, (usize, usize), Ray, BatchRay)> {
        // All sources are found before the first pixel is read, so that many loads from memory overlap.
        let sources: Vec<_> = range.clone().map(|index| self.source(step, index as u64, rays)).collect();
        let pixels: Vec<_> = sources.iter().map(|&(view, pixel)| self.views[view].pixels[pixel]).collect();
        let all = range.zip(sources).zip(pixels);
        all.map(move |((index, (view, pixel)), rgba)| {
            let (ray, target) = self.target(step, index as u64, (view, pixel), rgba);
            (index as u64, (view, pixel), ray, target)
        })
    }

    /// Returns the ray of a pixel of colour `rgba`, and its batch entry: target colour and background, no samples yet.
    fn target(&self, step: u64, index: u64, (view, pixel): (usize, usize), rgba: [u8; 4]) -> (Ray, BatchRay) {
        let ray = ray_of(&self.cameras[view], pixel);
        let background = match self.background {
            // The background is a random corner of the colour cube: there, errors of opacity change the colour most.
            // White is drawn one time in three: against it, errors at the edges of most objects change the colour most.
            Background::Alpha if self.sampling.random_background => {
                let bits = uniform_u32(self.seed, Purpose::Background, step, index);
                let white = bits >> 30 == 0;
                std::array::from_fn(|c| if white { 1.0 } else { (bits >> c & 1) as f32 })
            }
            Background::Constant(colour) => colour.map(|c| f32::from(c) / 255.0),
            // An unbounded scene has no background: against a random colour, light that passes through is an error.
            Background::Unknown if self.bounds.contraction.is_some() => {
                let bits = uniform_u32(self.seed, Purpose::Background, step, index);
                std::array::from_fn(|c| (bits >> (8 * c) & 255) as f32 / 255.0)
            }
            _ => [0.0; 3],
        };
        let rgb = crate::data::over(rgba, background);
        (ray, BatchRay { dir: ray.dir.to_array(), rgb, background, samples: 0 })
    }

    fn samples(
        &self,
        step: u64,
        index: u64,
        ray: Ray,
        batch_ray: BatchRay,
        occupancy: Option<&OccupancyGrid<'_>>,
    ) -> (BatchRay, Vec<[f32; 3]>) {
        let mut positions = Vec::new();
        if let Some((enter, exit)) = self.bounds.scene_box.clip(&ray, self.bounds.near, self.bounds.far) {
            for bin in self.bins.overlapping(enter, exit) {
                let p = ray.at(self.t(step, index, bin));
                if occupancy
                    .map_or_else(|| self.bounds.scene_box.contains(p), |occupancy| occupancy.occupied(p))
                {
                    positions.push(p.to_array());
                }
            }
        }
        (BatchRay { samples: positions.len() as u32, ..batch_ray }, positions)
    }

    /// Returns the distance of the sample in `bin` of ray `index`, world units; never below that in an earlier bin.
    fn t(&self, step: u64, index: u64, bin: u32) -> f32 {
        let draw = || uniform(self.seed, Purpose::Jitter, step, (index << 12) + u64::from(bin));
        match self.sampling.jitter {
            Jitter::None => self.bins.at(bin, 0.5),
            Jitter::Bin => self.bins.within(bin, draw()),
            Jitter::Width(width) => {
                // The width is limited to the bin's length, so that samples have no peak at the bin's end.
                let delta = self.bins.delta();
                let u = draw() * width.min(delta) / delta;
                self.bins.within(bin, u.min(1f32.next_down()))
            }
        }
    }
}

/// Appends `rays` rays to `batch`, by parallel calls of `march` for `chunk` rays each. Returns the calls' total time.
fn marched(
    batch: &mut Batch,
    rays: usize,
    chunk: usize,
    march: impl Fn(Range<usize>, &mut Marched) + Sync,
) -> Duration {
    let of_chunk = |i: usize| {
        let (begun, mut found) = (Instant::now(), Marched::default());
        march(i * chunk..rays.min((i + 1) * chunk), &mut found);
        found.time = begun.elapsed();
        found
    };
    let chunks: Vec<Marched> = (0..rays.div_ceil(chunk)).into_par_iter().map(of_chunk).collect();
    let mut time = Duration::ZERO;
    for found in chunks {
        batch.rays.extend(found.rays);
        batch.surfaces.extend(found.surfaces);
        batch.along.extend(found.along);
        batch.views.extend(found.views);
        batch.pixels.extend(found.pixels);
        batch.origins.extend(found.origins);
        batch.lines.extend(found.lines);
        batch.positions.extend(found.samples.positions);
        batch.deltas.extend(found.samples.deltas);
        batch.gradient_scales.extend(found.samples.gradient_scales);
        time += found.time;
    }
    time
}

/// Maps 32 random bits to an index below `count`.
fn scale(bits: u32, count: u64) -> u64 {
    (u64::from(bits) * count) >> 32
}

fn ray_of(camera: &Camera, pixel: usize) -> Ray {
    let width = camera.intrinsics().width as usize;
    camera.ray((pixel % width) as f32 + 0.5, (pixel / width) as f32 + 0.5)
}

#[cfg(test)]
mod tests;
