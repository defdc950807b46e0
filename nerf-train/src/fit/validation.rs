//! Validation on the way: when, of which views, on which lattice of pixels, and what is kept of it.
//!
//! It never changes what is trained or exported.

use crate::data::View;
use crate::fit::run::{RunError, Session};
use crate::measure::eval::{Scores, measure};
use crate::measure::frame;
use crate::train::CurvePoint;
use crate::train::Snapshot;
use crate::train::candidate::About;
use nerf_core::plan::Quality;
use std::time::Instant;

/// Validation views that a question about rounding or a table asks, spread over the split.
pub const FINAL_VIEWS: usize = 10;
/// Validation views measured on the way.
const WATCHED_VIEWS: usize = 2;
/// Training views that questions about the export are asked of.
pub(super) const ASKED_VIEWS: usize = 3;
/// Parts of the budget that end with a validation, where no interval is given.
const PARTS: f64 = 8.0;
/// Steps between the points of the curve without validation.
const POINT_EVERY: u32 = 20;

/// Indices of at most `count` of `len` things, spread over all of them.
pub(super) fn spread_indices(len: usize, count: usize) -> impl ExactSizeIterator<Item = usize> {
    (0..len).step_by(len.div_ceil(count).max(1))
}

/// The views that are measured on the way, of `len`.
pub(super) fn watched(len: usize) -> Vec<usize> {
    let all: Vec<usize> = spread_indices(len, FINAL_VIEWS).collect();
    spread_indices(all.len(), WATCHED_VIEWS).map(|i| all[i]).collect()
}

/// Pixels of all of these views, and of the largest.
pub(super) fn pixels_of<'v>(views: impl IntoIterator<Item = &'v View>) -> (u64, u64) {
    let counts = views.into_iter().map(View::pixel_count);
    counts.fold((0, 0), |(all, largest), count| (all + count, largest.max(count)))
}

/// What is due at a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Due {
    validation: bool,
    pictures: bool,
}

impl Due {
    /// Whether anything is.
    pub fn any(self) -> bool {
        self.validation || self.pictures
    }
}

impl Session<'_, '_> {
    /// The validation and the pictures that are due between two steps.
    ///
    /// Decided by step, budget and what the trainer remembers, so that a run of so many steps that was taken up
    /// again validates where an undisturbed one does; with a limit in seconds, also by what it takes.
    ///
    /// `share`: of the budget that is used.
    pub(super) fn due_at(&self, share: f64, ended: bool) -> Due {
        Due {
            validation: self.validation_is_due(share, ended),
            pictures: self.pictures_are_due(share, ended),
        }
    }

    /// Puts a point into the curve, if one is due and validation has put none there.
    pub(super) fn note_point(&mut self, ended: bool) {
        let point = self.point();
        let noted = self.trainer.curve.last().is_some_and(|last| last.step == point.step);
        if !noted && point.step > 0 && (ended || point.step.is_multiple_of(POINT_EVERY)) {
            self.trainer.curve.push(point);
        }
    }

    /// The point of the curve at this step, without validation.
    fn point(&self) -> CurvePoint {
        CurvePoint {
            step: self.trainer.progressed().step,
            seconds: self.clock.seconds(),
            train_psnr_db: self.trainer.train_psnr_db(),
            val_psnr_db: None,
            val_views: 0,
            val_lattice: 0,
        }
    }

    /// The last point of the curve with validation.
    fn last_validation(&self) -> Option<&CurvePoint> {
        self.trainer.curve.iter().rev().find(|point| point.val_psnr_db.is_some())
    }

    /// PSNR at the last validation, dB.
    pub(super) fn last_val_psnr_db(&self) -> Option<f64> {
        self.last_validation().and_then(|point| point.val_psnr_db)
    }

    /// Whether another eighth of the budget is used than at `last`.
    ///
    /// What is kept for the end of a run is estimated anew all the time, and moves the eighths of a limit in
    /// seconds a little: an eighth that was just begun must not begin again.
    fn in_another_part(&self, share: f64, last: Option<(u32, f64)>) -> bool {
        let then = last.map_or(0.0, |(step, seconds)| self.share_at(step, seconds));
        let part = |share: f64| (share * PARTS) as u32;
        part(share) > part(then) && share - then > 0.5 / PARTS
    }

