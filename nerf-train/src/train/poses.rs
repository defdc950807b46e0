//! Poses of the photographs, refined with the field.
//!
//! A camera is rotated and translated by small steps against the gradient of the loss with respect to its rays. The
//! steps are taken in coordinates in which a step of length 1 moves the image by one pixel, root mean square, for any
//! mixture of rotation and translation.
//!
//! # Source
//! Lin et al. 2021 (BARF), poses by the photometric loss, coarse to fine; Park et al. 2023 (CamP), the preconditioner.
//! Deviation: a Cholesky factor in place of the symmetric root; the poses' gradient is blurred, not the field.

use crate::data::cameras::bundle::median;
use crate::data::{Dataset, View};
use crate::model::config::PoseRefinement;
use crate::model::engine::{Batch, RayGradient, RayQuestion};
use crate::train::photographs::SmallAdam;
use glam::{Mat3, Quat, Vec3};
use nerf_core::camera::{Camera, Pose, Ray};
use nerf_core::space::Contraction;
use serde::{Deserialize, Serialize};

/// Number of steps at the start of a run in which poses are refined on trial. Refinement goes on if the image has moved
/// by at least [`CALLED_FOR`].
const TRIAL: u32 = 1_000;
/// Steps between two moves of the cameras.
const EVERY: u32 = 8;
/// Learning rates at the beginning and end of the run, pixels of image motion per move of a camera.
const RATES: [f32; 2] = [0.3, 0.01];
/// Width of the blur of the field's gradient with respect to position, in radii of the uncontracted ball. First number:
/// at the beginning of the run. Second number: from the fraction `SHARP_FROM` of the run on.
const BLURS: [f32; 2] = [0.02, 0.001];
const SHARP_FROM: f64 = 0.5;
/// Least motion of the image in the first [`TRIAL`] steps with which refinement goes on: median over the photographs,
/// in focal lengths. Below it, the given poses are kept. Refining correct poses moves the image by 0.002 to 0.006, and
/// costs 0.1 to 0.4 dB of PSNR; refining poses that are wrong by 0.5 to 1 degree moves it by 0.013.
const CALLED_FOR: f64 = 8e-3;
/// Median reprojection error of the sparse points, pixels, up to which the given poses are trusted and not refined.
const BELIEVED: f64 = 2.0;

/// Length by which [`hold`] divides translations to compare them with rotations, as a fraction of the cameras' mean
/// distance from the scene's centre, which counts as at least 0.1 contraction radii. The fraction was chosen in a
/// simulation with the cameras of the scene fox. Rotations were wrong by half a degree to one degree, translations by 1
/// % of the distance. The common motion that remained after `hold` moved the image by 0.66 pixels for a fraction of
/// 0.5, and by 0.74 pixels for 1. With a fit to rotations only, it moved the image by 0.82 pixels. A length
/// proportional to the cameras' distance from their own centre is unstable if cameras are close together.
const LEVER: f32 = 0.5;

/// Motion of a camera in the axes of the world: rotation vector, radians, then translation, world units.
type Twist = [f32; 6];

/// Corrections of the given poses of a run's photographs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Poses {
    moved: Vec<Twist>,
    /// Corrections of the cameras that cast the next rays, which are cast a step ahead: the last move may be missing.
    cast: Vec<Twist>,
    /// For each camera, the sum of the loss gradients with respect to its pose since the last move.
    sums: Vec<Twist>,
    moment1: Vec<Twist>,
    moment2: Vec<Twist>,
    moves: u32,
    on_trial: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PosesFound {
    /// If `by_tracks`: median reprojection error of the sparse points, pixels. Otherwise: image motion caused by
    /// refining the poses in the first steps, pixels; median over the photographs.
    pub pixels: f64,
    /// Whether `pixels` is the reprojection error of sparse points.
    pub by_tracks: bool,
    pub refined: bool,
}

impl std::fmt::Display for PosesFound {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { pixels, by_tracks, refined } = self;
        match by_tracks {
            true => write!(f, "poses project their own key points within {pixels:.1} pixels (median): ")?,
            false => {
                write!(f, "poses refined in the first steps move pictures by {pixels:.1} pixels (median): ")?
            }
        }
        f.write_str(if *refined { "they are refined" } else { "they stay as they were given" })
    }
}

