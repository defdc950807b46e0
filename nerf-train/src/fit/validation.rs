//! Validation during training: its steps, views and pixels, and its results.
//!
//! Validation never changes what is trained or exported.

use crate::data::View;
use crate::fit::run::Session;
use crate::measure::eval::{Scores, measure};
use crate::measure::frame;
use crate::train::Snapshot;
use crate::train::candidate::{About, Candidate};
use nerf_core::plan::Quality;
use std::time::Instant;

/// Largest number of validation views, spread over the split, on which the quantisation loss is measured.
pub const FINAL_VIEWS: usize = 10;
const WATCHED_VIEWS: usize = 2;
/// Number of training views on which alternatives for the export are compared.
pub(super) const ASKED_VIEWS: usize = 3;
/// Number of equal parts of the budget. If no interval is given, a validation follows each part.
const PARTS: f64 = 8.0;

/// Returns at most `count` evenly spaced indices below `len`, beginning with 0. `count` must be above 0.
pub(super) fn spread_indices(len: usize, count: usize) -> impl ExactSizeIterator<Item = usize> {
    (0..len).step_by(len.div_ceil(count).max(1))
}

pub fn spread(views: &[View], count: usize) -> Vec<&View> {
    spread_indices(views.len(), count).map(|i| &views[i]).collect()
}

/// Returns the indices of the views that are validated during training, among `len` validation views.
pub(super) fn watched(len: usize) -> Vec<usize> {
    let all: Vec<usize> = spread_indices(len, FINAL_VIEWS).collect();
    spread_indices(all.len(), WATCHED_VIEWS).map(|i| all[i]).collect()
}

