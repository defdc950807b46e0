//! Errors of cameras and lenses against the oracle.

use crate::geometry::somewhere;
use crate::table::{Row, Worst, cases};
use glam::{Mat3, Vec3};
use nerf_core::camera::{Camera, CameraError, Intrinsics, Lens, Pose, Ray};
use nerf_testing::error::worst_of;
use nerf_testing::noise::signed_f64;
use nerf_testing::oracle::lens;

cases! {
    rays_are_of_unit_length: "error of the length over images from 1x1 to 65535x65535" => unit_rays;
    rays_point_where_the_pinhole_says: "angle to the oracle's direction, radians" => pinhole;
    poses_are_rotations: "share of 40,000 scaled, sheared, reflected, singular and odd poses decided otherwise" => poses;
    lenses_are_undone: "error of distort(undistort(p)), relative outside of the unit circle" => lenses;
    extreme_lenses_are_undone_or_refused: "error of distort(ray of a pixel), as above, over 3,000 lenses" => extreme;
    no_two_pixels_look_the_same_way: "share of the pixels of the same lenses behind a fold" => folds;
    sound_lenses_are_taken: "share of 2,000 radial lenses refused that only bend on the way to the corner" => sound;
}

/// Returns cameras with images of every shape and with random poses.
fn cameras(state: &mut u64) -> Vec<Camera> {
    let shapes = [(1, 1), (1, 65_535), (65_535, 1), (640, 480), (65_535, 65_535), (3, 2)];
    let camera = |(i, (width, height)): (usize, (u32, u32))| {
        let size = f64::from(width.max(height));
        let focal = (size * [0.05, 0.5, 1.0, 20.0][i % 4]) as f32;
        let pose = Pose::look_at(10.0 * somewhere(state), somewhere(state), Vec3::Y).expect("a pose");
        Camera::new(Intrinsics::centred(width, height, focal), Lens::NONE, pose).expect("a camera")
    };
    shapes.into_iter().cycle().take(48).enumerate().map(camera).collect()
}

fn each_ray(mut see: impl FnMut(&Camera, f32, f32, Ray)) {
    let mut state = 11;
    for camera in cameras(&mut state) {
        let i = *camera.intrinsics();
        for _ in 0..500 {
            let (u, v) = (0.5 + 0.5 * signed_f64(&mut state), 0.5 + 0.5 * signed_f64(&mut state));
            let (x, y) = ((u * f64::from(i.width)) as f32, (v * f64::from(i.height)) as f32);
            see(&camera, x, y, camera.ray(x, y));
        }
        for (x, y) in [(0.0, 0.0), (i.width as f32, 0.0), (i.width as f32, i.height as f32)] {
            see(&camera, x, y, camera.ray(x, y));
        }
    }
}

fn unit_rays() -> Vec<Row> {
    let mut worst = Worst::default();
    each_ray(|camera, x, y, ray| {
        let length = ray.dir.to_array().map(f64::from).iter().map(|d| d * d).sum::<f64>().sqrt();
        worst.see((1.0 - length).abs(), || {
            format!("({x}, {y}) of {}x{}", camera.intrinsics().width, camera.intrinsics().height)
        });
    });
    vec![worst.row("any", "any", 2e-7)]
}

fn pinhole() -> Vec<Row> {
    let mut worst = Worst::default();
    each_ray(|camera, x, y, ray| {
        let (i, rows) = (camera.intrinsics(), camera.pose().to_rows());
        let local = [
            (f64::from(x) - f64::from(i.cx)) / f64::from(i.fx),
            -(f64::from(y) - f64::from(i.cy)) / f64::from(i.fy),
            -1.0,
        ];
        let world = [0, 1, 2].map(|r| (0..3).map(|c| f64::from(rows[r][c]) * local[c]).sum::<f64>());
        let length = world.iter().map(|d| d * d).sum::<f64>().sqrt();
        let off: f64 = (0..3).map(|k| (world[k] / length - f64::from(ray.dir[k])).powi(2)).sum();
        worst.see(off.sqrt(), || format!("({x}, {y}) of {}x{}", i.width, i.height));
    });
    vec![worst.row("any", "any", 5e-7)]
}

