//! A run: data, settings and everything that changes from step to step.

pub mod candidate;

use crate::capture::sights::{self, Sights};
use crate::data::{Background, Dataset, View, mean_colour};
use crate::model::config::{Config, Density, Exposure, SamplingConfig};
use crate::model::engine::{Batch, Engine, Model, Phase, Phases, engine_for};
use crate::train::average::Average;
use crate::train::checkpoint::{Checkpoint, fingerprint, settings};
use crate::train::exposure::{ExposureFound, Gains};
use crate::train::moving::{Moved, Moving};
use crate::train::occupancy::{DensityQuery, Occupancy};
use crate::train::poses::{Poses, PosesFound};
use crate::train::rays::{MarchCells, RayBank};
use crate::train::schedule::learning_rate;
use crate::train::withheld::{LEARNED_FROM, Withheld, WithheldFound};
use crate::train::{Bounds, CurvePoint, Progressed, Snapshot, TrainError, find_bounds};
use nerf_core::Kernel;
use nerf_core::blob::MAX_SAMPLES;
use nerf_core::camera::Camera;
use std::time::{Duration, Instant};

/// Number of consecutive steps without any density after which a run restarts with another seed.
const DEAD_STEPS: u32 = 100;
/// Updates of the occupancy grid in which every cell of a grid field is evaluated once.
const REFRESHES: usize = 24;
/// Factor on the length of a grid's steps at the beginning, when most of the scene is still fog, and fraction of the
/// run after which the steps have their final length: in an unbounded scene and in a bounded one.
const UNBOUNDED_GROWTH: (f64, f64) = (4.0, 0.15);
const BOUNDED_GROWTH: (f64, f64) = (2.0, 0.4);
/// Number of stages in which steps become shorter.
const STAGES: f64 = 8.0;
/// Fraction of a run after which the cells of an unbounded scene that training rays give weight to are marked.
const MARKED_FROM: f64 = 0.5;
/// Number of steps in which the poses of validation views are refined.
const HELD_OUT_STEPS: u32 = 100;
/// Rays per validation view in each of these steps; fewer if there are more views than [`HELD_OUT_VIEWS`].
const HELD_OUT_RAYS: usize = 48;
const HELD_OUT_VIEWS: usize = 64;
/// Number of restarts before a run is given up.
pub(crate) const RESEEDS: u32 = 3;

/// A run: data, settings and everything that changes from step to step.
pub struct Trainer<'d> {
    config: Config,
    dataset: &'d Dataset,
    /// Background colour, display-encoded: the data's own; in an unbounded scene, where it shows only in parts that
    /// no photograph saw, the photographs' mean colour; else black.
    pub(crate) background: [f32; 3],
    model: Model,
    kernel: Kernel,
    bounds: Bounds,
    bank: RayBank<'d>,
    /// Width of the steps that rays are marched in; none if they are cut into bins between near and far.
    step_width: Option<f32>,
    engine: Box<dyn Engine>,
    occupancy: Option<Occupancy>,
    average: Average,
    batch: Batch,
    /// Key points of the training views of an unbounded scene.
    sights: Option<Sights>,
    gains: Option<Gains>,
    exposure: Option<ExposureFound>,
    poses: Option<Poses>,
    poses_found: Option<PosesFound>,
    moving: Option<Moving>,
    withheld: Option<Withheld>,
    withheld_found: Option<WithheldFound>,
    /// Occupied cells in the layout for marching; none until they are needed.
    cells: Option<MarchCells>,
    /// The next step's batch, if it was marched during this step's update, and the parameters of that march.
    prefetched: (Option<March>, Batch),
    progressed: Progressed,
    phases: Phases,
    fingerprint: u64,
    pub curve: Vec<CurvePoint>,
    pub snapshots: Vec<Snapshot>,
}

