//! Lines of sight from the camera of each photograph to the sparse points that the photograph shows.

use crate::data::{Dataset, SparsePoint, View};
use glam::Vec3;
use rayon::prelude::*;
use std::borrow::Borrow;
use std::fmt;

/// Minimum number of photographs that show a usable point: a point in two photographs may be a wrong match.
const MIN_TRACK: u32 = 3;
/// Mean reprojection error at or above which a point is not used, pixels of the full-size photograph.
const MAX_ERROR: f32 = 2.0;
/// Distance between a key point and the projection of its 3D point, pixels of the view, from which on the key point is
/// not used.
const MAX_RESIDUAL: f32 = 3.0;
/// Number of photographs that must show a point for full confidence in the point.
const FULL_TRACK: f32 = 6.0;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sight {
    /// Position of the point in the photograph, pixels from the left and from the top.
    pub at: [f32; 2],
    /// The point's index in [`Dataset::points`].
    pub point: u32,
    /// Distance from the camera to the point, world units.
    pub distance: f32,
    /// Confidence, 0 to 1: `min(1, track / 6) / (1 + error²)`. `track`: number of photographs that show the point.
    /// `error`: mean reprojection error of the point, pixels.
    pub confidence: f32,
}

/// Lines of sight of a list of views, and numbers of unused key points.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sights {
    pub of_views: Vec<Vec<Sight>>,
    /// Number of key points of each view that are not used because their 3D point does not project near them.
    pub contradictory: Vec<usize>,
    /// Number of key points of all views that are not used because too few photographs show their 3D point, or because
    /// the point's reprojection error is too large.
    doubtful: usize,
}

impl Sights {
    /// Makes a line of sight from each view to each reliable point that it shows, and counts the unused key points.
    pub fn of<V: Borrow<View> + Sync>(views: &[V], points: &[SparsePoint]) -> Self {
        let mut sights = Self::default();
        let of_view = |view: &V| {
            let view = view.borrow();
            let mut found = (Vec::new(), 0, 0);
            for key in &view.key_points {
                let Some(point) = points.get(key.point as usize) else { continue };
                // An error of NaN fails the comparison, so that the point is not used.
                let believed = point.track >= MIN_TRACK && point.error < MAX_ERROR;
                if !believed {
                    found.2 += 1;
                    continue;
                }
                let position = Vec3::from(point.position);
                let near = |(x, y): &(f32, f32)| (x - key.x).hypot(y - key.y) < MAX_RESIDUAL;
                if view.camera.project(position).filter(near).is_none() {
                    found.1 += 1;
                    continue;
                }
                let certain = (point.track as f32 / FULL_TRACK).min(1.0);
                found.0.push(Sight {
                    at: [key.x, key.y],
                    point: key.point,
                    distance: (position - view.camera.pose().position).length(),
                    confidence: certain / (1.0 + point.error * point.error),
                });
            }
            found
        };
        for (found, contradictory, doubtful) in views.par_iter().map(of_view).collect::<Vec<_>>() {
            sights.of_views.push(found);
            sights.contradictory.push(contradictory);
            sights.doubtful += doubtful;
        }
        sights
    }

    pub fn count(&self) -> usize {
        self.of_views.iter().map(Vec::len).sum()
    }
}

impl fmt::Display for Sights {
    /// Writes one sentence: numbers of used and unused key points, and the reasons for not using them.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (contradictory, doubtful) = (self.contradictory.iter().sum::<usize>(), self.doubtful);
        let (count, views) = (self.count(), self.of_views.len());
        write!(
            f,
            "{count} key points of {views} photographs say how far surfaces are and which space is free"
        )?;
        if contradictory + doubtful > 0 {
            write!(
                f,
                "; left out: {doubtful} of points with fewer than {MIN_TRACK} photographs or an error of {MAX_ERROR} \
                 pixels, {contradictory} whose point is projected elsewhere"
            )?;
        }
        Ok(())
    }
}

/// Returns the lines of sight of the training views; `None` if there are none, as in data without point tracks.
pub fn of_training(dataset: &Dataset) -> Option<Sights> {
    let sights = Sights::of(&dataset.train, &dataset.points);
    (sights.count() > 0).then_some(sights)
}
