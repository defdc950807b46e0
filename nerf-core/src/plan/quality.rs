//! The shortcuts of a frame, and which of them a scene's front offers at what price.

use crate::blob::{Blob, FrontPoint};
use crate::math::MathBackend;
use crate::names::names;

#[cfg(test)]
mod tests;

/// The shortcuts of a frame; each costs accuracy and saves time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quality {
    /// Samples per ray; 0 for what the scene was made for. Of a scene with bins, so many between its near and far, and as
    /// wide ones wherever else a ray is in its box; of one that is marched, so many steps to the diagonal of its box.
    /// With a proposal these are drawn from it, and the proposal's own, whose number is the scene's, come on top.
    pub samples: u16,
    /// A ray ends where its transmittance falls below this, and is opaque; 0 never ends one.
    pub transmittance_cut: f32,
    /// A sample's colour is asked for where the weight that waits for one exceeds this: its own, and that
    /// of the samples in front of it that were too light. 0 asks for every colour with a weight. A sample's
    /// normal is asked for in the same way, and in a field shaded once a ray its `h` is composited so.
    ///
    /// Opacity and distances never depend on it.
    pub colour_cut: f32,
    /// Whether cells that the occupancy grid calls empty are skipped.
    pub occupancy: bool,
    /// The implementation of the elementary functions.
    pub math: MathBackend,
    /// Whether samples are drawn from the scene's proposal network, if it has one; else they are even.
    /// No shortcut: it is how such a scene was made, and may cost more or less than even samples.
    pub proposal: bool,
}

impl Quality {
    /// The default transmittance cut: with the default colour cut 0.01 dB against no cut, and less than half the
    /// evaluations (`docs/journal/2026-11-22-frames.md`).
    pub const TRANSMITTANCE_CUT: f32 = 2e-2;
    /// The default colour cut.
    pub const COLOUR_CUT: f32 = 5e-3;

    /// No shortcut: every sample inside the scene box, drawn as the scene was made for.
    pub const EXACT: Self = Self {
        samples: 0,
        transmittance_cut: 0.0,
        colour_cut: 0.0,
        occupancy: false,
        math: MathBackend::Polynomial,
        proposal: true,
    };

    /// [`Quality::EXACT`] in this scene: behind its occupancy grid where that is part of the model.
    pub fn exact(blob: &Blob<'_>) -> Self {
        let occupancy_required = blob.scene().is_some_and(|scene| scene.occupancy_required);
        Self { occupancy: occupancy_required, ..Self::EXACT }
    }

    /// The cheapest settings of the blob's front that lose at most `db` against the exact rendering.
    ///
    /// Where every point loses more, the one that loses least. `None` without a front, or with one that
    /// needs maths backends or a proposal this build is without. The settings may cut beyond one half, which a
    /// frame with a median distance refuses.
    pub fn within_loss(blob: &Blob<'_>, db: f32) -> Option<Choice> {
        // Dearest first, and so from the least loss to the most.
        let last = Self::choices(blob).take_while(|choice| choice.loss_db <= db).last();
        last.map(|choice| Choice { within: true, ..choice }).or_else(|| Self::choices(blob).next())
    }

    /// The settings of the blob's front that lose least at no more than `ratio` of the exact rendering's
    /// multiply-adds; of two that lose the same, the cheaper.
    ///
    /// Where every point costs more, the cheapest. `None` as with [`Quality::within_loss`].
    pub fn within_cost(blob: &Blob<'_>, ratio: f32) -> Option<Choice> {
        let mut affordable = Self::choices(blob).filter(|choice| choice.cost <= ratio);
        let Some(first) = affordable.next() else { return Self::choices(blob).last() };
        let best = affordable.take_while(|choice| choice.loss_db <= first.loss_db).last().unwrap_or(first);
        Some(Choice { within: true, ..best })
    }