impl<'d> Trainer<'d> {
    /// Prepares the first step: bounds, hull, rays, initial values.
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
        let (gains, exposure) = gains_at_first(dataset, sights.as_ref(), &config);
        let (poses, poses_found) = match unbounded {
            true => Poses::of(dataset, sights.is_some(), config.capture.poses),
            false => (None, None),
        };
        let moving = match unbounded {
            true => Moving::of(&dataset.train, config.capture.moving),
            false => None,
        };
        let withheld = withheld_at_first(dataset, &config, poses.as_ref());
        let engine = engine_for(
            config.engine,
            &model,
            bounds.scene_box,
            config.optimiser.adam(),
            config.seed,
            kernel.isa,
        )?;
        let background = match dataset.background {
            Background::Constant(colour) => colour.map(|c| f32::from(c) / 255.0),
            Background::Unknown if bounds.contraction.is_some() => mean_colour(&dataset.train),
            Background::Alpha | Background::Unknown => [0.0; 3],
        };
        Ok(Self {
            average: Average::new(config.optimiser.average, config.averaged_every(), model.parameters()),
            dataset,
            background,
            model,
            kernel,
            bounds,
            bank,
            step_width,
            engine,
            occupancy,
            batch: Batch::default(),
            sights,
            gains,
            exposure,
            poses,
            poses_found,
            moving,
            withheld,
            withheld_found: None,
            cells: None,
            prefetched: Default::default(),
            progressed: Progressed::default(),
            phases: Phases::default(),
            curve: Vec::new(),
            snapshots: Vec::new(),
            fingerprint: fingerprint(dataset),
            config,
        })
    }

    pub fn model(&self) -> &Model {
        &self.model
    }

    /// Resumes from a checkpoint of the same run.
    ///
    /// # Errors
    /// [`TrainError::Engine`] if its parameters do not fit, [`TrainError::Parts`] if anything else does not; the run
    /// is then as before.
    pub fn restore(&mut self, checkpoint: Checkpoint) -> Result<(), TrainError> {
        self.check_parts(&checkpoint)?;
        self.engine.restore(&checkpoint.optimiser)?;
        self.average = checkpoint.average;
        self.occupancy = checkpoint.occupancy;
        (self.gains, self.exposure) = (checkpoint.gains, checkpoint.exposure);
        (self.poses, self.poses_found) = (checkpoint.poses, checkpoint.poses_found);
        self.moving = checkpoint.moving;
        (self.withheld, self.withheld_found) = (checkpoint.withheld, checkpoint.withheld_found);
        self.apply_weight_decay();
        let train = &self.dataset.train;
        self.bank.set_cameras(self.poses.as_ref().map_or_else(|| given(train), |poses| poses.cast(train)));
        self.forget_marched();
        self.progressed = checkpoint.progressed;
        self.curve = checkpoint.curve;
        self.snapshots = checkpoint.snapshots;
        Ok(())
    }

    /// Checks that the run can compute with a checkpoint, whose checksum does not tell who wrote it.
    fn check_parts(&self, checkpoint: &Checkpoint) -> Result<(), TrainError> {
        let Checkpoint { progressed: p, occupancy, .. } = checkpoint;
        let counted = p.rays.max(p.samples).max(p.evaluated) <= u64::MAX / 2;
        let alive = p.dead_steps < DEAD_STEPS && p.reseeds <= RESEEDS;
        let cells = match (occupancy, &self.occupancy) {
            (Some(theirs), Some(ours)) => theirs.is_like(ours),
            (theirs, ours) => theirs.is_none() && ours.is_none(),
        };
        let gains = checkpoint.gains.as_ref();
        let gains = gains.is_none_or(|gains| gains.views() == self.dataset.train.len());
        let poses = checkpoint.poses.as_ref();
        let poses =
            poses.is_none_or(|poses| poses.is_of(&self.dataset.train) && self.bounds.contraction.is_some());
        let moving = match (&checkpoint.moving, &self.moving) {
            (Some(theirs), Some(_)) => theirs.is_of(&self.dataset.train),
            (theirs, ours) => theirs.is_none() && ours.is_none(),
        };
        let withheld =
            checkpoint.withheld.as_ref().is_none_or(|withheld| withheld.is_of(&self.dataset.train))
                && checkpoint.withheld_found.is_none_or(|found| found.is_sound(&self.config.optimiser));
        let parts = [
            ("counters", counted && alive),
            ("occupancy cells", cells),
            ("gains of photographs", gains),
            ("poses of photographs", poses),
            ("patches of photographs", moving),
            ("withheld photographs", withheld),
        ];
        let wrong = parts.into_iter().find(|&(_, fits)| !fits).map(|(part, _)| part);
        match wrong.or_else(|| checkpoint.wrong_part(&self.average)) {
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
            average: self.average.clone(),
            occupancy: self.occupancy.clone(),
            gains: self.gains.clone(),
            exposure: self.exposure,
            poses: self.poses.clone(),
            poses_found: self.poses_found,
            moving: self.moving.clone(),
            withheld: self.withheld.clone(),
            withheld_found: self.withheld_found,
            progressed: self.progressed,
            curve: self.curve.clone(),
            snapshots: self.snapshots.clone(),
            seconds,
        }
    }

    pub fn config(&self) -> &Config {
        &self.config
    }

    /// Time of this process's steps by phase: wall-clock time for the occupancy, the sum over threads for the rest.
    pub fn phases(&self) -> Phases {
        let mut phases = self.phases;
        phases += self.engine.phases();
        phases
    }

    pub fn progressed(&self) -> &Progressed {
        &self.progressed
    }

    pub fn fingerprint(&self) -> u64 {
        self.fingerprint
    }

    pub fn bounds(&self) -> &Bounds {
        &self.bounds
    }

    /// Key points that the fit uses; `None` if there are none.
    pub fn sights(&self) -> Option<&Sights> {
        self.sights.as_ref()
    }

    /// Verdict on the photographs' exposure; `None` until it is known.
    pub fn exposure(&self) -> Option<ExposureFound> {
        self.exposure
    }

    /// Verdict on the photographs' poses; `None` until it is known.
    pub fn poses(&self) -> Option<PosesFound> {
        self.poses_found
    }

    /// Training photographs of which something that moved is masked at present.
    pub fn moved(&self) -> Vec<Moved> {
        self.moving.as_ref().map_or_else(Vec::new, |moving| moving.found(&self.dataset.train))
    }

    pub fn has_moved(&self) -> bool {
        self.moving.as_ref().is_some_and(Moving::is_found)
    }

    /// Verdict of the withheld photographs; `None` until it is known.
    pub fn withheld(&self) -> Option<WithheldFound> {
        self.withheld_found
    }

    pub fn training_cameras(&self) -> Vec<Camera> {
        let train = &self.dataset.train;
        self.refined().map_or_else(|| given(train), |poses| poses.cameras(train))
    }

    /// The poses, if they are refined and no longer on trial.
    fn refined(&self) -> Option<&Poses> {
        self.poses.as_ref().filter(|poses| poses.are_refined())
    }

    /// Number of rays that refining the validation views' poses will take; 0 if poses are not refined.
    pub fn held_out_rays(&self) -> u64 {
        let rays = HELD_OUT_RAYS * self.dataset.val.len().min(HELD_OUT_VIEWS);
        if self.refined().is_some() { u64::from(HELD_OUT_STEPS) * rays as u64 } else { 0 }
    }

    /// Refined cameras of the training views, and of the validation views, which are refined against the present
    /// field; `None` if poses are not refined.
    ///
    /// # Errors
    /// [`TrainError::Engine`] if the field has no finite loss on the validation views.
    pub fn refined_cameras(&mut self) -> Result<Option<RefinedCameras>, TrainError> {
        let (Some(poses), Some(contraction)) = (self.refined(), &self.bounds.contraction) else {
            return Ok(None);
        };
        let (Some(width), Some(occupancy)) = (self.step_width, &self.occupancy) else { return Ok(None) };
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

    /// Occupied fraction of the cells; 1 without an occupancy grid.
    pub fn occupied_share(&self) -> f32 {
        self.occupancy.as_ref().map_or(1.0, |occupancy| occupancy.lookup().occupied_share())
    }

    pub fn parameters(&self) -> usize {
        self.model.parameters()
    }

    pub fn train_psnr_db(&self) -> f64 {
        crate::train::psnr_db_of_mse(self.progressed.mse)
    }

    /// Does one step at the learning rate for the used fraction `share` of the budget.
    ///
    /// # Errors
    /// [`TrainError::Engine`] if the step diverged; the run is then as before it.
    /// [`TrainError::Dead`] if every restart ended without density.
    pub fn step(&mut self, share: f64) -> Result<(), TrainError> {
        let step = u64::from(self.progressed.step);
        self.draw(step, share);
        if let Some(grid) = self.config.network.grid.as_ref().filter(|grid| grid.is_rounded(share)) {
            self.engine.round_tables(grid.rounding());
        }
        let rate = learning_rate(&self.config.optimiser, self.progressed.step, share);
        let refreshed = self.config.occupancy.skip
            && (self.progressed.step + 1).is_multiple_of(self.config.occupancy.every);
        let width = self.step_width(share);
        let Self {
            bank,
            batch,
            prefetched,
            cells,
            phases,
            progressed: p,
            kernel,
            gains,
            poses,
            moving,
            withheld,
            ..
        } = self;
        if let Some(gains) = gains {
            gains.factors(&batch.views, &mut batch.gains);
        }
        if let (Some(poses), Some(contraction)) = (poses, &self.bounds.contraction) {
            batch.question = Some(Poses::question(share, contraction));
            if poses.renew() {
                bank.set_cameras(poses.cast(&self.dataset.train));
            }
        }
        if let Some(moving) = moving {
            moving.weigh(batch);
        }
        if let Some(withheld) = withheld {
            withheld.weigh(batch);
        }
        let s = &self.config.sampling;
        let grid = self.config.network.grid.is_some();
        let mut live_per_ray = p.live_per_ray;
        let loss = self.engine.step_with_prefetch(batch, rate, &mut |loss| {
            if grid {
                live_per_ray = smoothed(live_per_ray, loss.kept, batch.rays.len());
            }
            // The cells that an update of the occupancy grid leaves are not known yet.
            if let (Some(width), Some(cells), false) = (width, &cells, refreshed) {
                let march = March { step: step + 1, rays: rays_of(s, 1.0, live_per_ray), width };
                prefetched.0 = Some(march);
                phases.add(Phase::March, march.fill(bank, *kernel, cells, &mut prefetched.1));
            }
        })?;
        self.learn_gains();
        self.learn_poses(share);
        let shown = self.all_are_shown();
        if let Some(moving) = self.moving.as_mut().filter(|_| shown) {
            moving.add(&self.batch, self.engine.errors());
            moving.step(self.progressed.step);
        }
        self.learn_withheld(share);
        self.mark_weighted(share);
        let p = &mut self.progressed;
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
        self.average.update(self.progressed.step, || self.engine.parameters());
        if refreshed {
            let now = Instant::now();
            self.refresh_occupancy();
            self.phases.lap(Phase::Occupancy, now);
        }
        Ok(())
    }

    /// Updates the photographs' gains by the last step.
    fn learn_gains(&mut self) {
        let Some(gains) = &mut self.gains else { return };
        if let Some(found) = gains.step(&self.engine.gain_gradients(gains.views())) {
            self.exposure = Some(found);
            if !found.fitted {
                self.gains = None;
            }
        }
    }

    /// Updates the photographs' cameras by the last step.
    fn learn_poses(&mut self, share: f64) {
        let (Some(poses), Some(contraction)) = (&mut self.poses, &self.bounds.contraction) else { return };
        poses.add(&self.batch, self.engine.ray_gradients());
        let at = (self.progressed.step, share);
        let Some(found) = poses.step(&self.dataset.train, at, contraction) else { return };
        self.poses_found = Some(found);
        if !found.refined {
            self.poses = None;
            self.bank.set_cameras(given(&self.dataset.train));
            self.prefetched.0 = None;
        }
    }

    /// Whether the field has been trained on all photographs for long enough to be contradicted by one.
    fn all_are_shown(&self) -> bool {
        let after_trial = self.withheld_found.is_none() || self.progressed.step >= LEARNED_FROM;
        self.withheld.is_none() && after_trial
    }

    /// Adds the errors of the last step, and decides the weight decay if that was the trial's last.
    fn learn_withheld(&mut self, share: f64) {
        self.withheld.take_if(|_| Withheld::is_given_up(share));
        let Some(withheld) = &mut self.withheld else { return };
        let step = self.progressed.step;
        withheld.add(&self.batch, step, self.engine.errors());
        if let Some(found) = withheld.verdict(step, &self.config.optimiser) {
            (self.withheld, self.withheld_found) = (None, Some(found));
            self.apply_weight_decay();
            // Key points tell more about exposure than contradictions do.
            let unknown = self.exposure.is_none() && self.gains.is_none();
            if found.contradict() && unknown && self.config.capture.exposure == Exposure::Auto {
                self.gains = Some(Gains::of_contradicting(&self.dataset.train));
            }
        }
    }

    fn apply_weight_decay(&mut self) {
        let given = self.config.optimiser.weight_decay;
        self.engine.set_weight_decay(self.withheld_found.map_or(given, |found| found.weight_decay));
    }

    /// Marks the cells of an unbounded scene that the last step gave weight to.
    fn mark_weighted(&mut self, share: f64) {
        if self.bounds.contraction.is_none() || share < MARKED_FROM {
            return;
        }
        if let Some(occupancy) = &mut self.occupancy {
            occupancy.mark(self.batch.rays.len(), self.engine.weighted());
        }
    }

    /// Width of the marched steps at the used fraction `share` of the budget.
    fn step_width(&self, share: f64) -> Option<f32> {
        let longer = lengthened(share, self.bounds.contraction.is_some());
        self.step_width.filter(|_| self.occupancy.is_some()).map(|width| longer * width)
    }

    fn draw(&mut self, step: u64, share: f64) {
        let s = &self.config.sampling;
        let occupancy = self.occupancy.as_ref().filter(|_| self.config.occupancy.skip).map(Occupancy::lookup);
        let live_per_ray = self.progressed.live_per_ray;
        // A grid's samples count if they are kept, which is known only after the step.
        let counted_after = self.config.network.grid.is_some();
        if let (Some(width), Some(occupancy)) = (self.step_width(share), &self.occupancy) {
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
            self.progressed.live_per_ray = smoothed(live_per_ray, live, self.batch.rays.len());
        }
        self.batch.empty_weight = self.config.occupancy.empty_weight;
        if let Some(occupancy) = &occupancy {
            let count = self.config.occupancy.empty_share * self.batch.positions.len() as f32;
            self.bank.fill_empty(&mut self.batch, step, count as usize, occupancy);
        }
    }

    /// Discards what was marched with the previous cells.
    fn forget_marched(&mut self) {
        (self.cells, self.prefetched.0) = (None, None);
    }

    fn refresh_occupancy(&mut self) {
        let g = &self.config.occupancy;
        let parameters = self.model.fold(self.engine.parameters());
        let threshold = self.threshold();
        if let Some(occupancy) = &mut self.occupancy {
            let architecture = &self.model.architecture;
            let ask = DensityQuery {
                isa: self.kernel.isa,
                architecture,
                parameters: &parameters,
                seed: self.config.seed,
                contraction: self.bounds.contraction,
            };
            // Without a hull there are many cells to prune, and a grid's density is cheap to evaluate.
            let turn = occupancy.candidates().div_ceil(REFRESHES);
            let cells = if self.config.network.grid.is_some() { g.cells.max(turn) } else { g.cells };
            occupancy.refresh(&ask, cells, threshold, g.decay, self.progressed.step >= g.from);
        }
        self.forget_marched();
    }

    /// Density above which a cell is kept, 1/world unit.
    fn threshold(&self) -> f32 {
        let bins = f32::from(self.config.sampling.samples);
        let width = self.step_width.unwrap_or((self.bounds.far - self.bounds.near) / bins);
        self.config.occupancy.threshold / width
    }

    /// Restarts with another seed: the known cure when ReLU densities all become 0.
    fn reseed(&mut self) -> Result<(), TrainError> {
        let restarts = self.progressed.reseeds + 1;
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
        self.occupancy = find_bounds(self.dataset, &self.config, self.sights.as_ref())?.1;
        (self.poses, self.poses_found) = match self.bounds.contraction {
            Some(_) => Poses::of(self.dataset, self.sights.is_some(), self.config.capture.poses),
            None => (None, None),
        };
        (self.gains, self.exposure) = gains_at_first(self.dataset, self.sights.as_ref(), &self.config);
        self.moving =
            self.moving.as_ref().and_then(|_| Moving::of(&self.dataset.train, self.config.capture.moving));
        (self.withheld, self.withheld_found) =
            (withheld_at_first(self.dataset, &self.config, self.poses.as_ref()), None);
        self.bank.set_cameras(given(&self.dataset.train));
        self.forget_marched();
        self.average.clear();
        self.progressed = Progressed { reseeds: restarts, ..Progressed::default() };
        self.curve.clear();
        self.snapshots.clear();
        Ok(())
    }
}

