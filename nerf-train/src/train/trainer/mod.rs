//! Trainer of a scene: data, settings and everything that changes from step to step.

pub mod candidate;

use crate::capture::sights::{self, Sights};
use crate::data::{Background, Dataset, mean_colour};
use crate::model::config::{Config, Density, SamplingConfig};
use crate::model::engine::{Batch, Engine, Model, Phase, Phases, engine_for};
use crate::train::average::Average;
use crate::train::checkpoint::{Checkpoint, State, fingerprint, settings};
use crate::train::occupancy::{DensityQuery, Occupancy};
use crate::train::photographs::Photographs;
use crate::train::poses::{Poses, given};
use crate::train::rays::{MarchCells, RayBank};
use crate::train::schedule::learning_rate;
use crate::train::{Bounds, Progressed, TrainError, find_bounds};
use nerf_core::Kernel;
use nerf_core::blob::MAX_SAMPLES;
use nerf_core::camera::Camera;
use std::time::{Duration, Instant};

/// Number of consecutive steps without gradients, usually with every density 0, after which a run restarts.
const DEAD_STEPS: u32 = 100;
/// Largest number of occupancy updates until every candidate cell has been evaluated, if the field has a learned grid.
const REFRESHES: usize = 24;
/// Step length of the ray march in an unbounded scene: length at the start, as a multiple of the final length, and
/// fraction of the run after which the final length is reached. Steps are long at first, as densities are diffuse.
const UNBOUNDED_GROWTH: (f64, f64) = (4.0, 0.15);
/// Step length of the ray march in a bounded scene: length at the start, as a multiple of the final length, and
/// fraction of the run after which the final length is reached.
const BOUNDED_GROWTH: (f64, f64) = (2.0, 0.4);
/// Number of stages in which the march's steps are shortened to their final length.
const STAGES: f64 = 8.0;
/// Fraction of a run after which samples of enough weight mark their cells as visible, in an unbounded scene.
const MARKED_FROM: f64 = 0.5;
/// Number of steps in which the poses of validation views are refined.
const HELD_OUT_STEPS: u32 = 100;
/// Rays per validation view in each of the [`HELD_OUT_STEPS`]; fewer if there are more views than [`HELD_OUT_VIEWS`].
const HELD_OUT_RAYS: usize = 48;
const HELD_OUT_VIEWS: usize = 64;
/// Number of restarts before a run is given up.
pub(crate) const RESEEDS: u32 = 3;

/// Fit of a radiance field: data, settings and everything that changes from step to step.
pub struct Trainer<'d> {
    pub(crate) config: Config,
    dataset: &'d Dataset,
    /// Background colour, display-encoded: the data set's constant colour, otherwise black. Exception: in an unbounded
    /// scene of unknown background, the mean colour of the photographs, which shows only in unseen space.
    pub(crate) background: [f32; 3],
    pub(crate) model: Model,
    kernel: Kernel,
    pub(crate) bounds: Bounds,
    bank: RayBank<'d>,
    /// Final step length of the ray march, world units; `None` if rays are divided into bins between near and far.
    step_width: Option<f32>,
    engine: Box<dyn Engine>,
    pub(crate) state: State,
    batch: Batch,
    /// Lines of sight from the training cameras to sparse points; `None` if there are none, or in a bounded scene.
    pub(crate) sights: Option<Sights>,
    cells: Option<MarchCells>,
    /// Ray march and batch of the next step, filled during the present step. `None`: the batch is not filled.
    prefetched: (Option<March>, Batch),
    phases: Phases,
    pub(crate) fingerprint: u64,
}

