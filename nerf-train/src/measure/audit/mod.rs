//! Ablation of a scene's effects, such as view dependence: renderings with and without each effect.

mod average;

use crate::data::View;
use crate::data::pictures::colour;
use crate::measure::bench::Variants;
use crate::measure::metrics::gain_db;
use crate::measure::point::{Clock, Origin, Point, Settings, ViewErrors};
use crate::system::cpu;
use anyhow::bail;
pub use average::{flattened, mean_encoding, without_direction};
use nerf_core::plan::Quality;
use serde::Serialize;

/// Default threshold, dB: an effect, such as view dependence, is kept if it raises PSNR by at least this.
pub const THRESHOLD_DB: f64 = 0.05;
/// Ratio of multiply-adds (with the effect / without it) below which an effect saves work. An effect that saves work is
/// kept if it lowers PSNR by less than the threshold.
const SPARED: f64 = 0.9;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Without {
    pub settings: Settings,
    pub background: [f32; 3],
}

/// Result of [`Effect::without`]. The inner error is the reason why the effect cannot be left out of this scene.
pub type Asked = anyhow::Result<Result<Without, &'static str>>;

/// Effect of a scene, such as view dependence, with a function that leaves the effect out.
pub struct Effect {
    pub name: &'static str,
    pub instead: &'static str,
    /// Returns the settings without the effect, given the settings with it. May add a variant of the scene. To leave
    /// out view dependence, the encoded direction is replaced by its mean over the rays of the given views.
    pub without: fn(&mut Variants<'_>, Without, &[&View]) -> Asked,
}

/// All effects that an audit measures, in the order of the report.
pub const EFFECTS: &[Effect] = &[
    Effect {
        name: "view dependence",
        instead: "the mean over directions",
        without: |lab, with, rays| {
            let parameters = lab.parameters();
            let Some((flat, parameters)) = flattened(lab.blob.architecture(), &parameters, rays) else {
                return Ok(Err("colour does not depend on direction"));
            };
            let variant = lab.add_network("without view dependence", &flat, &parameters)?;
            Ok(Ok(Without { settings: Settings { variant, ..with.settings }, ..with }))
        },
    },
    Effect {
        name: "occupancy",
        instead: "the network everywhere in the box",
        without: |lab, with, _| {
            if !lab.has_occupancy(0) {
                return Ok(Err("the scene has none"));
            }
            if lab.scene.occupancy_required {
                return Ok(Err("it is part of the model"));
            }
            let quality = Quality { occupancy: false, ..with.settings.quality };
            Ok(Ok(Without { settings: Settings { quality, ..with.settings }, ..with }))
        },
    },
    Effect {
        name: "background",
        instead: "black",
        without: |_, with, _| {
            if with.background == [0.0; 3] {
                return Ok(Err("it is black"));
            }
            Ok(Ok(Without { background: [0.0; 3], ..with }))
        },
    },
];

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// Effect that raises PSNR by at least the threshold, or saves work and lowers PSNR by less than the threshold.
    Keeps,
    Drops,
}

impl Verdict {
    /// Judges an effect that adds `gain_db` to PSNR and multiplies the number of multiply-adds by `relative_macs`.
    pub fn of(gain_db: f64, relative_macs: f64, threshold_db: f64) -> Self {
        let spares = relative_macs < SPARED && gain_db > -threshold_db;
        // With a gain of NaN (not measured), the effect is kept.
        if gain_db < threshold_db && !spares { Self::Drops } else { Self::Keeps }
    }

    pub fn name(self) -> &'static str {
        match self {
            Self::Keeps => "keeps",
            Self::Drops => "drops",
        }
    }
}

#[derive(Clone, Copy, Debug)]
pub struct Worth {
    pub with_db: f64,
    pub without_db: f64,
    /// Ratio of the render time with the effect to the time without it, median over the rounds of timing.
    pub relative_time: f64,
    pub relative_macs: f64,
    pub verdict: Verdict,
}

impl Worth {
    pub fn gain_db(&self) -> f64 {
        gain_db(self.with_db, self.without_db)
    }
}

/// Gain and cost of each effect, or the reason why the effect cannot be left out.
pub type Audit = Vec<(&'static Effect, Result<Worth, &'static str>)>;

#[derive(Clone, Copy, Debug)]
pub struct AuditOptions {
    pub threshold_db: f64,
    pub repeats: usize,
    pub clock: Clock,
}

