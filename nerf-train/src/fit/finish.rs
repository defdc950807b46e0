//! End of a run: export of the field, and measurement of the exported blob.

use crate::data::{Dataset, RefinedPoses, View};
use crate::fit::pace::{FINAL_SHARE, Pace, QUESTION_SHARE, lattice_of};
use crate::fit::run::Session;
use crate::fit::snapshot::SnapshotOptions;
use crate::fit::trend::Stop;
use crate::fit::validation::{ASKED_VIEWS, FINAL_VIEWS, measure_priced, pixels_of, spread, spread_indices};
use crate::measure::audit::{Verdict, flattened};
use crate::measure::eval::{OCCUPANCY_LOSS_DB, Scores, ViewScore, measure};
use crate::measure::frame::Frame;
use crate::measure::metrics::{flat_psnr_db, gain_db, is_flat, mean_flat_psnr_db};
use crate::measure::surfaces::Surfaces;
use crate::model::config::Config;
use crate::train::candidate::{About, Candidate};
use crate::train::exposure::ExposureFound;
use crate::train::moving::Moved;
use crate::train::poses::PosesFound;
use crate::train::withheld::WithheldFound;
use crate::train::{CurvePoint, Snapshot};
use nerf_core::plan::Quality;
use std::time::Instant;

const SHOWN_VIEWS: usize = 4;
/// Intended number of pixels from which each training photograph is scored.
const TRAINING_PIXELS: usize = 1000;
/// Maximum number of pixels, over all training photographs, from which the photographs are scored.
const MAX_TRAINING_PIXELS: usize = 120_000;

#[derive(Clone, Debug)]
pub struct Outcome {
    /// Bytes of the exported file, with the field after the last step.
    pub bytes: Vec<u8>,
    /// Scores of the exported field on the validation views, rendered over `background`; empty without such views.
    pub scores: Scores,
    /// Score of each training photograph, in the order of the training split, from a few evenly spaced pixels.
    pub trained: Vec<ViewScore>,
    /// Spacing, along rows and columns, of the pixels on which `scores` are measured; 1 measures every pixel.
    pub lattice: u32,
    /// Distances between the field's rendered surfaces and the sparse points that the validation views show.
    pub surfaces: Surfaces,
    /// Scores of the validation views with refined poses, measured on the same pixels as `scores`. `None` if poses are
    /// not refined, or without validation views.
    pub refined_scores: Option<Scores>,
    pub refined_poses: Option<RefinedPoses>,
    pub poses: Option<PosesFound>,
    pub exposure: Option<ExposureFound>,
    pub withheld: Option<WithheldFound>,
    pub moved: Vec<Moved>,
    /// Renderings of some validation views; empty unless a report is requested.
    pub shown: Vec<Shown>,
    /// Background over which validation views are rendered and measured, display-encoded.
    pub background: [f32; 3],
    /// Mean PSNR, dB, of images that are filled with the mean colour of a view. The mean is over the validation views
    /// that show more than one colour. Without validation views, some training views are used.
    pub flat_psnr_db: f64,
    /// Whether no view scores better than one flat colour: the learning rate is too high, or the steps are too few.
    pub flat: bool,
    /// PSNR lost by rounding weights to f16 and tables to their stored format, dB. Measured on at most ten validation
    /// views, at the same pixels as `scores`. `None` without validation views.
    pub quantisation_loss_db: Option<f64>,
    /// PSNR lost by rendering without the occupancy grid, dB, on training views. `None` for a learned grid: in space
    /// without training samples its tables hold arbitrary values, so that rendering needs the occupancy grid.
    pub occupancy_loss_db: Option<f64>,
    pub occupancy_required: bool,
    pub view_dependence: Option<ViewDependence>,
    pub subnormal_weights: usize,
    pub curve: Vec<CurvePoint>,
    pub overfitting: Option<Stop>,
    /// Names of the views that were validated during training.
    pub watched: Vec<String>,
    pub snapshots: Vec<Snapshot>,
    /// Steps at which a snapshot was requested but not taken: the run ended earlier, or was resumed from a later step.
    pub missed_snapshots: Vec<u32>,
    pub steps: u32,
    /// Number of restarts with another seed. A run restarts if all densities have become 0.
    pub reseeds: u32,
    pub parameters: usize,
    pub occupied_share: f32,
    /// Seconds from the start until the last step, including validation and reading of the data set.
    pub train_seconds: f64,
    /// Numbers of samples per second of training: `[samples with evaluated density, samples with computed gradients]`.
    pub samples_per_second: [f64; 2],
}

