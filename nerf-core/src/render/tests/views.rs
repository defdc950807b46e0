//! Tests of a scene seen from any position: samples cover the part of a ray inside the box, whatever the camera's
//! distance.

extern crate std;

use super::{constant, kernels};
use crate::blob::{Body, Content, SceneFacts, SceneSampling, StoredOccupancy};
use crate::camera::{Camera, Intrinsics, Lens, Pose, Ray};
use crate::plan::{Batch, Effects, Outputs, Plan, PlanError, Quality};
use crate::render::{Rect, Renderer};
use crate::testing::{SCENE, Worse, architecture, body, bytes, halve, pi};
use crate::volume::{OPACITY_EPSILON, Pixel};
use crate::{Blob, Kernel, Line};
use glam::Vec3;
use std::vec;
use std::vec::Vec;

const SIDE: u32 = 24;
const SIGMA: f64 = 0.75;
const STEP: f32 = 0.11;
/// Distance of the training cameras from the scene's middle: half way between near and far.
const TRAINED: f32 = 4.0;
const WAYS: [SceneSampling; 2] = [SceneSampling::March(STEP), SceneSampling::Bins(32)];

/// Blob of a fog that fills the box. `ball`: only the cells of a ball are occupied, in a grid of 8³ cells.
fn scene(sampling: SceneSampling, ball: bool) -> Vec<u8> {
    let a = architecture(pi(3, 4), None, &[(4, false)], &[]);
    let (weights, _) = halve(&constant(&a, SIGMA as f32, [0.0, 2.0, -1.0]));
    let mut bits = [0u8; 64];
    for cell in (0..512).filter(|&cell| in_ball(cell)) {
        bits[cell / 8] |= 1 << (cell % 8);
    }
    let facts = SceneFacts { sampling, occupancy_required: ball, ..SCENE };
    let occupancy = ball.then_some(StoredOccupancy { resolution: [8; 3], bits: &bits });
    bytes(&Body { content: Content::Scene(facts), ..body(a, occupancy, &weights) })
}

fn in_ball(cell: usize) -> bool {
    let side = |index: usize| (index as f64 + 0.5) / 4.0 - 1.0;
    side(cell / 64).powi(2) + side(cell / 8 % 8).powi(2) + side(cell % 8).powi(2) < 0.7
}

/// Camera that looks at the scene's middle from direction `towards`. Its distance from the middle is `times` times
/// [`TRAINED`]. The scene fills its image.
fn from(times: f32, towards: Vec3) -> Camera {
    let distance = times * TRAINED;
    let eye = towards.normalize() * distance;
    let pose = Pose::look_at(eye, Vec3::new(0.03, -0.02, 0.01), Vec3::Y).unwrap();
    let focal = SIDE as f32 * (distance / 3.0).max(0.4);
    Camera::new(Intrinsics::centred(SIDE, SIDE, focal), Lens::NONE, pose).unwrap()
}

fn rays(camera: &Camera) -> impl Iterator<Item = Ray> {
    (0..SIDE * SIDE).map(|i| camera.ray((i % SIDE) as f32 + 0.5, (i / SIDE) as f32 + 0.5))
}

/// Distances at which the ray enters and leaves the box `[-1, 1]³`, in f64; `None` if the ray misses the box.
fn chord(ray: &Ray) -> Option<(f64, f64)> {
    let (mut enter, mut exit) = (0.0f64, f64::INFINITY);
    for axis in 0..3 {
        let (o, d) = (f64::from(ray.origin[axis]), f64::from(ray.dir[axis]));
        if d == 0.0 {
            if o.abs() > 1.0 {
                return None;
            }
            continue;
        }
        let (a, b) = ((-1.0 - o) / d, (1.0 - o) / d);
        (enter, exit) = (enter.max(a.min(b)), exit.min(a.max(b)));
    }
    (enter < exit).then_some((enter, exit))
}

