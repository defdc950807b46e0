//! Initial viewpoint for viewers of a scene: the position of one of its cameras, a target and an up direction.

use super::bundle::median;
use super::geometry::{LookAt, distances, outer, smallest_eigenvalue};
use crate::data::Dataset;
use glam::{DMat3, DVec3, Vec3};
use nerf_core::blob::Viewpoint;
use nerf_core::camera::{Camera, Pose};
use std::f32::consts::TAU;

/// Fraction of the cameras' azimuths in the arc from which a viewer's orbit range is derived. The arc is the shortest
/// that contains this fraction.
const MOST: f32 = 0.95;
/// Two thirds of a circle, radians. If the cameras' azimuths span at least this, a viewer may orbit the full circle.
const ROUND: f32 = 2.0 / 3.0 * TAU;
/// Maximum of e1 / e2 and minimum of e2 at which the cameras' x axes determine the up direction. e1 ≤ e2 ≤ e3:
/// eigenvalues of the mean outer product x xᵀ of the x axes.
const LEVEL: (f64, f64) = (0.15, 0.02);
/// Minimum number of sparse points that a view must show for an estimate of the scene's depth from them.
const ENOUGH_POINTS: usize = 8;

/// Chooses the first viewpoint from the training cameras; `None` if none is valid. `range`: near and far, world units.
///
/// If the cameras look at a common point, this point is the target. The eye is the camera nearest to a typical
/// position: median height over the target, and median distance from the vertical axis through the target. Unless the
/// cameras surround the target, the typical position also has the middle of the cameras' range of azimuths.
///
/// Without a common point, the viewpoint is the camera nearest to the geometric median of all positions.
pub fn viewpoint(dataset: &Dataset, range: (f32, f32)) -> Option<Viewpoint> {
    let cameras: Vec<Camera> = dataset.train.iter().map(|view| view.camera).collect();
    let eyes: Vec<Vec3> = cameras.iter().map(|camera| camera.pose().position).collect();
    let up = up_of(&cameras);
    let look_at = LookAt::of(&cameras).filter(|look_at| look_at.agrees() && !look_at.forward_facing());
    let (target, middle) = match look_at {
        Some(look_at) => (Vec3::from(look_at.point), None),
        None => {
            let median =
                geometric_median(&eyes.iter().map(|eye| eye.as_dvec3()).collect::<Vec<_>>()).as_vec3();
            let middle = nearest(&eyes, |eye| eye.distance(median))?;
            let depth = depth_of(dataset, middle, range);
            (eyes[middle] + depth * cameras[middle].pose().forward(), Some(middle))
        }
    };
    let places: Vec<Place> = eyes.iter().map(|&eye| Place::of(eye - target, up)).collect();
    let (begin, arc) = covered(places.iter().map(|place| place.azimuth).collect())?;
    let is_round = arc >= ROUND;
    let eye = match middle {
        Some(middle) => middle,
        None => {
            let height = median(places.iter().map(|place| place.height)) as f32;
            let distance = median(places.iter().map(|place| place.distance)) as f32;
            nearest(&places, |place| {
                let turn = if is_round { 0.0 } else { place.turn_from(begin + 0.5 * arc) };
                Vec3::new(place.height - height, place.distance - distance, turn * distance).length()
            })?
        }
    };
    let aside = places[eye].turn_from(begin + 0.5 * arc).abs();
    let arc = if is_round { TAU } else { (arc - 2.0 * aside).max(0.0) };
    let places = Pose::look_at(eyes[eye], target, up).is_some();
    let found = Viewpoint { eye: eyes[eye].into(), target: target.into(), up: up.into(), arc };
    places.then_some(found)
}

/// Estimates the depth of the scene in the training view `middle`, world units: the median distance of the sparse
/// points in view or, if they are too few, the harmonic mean of `near` and `far` (half of `far` if `near` is 0).
fn depth_of(dataset: &Dataset, middle: usize, (near, far): (f32, f32)) -> f32 {
    let seen = distances(&dataset.train[middle], &dataset.points);
    if seen.len() >= ENOUGH_POINTS {
        return median(seen) as f32;
    }
    let depth = 2.0 * near * far / (near + far);
    if depth > 0.0 { depth } else { 0.5 * (near + far) }
}

/// Position of a camera relative to the target, in cylindrical coordinates. `height`: along `up`, world units.
struct Place {
    height: f32,
    /// Distance of the camera from the axis along `up` through the target, world units.
    distance: f32,
    /// Angle around the axis along `up`, radians, from an arbitrary direction perpendicular to `up`.
    azimuth: f32,
}