impl Poses {
    /// Returns the poses to refine, and a finding. The poses are `None` if the given poses are kept. The finding is
    /// that the sparse points confirm the given poses; otherwise `None`. `sights`: whether there are lines of sight.
    pub fn of(dataset: &Dataset, sights: bool, asked: PoseRefinement) -> (Option<Self>, Option<PosesFound>) {
        let begin = |on_trial| Some(Self::given(dataset.train.len(), on_trial));
        if asked == PoseRefinement::Given || dataset.train.len() < 2 {
            return (None, None);
        }
        if asked == PoseRefinement::Refine {
            return (begin(false), None);
        }
        // Without points the median is NaN.
        let pixels = median(dataset.points.iter().map(|point| point.error));
        match sights && pixels <= BELIEVED {
            true => (None, Some(PosesFound { pixels, by_tracks: true, refined: false })),
            false => (begin(true), None),
        }
    }

    /// Creates corrections of 0 for `views` photographs. `on_trial`: whether the first steps decide about refinement.
    pub fn given(views: usize, on_trial: bool) -> Self {
        let zeros = vec![[0.0; 6]; views];
        Self {
            moved: zeros.clone(),
            cast: zeros.clone(),
            sums: zeros.clone(),
            moment1: zeros.clone(),
            moment2: zeros,
            moves: 0,
            on_trial,
        }
    }

    pub fn are_refined(&self) -> bool {
        !self.on_trial
    }

    /// Whether these poses, read from an untrusted checkpoint, fit the photographs `views` and are finite.
    pub fn is_of(&self, views: &[View]) -> bool {
        let all = [&self.moved, &self.cast, &self.sums, &self.moment1, &self.moment2];
        let finite = |twists: &Vec<Twist>| twists.as_flattened().iter().all(|x| x.is_finite());
        all.into_iter().all(|twists| twists.len() == views.len() && finite(twists))
            && self.moment2.as_flattened().iter().all(|&x| x >= 0.0)
    }

    /// Returns the cameras that cast the rays of the next step; `given`: the photographs with their given poses.
    pub fn cast(&self, given: &[View]) -> Vec<Camera> {
        cameras(given, &self.cast)
    }

    pub fn cameras(&self, given: &[View]) -> Vec<Camera> {
        cameras(given, &self.moved)
    }

    /// Makes the next step cast its rays from the present cameras. Returns whether cameras moved since the last call.
    pub fn renew(&mut self) -> bool {
        let moved = self.cast != self.moved;
        self.cast.clone_from(&self.moved);
        moved
    }

    /// Returns a request for the loss gradients with respect to ray origins and directions. `share`: used fraction of
    /// the budget, which sets the blur.
    pub fn question(share: f64, contraction: &Contraction) -> RayQuestion {
        let sharp = (share / SHARP_FROM).min(1.0) as f32;
        let blur = contraction.radius() * BLURS[0].powf(1.0 - sharp) * BLURS[1].powf(sharp);
        RayQuestion { contraction: *contraction, blur }
    }