/// Cameras after poses were refined, in the order of their views.
#[derive(Clone, Debug)]
pub struct RefinedCameras {
    pub train: Vec<Camera>,
    pub val: Vec<Camera>,
}

/// Gains to learn from the first step on, and the known exposure. A scene that ends at a box has no gains before its
/// photographs contradict each other, unless the settings ask for them.
fn gains_at_first(
    dataset: &Dataset,
    sights: Option<&Sights>,
    config: &Config,
) -> (Option<Gains>, Option<ExposureFound>) {
    let exposure = config.capture.exposure;
    if config.sampling.contraction.is_none() && exposure == Exposure::Auto {
        return (None, None);
    }
    Gains::of(&dataset.train, sights, exposure)
}

/// Photographs to withhold. None if poses are refined: the others' poses would move away from theirs.
fn withheld_at_first(dataset: &Dataset, config: &Config, poses: Option<&Poses>) -> Option<Withheld> {
    if poses.is_some() { None } else { Withheld::of(&dataset.train, config) }
}

fn given(views: &[View]) -> Vec<Camera> {
    views.iter().map(|view| view.camera).collect()
}

/// Parameters that a step's samples are marched with.
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

/// Number of rays that a step draws if each has `live_per_ray` samples; 0 is not known yet.
fn rays_of(sampling: &SamplingConfig, margin: f64, live_per_ray: f64) -> usize {
    if sampling.live_samples > 0 && live_per_ray > 0.0 {
        ((margin * sampling.live_samples as f64 / live_per_ray) as usize).clamp(64, 65_536)
    } else {
        sampling.rays
    }
}

/// Smoothed number of samples in occupied cells per ray, after a step that had `live` on `rays`.
fn smoothed(before: f64, live: usize, rays: usize) -> f64 {
    let now = live as f64 / rays.max(1) as f64;
    if before == 0.0 { now } else { 0.9 * before + 0.1 * now }
}

/// Length of a grid's steps at the used fraction `share` of the budget, as a multiple of the final length.
pub(crate) fn lengthened(share: f64, unbounded: bool) -> f32 {
    let (longest, growth) = if unbounded { UNBOUNDED_GROWTH } else { BOUNDED_GROWTH };
    let stage = (STAGES * share / growth).floor().min(STAGES);
    longest.powf(1.0 - stage / STAGES) as f32
}

/// Number of bins between near and far if the longest side of the box has `steps` of them.
fn bins_across(bounds: &Bounds, steps: u16) -> u16 {
    let longest = (bounds.scene_box.max - bounds.scene_box.min).max_element();
    let bins = f64::from(steps) * f64::from(bounds.far - bounds.near) / f64::from(longest);
    (bins.ceil() as u16).clamp(1, MAX_SAMPLES)
}
