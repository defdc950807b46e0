//! The plan of a frame: all decisions about the rendering, made from the scene's content and the caller's requests.
//!
//! This file is longer than 400 lines, since every decision is a field of one [`Plan`].

use crate::blob::{Blob, MAX_SAMPLES, SceneFacts, SceneSampling, steps};
use crate::camera::Ray;
use crate::math::{MathBackend, length};
use crate::sampling::{Bins, Ends, OccupancyGrid, SampleInterval, SampleJitter, Spacing};
use crate::simd::BLOCK;
use crate::space::{BoundsError, Contraction, SceneBox};
use glam::Vec3;

mod effects;
mod error;
mod quality;
mod settings;
mod span;

#[cfg(test)]
mod tests;

pub use effects::{EffectError, Effects, Jitter, ThinLens, Tone, ToneMap};
pub use error::PlanError;
pub use quality::{Choice, Preset, Quality};
pub use settings::Settings;
pub(crate) use span::{Lattice, Span, SpanAll, Spans};

/// Outputs that a frame computes for each pixel; an output that is `false` is not computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Outputs {
    /// Whether to output the colour over the background. If `false`, the colour branch is never evaluated.
    pub rgb: bool,
    /// Whether to output the opacity, `[0, 1]`.
    pub opacity: bool,
    /// Whether to output the samples' mean distance along the ray, weighted by compositing weight, world units.
    pub ray_distance: bool,
    /// Whether to output the samples' mean distance along the view axis, weighted by compositing weight, world units.
    pub z_depth: bool,
    /// Whether to output the distance along the ray where transmittance falls below ½, world units (feature `median`).
    pub median_distance: bool,
    /// Whether to output normals, from the gradient of the density (feature `normals`). The gradient is computed at the
    /// samples that [`Quality::colour_cut`] selects. Each gradient costs
    /// [`gradient_macs`](crate::network::Architecture::gradient_macs) multiply-adds.
    pub normals: bool,
}

impl Outputs {
    /// No output.
    pub const NONE: Self = Self {
        rgb: false,
        opacity: false,
        ray_distance: false,
        z_depth: false,
        median_distance: false,
        normals: false,
    };
    /// Colour and opacity.
    pub const RGB: Self = Self { rgb: true, opacity: true, ..Self::NONE };
    /// Colour, opacity, `ray_distance` and `z_depth`: the outputs that every build supports. Median distance and
    /// normals are not included, since each needs a feature of the build.
    pub const ALL: Self = Self { ray_distance: true, z_depth: true, ..Self::RGB };

    /// Whether colour or normals are requested. Both outputs are evaluated only at the samples that
    /// [`Quality::colour_cut`] selects.
    pub(crate) const fn picks(&self) -> bool {
        self.rgb || (cfg!(feature = "normals") && self.normals)
    }

    /// Whether median distances or normals are requested. For either output, rays are marched one by one.
    pub(crate) const fn surface(&self) -> bool {
        self.median_distance || self.normals
    }
}

/// Numbers of rays and samples that are processed at once. They affect memory and time, but never the image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Batch {
    /// Number of rays that are marched at the same time.
    pub rays: usize,
    /// Number of samples in a block that the network evaluates at once. Only the kernel `Kernel::IN_PLACE` uses this
    /// number. This kernel uses portable instructions, and reads weights directly from the scene file's bytes. Other
    /// kernels always evaluate blocks of 64 samples.
    pub samples: usize,
}

impl Batch {
    /// Maximum of [`Batch::rays`]: more than any image needs, few enough for 32-bit indices.
    pub const MAX_RAYS: usize = 1 << 24;

    /// One ray and one sample, for microcontrollers. Saves memory only with the kernel `Kernel::IN_PLACE`, which uses
    /// portable instructions, and reads weights directly from the scene file's bytes. Other kernels always evaluate
    /// blocks of 64 samples.
    pub const SMALLEST: Self = Self { rays: 1, samples: 1 };

    /// 256 rays, one for each pixel of a tile, and blocks of 64 samples, which fill the vectors of any instruction set.
    pub const FULL: Self = Self { rays: 256, samples: BLOCK };

