//! Point that the cameras look at, and the bounds of the scene that follow from it.

use crate::data::{Dataset, Format, SparsePoint, View};
use glam::{DMat3, DVec3, Vec3};
use nerf_core::camera::Camera;
use nerf_core::space::{BoundsError, SceneBox};
use rayon::prelude::*;
use serde::Serialize;

/// Largest [`LookAt::spread`] of parallel cameras. At this value, optical axes are about 0.5° from their mean direction.
const PARALLEL: f64 = 1e-4;
/// [`LookAt::spread`] below which a scene is forward-facing. At this value, optical axes are about 8° from their mean
/// direction.
const FORWARD_FACING: f64 = 0.02;
/// Number of reweighted least-squares iterations that minimise the sum of distances from the look-at point to the axes.
const ROUNDS: usize = 20;

/// Point with the least sum of distances to all optical axes, and how well the axes agree on it. The distances are not
/// squared, so that a few cameras that look elsewhere hardly move the point. Reversing an axis does not move the point.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct LookAt {
    pub point: [f32; 3],
    /// Mean distance of the axes from the point, world units.
    pub mean_residual: f32,
    /// Smallest distance of a camera from the point, world units.
    pub min_distance: f32,
    pub mean_distance: f32,
    pub max_distance: f32,
    /// Fraction of the cameras that have the point behind them, 0..=1.
    pub behind: f32,
    /// Mean squared sine, 0..=2/3, of the angles between the axes and the common direction, which minimises this mean.
    pub spread: f32,
}

impl LookAt {
    /// Finds the look-at point; `None` if there are fewer than two cameras, or if their axes are nearly parallel.
    pub fn of(cameras: &[Camera]) -> Option<Self> {
        let line = |camera: &Camera| {
            (camera.pose().position.as_dvec3(), camera.pose().forward().as_dvec3().normalize_or_zero())
        };
        Self::of_lines(&cameras.iter().map(line).collect::<Vec<_>>())
    }

    /// Finds the look-at point of `lines` (position, unit direction); `None` for fewer than two lines or nearly
    /// parallel lines.
    pub(crate) fn of_lines(lines: &[(DVec3, DVec3)]) -> Option<Self> {
        if lines.len() < 2 {
            return None;
        }
        let count = lines.len() as f64;
        // Coordinates are relative to the mean position, for precision in scenes far from the origin.
        let centre = lines.iter().map(|line| line.0).sum::<DVec3>() / count;
        let across = |dir: DVec3| DMat3::IDENTITY - outer(dir, dir);
        let spread = smallest_eigenvalue(lines.iter().map(|l| across(l.1)).sum::<DMat3>() * (1.0 / count));
        if spread.is_nan() || spread <= PARALLEL {
            return None;
        }
        let mut weights = vec![1.0; lines.len()];
        let mut point = DVec3::ZERO;
        for _ in 0..ROUNDS {
            let (mut matrix, mut right) = (DMat3::ZERO, DVec3::ZERO);
            for ((origin, dir), weight) in lines.iter().zip(&weights) {
                let projector = across(*dir) * *weight;
                matrix += projector;
                right += projector * (*origin - centre);
            }
            let next = matrix.inverse() * right;
            if !next.is_finite() {
                break;
            }
            point = next;
            let scale = lines.iter().map(|l| (point + centre - l.0).length()).sum::<f64>() / count;
            for ((origin, dir), weight) in lines.iter().zip(&mut weights) {
                let residual = (across(*dir) * (point + centre - *origin)).length();
                *weight = 1.0 / (residual / scale.max(f64::MIN_POSITIVE)).max(1e-3);
            }
        }
        let point = point + centre;
        let (mut residual, mut min, mut sum, mut max, mut behind) = (0.0, f64::INFINITY, 0.0, 0.0f64, 0usize);
        for (origin, dir) in lines {
            let to = point - *origin;
            let distance = to.length();
            residual += (across(*dir) * to).length();
            (min, sum, max) = (min.min(distance), sum + distance, max.max(distance));
            behind += usize::from(to.dot(*dir) < 0.0);
        }
        let look_at = Self {
            point: point.as_vec3().into(),
            mean_residual: (residual / count) as f32,
            min_distance: min as f32,
            mean_distance: (sum / count) as f32,
            max_distance: max as f32,
            behind: (behind as f64 / count) as f32,
            spread: spread as f32,
        };
        look_at.point.iter().all(|v| v.is_finite()).then_some(look_at)
    }

    /// Whether the axes' mean distance from [`Self::point`] is at most 0.3 times the cameras' mean distance from it.
    pub fn axes_meet(&self) -> bool {
        self.mean_residual <= 0.3 * self.mean_distance
    }

    /// Whether the axes meet ([`Self::axes_meet`]), and the point is in front of at least nine in ten cameras.
    pub fn agrees(&self) -> bool {
        self.axes_meet() && self.behind <= 0.1
    }

    /// Whether the cameras look in nearly the same direction. The depth of the look-at point is then uncertain.
    pub fn forward_facing(&self) -> bool {
        f64::from(self.spread) < FORWARD_FACING
    }

    /// Whether the point is certain enough to be the centre of the scene box.
    ///
    /// Two conditions must hold: [`Self::agrees`], and an uncertainty of the point along the cameras' common direction
    /// (`mean_residual` / √`spread`) of at most half of [`Self::mean_distance`].
    pub fn places_the_scene(&self) -> bool {
        self.agrees() && self.mean_residual <= 0.5 * self.mean_distance * self.spread.sqrt()
    }
}