impl<'d> Trainer<'d> {
    /// Creates a trainer before its first step, with scene bounds, initial occupancy and initial parameters.
    pub fn new(dataset: &'d Dataset, config: Config, kernel: Kernel) -> Result<Self, TrainError> {
        config.check()?;
        let unbounded = config.sampling.contraction.is_some();
        let sights = Some(dataset).filter(|_| unbounded).and_then(sights::of_training);
        let (bounds, occupancy) = find_bounds(dataset, &config, sights.as_ref())?;
        let extent = bounds.scene_box.max - bounds.scene_box.min;
        let model = config.model_of(extent);
        let mut config = config;
        let mut step_width = None;
        if config.network.grid.is_some() {
            config.sampling.samples = bins_across(&bounds, config.sampling.steps_across);
            step_width = Some(bounds.step(config.sampling.steps_across));
        }
        let mut bank = RayBank::new(&dataset.train, dataset.background, bounds, &config)?;
        if let Some(sights) = sights.as_ref().filter(|_| config.capture.depth > 0.0) {
            bank = bank.with_sights(sights);
        }
        let adam = config.optimiser.adam();
        let engine = engine_for(config.engine, &model, bounds.scene_box, adam, config.seed, kernel.isa)?;
        let background = match dataset.background {
            Background::Constant(colour) => colour.map(|c| f32::from(c) / 255.0),
            Background::Unknown if bounds.contraction.is_some() => mean_colour(&dataset.train),
            Background::Alpha | Background::Unknown => [0.0; 3],
        };
        let state = State {
            average: Average::new(config.optimiser.average, config.averaged_every(), model.parameters()),
            occupancy,
            photographs: Photographs::of(dataset, &config, sights.as_ref()),
            ..State::default()
        };
        Ok(Self {
            dataset,
            background,
            model,
            kernel,
            bounds,
            bank,
            step_width,
            engine,
            state,
            batch: Batch::default(),
            sights,
            cells: None,
            prefetched: Default::default(),
            phases: Phases::default(),
            fingerprint: fingerprint(dataset),
            config,
        })
    }

    /// Resumes from a checkpoint of the same run. Fails, without a change, if the checkpoint's parameters do not fit
    /// the network ([`TrainError::Engine`]), or another part does not fit ([`TrainError::Parts`]).
    pub fn restore(&mut self, checkpoint: Checkpoint) -> Result<(), TrainError> {
        self.check_parts(&checkpoint)?;
        self.engine.restore(&checkpoint.optimiser)?;
        self.state = checkpoint.state;
        let train = &self.dataset.train;
        let poses = self.state.photographs.poses.as_ref();
        self.bank.set_cameras(poses.map_or_else(|| given(train), |poses| poses.cast(train)));
        self.forget_marched();
        Ok(())
    }

    /// Fails if a part of a checkpoint does not fit this run. A valid checksum does not prove who wrote the file.
    fn check_parts(&self, checkpoint: &Checkpoint) -> Result<(), TrainError> {
        let State { progressed: p, occupancy, photographs, .. } = &checkpoint.state;
        let counted = p.rays.max(p.samples).max(p.evaluated) <= u64::MAX / 2;
        let alive = p.dead_steps < DEAD_STEPS && p.reseeds <= RESEEDS;
        let cells = match (occupancy, &self.state.occupancy) {
            (Some(theirs), Some(ours)) => theirs.is_like(ours),
            (theirs, ours) => theirs.is_none() && ours.is_none(),
        };
        let own = &self.state.photographs;
        let wrong = match (counted && alive, cells) {
            (false, _) => Some("counters"),
            (true, false) => Some("occupancy cells"),
            (true, true) => own.wrong_part(photographs, &self.dataset.train, &self.config),
        };
        match wrong.or_else(|| checkpoint.wrong_part(&self.state.average)) {
            Some(part) => Err(TrainError::Parts { part }),
            None => Ok(()),
        }
    }

    pub fn checkpoint(&self, seconds: f64) -> Checkpoint {
        Checkpoint {
            config: settings(&self.config),
            data: self.dataset.name.clone(),
            fingerprint: self.fingerprint,
            optimiser: self.engine.state(),
            state: self.state.clone(),
            seconds,
        }
    }

    /// Returns the time spent in each phase: wall-clock for occupancy updates, otherwise summed over threads.
    pub fn phases(&self) -> Phases {
        let mut phases = self.phases;
        phases += self.engine.phases();
        phases
    }

    pub fn progressed(&self) -> &Progressed {
        &self.state.progressed
    }

    pub fn training_cameras(&self) -> Vec<Camera> {
        let train = &self.dataset.train;
        self.state.photographs.refined().map_or_else(|| given(train), |poses| poses.cameras(train))
    }