impl Place {
    fn of(from_target: Vec3, up: Vec3) -> Self {
        let (side, ahead) = up.any_orthonormal_pair();
        let (x, y) = (from_target.dot(side), from_target.dot(ahead));
        Self { height: from_target.dot(up), distance: x.hypot(y), azimuth: y.atan2(x) }
    }

    /// Returns the signed angle from `azimuth` to this position, radians within ±π.
    fn turn_from(&self, azimuth: f32) -> f32 {
        (self.azimuth - azimuth + 0.5 * TAU).rem_euclid(TAU) - 0.5 * TAU
    }
}

/// Returns start and length, radians, of the shortest arc with the fraction [`MOST`] of `azimuths`; `None` without any.
fn covered(mut azimuths: Vec<f32>) -> Option<(f32, f32)> {
    azimuths.sort_unstable_by(f32::total_cmp);
    let count = azimuths.len();
    let held = (MOST * count as f32).ceil() as usize;
    let arc = |begin: usize| {
        let end = begin + held.max(1) - 1;
        let lap = if end >= count { TAU } else { 0.0 };
        (azimuths[begin], azimuths[end % count] + lap - azimuths[begin])
    };
    (0..count).map(arc).min_by(|a, b| a.1.total_cmp(&b.1))
}

/// Returns the up direction of the scene: the direction perpendicular to the cameras' x axes, because people hold
/// cameras level. If the x axes determine no direction, the median of the cameras' up directions is returned instead.
/// The median is also returned if it differs from the perpendicular direction by 60° or more.
fn up_of(cameras: &[Camera]) -> Vec3 {
    let axes = |axis: fn(&Pose) -> Vec3| -> Vec<DVec3> {
        cameras.iter().map(|camera| axis(camera.pose()).as_dvec3().normalize_or_zero()).collect()
    };
    let ups = axes(|pose| pose.rotation.y_axis);
    let mean = ups.iter().sum::<DVec3>() / ups.len().max(1) as f64;
    let up = [geometric_median(&ups), mean].into_iter().find(|up| up.length() > 0.1);
    let up = up.unwrap_or(DVec3::Z).normalize();
    let level = level(&axes(|pose| pose.rotation.x_axis)).map(|level| level * level.dot(up).signum());
    // Adding zero turns negative zeros into positive ones.
    level.filter(|level| level.dot(up) > 0.5).unwrap_or(up).as_vec3().normalize() + Vec3::ZERO
}

/// Returns the normal of the plane in which the unit vectors `horizons` nearly lie; `None` if no or several planes fit.
fn level(horizons: &[DVec3]) -> Option<DVec3> {
    let m = horizons.iter().map(|&dir| outer(dir, dir)).sum::<DMat3>() * (1.0 / horizons.len() as f64);
    let least = smallest_eigenvalue(m);
    let rest = m - DMat3::from_diagonal(DVec3::splat(least));
    let (x, y, z) = (rest.x_axis, rest.y_axis, rest.z_axis);
    // Columns of the adjugate of `rest`: the outer product of the normal with itself, times the product of the two
    // eigenvalues other than 0.
    let normals = [y.cross(z), z.cross(x), x.cross(y)];
    let product = normals[0].x + normals[1].y + normals[2].z;
    let half = 0.5 * (x.x + y.y + z.z);
    let next = least + half - (half * half - product).max(0.0).sqrt();
    let normal = normals.into_iter().max_by(|a, b| a.length().total_cmp(&b.length()))?;
    let tells = least <= LEVEL.0 * next && next >= LEVEL.1;
    normal.try_normalize().filter(|_| tells)
}

/// Returns the point with the least sum of distances to `points` (Weiszfeld 1937).
fn geometric_median(points: &[DVec3]) -> DVec3 {
    let mean = points.iter().sum::<DVec3>() / points.len().max(1) as f64;
    (0..50).fold(mean, |at, _| {
        let weights = points.iter().map(|point| 1.0 / point.distance(at).max(1e-9));
        let weighted = |(point, weight): (&DVec3, f64)| (*point * weight, weight);
        let (sum, all) = (points.iter().zip(weights).map(weighted))
            .fold((DVec3::ZERO, 0.0), |sum, one| (sum.0 + one.0, sum.1 + one.1));
        if all > 0.0 { sum / all } else { at }
    })
}

/// Returns the index of the first item with the smallest `distance`; `None` if there are no items.
fn nearest<T>(items: &[T], distance: impl Fn(&T) -> f32) -> Option<usize> {
    (0..items.len()).min_by(|&a, &b| distance(&items[a]).total_cmp(&distance(&items[b])))
}