/// Length of the ray inside the ball's cells, estimated from 4,000 points. `enter`, `exit`: distances at which the ray
/// enters and leaves the box.
fn way_in_ball(ray: &Ray, (enter, exit): (f64, f64)) -> f64 {
    let points = 4000;
    let width = (exit - enter) / f64::from(points);
    let cell = |t: f64| -> usize {
        let side = |axis: usize| {
            let x = f64::from(ray.origin[axis]) + t * f64::from(ray.dir[axis]);
            (((x + 1.0) * 4.0) as usize).min(7)
        };
        (side(0) * 8 + side(1)) * 8 + side(2)
    };
    (0..points).filter(|&i| in_ball(cell(enter + (f64::from(i) + 0.5) * width))).count() as f64 * width
}

fn pixels(
    bytes: &[u8],
    kernel: Kernel,
    camera: &Camera,
    change: impl Fn(Plan<'_>) -> Plan<'_>,
) -> Vec<Pixel> {
    let blob = Blob::open(bytes).unwrap();
    let quality = Quality { occupancy: true, ..Quality::EXACT };
    let plan = change(Plan::new(&blob, &quality, outputs(), Batch::FULL).unwrap());
    let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, kernel)];
    let renderer = Renderer::new(blob.clone(), kernel, &mut memory).unwrap();
    super::render(&renderer, &plan, camera).pixels
}

fn outputs() -> Outputs {
    Outputs { median_distance: cfg!(feature = "median"), ..Outputs::ALL }
}

/// Composited mean distance of a ray in a fog of density [`SIGMA`] that fills the distances from 0 to `length`, in
/// closed form.
fn mean_in_fog(length: f64) -> f64 {
    let left = (-SIGMA * length).exp();
    (1.0 / SIGMA) - length * left / (1.0 - left)
}

const SIDES: [Vec3; 4] =
    [Vec3::new(0.3, 0.5, 0.8), Vec3::new(-0.2, -0.4, -0.9), Vec3::Z, Vec3::new(0.0, -0.01, -1.0)];

#[test]
fn a_fog_is_as_dense_from_anywhere() {
    for sampling in WAYS {
        let bytes = scene(sampling, false);
        let delta = f64::from(SceneFacts { sampling, ..SCENE }.step());
        // A march ends at the faces of the box. Bins may end up to half a bin in front of a face or behind it.
        let march = matches!(sampling, SceneSampling::March(_));
        let ends = if march { 0.0 } else { delta };
        for times in [0.01, 0.1, 0.3, 0.6, 1.0, 1.5, 4.0, 100.0] {
            for towards in SIDES {
                let camera = from(times, towards);
                // Bound on the rounding of the camera's position in f32.
                let off = 4.0 * f64::from(times * TRAINED * f32::EPSILON) + 2e-6;
                let found = pixels(&bytes, Kernel::IN_PLACE, &camera, |plan| plan);
                let mut hits = 0;
                for (pixel, ray) in found.iter().zip(rays(&camera)) {
                    let Some((enter, exit)) = chord(&ray).filter(|(a, b)| b - a > 10.0 * off + ends) else {
                        continue;
                    };
                    hits += 1;
                    let way = exit - enter;
                    let thickness = -f64::from(1.0 - pixel.opacity).ln();
                    let error = (thickness - SIGMA * way).abs();
                    assert!(
                        error <= SIGMA * (ends + 30.0 * off) * 1.001 + 1e-5,
                        "{sampling:?} from {times}: {way}, {thickness} off {error}"
                    );
                    // Tolerance: bins replace the integral by samples in their middles, and need not end at the faces.
                    let mean = enter + mean_in_fog(way);
                    let error = (f64::from(pixel.ray_distance) - mean).abs();
                    let expected = ends + delta * delta / 4.0 + 40.0 * off;
                    assert!(error <= expected, "{sampling:?} from {times}: {way}, distance off {error}");
                    if cfg!(feature = "median") && SIGMA * (way - ends) > 0.7 {
                        let median = enter + core::f64::consts::LN_2 / SIGMA;
                        let error = (f64::from(pixel.median_distance) - median).abs();
                        assert!(error <= ends + 40.0 * off, "{sampling:?} from {times}: median off {error}");
                    }
                }
                assert!(hits > 100, "{sampling:?} from {times}: {hits} rays");
            }
        }
    }
}