    /// Whether the batch has 1 to [`Batch::MAX_RAYS`] rays and 1 to 64 samples.
    pub(crate) fn is_valid(&self) -> bool {
        (1..=Self::MAX_RAYS).contains(&self.rays) && (1..=BLOCK).contains(&self.samples)
    }
}

/// Stages and settings of a frame, checked and decided before rendering.
#[derive(Clone, Copy, Debug)]
pub struct Plan<'a> {
    /// [`Blob::identity`] of the blob that the plan was made for.
    pub(crate) scene: usize,
    pub(crate) bounds: SceneBox,
    /// Contraction of an unbounded scene; `None` if the scene is bounded. In an unbounded scene, a sample's position
    /// along its ray is given as `s` of [`Contraction::distance`] instead of as a distance. [`Plan::point`] and
    /// [`Plan::interval`] take such positions.
    pub(crate) contraction: Option<Contraction>,
    pub(crate) lattice: Lattice,
    /// The bins in which a ray's samples lie. If a proposal network places the samples, these bins only give the number
    /// of samples to place on each ray: one sample per bin.
    pub(crate) bins: Bins,
    /// Number of samples per ray, counted as in [`Quality::samples`]: the requested number or, for 0, the scene's own.
    samples: u16,
    /// Nearest and farthest visible distance along a ray, world units.
    pub(crate) range: (f32, f32),
    /// The bins in which the proposal network is evaluated; `None` if no proposal network places the samples.
    pub(crate) proposal: Option<Bins>,
    pub(crate) near: f32,
    pub(crate) far: f32,
    pub(crate) background: [f32; 3],
    pub(crate) occupancy: Option<OccupancyGrid<'a>>,
    pub(crate) outputs: Outputs,
    pub(crate) transmittance_cut: f32,
    pub(crate) colour_cut: f32,
    pub(crate) math: MathBackend,
    pub(crate) batch: Batch,
    pub(crate) normal_blur: f32,
    pub(crate) effects: Effects,
}

impl<'a> Plan<'a> {
    /// Default width of the blur of normals, in bins. With one sample per bin, detail finer than a bin is not resolved.
    pub const NORMAL_BLUR: f32 = 1.0;

    /// Makes the plan of a frame from what `blob` holds and from the requested settings.
    ///
    /// # Errors
    /// [`PlanError`] names the setting that is invalid, or that the scene or this build does not support.
    pub fn new(
        blob: &Blob<'a>,
        quality: &Quality,
        outputs: Outputs,
        batch: Batch,
    ) -> Result<Self, PlanError> {
        let (Some(scene), Some(bounds)) = (blob.scene(), blob.scene_box()) else {
            return Err(PlanError::NotAScene);
        };
        for (effect, asked, built) in [
            ("median_distance", outputs.median_distance, cfg!(feature = "median")),
            ("normals", outputs.normals, cfg!(feature = "normals")),
        ] {
            if asked && !built {
                return Err(PlanError::NotBuilt { effect });
            }
        }
        if scene.occupancy_required && !quality.occupancy {
            return Err(PlanError::OccupancyRequired);
        }
        let samples = if quality.samples == 0 { scene.samples() } else { quality.samples };
        if samples > MAX_SAMPLES {
            return Err(PlanError::Samples { found: samples });
        }
        if !(0.0..1.0).contains(&quality.transmittance_cut) {
            return Err(PlanError::TransmittanceCut { found: quality.transmittance_cut });
        }
        if outputs.median_distance && quality.transmittance_cut > 0.5 {
            return Err(PlanError::MedianBehindCut { found: quality.transmittance_cut });
        }
        if !(0.0..1.0).contains(&quality.colour_cut) {
            return Err(PlanError::ColourCut { found: quality.colour_cut });
        }
        if !batch.is_valid() {
            return Err(PlanError::Batch { found: batch });
        }
        let proposal = blob.proposal().filter(|_| quality.proposal && cfg!(feature = "proposal"));
        let coarse = proposal.map(|proposal| Bins::new(scene.near, scene.far, proposal.samples.into()));
        let proposal = coarse.transpose().map_err(PlanError::Bounds)?;
        let (lattice, bins) = lattice(scene, samples, proposal.is_some()).map_err(PlanError::Bounds)?;
        Ok(Self {
            scene: blob.identity(),
            bounds,
            contraction: scene.contraction(),
            lattice,
            bins,
            samples,
            range: (0.0, f32::MAX),
            proposal,
            near: scene.near,
            far: scene.far,
            background: scene.background,
            occupancy: if quality.occupancy { blob.occupancy() } else { None },
            outputs,
            transmittance_cut: quality.transmittance_cut,
            colour_cut: quality.colour_cut,
            math: quality.math,
            batch,
            normal_blur: Self::NORMAL_BLUR,
            effects: Effects::NONE,
        })
    }