#[derive(Clone, Debug)]
pub struct Shown {
    pub view: usize,
    /// Rendering of the exported field with the view's camera.
    pub frame: Frame,
    /// Colours of the photograph, composited over the rendering's background, at the pixels of `frame`.
    pub truth: Vec<[f32; 3]>,
    pub psnr_db: f64,
}

pub(crate) fn convention(views: usize, lattice: u32, background: [f32; 3], config: &Config) -> String {
    let [r, g, b] = background.map(|c| (c * 255.0).round());
    let pixels = match lattice {
        1 => String::new(),
        step => format!("one pixel of {step}x{step}, "),
    };
    let s = &config.sampling;
    let sampling = match (&config.network.grid, s.contraction) {
        (Some(_), None) => format!("{} march steps across the scene box", s.steps_across),
        (Some(_), Some(_)) => format!("{} march steps across the uncontracted ball", s.steps_across),
        (None, _) => format!("{} samples a ray", s.samples),
    };
    format!("mean over {views} validation views, {pixels}background sRGB ({r}, {g}, {b}), {sampling}")
}

/// Exports the state after the last step, and measures the exported blob.
pub(super) fn finish(session: &mut Session<'_, '_>) -> anyhow::Result<Outcome> {
    let mut candidate = Candidate::of(&session.trainer, true);
    let view_dependence = ask_direction(session, &mut candidate)?;
    let draft = candidate.export(&session.trainer, &About::default())?.bytes;
    let (occupancy_loss_db, trained) = ask_occupancy(session, &draft)?;
    let occupancy_required =
        occupancy_loss_db.is_none_or(|loss| loss.is_nan() || loss.abs() > OCCUPANCY_LOSS_DB);

    let background = session.trainer.background;
    let (scores, lattice, shown) = evaluate(session, &draft)?;
    let (refined_poses, refined_scores) = refine(session, &draft, lattice)?;
    let all: Vec<&View> = session.dataset.val.iter().collect();
    let surfaces = Surfaces::of(&draft, session.options.kernel, &all, &session.dataset.points)?;
    let quantisation_loss_db = ask_rounding(session, &candidate, &draft, &scores, lattice)?;
    let psnr_db = scores.psnr_db();
    let asked = asked_views(session);
    let asked: Vec<&View> = asked.iter().collect();
    let (judged, judged_scores) = if all.is_empty() { (&asked, &trained) } else { (&all, &scores) };
    let flat_of = |view: &&View| {
        let thin = view.thinned(lattice);
        flat_psnr_db(&thin.counted(&thin.composite_over(background)))
    };
    let flats: Vec<f64> = judged.iter().map(flat_of).collect();
    let judged_db = judged_scores.views.iter().map(|score| score.psnr_db);
    let flat = is_flat(judged_db.zip(flats.iter().copied()));
    let convention = convention(all.len(), lattice, background, &session.trainer.config);
    let about = About { occupancy_required, psnr_db, convention: &convention, quantisation_loss_db };
    let exported = candidate.export(&session.trainer, &about)?;
    let missed = |options: &SnapshotOptions| options.missed(&session.trainer.state.snapshots);
    let watched = session.watched.iter().filter_map(|&view| session.dataset.val.get(view));
    Ok(Outcome {
        bytes: exported.bytes,
        scores,
        trained: score_training(session, &draft)?,
        lattice,
        surfaces,
        refined_scores,
        refined_poses,
        poses: session.trainer.state.photographs.poses_found,
        exposure: session.trainer.state.photographs.exposure,
        withheld: session.trainer.state.photographs.withheld_found,
        moved: session.trainer.state.photographs.moved(&session.dataset.train),
        shown,
        background,
        flat_psnr_db: mean_flat_psnr_db(flats),
        flat,
        quantisation_loss_db,
        occupancy_loss_db,
        occupancy_required,
        view_dependence,
        subnormal_weights: exported.subnormal_weights,
        overfitting: Stop::of(&session.trainer.state.curve),
        watched: watched.map(|view| view.name.clone()).collect(),
        missed_snapshots: session.options.snapshots.as_ref().map_or_else(Vec::new, missed),
        steps: session.trainer.progressed().step,
        reseeds: session.trainer.progressed().reseeds,
        parameters: session.trainer.model.parameters(),
        occupied_share: candidate.live.lookup().occupied_share(),
        train_seconds: session.train_seconds,
        samples_per_second: session.samples_per_second,
        snapshots: session.trainer.state.snapshots.clone(),
        curve: session.trainer.state.curve.clone(),
    })
}