fn lenses() -> Vec<Row> {
    let mut worst = Worst::default();
    let mut state = 13;
    let lenses = [
        Lens { k1: 0.1, k2: 0.02, p1: 0.0, p2: 0.0, ..Lens::NONE },
        Lens { k1: -0.2, k2: 0.05, p1: 0.001, p2: -0.002, ..Lens::NONE },
        Lens { k1: 0.5, k2: 0.5, p1: 0.01, p2: 0.01, ..Lens::NONE },
    ];
    for lens in lenses {
        for _ in 0..5_000 {
            let (x, y) = (0.8 * signed_f64(&mut state), 0.8 * signed_f64(&mut state));
            // None of them folds within what is asked for: each point has an answer.
            let (u, v) = lens.undistort(x as f32, y as f32).unwrap_or((f32::NAN, f32::NAN));
            let (found, _) = lens::distort(coefficients(&lens), f64::from(u), f64::from(v));
            let (x, y) = (f64::from(x as f32), f64::from(y as f32));
            let off = (found[0] - x).hypot(found[1] - y) / x.hypot(y).max(1.0);
            worst.see(off, || format!("({x:.4}, {y:.4}) of {lens:?}"));
        }
    }
    // The residual Newton's method stops at, and the rounding of checking it.
    vec![worst.row("any", "any", 1.5e-6)]
}

/// Compares which poses are accepted with a decision in f64, for poses close to and far from rotations.
fn poses() -> Vec<Row> {
    let (mut wrong, mut accepted, mut at) = (0, 0, String::new());
    let mut state = 19;
    let total = 40_000;
    for i in 0..total {
        let straight = Pose::look_at(somewhere(&mut state), 3.0 * somewhere(&mut state), Vec3::Y);
        let straight = straight.expect("a pose").rotation;
        // From rounding to far beyond what is allowed.
        let size = 10f64.powf(-3.0 + 4.0 * signed_f64(&mut state)) as f32;
        let other = Mat3::from_cols(somewhere(&mut state), somewhere(&mut state), somewhere(&mut state));
        let odd = [0.0, -0.0, 1e-45, 1e30, f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX];
        let mut rotation = match i % 5 {
            0 => straight * (1.0 + size),
            1 => straight * (Mat3::IDENTITY + other * size),
            2 => straight * Mat3::from_diagonal(Vec3::new(1.0, -1.0, 1.0 + size)),
            3 => straight * Mat3::from_diagonal(Vec3::new(1.0, 1.0, size)),
            _ => straight,
        };
        if i % 5 == 4 {
            rotation.as_mut()[i / 5 % 9] = odd[i / 45 % 8];
        }
        let pose = Pose { rotation, position: Vec3::ZERO };
        let found = Camera::new(Intrinsics::centred(4, 4, 4.0), Lens::NONE, pose);
        let (off, determinant) = from_rotation(&rotation);
        accepted += usize::from(found.is_ok());
        let right = match found {
            Ok(_) => off <= 1.001e-3 && determinant > 0.0,
            Err(CameraError::PoseNotRotation { .. }) => off.is_nan() || off >= 0.999e-3 || determinant <= 0.0,
            Err(CameraError::PoseNotFinite) => !rotation.is_finite(),
            Err(_) => false,
        };
        if !right {
            (wrong, at) = (wrong + 1, format!("{rotation:?}"));
        }
    }
    assert!((total / 10..total / 2).contains(&accepted), "{accepted} of {total}");
    vec![Worst { error: f64::from(wrong) / total as f64, at }.row("any", "any", 0.0)]
}

/// Returns the largest entry of |RᵀR − I|, and the determinant of R.
fn from_rotation(rotation: &Mat3) -> (f64, f64) {
    let c = rotation.to_cols_array_2d().map(|column| column.map(f64::from));
    let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let cross = |a: [f64; 3], b: [f64; 3]| {
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    };
    let entries = (0..9).map(|k| (dot(c[k / 3], c[k % 3]) - f64::from(u8::from(k / 3 == k % 3))).abs());
    (worst_of(entries), dot(cross(c[0], c[1]), c[2]))
}

fn coefficients(lens: &Lens) -> [f64; 4] {
    [lens.k1, lens.k2, lens.p1, lens.p2].map(f64::from)
}

