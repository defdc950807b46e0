//! Looks at the validation views on the way: when, at which, and what is kept of them.

use super::CurvePoint;
use super::candidate::About;
use super::run::{RunError, Session};
use super::snapshot::Snapshot;
use crate::eval::{Scores, measure};
use crate::report::picture::Picture;
use nerf_core::plan::Quality;
use std::time::Instant;

/// Validation views a run looks at in the end, spread over the split.
pub const FINAL_VIEWS: usize = 10;
/// Validation views it looks at on the way.
const WATCHED_VIEWS: usize = 2;
/// Training views that the grid's loss is measured on.
pub(super) const GRID_VIEWS: usize = 3;
/// Parts of the budget that end with a look, where no interval is given.
const PARTS: f64 = 8.0;
/// Steps between the points of the curve that are no looks.
const POINT_EVERY: u32 = 20;

/// Indices of at most `count` of `len` things, spread over all of them.
pub(super) fn spread_indices(len: usize, count: usize) -> impl ExactSizeIterator<Item = usize> {
    (0..len).step_by(len.div_ceil(count).max(1))
}

/// The views that are looked at on the way, of `len`: some of those of the end, so that the curve is of a piece.
pub(super) fn watched(len: usize) -> Vec<usize> {
    let all: Vec<usize> = spread_indices(len, FINAL_VIEWS).collect();
    spread_indices(all.len(), WATCHED_VIEWS).map(|i| all[i]).collect()
}

impl Session<'_, '_> {
    /// Looks, pictures and points of the curve that are due between two steps.
    ///
    /// All of it is decided by step, budget and what the trainer remembers, so that a run that was taken up
    /// again looks where an undisturbed one does; and pictures never decide what is kept.
    ///
    /// `share`: of the budget that is used.
    pub(super) fn observe(&mut self, share: f64, ended: bool) -> Result<(), RunError> {
        let step = self.trainer.progressed().step;
        let (look, picture) = (self.look_is_due(share, ended), self.picture_is_due(share, ended));
        let mut point = CurvePoint {
            step,
            seconds: self.clock.seconds(),
            train_psnr_db: self.trainer.train_psnr_db(),
            val_psnr_db: None,
        };
        if look || picture {
            point.val_psnr_db = self.look(look, picture, point.seconds)?;
        }
        let curve = &mut self.trainer.curve;
        let noted = curve.last().is_some_and(|last| last.step == step);
        if point.val_psnr_db.is_some() && noted {
            curve.pop();
        }
        let regular = step > 0 && (ended || step.is_multiple_of(POINT_EVERY));
        if point.val_psnr_db.is_some() || regular && !noted {
            curve.push(point);
        }
        Ok(())
    }

    /// The last point of the curve that was a look.
    fn last_look(&self) -> Option<&CurvePoint> {
        self.trainer.curve.iter().rev().find(|point| point.val_psnr_db.is_some())
    }

    /// PSNR of the watched views at the last look, dB.
    pub(super) fn last_val_psnr_db(&self) -> Option<f64> {
        self.last_look().and_then(|point| point.val_psnr_db)
    }

    /// Whether another eighth of the budget is used than at `last`.
    ///
    /// What is kept back for the end of a run is guessed anew at every look, and moves the eighths of a limit
    /// in seconds a little: an eighth that was just begun must not begin again.
    fn in_another_part(&self, share: f64, last: Option<(u32, f64)>) -> bool {
        let then = last.map_or(0.0, |(step, seconds)| self.options.budget.share(step, seconds, self.reserve));
        let part = |share: f64| (share * PARTS) as u32;
        part(share) > part(then) && share - then > 0.5 / PARTS
    }

    fn look_is_due(&self, share: f64, ended: bool) -> bool {
        let last = self.last_look().map(|point| (point.step, point.seconds));
        let since = self.trainer.progressed().step - last.map_or(0, |(step, _)| step);
        if self.watched.is_empty() || last.is_some() && since == 0 {
            return false;
        }
        ended
            || match self.options.validate_every {
                Some(every) => since >= every.max(1),
                None => self.in_another_part(share, last),
            }
    }

    fn picture_is_due(&self, share: f64, ended: bool) -> bool {
        let Some(options) = &self.options.snapshots else { return false };
        let step = self.trainer.progressed().step;
        let last = self.trainer.snapshots.last().map(|taken| (taken.step, taken.seconds));
        let taken = self.trainer.snapshots.iter().any(|taken| taken.step == step);
        if self.pictured.is_empty() || taken {
            return false;
        }
        if options.steps.is_empty() {
            self.look_is_due(share, ended) && (ended || self.in_another_part(share, last))
        } else {
            options.steps.contains(&step)
        }
    }

    /// Renders the run as it stands from the watched views and from those to take pictures of.
    ///
    /// Returns the mean PSNR of the watched views, dB, if `look` asked for it; the state then competes for
    /// being exported.
    fn look(&mut self, look: bool, picture: bool, seconds: f64) -> Result<Option<f64>, RunError> {
        let start = Instant::now();
        let candidate = self.trainer.candidate();
        let bytes = self.trainer.export(&candidate, &About::default())?.bytes;
        let asked = Instant::now();
        let watched = if look { self.watched.clone() } else { Vec::new() };
        let pictured = if picture { self.pictured.clone() } else { Vec::new() };
        let others = pictured.iter().filter(|view| !watched.contains(view));
        let indices: Vec<usize> = watched.iter().chain(others).copied().collect();
        let (tier, background) = (self.options.tier, self.trainer.background());
        let views = indices.iter().map(|&view| &self.dataset.val[view]);
        let mut frames: Vec<Picture> = Vec::new();
        let quality = Quality::default();
        let mut scores = measure(&bytes, None, tier, &quality, background, views, |_, frame, _, _| {
            frames.push(frame.picture());
        })?;
        if look && self.options.budget.seconds.is_some() {
            let a_view = asked.elapsed().as_secs_f64() / indices.len() as f64;
            let a_look = start.elapsed().as_secs_f64();
            // The last look; final views twice (f16 and f32); a few with and without view dependence; and dense
            // views, some ten times as dear.
            self.set_reserve(1.0 + a_look + a_view * (2 * FINAL_VIEWS + 13 * GRID_VIEWS) as f64);
        }
        for ((&view, frame), score) in indices.iter().zip(&frames).zip(&scores.views) {
            let Some(options) = self.options.snapshots.as_ref().filter(|_| pictured.contains(&view)) else {
                continue;
            };
            let snapshot = Snapshot { step: candidate.step, seconds, view, psnr_db: score.psnr_db };
            frame.write_png(snapshot.path(&options.folder, self.dataset))?;
            self.trainer.snapshots.push(snapshot);
        }
        scores.views.truncate(watched.len());
        let val_psnr_db = Scores::psnr_db(&scores);
        if let Some(val_psnr_db) = val_psnr_db {
            self.trainer.consider(candidate, val_psnr_db, seconds);
        }
        Ok(val_psnr_db)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn watched_views_are_among_those_of_the_end() {
        assert!(watched(0).is_empty());
        assert_eq!(watched(1), [0]);
        assert_eq!((watched(2), watched(10), watched(100)), (vec![0, 1], vec![0, 5], vec![0, 50]));
        for len in 1..300 {
            let all: Vec<usize> = spread_indices(len, FINAL_VIEWS).collect();
            let watched = watched(len);
            assert!(all.len() <= FINAL_VIEWS && (1..=WATCHED_VIEWS).contains(&watched.len()), "{len}");
            assert!(watched.iter().all(|view| all.contains(view)), "{len}");
        }
    }
}