/// Returns the scores of the field in `blob` on `views`. `parameters`: unrounded weights in place of the stored ones.
fn scores_of<'v>(
    session: &Session<'_, '_>,
    blob: &[u8],
    parameters: Option<&[f32]>,
    quality: &Quality,
    views: impl IntoIterator<Item = &'v View>,
) -> anyhow::Result<Scores> {
    let (kernel, background) = (session.options.kernel, session.trainer.background);
    measure(blob, parameters, kernel, quality, background, views, |_, _, _, _| {})
}

/// Returns the scores of `views` for each of `renderings`: the bytes of a scene file, and the quality settings with
/// which it is rendered. All are scored on the same pixels: as many as the time limit allows, up to a maximum per view.
pub(super) fn compare(
    session: &Session<'_, '_>,
    views: &[&View],
    renderings: &[(&[u8], Quality)],
) -> anyhow::Result<Vec<Scores>> {
    let (pixels, largest) = pixels_of(views.iter().copied());
    let on = |lattice: u32| -> anyhow::Result<Vec<Scores>> {
        let views: Vec<_> = views.iter().map(|view| view.thinned(lattice)).collect();
        let measured = |&(bytes, quality): &(&[u8], Quality)| {
            scores_of(session, bytes, None, &quality, views.iter().map(|view| &**view))
        };
        renderings.iter().map(measured).collect()
    };
    // The time per pixel is measured on these renderings: without occupancy grid it is far longer than in validation.
    let mut pace = Pace::new(session.options.budget.seconds, false, false);
    let everything = pace.lattice_on_the_way(pixels, largest, f64::INFINITY);
    if !pace.is_limited() {
        return on(everything);
    }
    let (probe, begun) = (pace.probe(largest).max(everything), Instant::now());
    let scores = on(probe)?;
    pace.measured(pixels / u64::from(probe).pow(2), begun.elapsed().as_secs_f64());
    let allowed = pace.share(QUESTION_SHARE) * renderings.len() as f64;
    let lattice = pace.lattice_on_the_way(pixels, largest, allowed);
    if lattice < probe { on(lattice) } else { Ok(scores) }
}

/// Measures the file `draft` on training views with and without its occupancy grid. Returns the PSNR, dB, that is lost
/// without the grid, and the scores with the grid. For a learned grid, the loss is not measured, and is `None`.
fn ask_occupancy(session: &Session<'_, '_>, draft: &[u8]) -> anyhow::Result<(Option<f64>, Scores)> {
    let views = asked_views(session);
    let views: Vec<&View> = views.iter().collect();
    let with = Quality::default();
    let without = Quality { occupancy: false, ..with };
    if session.trainer.config.network.grid.is_some() {
        return Ok((None, compare(session, &views, &[(draft, with)])?.swap_remove(0)));
    }
    let mut scores = compare(session, &views, &[(draft, with), (draft, without)])?;
    let db = |scores: Option<&Scores>| scores.and_then(Scores::psnr_db).unwrap_or(f64::NAN);
    let loss_db = gain_db(db(scores.first()), db(scores.last()));
    Ok((Some(loss_db), scores.swap_remove(0)))
}