    /// Returns this plan with the quality settings `quality` in place of its own. `blob`: the blob of this plan.
    ///
    /// # Errors
    /// The errors of [`Plan::new`].
    pub fn at(&self, blob: &Blob<'a>, quality: &Quality) -> Result<Self, PlanError> {
        let plan = Self::new(blob, quality, self.outputs, self.batch)?;
        let plan = if self.lattice == Lattice::Own { plan.with_own_bins() } else { plan };
        let Self { background, normal_blur, effects, range, .. } = *self;
        Ok(Self { background, normal_blur, effects, range, ..plan })
    }

    /// Returns the plan with limits of visibility: only points at a distance of `t_min` to `t_max` along a ray are
    /// visible, world units. The default is 0 to infinity.
    ///
    /// A limit inside a bin cuts this bin short, so that opacity changes continuously with the limits. Nothing behind
    /// `t_max` is visible, and a pixel without a surface has a distance of at most `t_max`.
    ///
    /// # Errors
    /// [`PlanError::Range`] unless `0 <= t_min <= t_max`; `t_max` may be infinite.
    pub fn with_range(mut self, t_min: f32, t_max: f32) -> Result<Self, PlanError> {
        if !(t_min >= 0.0 && t_min <= t_max && t_min.is_finite()) {
            return Err(PlanError::Range { t_min, t_max });
        }
        self.range = (t_min, t_max.min(f32::MAX));
        Ok(self)
    }

    /// Returns the plan with samples only in the bins used in training, from near to far. By default, there are further
    /// bins of the same width in front of near and behind far. Use the training bins alone to reproduce results that
    /// were measured without the further bins.
    ///
    /// Has no effect unless the scene's sampling is [`SceneSampling::Bins`].
    #[must_use]
    pub fn with_own_bins(mut self) -> Self {
        if self.lattice == Lattice::Extended {
            self.lattice = Lattice::Own;
        }
        self
    }

    /// Returns the plan with another blur of normals. `bins`: width of the blur, in bins; 0 for no blur. With a
    /// proposal network, a bin is the mean distance between samples, (far − near) / samples per ray.
    ///
    /// A blur of one bin replaces the density's gradient by its mean over a Gaussian. The standard deviation of the
    /// Gaussian is the bin's width / √12, the standard deviation of a uniform distribution over the bin.
    ///
    /// A field that was trained with samples one bin apart also varies over distances far shorter than a bin. These
    /// variations cancel in sums along a ray, but dominate in the gradient: the tenth frequency of a sinusoidal
    /// encoding multiplies the gradient by 2^9 π.
    ///
    /// # Errors
    /// [`PlanError::NormalBlur`] unless `bins` is finite and at least 0.
    pub fn with_normal_blur(mut self, bins: f32) -> Result<Self, PlanError> {
        if !(0.0..=f32::MAX).contains(&bins) {
            return Err(PlanError::NormalBlur { found: bins });
        }
        self.normal_blur = bins;
        Ok(self)
    }

    /// Standard deviation of the Gaussian over which normals are averaged, world units.
    pub(crate) fn normal_deviation(&self) -> f32 {
        // 1/√12: the standard deviation of a uniform distribution over a bin.
        const EVEN: f32 = 0.288_675_13;
        // Samples of a proposal network have no bins: their mean spacing is used.
        let width = match self.proposal {
            Some(_) => (self.far - self.near) / self.samples_per_ray() as f32,
            None => self.bins.delta() * self.contraction.map_or(1.0, |contraction| contraction.radius()),
        };
        self.normal_blur * width * EVEN
    }

    /// Returns the requested outputs of a pixel.
    pub fn outputs(&self) -> Outputs {
        self.outputs
    }