    /// Adds `gradients`, loss gradients of rays of `batch`, to the sums of the cameras that cast the rays.
    pub fn add<'g>(&mut self, batch: &Batch, gradients: impl Iterator<Item = &'g RayGradient>) {
        for gradient in gradients {
            let ray = gradient.ray as usize;
            let view = batch.views.get(ray).map(|&view| view as usize);
            let Some(sum) = view.and_then(|view| self.sums.get_mut(view)) else { continue };
            let turn = Vec3::from(batch.rays[ray].dir).cross(gradient.by_dir);
            let twist = [turn.to_array(), gradient.by_origin.to_array()];
            sum.iter_mut().zip(twist.as_flattened()).for_each(|(sum, g)| *sum += g);
        }
    }

    /// Moves the cameras after every `EVERY`th step. Returns a finding about the poses after `TRIAL` steps, otherwise
    /// `None`. `step`: counted from 0; `share`: used fraction of the budget.
    pub fn step(
        &mut self,
        given: &[View],
        (step, share): (u32, f64),
        contraction: &Contraction,
    ) -> Option<PosesFound> {
        if (step + 1).is_multiple_of(EVERY) {
            self.move_cameras(given, share, contraction);
            hold(&mut self.moved, given, contraction);
        }
        self.verdict(step, given, contraction)
    }

    /// Decides after step `TRIAL` − 1 (counted from 0) whether to go on refining the poses; `None` after other steps.
    fn verdict(&mut self, step: u32, given: &[View], contraction: &Contraction) -> Option<PosesFound> {
        if step + 1 != TRIAL {
            return None;
        }
        let (pixels, share) = self.median_motion(given, contraction);
        let on_trial = std::mem::take(&mut self.on_trial);
        let refined = !on_trial || share >= CALLED_FOR;
        Some(PosesFound { pixels, by_tracks: false, refined })
    }

    /// Moves each camera by one Adam step in the preconditioned coordinates, whose unit is one pixel of image motion.
    /// `given`: the photographs with their given poses. `share`: used fraction of the budget; sets the learning rate.
    pub fn move_cameras(&mut self, given: &[View], share: f64, contraction: &Contraction) {
        self.moves += 1;
        let rate = RATES[0] * (RATES[1] / RATES[0]).powf(share as f32);
        let adam = SmallAdam::after(self.moves);
        let cameras = self.cameras(given);
        let moments = self.moment1.iter_mut().zip(&mut self.moment2);
        let all = self.moved.iter_mut().zip(&mut self.sums).zip(&cameras);
        for (((moved, sum), camera), (m1, m2)) in all.zip(moments) {
            let gradient = std::mem::take(sum);
            if gradient == [0.0; 6] {
                continue;
            }
            let factor = cholesky(&motion(camera, contraction));
            let gradient = forward(&factor, gradient);
            let step = std::array::from_fn(|i| adam.step(-rate, gradient[i], &mut m1[i], &mut m2[i]));
            let step = backward(&factor, step);
            moved.iter_mut().zip(step).for_each(|(moved, step)| *moved += step);
        }
    }

    /// Returns the image motion from the given to the refined pose, in pixels and in focal lengths: root mean square
    /// over the points of a view, median over the views.
    fn median_motion(&self, given: &[View], contraction: &Contraction) -> (f64, f64) {
        let of = |(view, moved): (&View, &Twist)| {
            let m = motion(&view.camera, contraction);
            let square: f32 =
                (0..6).map(|i| (0..6).map(|j| moved[i] * m[i][j] * moved[j]).sum::<f32>()).sum();
            let pixels = f64::from(square.max(0.0)).sqrt();
            (pixels, pixels / f64::from(view.camera.intrinsics().fx))
        };
        let mut all: Vec<_> = given.iter().zip(&self.moved).map(of).collect();
        all.sort_by(|a, b| a.1.total_cmp(&b.1));
        all.get(all.len() / 2).copied().unwrap_or_default()
    }
}

pub(super) fn given(views: &[View]) -> Vec<Camera> {
    views.iter().map(|view| view.camera).collect()
}

fn cameras(given: &[View], moved: &[Twist]) -> Vec<Camera> {
    let of = |(view, &[x, y, z, tx, ty, tz]): (&View, &Twist)| {
        let pose = view.camera.pose();
        let turn = Mat3::from_quat(Quat::from_scaled_axis(Vec3::new(x, y, z)));
        let position = pose.position + Vec3::new(tx, ty, tz);
        let pose = Pose { rotation: turn * pose.rotation, position };
        view.camera.at(pose).unwrap_or(view.camera)
    };
    given.iter().zip(moved).map(of).collect()
}

/// Returns the matrix `M` for which `vᵀ M v` is the mean square, pixels², of the image motion caused by `v`, a small
/// [`Twist`] of the camera. The mean is over a grid of image points at three depths.
fn motion(camera: &Camera, contraction: &Contraction) -> [[f32; 6]; 6] {
    const SIDE: u8 = 5;
    let i = camera.intrinsics();
    let away = (contraction.centre() - camera.pose().position).length().max(0.1 * contraction.radius());
    let mut sum = [[0.0f32; 6]; 6];
    let at = |k: u8, side: u32| (f32::from(k) + 0.5) / f32::from(SIDE) * side as f32;
    for (x, y) in (0..SIDE).flat_map(|x| (0..SIDE).map(move |y| (x, y))) {
        let Ray { dir, .. } = camera.ray(at(x, i.width), at(y, i.height));
        let cosine = dir.dot(camera.pose().forward()).max(0.1);
        for distance in [0.5 * away, away, 2.0 * away] {
            // Two unit vectors perpendicular to the ray and to each other.
            for across in [dir.any_orthonormal_vector(), dir.cross(dir.any_orthonormal_vector())] {
                // Uses across · (turn × dir) = turn · (dir × across).
                let (turn, shift) = (dir.cross(across) * i.fx / cosine, across * i.fx / cosine / distance);
                let row = [turn.to_array(), shift.to_array()];
                let row = row.as_flattened();
                for (sum, &a) in sum.iter_mut().zip(row) {
                    sum.iter_mut().zip(row).for_each(|(sum, &b)| *sum += a * b);
                }
            }
        }
    }
    let count = 3.0 * f32::from(SIDE).powi(2);
    sum.map(|row| row.map(|x| x / count))
}