    /// Returns the number of rays that will refine the poses of the validation views; 0 if poses are not refined.
    pub fn held_out_rays(&self) -> u64 {
        let rays = HELD_OUT_RAYS * self.dataset.val.len().min(HELD_OUT_VIEWS);
        if self.state.photographs.refined().is_some() { u64::from(HELD_OUT_STEPS) * rays as u64 } else { 0 }
    }

    /// Returns the refined cameras of training and validation views; `None` if poses are not refined. The validation
    /// views are refined here, with the field fixed. Fails if they have no finite loss ([`TrainError::Engine`]).
    pub fn refined_cameras(&mut self) -> Result<Option<RefinedCameras>, TrainError> {
        let (Some(poses), Some(contraction)) = (self.state.photographs.refined(), &self.bounds.contraction)
        else {
            return Ok(None);
        };
        let (Some(width), Some(occupancy)) = (self.step_width, &self.state.occupancy) else {
            return Ok(None);
        };
        let (train, views) = (poses.cameras(&self.dataset.train), &self.dataset.val);
        if views.is_empty() {
            return Ok(Some(RefinedCameras { train, val: Vec::new() }));
        }
        let mut bank = RayBank::new(views, self.dataset.background, self.bounds, &self.config)?;
        let (mut poses, cells) = (Poses::given(views.len(), false), MarchCells::new(occupancy.live()));
        let rays = HELD_OUT_RAYS * views.len().min(HELD_OUT_VIEWS);
        for step in 0..HELD_OUT_STEPS {
            let share = f64::from(step) / f64::from(HELD_OUT_STEPS);
            bank.fill_marched(self.kernel.isa, &mut self.batch, step.into(), rays, &cells, width);
            // Smoothness says nothing about where a camera stood.
            self.batch.smoothness = None;
            self.batch.question = Some(Poses::question(share, contraction));
            self.engine.ask(&self.batch)?;
            poses.add(&self.batch, self.engine.ray_gradients());
            poses.move_cameras(views, share, contraction);
            bank.set_cameras(poses.cameras(views));
        }
        self.prefetched.0 = None;
        Ok(Some(RefinedCameras { train, val: poses.cameras(views) }))
    }

    pub fn pixels(&self) -> u64 {
        self.bank.pixels()
    }

    /// Does one training step. `share`: used fraction of the budget, which sets the learning rate. Fails if all
    /// densities are 0 again after the last restart ([`TrainError::Dead`]) or, without a change, if the step diverges.
    pub fn step(&mut self, share: f64) -> Result<(), TrainError> {
        let step = self.state.progressed.step;
        self.draw(step.into(), share);
        let optimiser = &self.config.optimiser;
        let found = self.state.photographs.withheld_found;
        self.engine.set_weight_decay(found.map_or(optimiser.weight_decay, |found| found.weight_decay));
        if let Some(grid) = self.config.network.grid.as_ref().filter(|grid| grid.is_rounded(share)) {
            self.engine.round_tables(grid.rounding());
        }
        let rate = learning_rate(optimiser, step, share);
        let refreshed = self.config.occupancy.skip && (step + 1).is_multiple_of(self.config.occupancy.every);
        let width = self.step_width(share);
        let (views, contraction) = (&self.dataset.train, self.bounds.contraction.as_ref());
        let moved = self.state.photographs.prepare(&mut self.batch, views, share, contraction);
        if let Some(cameras) = moved {
            self.bank.set_cameras(cameras);
        }
        let Self { bank, batch, prefetched, cells, phases, kernel, .. } = self;
        let s = &self.config.sampling;
        let grid = self.config.network.grid.is_some();
        let mut live_per_ray = self.state.progressed.live_per_ray;
        let loss = self.engine.step_with_prefetch(batch, rate, &mut |loss| {
            if grid {
                live_per_ray = smoothed(live_per_ray, loss.kept, batch.rays.len());
            }
            // If this step ends with an update of the occupancy grid, the cells of the next step are not known yet.
            if let (Some(width), Some(cells), false) = (width, &cells, refreshed) {
                let (step, rays) = (u64::from(step) + 1, rays_of(s, 1.0, live_per_ray));
                let march = March { step, rays, width };
                prefetched.0 = Some(march);
                phases.add(Phase::March, march.fill(bank, *kernel, cells, &mut prefetched.1));
            }
        })?;
        let (photographs, engine) = (&mut self.state.photographs, &*self.engine);
        let at = (step, share);
        if photographs.learn(engine, &self.batch, views, &self.config, contraction, at) {
            self.bank.set_cameras(given(views));
            self.prefetched.0 = None;
        }
        self.mark_weighted(share);
        let p = &mut self.state.progressed;
        p.live_per_ray = live_per_ray;
        p.step += 1;
        p.rays += self.batch.rays.len() as u64;
        p.evaluated += loss.evaluated as u64;
        p.samples += loss.kept as u64;
        p.mse = if step == 0 { loss.mse } else { 0.98 * p.mse + 0.02 * loss.mse };
        p.dead_steps = if loss.dead { p.dead_steps + 1 } else { 0 };
        if p.dead_steps >= DEAD_STEPS {
            return self.reseed();
        }
        self.state.average.update(p.step, || self.engine.parameters());
        if refreshed {
            let now = Instant::now();
            self.refresh_occupancy();
            self.phases.lap(Phase::Occupancy, now);
        }
        Ok(())
    }

