//! Quality settings of a frame. Each point of a scene's Pareto front has settings, their loss (PSNR of the exact
//! rendering minus PSNR with these settings, dB) and their cost (multiply-adds relative to the exact rendering).

use crate::blob::{Blob, FrontPoint};
use crate::math::MathBackend;
use crate::names::names;

#[cfg(test)]
mod tests;

/// The quality settings of a frame: approximations that save time and lower the accuracy.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quality {
    /// Number of samples per ray; 0 for the scene's own number. What is counted depends on the scene's
    /// [`SceneSampling`](crate::blob::SceneSampling):
    ///
    /// - `Bins`: bins from near to far. Bins of the same width in front of near and behind far are not counted.
    /// - `Bins` with a proposal network: samples placed by this network. Evaluations of this network are not counted.
    /// - `March`: steps along the diagonal of the scene box.
    /// - `Contracted`: steps on a ray through the centre of the contraction's inner ball, from the point where the ray
    ///   enters the ball to the point at distance `far` behind the centre.
    pub samples: u16,
    /// Transmittance below which a ray ends and counts as opaque, `[0, 1)`; with 0, no ray ends early.
    pub transmittance_cut: f32,
    /// Threshold of a sum of compositing weights, above which a colour is evaluated. The weights of consecutive samples
    /// are summed along a ray. Once the sum exceeds the threshold, the current sample's colour is evaluated and
    /// weighted by the whole sum, and the sum restarts at 0. With a threshold of 0, the colour of every sample of
    /// weight above 0 is evaluated.
    ///
    /// The same rule selects the samples whose normal is evaluated. With [`Shading::PerRay`](crate::network::Shading)
    /// the rule selects the samples whose trunk outputs are composited. The cut never affects opacity or distances.
    pub colour_cut: f32,
    /// Whether cells that the occupancy grid marks as empty are skipped.
    pub occupancy: bool,
    /// Implementation of the elementary functions, such as exp and sine.
    pub math: MathBackend,
    /// Whether the scene's proposal network places the samples. If `false`, or if the scene has no proposal network,
    /// samples are uniform. A scene with a proposal network was trained with samples placed by that network. Rendering
    /// with the network's samples may take more or less time than rendering with uniform samples.
    pub proposal: bool,
}

impl Quality {
    /// Default of [`Quality::transmittance_cut`]. In four scenes, this cut and the default colour cut together save
    /// more than half of the density evaluations and lower the PSNR by at most 0.03 dB
    /// (`docs/journal/2026-11-22-frames.md`).
    pub const TRANSMITTANCE_CUT: f32 = 2e-2;
    /// Default of [`Quality::colour_cut`], which is a threshold on a sum of compositing weights.
    pub const COLOUR_CUT: f32 = 5e-3;

    /// The exact rendering: evaluates every sample inside the scene box, at the positions used in training.
    pub const EXACT: Self = Self {
        samples: 0,
        transmittance_cut: 0.0,
        colour_cut: 0.0,
        occupancy: false,
        math: MathBackend::Polynomial,
        proposal: true,
    };

    /// Returns the settings of the exact rendering of the scene in `blob`: [`Quality::EXACT`], with the occupancy grid
    /// only if the blob requires the grid (`occupancy_required`).
    pub fn exact(blob: &Blob<'_>) -> Self {
        let occupancy_required = blob.scene().is_some_and(|scene| scene.occupancy_required);
        Self { occupancy: occupancy_required, ..Self::EXACT }
    }

    /// Returns the cheapest settings on the blob's Pareto front whose PSNR is at most `db` dB below exact rendering.
    ///
    /// If the PSNR of every point is lower, returns the point of highest PSNR. `None` without a Pareto front, or if
    /// every point needs a maths backend or a proposal network that this build lacks. The returned settings may have a
    /// transmittance cut above one half; [`Plan::new`](crate::plan::Plan::new) refuses such settings together with a
    /// median distance.
    pub fn within_loss(blob: &Blob<'_>, db: f32) -> Option<Choice> {
        // Ordered from the most expensive point to the cheapest, and thus from the highest PSNR to the lowest.
        let last = Self::choices(blob).take_while(|choice| choice.loss_db <= db).last();
        last.map(|choice| Choice { within: true, ..choice }).or_else(|| Self::choices(blob).next())
    }

    /// Returns the settings of highest PSNR on the blob's Pareto front with at most `ratio` times the multiply-adds of
    /// the exact rendering; of settings with equal PSNR, the cheapest.
    ///
    /// If every point costs more, returns the cheapest point. `None` in the same cases as [`Quality::within_loss`].
    pub fn within_cost(blob: &Blob<'_>, ratio: f32) -> Option<Choice> {
        let mut affordable = Self::choices(blob).filter(|choice| choice.cost <= ratio);
        let Some(first) = affordable.next() else { return Self::choices(blob).last() };
        let best = affordable.take_while(|choice| choice.loss_db <= first.loss_db).last().unwrap_or(first);
        Some(Choice { within: true, ..best })
    }