/// Calls `see` for random image points of cameras with lenses from none to extreme and images of every shape, if the
/// camera is accepted. `see` receives the camera, the distorted point and the undistorted point.
fn each_lens(mut see: impl FnMut(&Camera, [f64; 2], [f64; 2])) {
    let (mut state, mut accepted) = (23, 0);
    let lenses = 3_000;
    for i in 0..lenses {
        let mut part = |most: f64| {
            (signed_f64(&mut state).signum() * 10f64.powf(most - 1.5 + 1.5 * signed_f64(&mut state))) as f32
        };
        let tangential = if i % 3 == 0 { 0.0 } else { -2.5 };
        let mut lens =
            Lens { k1: part(0.0), k2: part(0.0), p1: part(tangential), p2: part(tangential), ..Lens::NONE };
        // Half of them bend inwards and out again: a fold that ends, mostly well inside the image.
        if i % 2 == 0 {
            lens.k1 = -lens.k1.abs();
            lens.k2 = lens.k1 * lens.k1 * (0.25 + 0.25 * signed_f64(&mut state)) as f32;
        }
        let (width, height) = [(40, 30), (1, 200), (7, 1), (640, 480)][i / 2 % 4];
        let reach = 10f64.powf(0.3 + 1.2 * signed_f64(&mut state)) as f32 / lens.k1.abs().sqrt().max(0.3);
        let mut intrinsics = Intrinsics::centred(width, height, width.max(height) as f32 / reach);
        intrinsics.cx += 0.2 * width as f32 * signed_f64(&mut state) as f32;
        let pose = Pose { rotation: Mat3::IDENTITY, position: Vec3::ZERO };
        let Ok(camera) = Camera::new(intrinsics, lens, pose) else { continue };
        accepted += 1;
        for _ in 0..400 {
            let (x, y) = (0.5 + 0.5 * signed_f64(&mut state), 0.5 + 0.5 * signed_f64(&mut state));
            let (x, y) = ((x * f64::from(width)) as f32, (y * f64::from(height)) as f32);
            let [u, v, w] = camera.ray(x, y).dir.to_array().map(f64::from);
            let wanted = [(x - intrinsics.cx) / intrinsics.fx, (y - intrinsics.cy) / intrinsics.fy];
            see(&camera, wanted.map(f64::from), [u / -w, v / w]);
        }
    }
    assert!((lenses / 10..lenses * 9 / 10).contains(&accepted), "{accepted} of {lenses} lenses");
}

fn extreme() -> Vec<Row> {
    let mut worst = Worst::default();
    each_lens(|camera, wanted, ideal| {
        let (seen, _) = lens::distort(coefficients(camera.lens()), ideal[0], ideal[1]);
        let scale = wanted.iter().chain(&ideal).fold(1.0, |most: f64, x| most.max(x.abs()));
        let off = (seen[0] - wanted[0]).hypot(seen[1] - wanted[1]) / scale;
        worst.see(off, || format!("({:.4}, {:.4}) of {:?}", wanted[0], wanted[1], camera.lens()));
    });
    // The residual Newton's method stops at along each axis, and the rounding of the ray.
    vec![worst.row("any", "any", 2.5e-6)]
}

/// Measures the share of pixels behind a fold: the model turns back on the line from the axis to the pixel's direction,
/// so that some direction is visible twice.
fn folds() -> Vec<Row> {
    let (mut behind, mut all, mut at) = (0, 0, String::new());
    each_lens(|camera, wanted, ideal| {
        all += 1;
        if lens::folds_before(coefficients(camera.lens()), ideal) {
            behind += 1;
            at = format!(
                "({:.4}, {:.4}) of {:?}, {:?}",
                wanted[0],
                wanted[1],
                camera.lens(),
                camera.intrinsics()
            );
        }
    });
    vec![Worst { error: f64::from(behind) / f64::from(all), at }.row("any", "any", 0.0)]
}

/// Measures the share of valid lenses that are refused: without tangential distortion, with a slope above 0.05 up to
/// the corner and up to the corner's distorted radius.
fn sound() -> Vec<Row> {
    let (mut state, mut all, mut refused, mut at) = (29, 0, 0, String::new());
    while all < 2_000 {
        let [k1, k2] = [0; 2].map(|_| (0.6 * signed_f64(&mut state)) as f32);
        let lens = Lens { k1, k2, ..Lens::NONE };
        let corner = 0.2 + 0.8 * (1.0 + signed_f64(&mut state));
        let slope = |r: f64| 1.0 + r * r * (3.0 * f64::from(k1) + 5.0 * f64::from(k2) * r * r);
        let ([seen, _], _) = lens::distort(coefficients(&lens), corner, 0.0);
        if (1..=256).any(|step| slope(f64::from(step) / 256.0 * corner.max(seen)) < 0.05) {
            continue;
        }
        all += 1;
        // Of 8 x 6 pixels; the corner is 5 pixels off the axis.
        let intrinsics = Intrinsics::centred(8, 6, (5.0 / seen) as f32);
        let pose = Pose { rotation: Mat3::IDENTITY, position: Vec3::ZERO };
        if let Err(error) = Camera::new(intrinsics, lens, pose) {
            (refused, at) = (refused + 1, format!("{lens:?}, seen to {seen:.3}: {error}"));
        }
    }
    // Those from whose corner Newton's first step is longer than the way to the axis.
    vec![Worst { error: f64::from(refused) / f64::from(all), at }.row("any", "any", 1e-2)]
}