    /// Returns the plan with the background colour `background` (red, green, blue), display-encoded.
    ///
    /// # Errors
    /// [`PlanError::Background`] unless every channel is in `[0, 1]`.
    pub fn with_background(mut self, background: [f32; 3]) -> Result<Self, PlanError> {
        if !background.iter().all(|c| (0.0..=1.0).contains(c)) {
            return Err(PlanError::Background { found: background });
        }
        self.background = background;
        Ok(self)
    }

    /// Returns the plan with `effects` in place of this plan's effects.
    ///
    /// Leaves out effects that would change nothing: a lens without aperture, and the tone of a frame without colour.
    ///
    /// # Errors
    /// [`PlanError::Effects`] on a setting that is out of range or not in this build.
    pub fn with_effects(mut self, effects: Effects) -> Result<Self, PlanError> {
        self.effects = effects.checked().map_err(PlanError::Effects)?;
        if !self.outputs.rgb {
            self.effects.tone = Tone::NONE;
        }
        Ok(self)
    }

    /// Requested number of samples per ray, counted as in [`Quality::samples`]. With a proposal network, the number
    /// includes the samples at which the proposal network is evaluated. Bins in front of near and behind far are not
    /// counted: where such bins exist, a ray may get more samples.
    pub(crate) fn samples_per_ray(&self) -> u32 {
        u32::from(self.samples) + self.proposal.map_or(0, |coarse| coarse.count())
    }

    /// Index of the first bin of `from..end` whose sample lies in an occupied cell; `end` if none does. Without an
    /// occupancy grid, all of the scene box counts as occupied. `place`: positions of the ray's samples in their bins.
    // Not inlined: a copy at each call would be a large part of a microcontroller's code.
    #[inline(never)]
    pub(crate) fn first_occupied(
        &self,
        bins: &Bins,
        ray: &Ray,
        place: SampleJitter,
        from: u32,
        end: u32,
    ) -> u32 {
        let t = |bin| place.t(bins, bin);
        match &self.occupancy {
            // A straight ray is curved in the contracted space of the occupancy grid.
            Some(occupancy) if self.contraction.is_some() => {
                (from..end).find(|&bin| occupancy.occupied(self.point(ray, t(bin)))).unwrap_or(end)
            }
            None if self.contraction.is_some() => from.min(end),
            Some(occupancy) => occupancy.first_occupied(ray, bins, from, end, t),
            None => (from..end).find(|&bin| self.bounds.contains(ray.at(t(bin)))).unwrap_or(end),
        }
    }

    /// Nearest and farthest visible distance along a ray, world units: the ray's own limits `t_min` and `t_max`,
    /// intersected with the limits of the plan.
    #[inline]
    pub(crate) fn range_of(&self, t_min: f32, t_max: f32) -> [f32; 2] {
        [self.range.0.max(t_min), self.range.1.min(t_max)]
    }

    /// Distance, world units, that a frame outputs for each pixel without a surface. `eye`: position of the camera. No
    /// visible point of the scene is farther from `eye`.
    pub fn far_from(&self, eye: Vec3) -> f32 {
        if self.lattice == Lattice::Own {
            return self.far.min(self.range.1);
        }
        if let Some(contraction) = &self.contraction {
            return (length(eye - contraction.centre()) + self.far).min(self.range.1);
        }
        let reach = (eye - self.bounds.min).abs().max((eye - self.bounds.max).abs());
        self.far.max(length(reach)).min(self.range.1)
    }

    /// Whether a point of the network's space ([`Plan::inside`]) is in an occupied cell. Without an occupancy grid,
    /// whether the point is in the scene box.
    #[inline]
    pub(crate) fn occupied(&self, p: Vec3) -> bool {
        match &self.occupancy {
            Some(occupancy) => occupancy.occupied(p),
            None => self.bounds.contains(p),
        }
    }

    /// Converts a point of the world to the network's space: contracts it if the scene is unbounded, else returns it
    /// unchanged. A point with a NaN is also returned unchanged: no box contains such a point.
    #[inline]
    pub(crate) fn inside(&self, p: Vec3) -> Vec3 {
        match &self.contraction {
            Some(contraction) if !p.is_nan() => contraction.contract(p),
            _ => p,
        }
    }