/// Returns the number of pixels of all views together, and of the largest view.
pub(super) fn pixels_of<'v>(views: impl IntoIterator<Item = &'v View>) -> (u64, u64) {
    let counts = views.into_iter().map(View::pixel_count);
    counts.fold((0, 0), |(all, largest), count| (all + count, largest.max(count)))
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Due {
    validation: bool,
    pictures: bool,
}

/// Returns the due work, which is a validation, snapshots or both; `None` if neither is due. `share`: used fraction of
/// the budget. `ended`: whether the last step is done. The decision depends on step, budget and the trainer's state, so
/// that a resumed run validates at the same steps as an uninterrupted run. With a limit in seconds, the decision also
/// depends on measured times.
pub(super) fn due_at(session: &Session<'_, '_>, share: f64, ended: bool) -> Option<Due> {
    let validation = validation_is_due(session, share, ended);
    let pictures = pictures_are_due(session, share, ended);
    (validation || pictures).then_some(Due { validation, pictures })
}

/// Whether another eighth of the budget has begun since `last`, the step and seconds of the last validation or
/// snapshot. `share`: used fraction of the budget.
///
/// With a limit in seconds, the eighths shift slightly, because the time reserved for the end of a run is estimated
/// anew at every step. Therefore, at least half an eighth must also have passed since `last`.
fn in_another_part(session: &Session<'_, '_>, share: f64, last: Option<(u32, f64)>) -> bool {
    let then = last.map_or(0.0, |(step, seconds)| session.share_at(step, seconds));
    let part = |share: f64| (share * PARTS) as u32;
    part(share) > part(then) && share - then > 0.5 / PARTS
}

fn validation_is_due(session: &Session<'_, '_>, share: f64, ended: bool) -> bool {
    let last = session.trainer.state.last_validation().map(|(point, _)| (point.step, point.seconds));
    let since = session.trainer.progressed().step - last.map_or(0, |(step, _)| step);
    if session.watched.is_empty() || last.is_some() && since == 0 {
        return false;
    }
    let due = ended
        || match session.options.validate_every {
            Some(every) => since >= every.max(1),
            None => in_another_part(session, share, last),
        };
    due && session.pace.affords(session.clock.own_seconds(), session.watched.len())
}

fn pictures_are_due(session: &Session<'_, '_>, share: f64, ended: bool) -> bool {
    let Some(options) = &session.options.snapshots else { return false };
    let step = session.trainer.progressed().step;
    let last = session.trainer.state.snapshots.last().map(|taken| (taken.step, taken.seconds));
    let taken = session.trainer.state.snapshots.iter().any(|taken| taken.step == step);
    if session.pictured.is_empty() || taken {
        return false;
    }
    if options.steps.is_empty() {
        validation_is_due(session, share, ended) && (ended || in_another_part(session, share, last))
    } else {
        options.steps.contains(&step)
    }
}

/// Validates the present field, takes snapshots, or both. All rendered views have the same spacing of measured pixels.
pub(super) fn validate(session: &mut Session<'_, '_>, due: Due) -> anyhow::Result<()> {
    let (begun, seconds) = (Instant::now(), session.clock.seconds());
    let mut point = session.trainer.state.point(seconds, None);
    let allowed = session.pace.allowance(session.clock.own_seconds());
    let candidate = Candidate::of(&session.trainer, false);
    let bytes = candidate.export(&session.trainer, &About::default())?.bytes;
    session.pace.made(begun.elapsed().as_secs_f64());

    let watched = if due.validation { session.watched.clone() } else { Vec::new() };
    let pictured = if due.pictures { session.pictured.clone() } else { Vec::new() };
    let others = pictured.iter().filter(|view| !watched.contains(view));
    let indices: Vec<usize> = watched.iter().chain(others).copied().collect();
    let dataset = session.dataset;
    let views: Vec<&View> = indices.iter().map(|&view| &dataset.val[view]).collect();
    let (pixels, largest) = pixels_of(views.iter().copied());
    if session.pace.is_limited() && !session.pace.knows() {
        let probe = session.pace.probe(largest);
        measure_priced(session, &bytes, &views, probe, |_| {})?;
    }
    let left = allowed - begun.elapsed().as_secs_f64();
    let lattice = session.pace.lattice_on_the_way(pixels, largest, left.max(0.0));
    let mut frames = Vec::new();
    let mut scores = measure_priced(session, &bytes, &views, lattice, |picture| frames.push(picture))?;
    for ((&view, frame), score) in indices.iter().zip(&frames).zip(&scores.views) {
        let Some(options) = session.options.snapshots.as_ref().filter(|_| pictured.contains(&view)) else {
            continue;
        };
        let snapshot = Snapshot { step: candidate.step, seconds, view, psnr_db: score.psnr_db };
        frame.write_png(snapshot.path(&options.folder, dataset))?;
        session.trainer.state.snapshots.push(snapshot);
    }
    scores.views.truncate(watched.len());
    point.val_psnr_db = scores.psnr_db();
    (point.val_views, point.val_lattice) = (watched.len() as u32, lattice);
    session.pace.validated(begun.elapsed().as_secs_f64());
    if point.val_psnr_db.is_some() {
        let curve = &mut session.trainer.state.curve;
        curve.pop_if(|last| last.step == point.step);
        curve.push(point);
    }
    Ok(())
}

/// Measures the field in the file bytes `bytes` at every `lattice`-th row and column of `views`, and stores the seconds
/// per pixel in the session's `Pace`. Calls the function `each` with the rendering of each view.
pub(super) fn measure_priced(
    session: &mut Session<'_, '_>,
    bytes: &[u8],
    views: &[&View],
    lattice: u32,
    mut each: impl FnMut(crate::data::pictures::rgb::Picture),
) -> anyhow::Result<Scores> {
    let (mut begun, mut counted) = (Instant::now(), 0);
    let thinned: Vec<_> = views.iter().map(|view| view.thinned(lattice)).collect();
    let (kernel, background) = (session.options.kernel, session.trainer.background);
    let views = || thinned.iter().map(|view| &**view);
    let scores =
        measure(bytes, None, kernel, &Quality::default(), background, views(), |view, frame, _, _| {
            each(frame::picture(frame));
            // The first view's time includes opening the blob: with more than one view, the first is not counted.
            if counted == 0 && thinned.len() > 1 {
                (begun, counted) = (Instant::now(), view.pixel_count());
            }
        })?;
    session.pace.measured(pixels_of(views()).0 - counted, begun.elapsed().as_secs_f64());
    Ok(scores)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn watched_views_are_spread_over_the_split() {
        assert!(watched(0).is_empty());
        assert_eq!(watched(1), [0]);
        assert_eq!((watched(2), watched(10), watched(100)), (vec![0, 1], vec![0, 5], vec![0, 50]));
        for len in 1..300 {
            let watched = watched(len);
            assert!((1..=WATCHED_VIEWS).contains(&watched.len()) && watched.iter().all(|&view| view < len));
        }
    }
}