#[test]
fn a_ball_is_lost_from_nowhere() {
    for sampling in WAYS {
        let bytes = scene(sampling, true);
        let delta = f64::from(SceneFacts { sampling, ..SCENE }.step());
        for times in [0.3, 0.6, 1.0, 1.5, 4.0, 100.0] {
            for towards in SIDES {
                let camera = from(times, towards);
                let found = pixels(&bytes, Kernel::detect(), &camera, |plan| plan);
                let (mut lost, mut seen) = (0, 0);
                for (pixel, ray) in found.iter().zip(rays(&camera)) {
                    let way = chord(&ray).map_or(0.0, |chord| way_in_ball(&ray, chord));
                    let thickness = -f64::from(1.0 - pixel.opacity).ln();
                    assert!((thickness - SIGMA * way).abs() <= SIGMA * 3.0 * delta, "{way}: {thickness}");
                    seen += u32::from(way > 0.3);
                    lost += u32::from(way > 0.3 && pixel.opacity <= OPACITY_EPSILON);
                }
                assert!(lost == 0 && seen > 60, "{sampling:?} from {times}: {lost} of {seen} lost");
            }
        }
    }
}

/// The scene is still visible from 10^6 units away, where rounding in f32 moves rays by 0.06 units.
#[test]
fn a_million_units_away_it_is_still_there() {
    for sampling in WAYS {
        for ball in [false, true] {
            let bytes = scene(sampling, ball);
            for towards in SIDES {
                let camera = from(2.5e5, towards);
                let found = pixels(&bytes, Kernel::detect(), &camera, |plan| plan);
                let far = f64::from(camera.pose().position.length());
                let (mut seen, mut lost) = (0, 0);
                for (pixel, ray) in found.iter().zip(rays(&camera)) {
                    let Some(chord) = chord(&ray) else { continue };
                    let way = if ball { way_in_ball(&ray, chord) } else { chord.1 - chord.0 };
                    if way > 0.8 {
                        seen += 1;
                        lost += u32::from(pixel.opacity <= OPACITY_EPSILON);
                        assert!((f64::from(pixel.ray_distance) - far).abs() < 2.5, "{}", pixel.ray_distance);
                    }
                }
                assert!(lost == 0 && seen > 60, "{sampling:?}, ball {ball}: {lost} of {seen} lost");
            }
        }
    }
}

#[test]
fn away_from_the_scene_nothing_is_seen_and_far_is_one_finite_number() {
    for sampling in WAYS {
        let bytes = scene(sampling, false);
        for times in [0.6, 4.0, 2.5e5] {
            let eye = Vec3::new(0.0, 0.0, times * TRAINED);
            let pose = Pose::look_at(eye, 2.0 * eye, Vec3::Y).unwrap();
            let camera = Camera::new(Intrinsics::centred(SIDE, SIDE, 20.0), Lens::NONE, pose).unwrap();
            let found = pixels(&bytes, Kernel::IN_PLACE, &camera, |plan| plan);
            let far = found[0].ray_distance;
            assert!(far.is_finite() && far >= times * TRAINED, "{far}");
            assert!(found.iter().all(|p| p.opacity == 0.0 && p.rgb == SCENE.background));
            assert!(found.iter().all(|p| [p.ray_distance, p.z_depth] == [far; 2]));
        }
    }
}

