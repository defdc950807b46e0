//! What each effect of a scene is worth: the scene with it and without it.

mod average;
mod summary;

use crate::measure::bench::Variants;
use crate::measure::error::StudyError;
use crate::measure::point::{Clock, Origin, Point, ViewErrors};
use crate::measure::settings::Settings;
pub use average::{flattened, mean_encoding, without_direction};
pub use summary::Summary;

use crate::data::View;
use crate::measure::metrics::gain_db;
use nerf_core::plan::Quality;

/// What an effect must gain to be kept where nothing else is said, dB.
pub const THRESHOLD_DB: f64 = 0.05;
/// An effect that spares so much of the work is kept for that.
const SPARED: f64 = 0.9;

/// How to render without an effect.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Without {
    /// Its knobs.
    pub settings: Settings,
    /// What is behind the scene, display-encoded.
    pub background: [f32; 3],
}

/// How to render without an effect, or why there is nothing to leave out.
pub type Asked = Result<Result<Without, &'static str>, StudyError>;

/// An effect that a scene may have: one entry of the table.
pub struct Effect {
    pub name: &'static str,
    /// What stands in its place.
    pub instead: &'static str,
    /// How to render without it, given how to render with it; it may add a variant to the blob's variants.
    pub without: fn(&mut Variants<'_>, Without, &[&View]) -> Asked,
}

/// All effects, in the order of the report. An effect of the scene joins the audit by an entry here.
pub const EFFECTS: &[Effect] = &[
    Effect {
        name: "view dependence",
        instead: "the mean over directions",
        without: |lab, with, rays| {
            let parameters = lab.parameters();
            let Some((flat, parameters)) = flattened(lab.blob().architecture(), &parameters, rays) else {
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
            if lab.occupancy_required() {
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

/// What is to become of an effect.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// It gains what it must, or spares work and loses nothing.
    Keeps,
    /// It does not.
    Drops,
}

impl Verdict {
    /// Of an effect that gains `gain_db` and takes `relative_macs` of the work without it.
    pub fn of(gain_db: f64, relative_macs: f64, threshold_db: f64) -> Self {
        let spares = relative_macs < SPARED && gain_db > -threshold_db;
        // What was not measured is kept.
        if gain_db < threshold_db && !spares { Self::Drops } else { Self::Keeps }
    }

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Keeps => "keeps",
            Self::Drops => "drops",
        }
    }
}

/// An effect, and what it is worth.
#[derive(Clone, Copy, Debug)]
pub struct Worth {
    /// Mean PSNR with it, dB.
    pub with_db: f64,
    /// Mean PSNR without it, dB.
    pub without_db: f64,
    /// Its time over that without it: median of rounds.
    pub relative_time: f64,
    /// Its multiply-adds over those without it.
    pub relative_macs: f64,
    pub verdict: Verdict,
}

impl Worth {
    /// What it gains, dB.
    pub fn gain_db(&self) -> f64 {
        gain_db(self.with_db, self.without_db)
    }
}

/// The findings, by effect: its worth, or why there was nothing to leave out.
pub type Audit = Vec<(&'static Effect, Result<Worth, &'static str>)>;

/// How an audit is made.
#[derive(Clone, Copy, Debug)]
pub struct AuditOptions {
    /// What an effect must gain, dB.
    pub threshold_db: f64,
    pub repeats: usize,
    pub clock: Clock,
}

/// Renders `views` with every effect and without each; `rays`: the views whose directions are averaged.
///
/// With and without are rendered in turns, view by view. `each` is told the frames done and their number.
///
/// # Errors
/// [`StudyError`].
pub fn audit(
    lab: &mut Variants<'_>,
    views: &[&View],
    rays: &[&View],
    options: &AuditOptions,
    each: &mut dyn FnMut(u64, u64),
) -> Result<Audit, StudyError> {
    if views.is_empty() {
        return Err(StudyError::NoViews);
    }
    let background = lab.scene().background;
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

/// Each way on each view, `repeats` times in turns; errors are against the first way.
fn measure(
    lab: &Variants<'_>,
    ways: &[Without],
    views: &[&View],
    repeats: usize,
    each: &mut dyn FnMut(u64, u64),
) -> Result<Vec<Point>, StudyError> {
    let settings: Vec<Settings> = ways.iter().map(|way| way.settings).collect();
    let new = |settings: &Settings| Point::new(Origin::Base, *settings, String::new(), views.len());
    let mut points: Vec<Point> = settings.iter().map(new).collect();
    for point in &mut points {
        point.rounds = vec![vec![None; views.len()]; repeats];
    }
    let total = (repeats * views.len() * ways.len()) as u64;
    let mut done = 0;
    lab.prepared(&settings, |bench| {
        for round in 0..repeats {
            for (v, view) in views.iter().enumerate() {
                // The truth has the scene's own background, whatever is rendered.
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
        // It takes a fortieth of the work: worth no more than the threshold's loss.
        assert_eq!(verdict(-0.02, 0.025), Verdict::Keeps);
        assert_eq!(verdict(-0.2, 0.025), Verdict::Drops);
        assert_eq!(verdict(f64::NAN, 1.0), Verdict::Keeps);
    }
}