    fn validation_is_due(&self, share: f64, ended: bool) -> bool {
        let last = self.last_validation().map(|point| (point.step, point.seconds));
        let since = self.trainer.progressed().step - last.map_or(0, |(step, _)| step);
        if self.watched.is_empty() || last.is_some() && since == 0 {
            return false;
        }
        let due = ended
            || match self.options.validate_every {
                Some(every) => since >= every.max(1),
                None => self.in_another_part(share, last),
            };
        due && self.pace.affords(self.clock.own_seconds(), self.watched.len())
    }

    fn pictures_are_due(&self, share: f64, ended: bool) -> bool {
        let Some(options) = &self.options.snapshots else { return false };
        let step = self.trainer.progressed().step;
        let last = self.trainer.snapshots.last().map(|taken| (taken.step, taken.seconds));
        let taken = self.trainer.snapshots.iter().any(|taken| taken.step == step);
        if self.pictured.is_empty() || taken {
            return false;
        }
        if options.steps.is_empty() {
            self.validation_is_due(share, ended) && (ended || self.in_another_part(share, last))
        } else {
            options.steps.contains(&step)
        }
    }

    /// Renders the run as it stands from the watched views and from those to take pictures of, all on one lattice.
    pub(super) fn measure_views(&mut self, due: Due) -> Result<(), RunError> {
        let (begun, mut point) = (Instant::now(), self.point());
        let allowed = self.pace.allowance(self.clock.own_seconds());
        let candidate = self.trainer.candidate(false);
        let bytes = self.trainer.export(&candidate, &About::default())?.bytes;
        self.pace.made(begun.elapsed().as_secs_f64());

        let watched = if due.validation { self.watched.clone() } else { Vec::new() };
        let pictured = if due.pictures { self.pictured.clone() } else { Vec::new() };
        let others = pictured.iter().filter(|view| !watched.contains(view));
        let indices: Vec<usize> = watched.iter().chain(others).copied().collect();
        let dataset = self.dataset;
        let views: Vec<&View> = indices.iter().map(|&view| &dataset.val[view]).collect();
        let (pixels, largest) = pixels_of(views.iter().copied());
        if self.pace.is_limited() && !self.pace.knows() {
            let probe = self.pace.probe(largest);
            self.measure_priced(&bytes, &views, probe, |_| {})?;
        }
        let left = allowed - begun.elapsed().as_secs_f64();
        let lattice = self.pace.lattice_on_the_way(pixels, largest, left.max(0.0));
        let mut frames = Vec::new();
        let mut scores = self.measure_priced(&bytes, &views, lattice, |picture| frames.push(picture))?;
        for ((&view, frame), score) in indices.iter().zip(&frames).zip(&scores.views) {
            let Some(options) = self.options.snapshots.as_ref().filter(|_| pictured.contains(&view)) else {
                continue;
            };
            let (step, seconds) = (candidate.step, point.seconds);
            let snapshot = Snapshot { step, seconds, view, psnr_db: score.psnr_db };
            frame.write_png(snapshot.path(&options.folder, dataset))?;
            self.trainer.snapshots.push(snapshot);
        }
        scores.views.truncate(watched.len());
        point.val_psnr_db = scores.psnr_db();
        (point.val_views, point.val_lattice) = (watched.len() as u32, lattice);
        self.pace.validated(begun.elapsed().as_secs_f64());
        if point.val_psnr_db.is_some() {
            let curve = &mut self.trainer.curve;
            curve.pop_if(|last| last.step == point.step);
            curve.push(point);
        }
        Ok(())
    }

    /// Measures a blob on a lattice of views, and remembers what a pixel took.
    pub(super) fn measure_priced(
        &mut self,
        bytes: &[u8],
        views: &[&View],
        lattice: u32,
        mut each: impl FnMut(crate::data::pictures::rgb::Picture),
    ) -> Result<Scores, RunError> {
        let (mut begun, mut counted) = (Instant::now(), 0);
        let thinned: Vec<_> = views.iter().map(|view| view.thinned(lattice)).collect();
        let (kernel, background) = (self.options.kernel, self.trainer.background());
        let views = || thinned.iter().map(|view| &**view);
        let scores =
            measure(bytes, None, kernel, &Quality::default(), background, views(), |view, frame, _, _| {
                each(frame::picture(frame));
                // The first view's time has the opening of the file in it: it counts only where it is the only one.
                if counted == 0 && thinned.len() > 1 {
                    (begun, counted) = (Instant::now(), view.pixel_count());
                }
            })?;
        self.pace.measured(pixels_of(views()).0 - counted, begun.elapsed().as_secs_f64());
        Ok(scores)
    }
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