pub(super) fn outer(a: DVec3, b: DVec3) -> DMat3 {
    DMat3::from_cols(a * b.x, a * b.y, a * b.z)
}

/// Returns the smallest eigenvalue of a symmetric matrix with eigenvalues in 0..=1.
///
/// # Source
/// Smith 1961, "Eigenvalues of a symmetric 3 × 3 matrix".
pub(super) fn smallest_eigenvalue(m: DMat3) -> f64 {
    let mean = (m.x_axis.x + m.y_axis.y + m.z_axis.z) / 3.0;
    let shifted = m - DMat3::from_diagonal(DVec3::splat(mean));
    let columns = [shifted.x_axis, shifted.y_axis, shifted.z_axis];
    let p = (columns.iter().map(|c| c.length_squared()).sum::<f64>() / 6.0).sqrt();
    if p < 1e-12 {
        return mean;
    }
    let half_determinant = ((shifted * (1.0 / p)).determinant() / 2.0).clamp(-1.0, 1.0);
    let angle = half_determinant.acos() / 3.0;
    mean + 2.0 * p * (angle + 2.0 * std::f64::consts::FRAC_PI_3).cos()
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SceneBounds {
    pub near: f32,
    pub far: f32,
    /// Proposed box around the scene, wide rather than tight.
    pub scene_box: SceneBox,
}

/// Returns near and far distance, world units, and scene box of a data set. `min`, `mean` and `max` below are the
/// distances of the cameras from their common look-at point.
///
/// - `near` and `far`: the data set's own, if stated. Else 2 and 6 for NeRF-synthetic, CS180 and tiny_nerf data with
///   cameras at about 4. Else `near = min / 2` and `far = max + mean − min / 2`.
/// - Box: a cube around the look-at point, with half side `mean − near`. If the look-at point is uncertain
///   ([`LookAt::places_the_scene`]), or if `mean` is at most `near`: the bounding box of all view frusta.
///
/// `None` if `near` or `far` is not stated and the look-at point is uncertain, if `near` is not below `far`, or if the
/// box is invalid ([`SceneBox::new`]).
pub fn scene_bounds(dataset: &Dataset) -> Option<SceneBounds> {
    let cameras: Vec<Camera> = dataset.cameras().copied().collect();
    bounds(&cameras, LookAt::of(&cameras).as_ref(), dataset)
}

pub(crate) fn bounds(cameras: &[Camera], look_at: Option<&LookAt>, dataset: &Dataset) -> Option<SceneBounds> {
    let look_at = look_at.filter(|look_at| look_at.places_the_scene());
    let proposed = look_at.map(|look_at| proposed_range(look_at, dataset.format));
    let near = dataset.near.or(proposed.map(|range| range.0))?;
    let far = dataset.far.or(proposed.map(|range| range.1))?;
    // A given bound may contradict a proposed one.
    if near >= far {
        return None;
    }
    let scene_box = match look_at {
        Some(look_at) if look_at.mean_distance > near => {
            let centre = Vec3::from(look_at.point);
            let half = Vec3::splat(look_at.mean_distance - near);
            SceneBox::new(centre - half, centre + half)
        }
        _ => frusta_box(cameras, near, far),
    };
    Some(SceneBounds { near, far, scene_box: scene_box.ok()? })
}

fn proposed_range(look_at: &LookAt, format: Format) -> (f32, f32) {
    let recipe = matches!(format, Format::Cs180 | Format::TinyNerf | Format::Blender);
    let usual = look_at.min_distance > 3.0 && look_at.max_distance < 5.0;
    if recipe && usual && (look_at.mean_distance - 4.0).abs() < 0.25 {
        return (2.0, 6.0);
    }
    let near = 0.5 * look_at.min_distance;
    (near, look_at.max_distance + (look_at.mean_distance - near))
}

/// Returns the smallest axis-aligned box around all view frusta between the distances `near` and `far`, world units.
pub fn frusta_box(cameras: &[Camera], near: f32, far: f32) -> Result<SceneBox, BoundsError> {
    let (mut min, mut max) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    for camera in cameras {
        let i = camera.intrinsics();
        let (w, h) = (i.width as f32, i.height as f32);
        for (x, y) in [(0.0, 0.0), (w, 0.0), (0.0, h), (w, h), (0.5 * w, 0.5 * h)] {
            let ray = camera.ray(x, y);
            for p in [ray.at(near), ray.at(far)] {
                (min, max) = (min.min(p), max.max(p));
            }
        }
    }
    SceneBox::new(min, max)
}

/// Smallest number of sparse points from which a near distance is estimated.
const ENOUGH_POINTS: usize = 50;
/// Quantile and factor for the near distance of a view, which is the quantile of the distances from the camera to the
/// sparse points in view, times the factor. The quantile skips outliers; the factor allows for nearer surfaces.
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

/// Estimates a near or far distance: the quantile `in_front` (0..1) of `distances`, times `share`. `None` for fewer
/// than 50 distances.
pub(crate) fn begin(mut distances: Vec<f32>, (in_front, share): (f32, f32)) -> Option<f32> {
    if distances.len() < ENOUGH_POINTS {
        return None;
    }
    distances.sort_unstable_by(f32::total_cmp);
    Some(share * distances[(in_front * distances.len() as f32) as usize])
}
