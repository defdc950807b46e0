//! Spread of the photographs around their common point: azimuths, and gaps in the orbit.

use crate::data::cameras::bundle::median;
use crate::data::{LookAt, View};
use glam::Vec3;
use nerf_core::camera::Camera;

/// Size from which every gap between azimuths is reported, degrees. The largest gap is reported whatever its size.
const GAP: f32 = 30.0;
/// Elevation above or below the horizon beyond which a camera has no azimuth, degrees.
const STEEP: f32 = 75.0;

/// Factor for jumps. The viewing direction jumps between two photographs if it turns by at least [`GAP`] and by at
/// least this multiple of the median turn.
const JUMP: f32 = 5.0;
/// Minimum number of consecutive photographs in a run between jumps; only the last run may be shorter.
const SHORTEST_RUN: usize = 3;

/// A range of azimuths, `degrees` wide, without photographs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Gap {
    pub degrees: f32,
    /// Indices of the photographs at the two ends of the range.
    pub between: [usize; 2],
}

/// Directions of the cameras, seen from their common look-at point or, without such a point, their viewing directions.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Spread {
    /// Whether the cameras look at one point.
    pub inward: bool,
    /// Azimuth of each photograph's direction about the mean up axis, degrees; `None` if steeper than [`STEEP`].
    pub azimuths: Vec<Option<f32>>,
    /// Largest gap, and all further gaps of at least [`GAP`], in descending order.
    pub gaps: Vec<Gap>,
}

impl Spread {
    /// Returns the spread of `views`; `None` for fewer than two views, or if all have nearly one viewing direction.
    pub fn of(views: &[&View]) -> Option<Self> {
        let cameras: Vec<Camera> = views.iter().map(|view| view.camera).collect();
        let look_at = LookAt::of(&cameras).filter(|look_at| !look_at.forward_facing())?;
        let inward = look_at.agrees();
        let middle = Vec3::from(look_at.point);
        let up: Vec3 = cameras.iter().map(|camera| camera.pose().rotation.y_axis).sum();
        let up = up.try_normalize().unwrap_or(Vec3::Z);
        let (side, ahead) = up.any_orthonormal_pair();
        let azimuth = |camera: &Camera| {
            let pose = camera.pose();
            let from = if inward { pose.position - middle } else { pose.forward() }.normalize_or_zero();
            let steep = from.dot(up).abs() > STEEP.to_radians().sin();
            (!steep).then(|| from.dot(ahead).atan2(from.dot(side)).to_degrees())
        };
        let azimuths: Vec<Option<f32>> = cameras.iter().map(azimuth).collect();
        let mut around: Vec<(f32, usize)> =
            azimuths.iter().enumerate().filter_map(|(i, azimuth)| Some(((*azimuth)?, i))).collect();
        around.sort_by(|a, b| a.0.total_cmp(&b.0));
        let gap = |(i, &(from, view)): (usize, &(f32, usize))| match around.get(i + 1) {
            Some(&(to, next)) => Gap { degrees: to - from, between: [view, next] },
            None => Gap { degrees: around[0].0 + 360.0 - from, between: [view, around[0].1] },
        };
        let mut gaps: Vec<Gap> = around.iter().enumerate().map(gap).collect();
        gaps.sort_by(|a, b| b.degrees.total_cmp(&a.degrees));
        let wide = gaps.iter().filter(|gap| gap.degrees >= GAP).count();
        gaps.truncate(wide.max(1));
        Some(Self { inward, azimuths, gaps })
    }
}

/// Splits consecutive `views` into runs of indices. A run ends where the viewing direction jumps ([`JUMP`]), once it
/// has at least [`SHORTEST_RUN`] views.
pub(super) fn runs(views: &[&View]) -> Vec<Vec<usize>> {
    let ahead = |view: &View| view.camera.pose().forward();
    let turns: Vec<f32> =
        views.windows(2).map(|two| ahead(two[0]).angle_between(ahead(two[1])).to_degrees()).collect();
    // The median of no angles is NaN, which `max` ignores.
    let jump = GAP.max(JUMP * median(turns.iter().copied()) as f32);
    let mut runs: Vec<Vec<usize>> = Vec::new();
    for view in 0..views.len() {
        match runs.last_mut() {
            Some(run) if turns[view - 1] < jump || run.len() < SHORTEST_RUN => run.push(view),
            _ => runs.push(vec![view]),
        }
    }
    runs
}