/// Renders the validation views from the file bytes `draft`. Returns their scores, the spacing of the scored pixels
/// along rows and columns, and the renderings for the report.
fn evaluate(session: &mut Session<'_, '_>, draft: &[u8]) -> anyhow::Result<(Scores, u32, Vec<Shown>)> {
    let views: Vec<&View> = session.dataset.val.iter().collect();
    let (pixels, largest) = pixels_of(views.iter().copied());
    if session.pace.is_limited() && !session.pace.knows() {
        let some = spread(&session.dataset.val, ASKED_VIEWS);
        measure_priced(session, draft, &some, session.pace.probe(largest), |_| {})?;
    }
    let lattice = session.pace.lattice(session.times() * pixels, largest, session.pace.share(FINAL_SHARE));
    let kept: Vec<usize> = spread_indices(views.len(), SHOWN_VIEWS).collect();
    let (mut index, mut shown) = (0, Vec::new());
    let (kernel, background) = (session.options.kernel, session.trainer.background);
    let thinned: Vec<_> = views.iter().map(|view| view.thinned(lattice)).collect();
    let views = thinned.iter().map(|view| &**view);
    let each = |_: &View, frame: &Frame, truth: &[[f32; 3]], score: &ViewScore| {
        if session.options.report && kept.contains(&index) {
            let (frame, truth, psnr_db) = (frame.clone(), truth.to_vec(), score.psnr_db);
            shown.push(Shown { view: index, frame, truth, psnr_db });
        }
        index += 1;
    };
    let scores = measure(draft, None, kernel, &Quality::default(), background, views, each)?;
    Ok((scores, lattice, shown))
}

/// Returns the score of the file `draft` on each training photograph, without masked pixels. Few pixels are measured,
/// so that the measurement is expected to take at most the fraction [`QUESTION_SHARE`] of the time limit.
fn score_training(session: &Session<'_, '_>, draft: &[u8]) -> anyhow::Result<Vec<ViewScore>> {
    let train = &session.dataset.train;
    let (pixels, largest) = pixels_of(train);
    let some = (train.len() * TRAINING_PIXELS).min(MAX_TRAINING_PIXELS) as f64;
    let allowed = session.pace.share(QUESTION_SHARE);
    let lattice = lattice_of(pixels, some).max(session.pace.lattice(pixels, largest, allowed));
    let seen = train.iter().zip(session.trainer.training_cameras());
    let mut views: Vec<View> = seen.map(|(view, camera)| view.seen_from(camera)).collect();
    for moved in session.trainer.state.photographs.moved(&session.dataset.train) {
        moved.leave_out_of(&mut views[moved.view]);
    }
    let thinned: Vec<_> = views.iter().map(|view| view.thinned(lattice).into_owned()).collect();
    Ok(scores_of(session, draft, None, &Quality::default(), &thinned)?.views)
}

/// Returns the training views on which alternatives for the export are compared, with their refined cameras.
pub(super) fn asked_views(session: &Session<'_, '_>) -> Vec<View> {
    let (train, cameras) = (&session.dataset.train, session.trainer.training_cameras());
    spread_indices(train.len(), ASKED_VIEWS).map(|i| train[i].seen_from(cameras[i])).collect()
}

/// Returns the refined poses of all views, and the scores of the file `draft` with these poses, measured on every
/// `lattice`-th row and column of the validation views. Both are `None` if poses are not refined; the scores are also
/// `None` without validation views.
fn refine(
    session: &mut Session<'_, '_>,
    draft: &[u8],
    lattice: u32,
) -> anyhow::Result<(Option<RefinedPoses>, Option<Scores>)> {
    let Some(cameras) = session.trainer.refined_cameras()? else { return Ok((None, None)) };
    let Dataset { train, val, origin, .. } = session.dataset;
    let all = train.iter().zip(cameras.train).chain(val.iter().zip(cameras.val.iter().copied()));
    let poses = RefinedPoses::of(all, *origin);
    let seen = val.iter().zip(&cameras.val);
    let views: Vec<_> =
        seen.map(|(view, &camera)| view.seen_from(camera).thinned(lattice).into_owned()).collect();
    let scores = scores_of(session, draft, None, &Quality::default(), &views)?;
    Ok((Some(poses), (!views.is_empty()).then_some(scores)))
}