    /// The settings of a preset in this scene; they lose no more than [`Preset::loss_db`] says.
    ///
    /// The front decides. Where even its best point loses too much, [`Quality::exact`], which loses
    /// nothing by definition.
    ///
    /// Without a front what they lose in this scene is not known. `Preset::Exact` is then [`Quality::exact`],
    /// `Preset::High` [`Quality::default`]; the others cut what a study of another scene says:
    ///
    /// | preset | transmittance cut | colour cut | samples | lost there |
    /// | --- | ---: | ---: | ---: | ---: |
    /// | `Balanced` | 0.03 | 0.03 | all | 0.05 dB |
    /// | `Fast` | 0.1 | 0.03 | all | 0.2 dB |
    /// | `Preview` | 0.1 | 0.1 | four fifths | 0.9 dB |
    ///
    /// # Source
    /// `docs/accuracy-and-time.md`, the learned grid.
    pub fn preset(blob: &Blob<'_>, preset: Preset) -> Self {
        match Self::within_loss(blob, preset.loss_db()) {
            Some(choice) if choice.within => choice.quality,
            Some(_) => Self::exact(blob),
            None if preset == Preset::Exact => Self::exact(blob),
            None => Self::unmeasured(blob, preset),
        }
    }

    /// A preset below exact of a scene without a front.
    fn unmeasured(blob: &Blob<'_>, preset: Preset) -> Self {
        let all = blob.scene().map_or(0, |scene| scene.samples());
        let (transmittance_cut, colour_cut, samples) = match preset {
            Preset::Exact | Preset::High => return Self::default(),
            Preset::Balanced => (0.03, 0.03, 0),
            Preset::Fast => (0.1, 0.03, 0),
            Preset::Preview => (0.1, 0.1, (all - all / 5).max(1)),
        };
        Self { transmittance_cut, colour_cut, samples, ..Self::default() }
    }

    /// These settings as a point of the blob's front, for who measured them.
    ///
    /// `loss_db`: PSNR of [`Quality::exact`] minus that of these settings, against ground truth.
    /// `cost`: their multiply-adds over those of the exact rendering. What the scene has not is off, and
    /// its own number of samples is spelt out, as a file has them; [`crate::blob::write()`] checks the rest.
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

    /// Every point of the blob's front that this build can render, with its index: dearest first, none of them
    /// chosen.
    pub fn front<'b>(blob: &'b Blob<'_>) -> impl Iterator<Item = (usize, Choice)> + 'b {
        let built = |point: &FrontPoint| !point.proposal || cfg!(feature = "proposal");
        blob.front().iter().enumerate().filter(move |(_, point)| built(point)).filter_map(|(index, point)| {
            let quality = Quality {
                samples: point.samples,
                transmittance_cut: point.transmittance_cut,
                colour_cut: point.colour_cut,
                occupancy: point.occupancy,
                math: MathBackend::from_tag(point.math)?,
                proposal: point.proposal,
            };
            Some((index, Choice { quality, loss_db: point.loss_db, cost: point.cost, within: false }))
        })
    }

    /// The points of [`Quality::front`].
    fn choices<'b>(blob: &'b Blob<'_>) -> impl Iterator<Item = Choice> + 'b {
        Self::front(blob).map(|(_, choice)| choice)
    }
}

impl Default for Quality {
    /// The shortcuts that cost nothing visible: the occupancy grid, the cuts at the values of
    /// [`Quality::TRANSMITTANCE_CUT`] and [`Quality::COLOUR_CUT`].
    fn default() -> Self {
        Self {
            transmittance_cut: Self::TRANSMITTANCE_CUT,
            colour_cut: Self::COLOUR_CUT,
            occupancy: true,
            ..Self::EXACT
        }
    }
}

/// The point of the blob's front that was chosen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Choice {
    /// The settings.
    pub quality: Quality,
    /// dB they lose against the exact rendering, as it was measured; below 0 a gain.
    pub loss_db: f32,
    /// Their multiply-adds relative to the exact rendering's.
    pub cost: f32,
    /// Whether they meet the limit that was asked for; else no point of the front does, and these come nearest.
    pub within: bool,
}

names! {
    /// Settings by what they may lose, dB against the exact rendering, best first; the scene's front says what they are.
    pub enum Preset {
        /// Nothing: 0 dB.
        Exact = "exact",
        /// Nothing that any picture shows: 0.01 dB.
        High = "high",
        /// 0.1 dB.
        Balanced = "balanced",
        /// 0.3 dB.
        Fast = "fast",
        /// 1 dB: to look around in.
        Preview = "preview",
    }
}

impl Preset {
    /// The most it may lose, dB.
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
