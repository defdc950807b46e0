//! Lenses against COLMAP's own projections: results of `pycolmap.Camera.img_from_cam` (4.2.1), rounded to 1e-4 pixels.

use crate::camera::{Camera, Intrinsics, Lens, Pose, Projection};
use glam::{Mat3, Vec3};

/// Test directions in camera coordinates: right, down, forward.
const DIRS: [[f32; 3]; 6] = [
    [0.0, 0.0, 1.0],
    [0.25, -0.125, 1.0],
    [-0.4375, 0.375, 1.0],
    [0.5, 0.625, 1.0],
    [-0.03125, -0.6875, 1.0],
    [1.5, -1.0, 2.0],
];

const FISHEYE: Lens = Lens { projection: Projection::Fisheye, ..Lens::NONE };

/// A test case: name of the COLMAP model, `fx fy cx cy`, lens, and the image points at which [`DIRS`] are seen.
type Case = (&'static str, [f32; 4], Lens, [[f64; 2]; 6]);

const CASES: [Case; 6] = [
    (
        "PINHOLE",
        [1375.5, 1374.25, 554.25, 965.5],
        Lens::NONE,
        [
            [554.25, 965.5],
            [898.125, 793.7188],
            [-47.5312, 1480.8438],
            [1242.0, 1824.4062],
            [511.2656, 20.7031],
            [1585.875, 278.375],
        ],
    ),
    (
        "SIMPLE_RADIAL",
        [1375.5, 1375.5, 554.25, 965.5],
        Lens { k1: -0.0625, ..Lens::NONE },
        [
            [554.25, 965.5],
            [896.4459, 794.402],
            [-35.0431, 1470.6084],
            [1214.4631, 1790.7664],
            [512.5381, 47.8371],
            [1533.4878, 312.6748],
        ],
    ),
    (
        "OPENCV",
        [1375.5, 1374.25, 554.25, 965.5],
        Lens { k1: 0.0578125, k2: -0.0804688, p1: -0.00098, p2: 0.00015625, ..Lens::NONE },
        [
            [554.25, 965.5],
            [899.6372, 792.8665],
            [-53.1483, 1485.2679],
            [1244.1617, 1826.0712],
            [510.9089, 9.9859],
            [1580.9586, 280.6717],
        ],
    ),
    (
        "FULL_OPENCV",
        [900.25, 905.5, 640.5, 480.25],
        Lens {
            k1: 0.25,
            k2: -0.125,
            p1: 0.001,
            p2: -0.0005,
            k3: 0.03125,
            k4: 0.1875,
            k5: -0.0625,
            k6: 0.015625,
            ..Lens::NONE
        },
        [
            [640.5, 480.25],
            [866.4153, 366.6867],
            [240.6398, 825.1579],
            [1098.2531, 1056.7209],
            [611.7412, -150.9871],
            [1324.9377, 21.7877],
        ],
    ),
    (
        "OPENCV_FISHEYE",
        [520.25, 522.5, 960.5, 540.25],
        Lens { k1: 0.0625, k2: -0.015625, k3: 0.001953125, k4: -1.0 / 4096.0, ..FISHEYE },
        [
            [960.5, 540.25],
            [1087.9039, 476.2726],
            [750.7176, 720.8411],
            [1185.4397, 822.6407],
            [945.9653, 219.1043],
            [1287.382, 321.3862],
        ],
    ),
    (
        "RADIAL_FISHEYE",
        [520.25, 520.25, 960.5, 540.25],
        Lens { k1: -0.03125, k2: 0.00390625, ..FISHEYE },
        [
            [960.5, 540.25],
            [1087.0342, 476.9829],
            [755.7145, 715.7805],
            [1176.9212, 810.7765],
            [946.4149, 230.3781],
            [1273.0674, 331.8717],
        ],
    ),
];

/// Makes a camera at the origin whose right, down and forward axes are +x, −y and −z of the world.
fn camera((width, height): (u32, u32), [fx, fy, cx, cy]: [f32; 4], lens: Lens) -> Camera {
    let pose = Pose { rotation: Mat3::IDENTITY, position: Vec3::ZERO };
    Camera::new(Intrinsics { width, height, fx, fy, cx, cy }, lens, pose).expect("a camera")
}

/// Distance, pixels, between the projections of two nearby unit directions, by the small-angle approximation.
fn apart(ray: Vec3, dir: Vec3, focal: f32) -> f32 {
    (ray - dir).length() * focal
}

#[test]
fn projections_are_colmaps_within_a_thousandth_of_a_pixel() {
    let mut worst = 0.0f64;
    for (name, intrinsics, lens, seen) in CASES {
        let camera = camera((1600, 1000), intrinsics, lens);
        for ([x, y, z], [px, py]) in DIRS.into_iter().zip(seen) {
            let (u, v) = camera.project(Vec3::new(x, -y, -z)).expect("in front");
            let off = (f64::from(u) - px).abs().max((f64::from(v) - py).abs());
            assert!(off <= 1e-3, "{name}: ({x}, {y}, {z}) is seen at ({u}, {v}), not at ({px}, {py})");
            worst = worst.max(off);
            let ray = camera.try_ray(px as f32, py as f32).expect("a ray");
            let dir = Vec3::new(x, -y, -z).normalize();
            let off = apart(ray.dir, dir, intrinsics[0]);
            assert!(off <= 1e-3, "{name}: the ray of ({px}, {py}) is {off} pixels off");
        }
    }
    assert!(worst > 1e-6, "compared with itself");
}

#[test]
fn every_pixels_ray_is_seen_at_the_pixel() {
    for (name, intrinsics, lens, _) in CASES {
        let camera = camera((1600, 1000), intrinsics, lens);
        for step in 0..=40u8 {
            for other in 0..=25u8 {
                let (x, y) = (40.0 * f32::from(step), 40.0 * f32::from(other));
                let (u, v) = camera.project(camera.ray(x, y).dir).expect("in front");
                let off = (u - x).abs().max((v - y).abs());
                // Newton's method ends at a residual of 1e-6 focal lengths.
                let limit = 1e-4 + 1.2e-6 * intrinsics[0];
                assert!(off <= limit, "{name}: the ray of ({x}, {y}) is seen at ({u}, {v})");
            }
        }
    }
}

#[test]
fn a_fisheye_sees_behind_itself() {
    // A width of 1116 pixels at 320 pixels per radian is a view of 200 degrees.
    let focal = 320.0;
    let camera = camera((1116, 4), [focal, focal, 558.0, 2.0], FISHEYE);
    for x in [0.0f32, 558.0, 558.0 + focal * 1.570_796_4, 1116.0] {
        let (sin, cos) = ((x - 558.0) / focal).sin_cos();
        let ray = camera.ray(x, 2.0);
        assert!(apart(ray.dir, Vec3::new(sin, 0.0, -cos), focal) < 5e-3, "{x}: {ray:?}");
        assert!((camera.project(ray.dir * 3.0).expect("seen").0 - x).abs() < 1e-3);
    }
    assert_eq!(camera.project(Vec3::ZERO), None);
    // `undistort` finds only directions in front of the camera; `direction` also finds directions behind it.
    assert!(FISHEYE.undistort(1.5, 0.0).is_some() && FISHEYE.undistort(1.6, 0.0).is_none());
    assert!(FISHEYE.direction(1.6, 0.0).is_some_and(|dir| dir.z < 0.0));
    let (u, _) = Lens::NONE.project(Vec3::new(1.0, 0.0, 2.0)).expect("in front");
    assert_eq!((u, Lens::NONE.project(Vec3::new(1.0, 0.0, 0.0))), (0.5, None));
}

#[test]
fn lenses_that_fold_within_the_picture_are_refused() {
    use crate::camera::CameraError;
    let made = |lens, side: u32| {
        let pose = Pose { rotation: Mat3::IDENTITY, position: Vec3::ZERO };
        Camera::new(Intrinsics::centred(side, side, 100.0), lens, pose)
    };
    let refused = |lens, side| matches!(made(lens, side), Err(CameraError::LensNotInvertible { .. }));
    // θ − 0.2 θ³ grows up to 0.86 at θ = 1.29, where the lens folds.
    let fold = Lens { k1: -0.2, ..FISHEYE };
    assert!(made(fold, 120).is_ok() && refused(fold, 124));
    // A fisheye without distortion sees angles up to π, 314 pixels from the centre.
    assert!(made(FISHEYE, 440).is_ok() && refused(FISHEYE, 448));
    // Two more lenses: a radial part with a pole at r² = 2, and a fold by the term k3 r⁶.
    let pole = Lens { k4: -0.5, ..Lens::NONE };
    assert!(made(pole, 100).is_ok());
    assert_eq!(pole.direction(f32::NAN, 0.0), None);
    let sixth = Lens { k3: -0.1, ..Lens::NONE };
    assert!(made(sixth, 120).is_ok() && refused(sixth, 400));
    for (name, lens) in
        [("k3", Lens { k3: f32::NAN, ..FISHEYE }), ("k6", Lens { k6: f32::INFINITY, ..Lens::NONE })]
    {
        assert!(matches!(made(lens, 8), Err(CameraError::LensNotFinite { name: n, .. }) if n == name));
    }
}

#[test]
fn coefficients_that_a_fisheye_lacks_are_refused() {
    use crate::camera::CameraError;
    let pose = Pose { rotation: Mat3::IDENTITY, position: Vec3::ZERO };
    for (name, lens) in [("p1", Lens { p1: 1e-3, ..FISHEYE }), ("k6", Lens { k6: -1.0, ..FISHEYE })] {
        let made = Camera::new(Intrinsics::centred(8, 8, 8.0), lens, pose);
        assert!(matches!(made, Err(CameraError::LensNotOfFisheyes { name: n, .. }) if n == name), "{made:?}");
    }
}

#[test]
fn a_lens_is_shown_by_what_is_not_zero() {
    use std::format;
    extern crate std;
    assert_eq!(
        format!("{:?}", Lens { k1: 0.5, ..Lens::NONE }),
        "Lens { k1: 0.5, k2: 0.0, p1: 0.0, p2: 0.0 }"
    );
    let text = format!("{:?}", Lens { k4: 0.25, ..FISHEYE });
    assert_eq!(text, "Lens { k1: 0.0, k2: 0.0, p1: 0.0, p2: 0.0, k4: 0.25, projection: Fisheye }");
}
