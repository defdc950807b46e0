//! Bundle adjustment: optimises cameras and points so that points project to where the photographs show them.
//!
//! Minimises Σ ρ(|π(R_i X_j + t_i) − x_ij|²) by Levenberg and Marquardt's method, with the points eliminated (Schur
//! complement). R_i, t_i: pose of photograph i. X_j: point j. π: projection. x_ij: where photograph i shows point j,
//! pixels. The robust loss is ρ(e²) = 2 s² (√(1 + e²/s²) − 1), s = 1 pixel. The variables are all poses, all points,
//! and for each device the focal length and two coefficients of radial distortion. Sums have a fixed order, whatever
//! the number of threads.
//!
//! # Source
//! Triggs et al. 2000, "Bundle adjustment: a modern synthesis"; the loss is SciPy's `soft_l1`.

mod linear;
#[cfg(test)]
mod tests;

use crate::data::cameras::geometry::outer;
use glam::{DMat3, DQuat, DVec2, DVec3};
use linear::Reduced;

/// Number of parameters of a pose (rotation, translation). A device has three: logarithm of the focal length, k1, k2.
const POSE: usize = 6;
/// Scale s of the robust loss, pixels. The loss is about quadratic in smaller reprojection errors, and about linear in
/// larger errors.
const SOFT_PIXELS: f64 = 1.0;
/// Minimum depth of a point in front of a camera, as a fraction of the camera's distance from the world origin.
const MIN_DEPTH: f64 = 1e-6;
const MAX_ITERATIONS: usize = 100;
/// Relative decrease of the sum of robust losses in a step, below which the adjustment ends.
const SMALLEST_GAIN: f64 = 1e-8;
const MAX_DAMPING: f64 = 1e8;
/// Number of iterations in which [`align`] finds the rotation.
const TURNS: usize = 20;

/// Intrinsics that all photographs of a device share: fx in pixels, k1 and k2. `second_order`: whether k2 is adjusted.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Device {
    pub(crate) focal: f64,
    pub(crate) radial: [f64; 2],
    pub(crate) second_order: bool,
}

/// Intrinsics of one photograph, which the adjustment leaves unchanged. `principal`: pixels. `tangential`: p1, p2.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Frame {
    pub(crate) principal: DVec2,
    /// Ratio fy / fx; fx is the device's focal length.
    pub(crate) aspect: f64,
    pub(crate) tangential: [f64; 2],
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct Photograph {
    /// Rotation from world to camera; the camera looks along +z with y down.
    pub(crate) rotation: DQuat,
    pub(crate) translation: DVec3,
    pub(crate) device: usize,
    pub(crate) frame: Frame,
}

impl Photograph {
    pub(crate) fn centre(&self) -> DVec3 {
        -(self.rotation.inverse() * self.translation)
    }
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct Observation {
    pub(crate) photograph: usize,
    pub(crate) point: usize,
    pub(crate) at: DVec2,
}

/// Input and result of bundle adjustment. [`Bundle::adjust`] sorts `observations` by point.
#[derive(Clone, Debug)]
pub(crate) struct Bundle {
    pub(crate) devices: Vec<Device>,
    pub(crate) photographs: Vec<Photograph>,
    pub(crate) points: Vec<DVec3>,
    pub(crate) observations: Vec<Observation>,
}

/// Residual (x, y) of an observation, pixels, and derivatives of its x and y with respect to pose, device and point.
struct Jacobian {
    residual: DVec2,
    pose: [[f64; POSE]; 2],
    device: [[f64; POSE]; 2],
    point: [DVec3; 2],
}

impl Bundle {
    fn residual(&self, seen: &Observation) -> Option<DVec2> {
        self.linearised(seen).map(|jacobian| jacobian.residual)
    }

    /// Returns residual and derivatives of an observation; `None` if the point is not in front of the camera.
    fn linearised(&self, seen: &Observation) -> Option<Jacobian> {
        let photograph = &self.photographs[seen.photograph];
        let device = &self.devices[photograph.device];
        let Frame { principal, aspect, tangential: [p1, p2] } = photograph.frame;
        let turn = DMat3::from_quat(photograph.rotation);
        let turned = turn * self.points[seen.point];
        let at = turned + photograph.translation;
        if at.z.is_nan() || at.z <= MIN_DEPTH * photograph.translation.length() {
            return None;
        }
        let (a, b) = (at.x / at.z, at.y / at.z);
        let [k1, k2] = device.radial;
        let r2 = a * a + b * b;
        let (scale, slope) = (1.0 + r2 * (k1 + r2 * k2), 2.0 * (k1 + 2.0 * k2 * r2));
        let x = a * scale + 2.0 * p1 * a * b + p2 * (r2 + 2.0 * a * a);
        let y = b * scale + p1 * (r2 + 2.0 * b * b) + 2.0 * p2 * a * b;
        let focal = DVec2::new(device.focal, device.focal * aspect);
        let mixed = slope * a * b + 2.0 * (p1 * a + p2 * b);
        let by_ab = [
            focal.x * DVec2::new(scale + slope * a * a + 2.0 * p1 * b + 6.0 * p2 * a, mixed),
            focal.y * DVec2::new(mixed, scale + slope * b * b + 6.0 * p1 * b + 2.0 * p2 * a),
        ];
        let by_at = by_ab.map(|d| DVec3::new(d.x, d.y, -(a * d.x + b * d.y)) / at.z);
        let by_pose = |d: DVec3| {
            let by_turn = turned.cross(d);
            [by_turn.x, by_turn.y, by_turn.z, d.x, d.y, d.z]
        };
        let second = if device.second_order { r2 * r2 } else { 0.0 };
        let by_device = |f: f64, x: f64, a: f64| [f * x, f * a * r2, f * a * second, 0.0, 0.0, 0.0];
        Some(Jacobian {
            residual: focal * DVec2::new(x, y) + principal - seen.at,
            pose: by_at.map(by_pose),
            device: [by_device(focal.x, x, a), by_device(focal.y, y, b)],
            point: by_at.map(|d| turn.transpose() * d),
        })
    }

