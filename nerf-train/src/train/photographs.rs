//! What a run learns of the photographs: gains, poses, masks of moving objects, and the PSNR of withheld photographs.

use super::exposure::{ExposureFound, Gains};
use super::moving::{Moved, Moving};
use super::poses::{Poses, PosesFound};
use super::withheld::{LEARNED_FROM, Withheld, WithheldFound};
use crate::capture::sights::Sights;
use crate::data::{Dataset, View};
use crate::model::config::{Config, Exposure};
use crate::model::engine::{Batch, Engine};
use nerf_core::camera::Camera;
use nerf_core::space::Contraction;
use serde::{Deserialize, Serialize};

/// Gains, poses and masks learned for the photographs; findings about exposure, poses and withheld photographs.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Photographs {
    gains: Option<Gains>,
    pub exposure: Option<ExposureFound>,
    pub(super) poses: Option<Poses>,
    pub poses_found: Option<PosesFound>,
    moving: Option<Moving>,
    withheld: Option<Withheld>,
    pub withheld_found: Option<WithheldFound>,
}

impl Photographs {
    pub fn of(dataset: &Dataset, config: &Config, sights: Option<&Sights>) -> Self {
        let (views, capture) = (&dataset.train, &config.capture);
        let unbounded = config.sampling.contraction.is_some();
        let mut found = Self::default();
        // In a bounded scene, gains are learned from the start only if the settings ask for them. Otherwise they begin
        // once photographs are found to contradict each other.
        if unbounded || capture.exposure != Exposure::Auto {
            (found.gains, found.exposure) = Gains::of(views, sights, capture.exposure);
        }
        if unbounded {
            (found.poses, found.poses_found) = Poses::of(dataset, sights.is_some(), capture.poses);
            found.moving = Moving::of(views, capture.moving);
        }
        // With refined poses, no photograph is withheld: the poses of the others would drift away from the poses of the
        // withheld photographs.
        if found.poses.is_none() {
            found.withheld = Withheld::of(views, config);
        }
        found
    }

    /// Returns the name of the first field of `theirs`, the state in a checkpoint, that does not fit `views` and
    /// `config`, for example by its number of photographs; `None` if all fit.
    pub(super) fn wrong_part(&self, theirs: &Self, views: &[View], config: &Config) -> Option<&'static str> {
        let gains = theirs.gains.as_ref().is_none_or(|gains| gains.views() == views.len());
        let unbounded = config.sampling.contraction.is_some();
        let poses = theirs.poses.as_ref().is_none_or(|poses| poses.is_of(views) && unbounded);
        let moving = theirs.moving.is_some() == self.moving.is_some()
            && theirs.moving.as_ref().is_none_or(|moving| moving.is_of(views));
        let withheld = theirs.withheld.as_ref().is_none_or(|withheld| withheld.is_of(views))
            && theirs.withheld_found.is_none_or(|found| found.is_sound(&config.optimiser));
        let parts = [
            ("gains of photographs", gains),
            ("poses of photographs", poses),
            ("patches of photographs", moving),
            ("withheld photographs", withheld),
        ];
        parts.into_iter().find(|&(_, fits)| !fits).map(|(part, _)| part)
    }

    /// Sets gains and loss weights of the rays of `batch`. If poses are refined, also requests loss gradients with
    /// respect to the rays. Returns refined cameras for the next rays, if any moved. `share`: used fraction of the
    /// budget.
    pub fn prepare(
        &mut self,
        batch: &mut Batch,
        views: &[View],
        share: f64,
        contraction: Option<&Contraction>,
    ) -> Option<Vec<Camera>> {
        if let Some(gains) = &self.gains {
            gains.factors(&batch.views, &mut batch.gains);
        }
        if let Some(moving) = &self.moving {
            moving.weigh(batch);
        }
        if let Some(withheld) = &self.withheld {
            withheld.weigh(batch);
        }
        let (poses, contraction) = (self.poses.as_mut()?, contraction?);
        batch.question = Some(Poses::question(share, contraction));
        poses.renew().then(|| poses.cast(views))
    }

    /// Updates gains, poses and masks after `engine` did step `step` on `batch`. Returns true if the refinement of
    /// poses was given up in this step: the caller must then cast rays from the given poses.
    pub fn learn(
        &mut self,
        engine: &dyn Engine,
        batch: &Batch,
        views: &[View],
        config: &Config,
        contraction: Option<&Contraction>,
        (step, share): (u32, f64),
    ) -> bool {
        if let Some(gains) = &mut self.gains
            && let Some(found) = gains.step(&engine.gain_gradients(gains.views()))
        {
            self.exposure = Some(found);
            self.gains.take_if(|_| !found.fitted);
        }
        let mut given = false;
        if let (Some(poses), Some(contraction)) = (&mut self.poses, contraction) {
            poses.add(batch, engine.ray_gradients());
            if let Some(found) = poses.step(views, (step, share), contraction) {
                (self.poses_found, given) = (Some(found), !found.refined);
                self.poses.take_if(|_| given);
            }
        }
        // Moving objects are found by errors of a field that has been trained on all photographs for long enough.
        let all_are_shown =
            self.withheld.is_none() && (self.withheld_found.is_none() || step >= LEARNED_FROM);
        if let Some(moving) = self.moving.as_mut().filter(|_| all_are_shown) {
            moving.add(batch, engine.errors());
            moving.step(step);
        }
        self.withheld.take_if(|_| Withheld::is_given_up(share));
        if let Some(withheld) = &mut self.withheld {
            withheld.add(batch, step, engine.errors());
            if let Some(found) = withheld.verdict(step, &config.optimiser) {
                (self.withheld, self.withheld_found) = (None, Some(found));
                // Exposures measured at key points take precedence: they are more reliable.
                let unknown = self.exposure.is_none() && self.gains.is_none();
                if found.contradict() && unknown && config.capture.exposure == Exposure::Auto {
                    self.gains = Some(Gains::of_contradicting(views));
                }
            }
        }
        given
    }

    /// Returns the refined poses; `None` if poses are not refined, or if the trial of refining them has not ended.
    pub(super) fn refined(&self) -> Option<&Poses> {
        self.poses.as_ref().filter(|poses| poses.are_refined())
    }

    pub fn has_moved(&self) -> bool {
        self.moving.as_ref().is_some_and(Moving::is_found)
    }

    /// Returns the training photographs `views` in which a moving object is masked at present.
    pub fn moved(&self, views: &[View]) -> Vec<Moved> {
        self.moving.as_ref().map_or_else(Vec::new, |moving| moving.found(views))
    }
}

const BETAS: [f32; 2] = [0.9, 0.99];
const EPSILON: f32 = 1e-12;

/// Adam optimiser for gains and poses, which are few parameters per photograph.
pub(super) struct SmallAdam {
    unbiased: [f32; 2],
}

impl SmallAdam {
    pub fn after(steps: u32) -> Self {
        Self { unbiased: BETAS.map(|beta| 1.0 - beta.powi(steps.min(10_000) as i32)) }
    }

    /// Updates the moments `m1`, `m2` for gradient `g`. Returns the value to subtract from the parameter.
    pub fn step(&self, rate: f32, g: f32, m1: &mut f32, m2: &mut f32) -> f32 {
        *m1 = BETAS[0] * *m1 + (1.0 - BETAS[0]) * g;
        *m2 = BETAS[1] * *m2 + (1.0 - BETAS[1]) * g * g;
        rate * *m1 / self.unbiased[0] / ((*m2 / self.unbiased[1]).sqrt() + EPSILON)
    }
}