#[test]
fn a_range_cuts_bins_and_never_drops_them() {
    let camera = from(0.9, SIDES[0]);
    let rays: Vec<Ray> = rays(&camera).collect();
    for sampling in WAYS {
        let march = matches!(sampling, SceneSampling::March(_));
        let delta = SceneFacts { sampling, ..SCENE }.step();
        for own in [false, true] {
            let bytes = scene(sampling, false);
            let of = |t_min: f32, t_max: f32| {
                pixels(&bytes, Kernel::IN_PLACE, &camera, |plan| {
                    let plan = if own { plan.with_own_bins() } else { plan };
                    plan.with_range(t_min, t_max).unwrap()
                })
            };
            let whole = of(0.0, f32::INFINITY);
            assert_eq!(whole, of(0.0, f32::MAX));
            let part = delta / 7.0;
            let mut before: Option<Vec<Pixel>> = None;
            for i in 0..70u8 {
                let t_max = 2.9 + f32::from(i) * part;
                let found = of(0.0, t_max);
                for ((pixel, ray), i) in found.iter().zip(&rays).zip(0..) {
                    assert!(pixel.ray_distance <= t_max && pixel.z_depth <= t_max);
                    if let Some(before) = &before {
                        let grown = pixel.opacity - before[i].opacity;
                        assert!((-1e-6..=SIGMA as f32 * part * 1.01 + 1e-6).contains(&grown), "{grown}");
                    }
                    if march && let Some((enter, exit)) = chord(ray) {
                        let way = (exit.min(f64::from(t_max)) - enter).max(0.0);
                        let opacity = -(-SIGMA * way).exp_m1();
                        assert!((f64::from(pixel.opacity) - opacity).abs() < 1e-5, "{way}: {pixel:?}");
                    }
                }
                before = Some(found);
            }
            // The transmittances in front of and behind a distance multiply to that of the whole ray.
            for at in [3.0, 3.4567, 4.1] {
                let (front, back) = (of(0.0, at), of(at, f32::MAX));
                let mut worst: f32 = 0.0;
                for ((front, back), whole) in front.iter().zip(&back).zip(&whole) {
                    let through = (1.0 - front.opacity) * (1.0 - back.opacity);
                    worst = worst.worse(f32::abs(through - (1.0 - whole.opacity)));
                    assert!(back.opacity <= OPACITY_EPSILON || back.ray_distance >= at);
                }
                assert!(worst < 1e-5, "{sampling:?} at {at}: {worst}");
            }
            let none = of(9.0, 9.0);
            assert!(none.iter().all(|p| p.opacity == 0.0 && p.ray_distance == of_far(&none)));
        }
    }
    let bytes = scene(WAYS[0], false);
    let blob = Blob::open(&bytes).unwrap();
    let plan = Plan::new(&blob, &Quality::EXACT, Outputs::ALL, Batch::SMALLEST).unwrap();
    for (t_min, t_max) in
        [(-1.0, 2.0), (2.0, 1.0), (f32::NAN, 1.0), (0.0, f32::NAN), (f32::INFINITY, f32::INFINITY)]
    {
        assert!(matches!(plan.with_range(t_min, t_max), Err(PlanError::Range { .. })), "{t_min}..{t_max}");
    }
}

fn of_far(pixels: &[Pixel]) -> f32 {
    pixels[0].ray_distance
}

#[test]
fn rays_along_and_in_faces_are_marched() {
    // Rays along z through the middle, in a face and in an edge of the box, from outside and from inside.
    let bytes = scene(WAYS[0], false);
    for (x, y) in [(0.0, 0.0), (1.0, 0.0), (-1.0, 0.5), (1.0, 1.0)] {
        for z in [-3.0f32, -0.5] {
            let pose = Pose::from_rows([[-1.0, 0.0, 0.0, x], [0.0, 1.0, 0.0, y], [0.0, 0.0, -1.0, z]]);
            let camera = Camera::new(Intrinsics::centred(1, 1, 1.0), Lens::NONE, pose).unwrap();
            assert_eq!(camera.ray(0.5, 0.5).dir, Vec3::Z);
            let pixel = pixels(&bytes, Kernel::IN_PLACE, &camera, |plan| plan)[0];
            let way = 1.0 - f64::from(z.max(-1.0));
            let opacity = -(-SIGMA * way).exp_m1();
            assert!((f64::from(pixel.opacity) - opacity).abs() < 1e-5, "{x}, {y}, {z}: {pixel:?}");
        }
    }
}