    /// Returns each observation's reprojection error, pixels; infinite if the point is not in front of the camera.
    pub(crate) fn errors(&self) -> Vec<f64> {
        let error = |seen| self.residual(seen).map_or(f64::INFINITY, DVec2::length);
        self.observations.iter().map(error).collect()
    }

    fn cost(&self) -> f64 {
        self.errors().iter().map(|e| 2.0 * SOFT_PIXELS * (SOFT_PIXELS.hypot(*e) - SOFT_PIXELS)).sum()
    }

    /// Moves each camera along its optical axis after a change of focal length. Objects at the median depth of the
    /// camera's points keep their size in the photograph. `own`: previous focal length of each photograph, pixels.
    pub(crate) fn dolly(&mut self, own: &[f64]) {
        let depths = self.depths();
        for ((photograph, own), depth) in self.photographs.iter_mut().zip(own).zip(depths) {
            photograph.translation.z += depth * (self.devices[photograph.device].focal / own - 1.0);
        }
    }

    /// Returns, for each photograph, the median depth of the points that it sees; NaN if it sees none.
    pub(crate) fn depths(&self) -> Vec<f64> {
        let mut depths = vec![Vec::new(); self.photographs.len()];
        for seen in &self.observations {
            let photograph = &self.photographs[seen.photograph];
            let at = photograph.rotation * self.points[seen.point] + photograph.translation;
            depths[seen.photograph].push(at.z);
        }
        depths.into_iter().map(median).collect()
    }

    /// Minimises the loss, then moves the reconstruction so that its camera centres [fit](align) those in `anchor`.
    /// Returns the number of iterations.
    pub(crate) fn adjust(&mut self, anchor: &[DVec3]) -> usize {
        self.observations.sort_by_key(|seen| (seen.point, seen.photograph));
        let seen = |bundle: &Self, seen: &Observation| bundle.residual(seen).is_some();
        let kept = self.observations.iter().copied().filter(|observation| seen(self, observation)).collect();
        let all = std::mem::replace(&mut self.observations, kept);
        let (mut damping, mut cost, mut steps) = (1e-4, self.cost(), 0);
        while steps < MAX_ITERATIONS && damping < MAX_DAMPING {
            steps += 1;
            let stepped = Reduced::of(self, damping).and_then(|reduced| reduced.step());
            let lower = stepped.map(|stepped| (stepped.cost(), stepped)).filter(|(new, _)| *new < cost);
            let Some((new, stepped)) = lower else {
                damping *= 8.0;
                continue;
            };
            let gain = (cost - new) / cost;
            (*self, cost, damping) = (stepped, new, (damping * 0.2).max(1e-12));
            if gain < SMALLEST_GAIN {
                break;
            }
        }
        self.observations = all;
        align(self, anchor);
        steps
    }
}

/// Rotates, scales and shifts the reconstruction so that the camera centres best fit `anchor`, one position per camera.
/// The loss does not change. Moves nothing if all camera centres or all positions of `anchor` coincide.
fn align(bundle: &mut Bundle, anchor: &[DVec3]) {
    let centres: Vec<DVec3> = bundle.photographs.iter().map(Photograph::centre).collect();
    let mean = |places: &[DVec3]| places.iter().sum::<DVec3>() / places.len().max(1) as f64;
    let (from, to) = (mean(&centres), mean(anchor));
    let pairs: Vec<(DVec3, DVec3)> = centres.iter().zip(anchor).map(|(a, b)| (*a - from, *b - to)).collect();
    let mut turn = DQuat::IDENTITY;
    for _ in 0..TURNS {
        let (mut matrix, mut right) = (DMat3::ZERO, DVec3::ZERO);
        for (a, b) in pairs.iter().map(|(a, b)| (turn * *a, *b)) {
            matrix += a.length_squared() * DMat3::IDENTITY - outer(a, a);
            right += a.cross(b);
        }
        let step = matrix.inverse() * right;
        if step.is_finite() {
            turn = (DQuat::from_scaled_axis(step) * turn).normalize();
        }
    }
    let (along, square) =
        pairs.iter().fold((0.0, 0.0), |(s, q), (a, b)| (s + (turn * *a).dot(*b), q + a.length_squared()));
    let scale = along / square;
    if !(scale.is_finite() && scale > 0.0) {
        return;
    }
    let moved = |place: DVec3| to + scale * (turn * (place - from));
    bundle.points.iter_mut().for_each(|point| *point = moved(*point));
    for (photograph, centre) in bundle.photographs.iter_mut().zip(centres) {
        photograph.rotation = (photograph.rotation * turn.inverse()).normalize();
        photograph.translation = -(photograph.rotation * moved(centre));
    }
}

/// Returns the median; for an even number of values, the larger of the two middle ones. NaN without values.
pub(crate) fn median<T: Into<f64>>(values: impl IntoIterator<Item = T>) -> f64 {
    let mut values: Vec<f64> = values.into_iter().map(Into::into).collect();
    let middle = values.len() / 2;
    if values.is_empty() {
        return f64::NAN;
    }
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}