    /// Whether several rays may be marched at once, one per SIMD lane. True for a frame that uses no proposal network
    /// and outputs neither median distances nor normals.
    pub(crate) fn marches_side_by_side(&self) -> bool {
        self.proposal.is_none() && !self.outputs.surface()
    }

    #[inline(always)]
    pub(crate) fn spacing(&self) -> Spacing<'_> {
        Spacing { bins: &self.bins, contraction: self.contraction.as_ref() }
    }

    /// Returns the point of the ray at `t`. In a bounded scene, `t` is the distance along the ray, world units. In an
    /// unbounded scene, `t` is the warped distance `s`, which [`Contraction::distance`] converts to world units; the
    /// returned point is contracted.
    #[inline]
    pub(crate) fn point(&self, ray: &Ray, t: f32) -> Vec3 {
        match &self.contraction {
            Some(contraction) => contraction.contract(ray.at(contraction.distance(t))),
            None => ray.at(t),
        }
    }

    /// The bins that a ray is marched through first: with a proposal network, the bins in which that network is
    /// evaluated; else the bins of the samples.
    pub(crate) fn marched_bins(&self) -> &Bins {
        self.proposal.as_ref().unwrap_or(&self.bins)
    }

    /// Least distance of a sample on a ray through an unbounded scene, world units. The distance is measured from the
    /// point at distance `start` along the ray. `t_min`: nearest visible distance, measured from the ray's origin.
    #[inline]
    pub(crate) fn least_distance(&self, start: f32, t_min: f32) -> f32 {
        self.near.max(t_min) - start
    }

    /// Returns the part of the ray over which the density of the sample at `t` is used. `t`: distance, world units; in
    /// an unbounded scene, position `s` of [`Contraction::distance`]. `start`: distance along the ray to the point at
    /// which `t` is 0, world units. `ends`: cuts of the ray's first and last bin. `t_min`: nearest visible
    /// distance along the ray, world units.
    #[inline]
    pub(crate) fn interval(&self, ends: &Ends, start: f32, t_min: f32, t: f32) -> SampleInterval {
        if self.contraction.is_some() {
            return self.spacing().interval(ends.parts(), self.least_distance(start, t_min), t);
        }
        if t >= ends.low && t < ends.high {
            // A jittered sample lies anywhere in its bin, so that the bin's middle is computed separately.
            let jittered = self.outputs.median_distance && self.effects.jitter.is_some();
            let mid = if jittered { self.bins.with(*ends).middle_around(t) } else { t };
            return SampleInterval { t, mid, delta: self.bins.delta() };
        }
        self.spacing().interval_of_cut(ends.parts(), t)
    }
}

/// Computes the bins of a frame and how the bins are placed on a ray. `samples`: number of samples per ray. `proposal`:
/// whether a proposal network places the samples. Fails if `samples` bins from near to far are too narrow for f32.
fn lattice(scene: &SceneFacts, samples: u16, proposal: bool) -> Result<(Lattice, Bins), BoundsError> {
    let diagonal = scene.diagonal();
    let step = |own: f32, way: f32| if samples == scene.samples() { own } else { way / f32::from(samples) };
    let (mut lattice, near, step) = match scene.sampling {
        SceneSampling::March(own) => (Lattice::March, 0.0, step(own, diagonal)),
        SceneSampling::Contracted { step: own, power } => {
            let step = step(own, scene.reach());
            let farthest = 1.0 + f32::from(power);
            return Ok((Lattice::Contracted, Bins::of_width(-farthest, step, steps(2.0 * farthest, step))));
        }
        SceneSampling::Bins(_) => {
            let own = Bins::new(scene.near, scene.far, samples.into())?;
            (Lattice::Extended, scene.near, own.delta())
        }
    };
    // Three more, since rounding may lengthen a ray beyond the diagonal, and bins begin in front of the box.
    let mut count = steps(diagonal, step).saturating_add(3).max(samples.into());
    // With a proposal network, or above `MAX_SAMPLES` bins, only the bins from near to far are used.
    if lattice == Lattice::Extended && (proposal || count > u32::from(MAX_SAMPLES)) {
        (lattice, count) = (Lattice::Own, samples.into());
    }
    Ok((lattice, Bins::of_width(near, step, count)))
}