#[test]
fn what_training_cameras_saw_is_the_same_with_the_scene_s_own_bins() {
    let camera = super::camera(SIDE, SIDE);
    for kernel in kernels() {
        let bytes = scene(SceneSampling::Bins(32), true);
        let own = pixels(&bytes, kernel, &camera, |plan| plan.with_own_bins());
        assert_eq!(own, pixels(&bytes, kernel, &camera, |plan| plan));
        // The scene's own bins begin at `near`. From this camera, the ball is in front of `near`.
        let close = from(0.3, Vec3::Z);
        assert!(pixels(&bytes, kernel, &close, |plan| plan.with_own_bins()).iter().all(|p| p.opacity == 0.0));
        assert!(pixels(&bytes, kernel, &close, |plan| plan).iter().any(|p| p.opacity > 0.5));
    }
}

#[test]
fn as_many_samples_as_the_scene_has_are_its_own_step() {
    let own = SceneFacts { sampling: WAYS[0], ..SCENE };
    assert_eq!((own.samples(), own.step()), (32, STEP), "√12 / 0.11 = 31.5");
    let bytes = scene(WAYS[0], false);
    let blob = Blob::open(&bytes).unwrap();
    let plan = |samples| {
        let quality = Quality { samples, ..Quality::EXACT };
        Plan::new(&blob, &quality, Outputs::ALL, Batch::SMALLEST).unwrap().bins.delta()
    };
    assert_eq!((plan(0), plan(32)), (STEP, STEP));
    assert!((plan(64) - 12f32.sqrt() / 64.0).abs() < 1e-7);
}

#[test]
fn tiles_and_batches_change_no_bit_of_any_view() {
    for sampling in WAYS {
        let bytes = scene(sampling, true);
        let blob = Blob::open(&bytes).unwrap();
        let quality = Quality { transmittance_cut: 0.2, ..Quality::default() };
        for (times, range) in [(0.1, (0.1, 1.3)), (1.5, (0.0, f32::MAX)), (4.0, (15.0, 16.2))] {
            let camera = from(times, SIDES[1]);
            let plan = |rays| {
                let batch = Batch { rays, samples: 64 };
                let plan = Plan::new(&blob, &quality, outputs(), batch).unwrap();
                #[cfg(feature = "jitter")]
                let effects = Effects { jitter: Some(crate::plan::Jitter { seed: 5 }), ..Effects::NONE };
                #[cfg(not(feature = "jitter"))]
                let effects = Effects::NONE;
                plan.with_range(range.0, range.1).unwrap().with_effects(effects).unwrap()
            };
            let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, Kernel::detect())];
            let renderer = Renderer::new(blob.clone(), Kernel::detect(), &mut memory).unwrap();
            let whole = super::render(&renderer, &plan(256), &camera);
            assert!(whole.pixels.iter().any(|p| p.opacity > 0.1));
            assert_eq!(whole.pixels, super::render(&renderer, &plan(7), &camera).pixels);
            let mut parts = vec![Pixel::BLANK; whole.pixels.len()];
            let plan = plan(31);
            let mut workspace = vec![Line::UNINIT; renderer.workspace_lines(&plan)];
            for rect in
                [Rect { x: 0, y: 0, width: 11, height: SIDE }, Rect { x: 11, y: 0, width: 13, height: SIDE }]
            {
                let mut put = |x: u32, y: u32, p: &Pixel| parts[(y * SIDE + x) as usize] = *p;
                renderer.render(&plan, &camera, rect, &mut workspace, &mut put).unwrap();
            }
            assert_eq!(whole.pixels, parts);
        }
    }
}