    /// Returns the settings of a preset in this scene: the cheapest on the scene's Pareto front whose PSNR is at most
    /// [`Preset::loss_db`] below that of the exact rendering. If every PSNR is too low, returns [`Quality::exact`].
    ///
    /// Without a Pareto front the PSNR of settings is not known. `Preset::Exact` is then [`Quality::exact`], and
    /// `Preset::High` is [`Quality::default`]. The other presets are then fixed settings, with losses measured in a
    /// scene with a learned grid:
    ///
    /// | preset | transmittance cut | colour cut | samples | PSNR below exact |
    /// | --- | ---: | ---: | ---: | ---: |
    /// | `Balanced` | 0.03 | 0.03 | all | 0.05 dB |
    /// | `Fast` | 0.1 | 0.03 | all | 0.2 dB |
    /// | `Preview` | 0.1 | 0.1 | four fifths | 0.9 dB |
    ///
    /// # Source
    /// `docs/accuracy-and-time.md`: measurements of the learned grid.
    pub fn preset(blob: &Blob<'_>, preset: Preset) -> Self {
        if let Some(choice) = Self::within_loss(blob, preset.loss_db()) {
            return if choice.within { choice.quality } else { Self::exact(blob) };
        }
        let all = blob.scene().map_or(0, |scene| scene.samples());
        let (transmittance_cut, colour_cut, samples) = match preset {
            Preset::Exact => return Self::exact(blob),
            Preset::High => return Self::default(),
            Preset::Balanced => (0.03, 0.03, 0),
            Preset::Fast => (0.1, 0.03, 0),
            Preset::Preview => (0.1, 0.1, (all - all / 5).max(1)),
        };
        Self { transmittance_cut, colour_cut, samples, ..Self::default() }
    }

    /// Returns these settings, with their measured loss and cost, as a point of a Pareto front for the blob.
    ///
    /// `loss_db`: PSNR with [`Quality::exact`] minus PSNR with these settings, each against the photographs. `cost`:
    /// multiply-adds relative to those of the exact rendering. In the returned point, the occupancy grid and the
    /// proposal network are off if the scene lacks them. If [`Quality::samples`] is 0, the point gets the scene's own
    /// number of samples. [`crate::blob::write()`] checks the ranges of all values.
    pub fn front_point(&self, blob: &Blob<'_>, loss_db: f32, cost: f32) -> FrontPoint {
        let own = blob.scene().map_or(0, |scene| scene.samples());
        FrontPoint {
            samples: if self.samples == 0 { own } else { self.samples },
            transmittance_cut: self.transmittance_cut,
            colour_cut: self.colour_cut,
            occupancy: self.occupancy && blob.occupancy().is_some(),
            math: self.math.tag(),
            proposal: self.proposal && blob.proposal().is_some(),
            loss_db,
            cost,
        }
    }

    /// Returns the settings on the blob's Pareto front (loss against cost) that this build can render, most expensive
    /// first, each with its index in the front. [`Choice::within`] is false, since no limit was requested.
    pub fn front<'b>(blob: &'b Blob<'_>) -> impl Iterator<Item = (usize, Choice)> + 'b {
        let built = |point: &FrontPoint| !point.proposal || cfg!(feature = "proposal");
        blob.front().iter().enumerate().filter(move |(_, point)| built(point)).filter_map(|(index, point)| {
            let FrontPoint { samples, transmittance_cut, colour_cut, occupancy, proposal, .. } = *point;
            let math = MathBackend::from_tag(point.math)?;
            let quality = Self { samples, transmittance_cut, colour_cut, occupancy, math, proposal };
            Some((index, Choice { quality, loss_db: point.loss_db, cost: point.cost, within: false }))
        })
    }

    /// Returns the settings on the blob's Pareto front that this build can render, most expensive first.
    fn choices<'b>(blob: &'b Blob<'_>) -> impl Iterator<Item = Choice> + 'b {
        Self::front(blob).map(|(_, choice)| choice)
    }
}

impl Default for Quality {
    /// Settings without a visible loss: the occupancy grid, [`Quality::TRANSMITTANCE_CUT`], [`Quality::COLOUR_CUT`].
    fn default() -> Self {
        Self {
            transmittance_cut: Self::TRANSMITTANCE_CUT,
            colour_cut: Self::COLOUR_CUT,
            occupancy: true,
            ..Self::EXACT
        }
    }
}

/// A point of the blob's Pareto front: quality settings with their loss and cost.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Choice {
    /// Quality settings of the point of the Pareto front.
    pub quality: Quality,
    /// PSNR of the exact rendering minus PSNR with these settings, each against photographs, dB; negative for a gain.
    pub loss_db: f32,
    /// Multiply-adds relative to those of the exact rendering.
    pub cost: f32,
    /// Whether the settings meet the requested limit. If `false`, either no point of the Pareto front meets the limit
    /// and these settings are the nearest to the limit, or no limit was requested ([`Quality::front`]).
    pub within: bool,
}

names! {
    /// Named limits of the loss: dB by which the PSNR may lie below that of the exact rendering. Smallest limit first.
    pub enum Preset {
        /// No loss: PSNR against photographs at least that of the exact rendering.
        Exact = "exact",
        /// PSNR against photographs at most 0.01 dB below that of the exact rendering: no visible difference.
        High = "high",
        /// PSNR against photographs at most 0.1 dB below that of the exact rendering.
        Balanced = "balanced",
        /// PSNR against photographs at most 0.3 dB below that of the exact rendering.
        Fast = "fast",
        /// PSNR against photographs at most 1 dB below that of the exact rendering: for navigation.
        Preview = "preview",
    }
}

impl Preset {
    /// Largest loss that the preset allows, dB: PSNR of the exact rendering minus PSNR with the preset's settings.
    pub const fn loss_db(self) -> f32 {
        match self {
            Self::Exact => 0.0,
            Self::High => 0.01,
            Self::Balanced => 0.1,
            Self::Fast => 0.3,
            Self::Preview => 1.0,
        }
    }
}