    /// Marks the cells of the last step's samples as visible, if the samples have enough weight. Does nothing in a
    /// bounded scene, or before the fraction [`MARKED_FROM`] of the run.
    fn mark_weighted(&mut self, share: f64) {
        if self.bounds.contraction.is_none() || share < MARKED_FROM {
            return;
        }
        if let Some(occupancy) = &mut self.state.occupancy {
            occupancy.mark(self.batch.rays.len(), self.engine.weighted());
        }
    }

    /// Returns the step length of the ray march, world units, when the fraction `share` of the budget is used up.
    /// `None` if rays are divided into a fixed number of bins.
    fn step_width(&self, share: f64) -> Option<f32> {
        let longer = lengthened(share, self.bounds.contraction.is_some());
        self.step_width.filter(|_| self.state.occupancy.is_some()).map(|width| longer * width)
    }

    fn draw(&mut self, step: u64, share: f64) {
        let s = &self.config.sampling;
        let occupancy =
            self.state.occupancy.as_ref().filter(|_| self.config.occupancy.skip).map(Occupancy::lookup);
        let live_per_ray = self.state.progressed.live_per_ray;
        // With a learned grid, the number of samples with a large enough weight is known only after the step.
        let counted_after = self.config.network.grid.is_some();
        if let (Some(width), Some(occupancy)) = (self.step_width(share), &self.state.occupancy) {
            let march = March { step, rays: rays_of(s, 1.0, live_per_ray), width };
            if self.prefetched.0.take() == Some(march) {
                std::mem::swap(&mut self.batch, &mut self.prefetched.1);
            } else {
                let cells = self.cells.get_or_insert_with(|| MarchCells::new(occupancy.live()));
                let time = march.fill(&self.bank, self.kernel, cells, &mut self.batch);
                self.phases.add(Phase::March, time);
            }
        } else {
            let (margin, limit) = if counted_after { (1.0, 0) } else { (1.1, s.live_samples) };
            let rays = rays_of(s, margin, live_per_ray);
            self.bank.fill(&mut self.batch, step, rays, limit, occupancy.as_ref());
        }
        if !counted_after {
            let live = self.batch.positions.len();
            self.state.progressed.live_per_ray = smoothed(live_per_ray, live, self.batch.rays.len());
        }
        self.batch.empty_weight = self.config.occupancy.empty_weight;
        if let Some(occupancy) = &occupancy {
            let count = self.config.occupancy.empty_share * self.batch.positions.len() as f32;
            self.bank.fill_empty(&mut self.batch, step, count as usize, occupancy);
        }
    }

    /// Discards the copy of the occupied cells and the prefetched batch, after the occupancy grid has changed.
    fn forget_marched(&mut self) {
        (self.cells, self.prefetched.0) = (None, None);
    }

    fn refresh_occupancy(&mut self) {
        let g = &self.config.occupancy;
        let parameters = self.model.fold(self.engine.parameters());
        let threshold = self.threshold();
        if let Some(occupancy) = &mut self.state.occupancy {
            let architecture = &self.model.architecture;
            let ask = DensityQuery {
                isa: self.kernel.isa,
                architecture,
                parameters: &parameters,
                seed: self.config.seed,
                contraction: self.bounds.contraction,
            };
            // Without a hull many cells must be emptied, and the density of a learned grid is cheap to evaluate.
            let turn = occupancy.candidates().div_ceil(REFRESHES);
            let cells = if self.config.network.grid.is_some() { g.cells.max(turn) } else { g.cells };
            occupancy.refresh(&ask, cells, threshold, g.decay, self.state.progressed.step >= g.from);
        }
        self.forget_marched();
    }