/// Renders each view with all effects, and again without each single effect. Returns every effect's gain and cost.
/// `rays`: views over whose rays the encoded direction is averaged, to leave out view dependence. `each`: function
/// called after every frame, with the numbers of rendered and of all frames. Fails if `views` is empty.
pub fn audit(
    lab: &mut Variants<'_>,
    views: &[&View],
    rays: &[&View],
    options: &AuditOptions,
    each: &mut dyn FnMut(usize, usize),
) -> anyhow::Result<Audit> {
    if views.is_empty() {
        bail!("views: expected at least one, found none");
    }
    let background = lab.scene.background;
    let with = Without { settings: Settings::base(), background };
    let mut ways = vec![with];
    let mut found: Vec<(&'static Effect, Result<usize, &'static str>)> = Vec::new();
    for effect in EFFECTS {
        let without = (effect.without)(lab, with, rays)?;
        found.push((effect, without.map(|without| (ways.push(without), ways.len() - 1).1)));
    }
    let points = measure(lab, &ways, views, options.repeats.max(1), each)?;
    let worth = |place: usize| {
        let (with, without) = (points[0].totals(&points[0]), points[place].totals(&points[0]));
        let relative_macs = 1.0 / without.relative_macs;
        let gain_db = gain_db(with.psnr_db, without.psnr_db);
        Worth {
            with_db: with.psnr_db,
            without_db: without.psnr_db,
            relative_time: points[0].relative_time(&points[place], options.clock).unwrap_or(f64::NAN),
            relative_macs,
            verdict: Verdict::of(gain_db, relative_macs, options.threshold_db),
        }
    };
    Ok(found.into_iter().map(|(effect, place)| (effect, place.map(worth))).collect())
}

/// Renders each view with each of the settings `ways`, `repeats` times. Returns errors and times in the order of
/// `ways`. Errors are measured against the rendering with the first of `ways`.
fn measure(
    lab: &Variants<'_>,
    ways: &[Without],
    views: &[&View],
    repeats: usize,
    each: &mut dyn FnMut(usize, usize),
) -> anyhow::Result<Vec<Point>> {
    let settings: Vec<Settings> = ways.iter().map(|way| way.settings).collect();
    let new = |settings: &Settings| Point::new(Origin::Base, *settings, String::new(), views.len());
    let mut points: Vec<Point> = settings.iter().map(new).collect();
    for point in &mut points {
        point.rounds = vec![vec![None; views.len()]; repeats];
    }
    let total = repeats * views.len() * ways.len();
    let mut done = 0;
    lab.prepared(&settings, |bench| {
        for round in 0..repeats {
            for (v, view) in views.iter().enumerate() {
                // Ground truth has the background of the scene, even if the rendering has another.
                let truth = view.composite_over(ways[0].background);
                let mut first = None;
                for (point, way) in points.iter_mut().zip(ways) {
                    let (frame, clocked, memory) =
                        bench.render(&way.settings, &view.camera, way.background)?;
                    point.memory = memory;
                    point.rounds[round][v] = Some(clocked);
                    let errors = ViewErrors::of(&frame, &truth, first.as_ref().unwrap_or(&frame));
                    point.views[v] = Some(errors);
                    first.get_or_insert(frame);
                    done += 1;
                    each(done, total);
                }
            }
        }
        Ok(())
    })?;
    Ok(points)
}

#[derive(Debug, Serialize)]
pub struct Summary {
    pub effects: Vec<EffectSummary>,
    pub threshold_db: f64,
    pub views: usize,
    pub split: &'static str,
    pub background: String,
    pub threads: usize,
    pub cpu: String,
}

/// Gain and cost of an effect, or the reason why the effect was not measured.
#[derive(Debug, Serialize)]
#[serde(untagged)]
pub enum EffectSummary {
    Asked {
        effect: &'static str,
        with_db: f64,
        without_db: f64,
        gain_db: f64,
        relative_time: f64,
        relative_macs: f64,
        kept: bool,
    },
    NotAsked {
        effect: &'static str,
        gain_db: Option<f64>,
        gain_db_note: &'static str,
    },
}

impl Summary {
    /// Returns the summary of an audit. `split`: name of the split. `views`: number of views. `background`: background
    /// colour of the scene.
    pub fn of(
        audit: &Audit,
        threshold_db: f64,
        (split, views): (&'static str, usize),
        background: [f32; 3],
    ) -> Self {
        let of_effect = |&(&Effect { name: effect, .. }, worth): &(_, Result<Worth, _>)| match worth {
            Ok(worth) => EffectSummary::Asked {
                effect,
                with_db: worth.with_db,
                without_db: worth.without_db,
                gain_db: worth.gain_db(),
                relative_time: worth.relative_time,
                relative_macs: worth.relative_macs,
                kept: worth.verdict == Verdict::Keeps,
            },
            Err(gain_db_note) => EffectSummary::NotAsked { effect, gain_db: None, gain_db_note },
        };
        Self {
            effects: audit.iter().map(of_effect).collect(),
            threshold_db,
            views,
            split,
            background: colour::name(background),
            threads: rayon::current_num_threads(),
            cpu: cpu::name(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_effect_is_kept_for_what_it_gains_or_spares() {
        let verdict = |gain, macs| Verdict::of(gain, macs, 0.05);
        assert_eq!(verdict(1.0, 1.01), Verdict::Keeps);
        assert_eq!(verdict(0.05, 1.0), Verdict::Keeps);
        assert_eq!(verdict(0.04, 1.0), Verdict::Drops);
        assert_eq!(verdict(-1.0, 1.0), Verdict::Drops);
        // An effect that reduces the work to a fortieth is kept if it lowers PSNR by less than the threshold.
        assert_eq!(verdict(-0.02, 0.025), Verdict::Keeps);
        assert_eq!(verdict(-0.2, 0.025), Verdict::Drops);
        assert_eq!(verdict(f64::NAN, 1.0), Verdict::Keeps);
    }
}