/// Returns the PSNR lost by quantisation of weights and tables, dB, on some validation views. `scores`: scores of the
/// quantised field `draft` on all validation views, at pixel spacing `lattice`. `None` without validation views.
fn ask_rounding(
    session: &Session<'_, '_>,
    candidate: &Candidate,
    draft: &[u8],
    scores: &Scores,
    lattice: u32,
) -> anyhow::Result<Option<f64>> {
    let views = &session.dataset.val;
    let (pixels, _) = pixels_of(views);
    let taken = session.pace.seconds_of(pixels / u64::from(lattice).pow(2)) / views.len().max(1) as f64;
    let count = ((session.pace.share(QUESTION_SHARE) / taken) as usize).clamp(1, FINAL_VIEWS);
    let indices: Vec<usize> = spread_indices(views.len(), count).collect();
    let thinned: Vec<_> = indices.iter().map(|&view| views[view].thinned(lattice)).collect();
    let thinned = thinned.iter().map(|view| &**view);
    let (unrounded, quality) = (Some(&*candidate.parameters), Quality::default());
    let unrounded = scores_of(session, draft, unrounded, &quality, thinned)?;
    let rounded = indices.iter().map(|&view| scores.views[view].clone()).collect();
    let rounded = Scores { views: rounded, ..*scores };
    Ok(unrounded.psnr_db().zip(rounded.psnr_db()).map(|(unrounded, rounded)| gain_db(unrounded, rounded)))
}

/// Number of training views from whose rays the mean encoded direction is computed.
const RAY_VIEWS: usize = 50;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ViewDependence {
    /// PSNR with view-dependent colour minus PSNR with the mean encoded direction, dB, on training views.
    pub gain_db: f64,
    pub left_out: bool,
}

/// Removes the view dependence of the export candidate if PSNR falls by less than the threshold. To remove it, replaces
/// the encoded direction by its mean over training rays. Returns the loss and the decision; `None` if no threshold is
/// set, or if colour does not depend on the direction.
///
/// PSNR is measured on training views: validation views must not decide what is exported.
pub(super) fn ask_direction(
    session: &Session<'_, '_>,
    candidate: &mut Candidate,
) -> anyhow::Result<Option<ViewDependence>> {
    let Some(threshold_db) = session.options.effect_threshold_db else { return Ok(None) };
    let views = asked_views(session);
    let views: Vec<_> = views.iter().collect();
    let rays = spread(&session.dataset.train, RAY_VIEWS);
    let with = &session.trainer.model.architecture;
    let Some((architecture, parameters)) = flattened(with, &candidate.parameters, &rays) else {
        return Ok(None);
    };
    let flat = Candidate { architecture: Some(architecture), parameters, ..candidate.clone() };
    let blob =
        |candidate: &Candidate| anyhow::Ok(candidate.export(&session.trainer, &About::default())?.bytes);
    let (dependent, independent) = (blob(candidate)?, blob(&flat)?);
    let quality = Quality::default();
    let scores = compare(session, &views, &[(&dependent, quality), (&independent, quality)])?;
    // With fitted gains, exposure differs between photographs: scores are aligned before they are compared.
    let gains = session.trainer.state.photographs.exposure.is_some_and(|found| found.fitted);
    let db = |scores: &Scores| {
        let db = if gains { scores.aligned_psnr_db() } else { scores.psnr_db() };
        db.unwrap_or(f64::NAN)
    };
    let gain_db = gain_db(db(&scores[0]), db(&scores[1]));
    // With a ratio of 1 for the multiply-adds, PSNR alone decides whether the direction is left out.
    let left_out = Verdict::of(gain_db, 1.0, threshold_db) == Verdict::Drops;
    if left_out {
        *candidate = flat;
    }
    Ok(Some(ViewDependence { gain_db, left_out }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::config::Preset;

    #[test]
    fn a_convention_says_how_rays_are_sampled() {
        let said = |config: &Config| convention(7, 1, [1.0, 0.0, 1.0], config);
        let (mut grid, small) = (Preset::Grid.config(), Preset::Small.config());
        grid.sampling.steps_across = 90;
        let views = "mean over 7 validation views, background sRGB (255, 0, 255), ";
        assert_eq!(said(&grid), format!("{views}90 march steps across the scene box"));
        grid.sampling.contraction = Some(2);
        assert_eq!(said(&grid), format!("{views}90 march steps across the uncontracted ball"));
        assert_eq!(said(&small), format!("{views}{} samples a ray", small.sampling.samples));
    }
}
