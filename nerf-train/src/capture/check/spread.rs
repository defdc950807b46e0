//! How photographs are spread around what they show: gaps in the orbit.

use crate::data::cameras::bundle::median;
use crate::data::{LookAt, View};
use glam::Vec3;
use nerf_core::camera::Camera;

/// A gap that is worth a word, degrees.
const GAP: f32 = 30.0;
/// Cameras steeper than this above or below have no side that they look from, degrees.
const STEEP: f32 = 75.0;

/// A turn between photographs in a row that is a jump: at least [`GAP`], and so many times the median turn.
const JUMP: f32 = 5.0;
/// Photographs of a run, at least, but for the last one.
const SHORTEST_RUN: usize = 3;

/// A sector from which no photograph looks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Gap {
    pub degrees: f32,
    /// The photographs at its two ends.
    pub between: [usize; 2],
}

/// Where photographs were taken from, around the point that they look at; around themselves where there is no such point.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Spread {
    /// Whether the cameras look at one point.
    pub inward: bool,
    /// Around the cameras' mean up, degrees; `None` nearly straight above and below.
    pub azimuths: Vec<Option<f32>>,
    /// The largest gap, and all others of at least [`GAP`], the largest first.
    pub gaps: Vec<Gap>,
}

impl Spread {
    /// Of these photographs; `None` where all look much the same way, or without any.
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

/// The photographs between jumps of the viewing direction, in the order given.
pub(super) fn runs(views: &[&View]) -> Vec<Vec<usize>> {
    let ahead = |view: &View| view.camera.pose().forward();
    let turns: Vec<f32> =
        views.windows(2).map(|two| ahead(two[0]).angle_between(ahead(two[1])).to_degrees()).collect();
    // Of a single photograph there is no median.
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