/// Returns the lower triangular matrix `L` with `L Lᵀ = m`, after a small multiple of the diagonal is added to `m`.
fn cholesky(m: &[[f32; 6]; 6]) -> [[f64; 6]; 6] {
    let mut l = [[0.0f64; 6]; 6];
    for i in 0..6 {
        for j in 0..=i {
            let sum: f64 = (0..j).map(|k| l[i][k] * l[j][k]).sum();
            l[i][j] = if i == j {
                (f64::from(m[i][i]) * 1.001 - sum).max(1e-12 * f64::from(m[i][i])).sqrt()
            } else {
                (f64::from(m[i][j]) - sum) / l[j][j]
            };
        }
    }
    l
}

/// Returns `L⁻¹ x` for the lower triangular matrix `L`, given as `l`, by forward substitution.
fn forward(l: &[[f64; 6]; 6], x: Twist) -> Twist {
    let mut y = x.map(f64::from);
    for i in 0..6 {
        let sum: f64 = (0..i).map(|k| l[i][k] * y[k]).sum();
        y[i] = (y[i] - sum) / l[i][i];
    }
    y.map(|y| y as f32)
}

/// Returns `L⁻ᵀ x` for the lower triangular matrix `L`, given as `l`, by back substitution.
fn backward(l: &[[f64; 6]; 6], x: Twist) -> Twist {
    let mut y = x.map(f64::from);
    for i in (0..6).rev() {
        let sum: f64 = (i + 1..6).map(|k| l[k][i] * y[k]).sum();
        y[i] = (y[i] - sum) / l[i][i];
    }
    y.map(|y| y as f32)
}

