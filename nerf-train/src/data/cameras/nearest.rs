//! How near something is that the views show, by the sparse points they see.

use crate::data::{Dataset, SparsePoint, View};
use glam::Vec3;
use rayon::prelude::*;

/// Fewer points say nothing of where things are.
const ENOUGH_POINTS: usize = 50;
/// A view's rays begin behind so many of the points that it sees, at so much of the distance of the nearest of the rest that
/// is: many points are outliers, and surfaces lie between them.
const ONE_VIEW: (f32, f32) = (0.01, 0.7);

pub(crate) fn set_near(dataset: &mut Dataset) {
    let Dataset { train, val, test, points, .. } = dataset;
    [train, val, test].into_iter().flatten().par_bridge().for_each(|view| {
        view.near = begin(distances(view, points), ONE_VIEW).unwrap_or(0.0);
    });
}

pub(crate) fn distances(view: &View, points: &[SparsePoint]) -> Vec<f32> {
    let (camera, (width, height)) = (&view.camera, view.size());
    let distance = |point: &SparsePoint| {
        let point = Vec3::from(point.position);
        let (x, y) = camera.project(point)?;
        let inside = (0.0..=width as f32).contains(&x) && (0.0..=height as f32).contains(&y);
        inside.then(|| (point - camera.pose().position).length())
    };
    points.iter().filter_map(distance).collect()
}

/// The distance that a share of those of many points is in front of, times another one.
pub(crate) fn begin(mut distances: Vec<f32>, (in_front, share): (f32, f32)) -> Option<f32> {
    if distances.len() < ENOUGH_POINTS {
        return None;
    }
    distances.sort_unstable_by(f32::total_cmp);
    Some(share * distances[(in_front * distances.len() as f32) as usize])
}