    /// Returns the density above which an update keeps a cell occupied, 1/world unit.
    fn threshold(&self) -> f32 {
        let bins = f32::from(self.config.sampling.samples);
        let width = self.step_width.unwrap_or((self.bounds.far - self.bounds.near) / bins);
        self.config.occupancy.threshold / width
    }

    /// Restarts with another seed if all densities became 0, as can happen with ReLU. Fails after [`RESEEDS`] restarts.
    fn reseed(&mut self) -> Result<(), TrainError> {
        let restarts = self.state.progressed.reseeds + 1;
        if restarts > RESEEDS {
            let relu = self.config.network.density == Density::Relu;
            return Err(TrainError::Dead { restarts, relu });
        }
        let seed = self.config.seed.wrapping_add(1000 * u64::from(restarts));
        self.engine = engine_for(
            self.config.engine,
            &self.model,
            self.bounds.scene_box,
            self.config.optimiser.adam(),
            seed,
            self.kernel.isa,
        )?;
        let sights = self.sights.as_ref();
        self.state.average.clear();
        self.state = State {
            average: std::mem::take(&mut self.state.average),
            occupancy: find_bounds(self.dataset, &self.config, sights)?.1,
            photographs: Photographs::of(self.dataset, &self.config, sights),
            progressed: Progressed { reseeds: restarts, ..Progressed::default() },
            ..State::default()
        };
        self.bank.set_cameras(given(&self.dataset.train));
        self.forget_marched();
        Ok(())
    }
}

#[derive(Clone, Debug)]
pub struct RefinedCameras {
    pub train: Vec<Camera>,
    pub val: Vec<Camera>,
}

/// Parameters of the ray march of a step's batch.
#[derive(Clone, Copy, PartialEq)]
struct March {
    step: u64,
    rays: usize,
    width: f32,
}

impl March {
    fn fill(&self, bank: &RayBank<'_>, kernel: Kernel, cells: &MarchCells, batch: &mut Batch) -> Duration {
        bank.fill_marched(kernel.isa, batch, self.step, self.rays, cells, self.width)
    }
}

/// Returns the number of rays that give `margin` times the configured number of samples. `live_per_ray`: samples per
/// ray; if 0 (unknown), returns the configured number of rays.
fn rays_of(sampling: &SamplingConfig, margin: f64, live_per_ray: f64) -> usize {
    if sampling.live_samples > 0 && live_per_ray > 0.0 {
        ((margin * sampling.live_samples as f64 / live_per_ray) as usize).clamp(64, 65_536)
    } else {
        sampling.rays
    }
}

/// Returns the smoothed number of samples per ray after a batch of `rays` rays and `live` samples. `before`: the
/// smoothed number before the batch; 0 at first.
fn smoothed(before: f64, live: usize, rays: usize) -> f64 {
    let now = live as f64 / rays.max(1) as f64;
    if before == 0.0 { now } else { 0.9 * before + 0.1 * now }
}

/// Returns the ray march's step length at the used fraction `share` of the budget, as a multiple of the final length.
pub(crate) fn lengthened(share: f64, unbounded: bool) -> f32 {
    let (longest, growth) = if unbounded { UNBOUNDED_GROWTH } else { BOUNDED_GROWTH };
    let stage = (STAGES * share / growth).floor().min(STAGES);
    longest.powf(1.0 - stage / STAGES) as f32
}

/// Returns the number of bins between near and far whose width is 1/`steps` of the longest side of the scene box.
fn bins_across(bounds: &Bounds, steps: u16) -> u16 {
    let longest = (bounds.scene_box.max - bounds.scene_box.min).max_element();
    let bins = f64::from(steps) * f64::from(bounds.far - bounds.near) / f64::from(longest);
    (bins.ceil() as u16).clamp(1, MAX_SAMPLES)
}