/// Removes the motion common to all cameras, which photographs cannot determine: rotation about the cameras' centre,
/// translation, and scaling. The common rotation is a least-squares fit to rotations and translations; see [`LEVER`].
fn hold(moved: &mut [Twist], given: &[View], contraction: &Contraction) {
    let count = moved.len().max(1) as f32;
    let places = || given.iter().map(|view| view.camera.pose().position);
    let middle = places().sum::<Vec3>() / count;
    let away = places().map(|place| place.distance(contraction.centre())).sum::<f32>() / count;
    let lever = LEVER * away.max(0.1 * contraction.radius());
    let part = |twist: &Twist, from: usize| Vec3::from_slice(&twist[from..]);
    let (mut turn, mut shift) = (Vec3::ZERO, Vec3::ZERO);
    let (mut along, mut square, mut arms) = (0.0, 0.0, Mat3::ZERO);
    for (twist, place) in moved.iter().zip(places()) {
        let (arm, translation) = (place - middle, part(twist, 3));
        turn += part(twist, 0) + arm.cross(translation) / lever.powi(2);
        shift += translation / count;
        along += arm.dot(translation);
        square += arm.length_squared();
        arms += Mat3::from_cols(arm.x * arm, arm.y * arm, arm.z * arm);
    }
    let growth = if square > 0.0 { along / square } else { 0.0 };
    // A camera's translation determines no rotation about its arm, the vector from the cameras' centre to the camera.
    let known = (Mat3::from_diagonal(Vec3::splat(square)) - arms) * (1.0 / lever.powi(2));
    turn = (Mat3::from_diagonal(Vec3::splat(count)) + known).inverse() * turn;
    for (twist, place) in moved.iter_mut().zip(places()) {
        let arm = place - middle;
        let rest = [part(twist, 0) - turn, part(twist, 3) - shift - turn.cross(arm) - growth * arm];
        twist.copy_from_slice(rest.map(|v| v.to_array()).as_flattened());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::demo;

    fn views() -> (Vec<View>, Contraction) {
        let cube = Contraction::cube(Vec3::ZERO, 1.0);
        (demo::small(9, 1, 40).train, Contraction::new(&cube, 1).expect("a cube"))
    }

    fn noise(i: usize) -> f32 {
        (i as f32 * 12.9898).sin() * 43_758.547 % 1.0 * 0.5
    }

    #[test]
    fn a_step_of_length_one_moves_the_image_by_a_pixel() {
        let (views, contraction) = views();
        for (n, view) in views.iter().enumerate() {
            let factor = cholesky(&motion(&view.camera, &contraction));
            let mut step: Twist = std::array::from_fn(|i| noise(7 * n + i));
            let length = step.iter().map(|x| x * x).sum::<f32>().sqrt();
            step = step.map(|x| x / length);
            let moved = cameras(std::slice::from_ref(view), &[backward(&factor, step)])[0];
            let away = view.camera.pose().position.length();
            let (mut square, mut count) = (0.0, 0.0);
            for pixel in 0..64 {
                let ray = view.camera.ray((pixel % 8 * 5) as f32 + 2.5, (pixel / 8 * 5) as f32 + 2.5);
                for distance in [0.5 * away, away, 2.0 * away] {
                    let project =
                        |camera: &Camera| camera.project(ray.at(distance)).expect("in front of the camera");
                    let (a, b) = (project(&view.camera), project(&moved));
                    square += (a.0 - b.0).powi(2) + (a.1 - b.1).powi(2);
                    count += 1.0;
                }
            }
            let pixels = (square / count).sqrt();
            assert!((pixels - 1.0).abs() < 0.15, "view {n}: {pixels} pixels");
        }
    }

    #[test]
    fn the_trial_ends_with_its_verdict() {
        let (views, contraction) = views();
        // A rotation by 0.01 radians moves the image by about 0.01 focal lengths.
        for (turn, refined) in [(0.0, false), (0.002, false), (0.02, true)] {
            let mut poses = Poses::given(views.len(), true);
            poses.moved.iter_mut().for_each(|moved| moved[0] = turn);
            assert!(poses.verdict(TRIAL - 2, &views, &contraction).is_none() && !poses.are_refined());
            let found = poses.verdict(TRIAL - 1, &views, &contraction);
            assert_eq!(found.map(|found| found.refined), Some(refined), "{found:?}");
            assert!(poses.are_refined());
        }
    }

    #[test]
    fn what_all_cameras_do_together_is_taken_out() {
        let (views, contraction) = views();
        let (turn, shift, growth) = (Vec3::new(0.01, -0.02, 0.03), Vec3::new(0.1, 0.2, -0.3), 0.02);
        let together = |view: &View| {
            let place = view.camera.pose().position;
            [turn, turn.cross(place) + shift + growth * place]
        };
        let mut moved: Vec<Twist> =
            views.iter().map(|view| std::array::from_fn(|i| together(view)[i / 3][i % 3])).collect();
        hold(&mut moved, &views, &contraction);
        assert!(moved.as_flattened().iter().all(|x| x.abs() < 1e-6), "{moved:?}");
    }

    #[test]
    fn errors_of_rotations_and_of_places_cancel_each_other() {
        let (views, contraction) = views();
        let mut moved: Vec<Twist> =
            (0..views.len()).map(|n| std::array::from_fn(|i| 0.01 * noise(7 * n + i))).collect();
        hold(&mut moved, &views, &contraction);
        let mut again = moved.clone();
        hold(&mut again, &views, &contraction);
        let mut pairs = moved.as_flattened().iter().zip(again.as_flattened());
        assert!(pairs.all(|(a, b)| (a - b).abs() < 1e-6), "{moved:?} {again:?}");
        // The rotation that was removed is the best fit: an additional common rotation leaves larger errors.
        let places: Vec<Vec3> = views.iter().map(|view| view.camera.pose().position).collect();
        let (count, centre) = (places.len() as f32, contraction.centre());
        let middle = places.iter().sum::<Vec3>() / count;
        let lever = LEVER * places.iter().map(|place| place.distance(centre)).sum::<f32>() / count;
        let left = |turn: Vec3| -> f32 {
            let of = |(twist, place): (&Twist, &Vec3)| {
                let [x, y, z, tx, ty, tz] = *twist;
                let translation = (Vec3::new(tx, ty, tz) - turn.cross(*place - middle)) / lever;
                (Vec3::new(x, y, z) - turn).length_squared() + translation.length_squared()
            };
            moved.iter().zip(&places).map(of).sum()
        };
        for axis in [Vec3::X, Vec3::Y, Vec3::Z] {
            assert!(left(1e-4 * axis).min(left(-1e-4 * axis)) > left(Vec3::ZERO), "{axis}");
        }
    }
}
