extern crate std;

use super::*;
use crate::camera::Lens;
use crate::simd::{Isa, MAX_LANES};
use crate::testing::noise;
use std::format;

const IDENTITY: Pose = Pose { rotation: Mat3::IDENTITY, position: Vec3::ZERO };

fn camera(width: u32, height: u32, focal: f32) -> Result<Camera, CameraError> {
    Camera::new(Intrinsics::centred(width, height, focal), Lens::NONE, IDENTITY)
}

fn with_rotation(rotation: Mat3) -> Result<Camera, CameraError> {
    Camera::new(Intrinsics::centred(4, 4, 4.0), Lens::NONE, Pose { rotation, position: Vec3::ZERO })
}

#[test]
fn right_is_plus_x_up_is_plus_y_and_forward_is_minus_z() {
    let camera = camera(4, 4, 4.0).unwrap();
    assert_eq!(camera.ray(2.0, 2.0).dir, Vec3::NEG_Z);
    assert!(camera.ray(3.5, 2.0).dir.x > 0.0, "pixels grow to the right");
    assert!(camera.ray(2.0, 0.5).dir.y > 0.0, "the first row is the top");
    assert_eq!(camera.pose().forward(), Vec3::NEG_Z);
}

#[test]
fn every_ray_is_of_unit_length_and_z_is_its_cosine() {
    let intrinsics = Intrinsics { width: 40, height: 30, fx: 25.0, fy: 31.0, cx: 18.0, cy: 16.5 };
    let pose = Pose::look_at(Vec3::new(1.0, 2.0, 3.0), Vec3::new(-0.3, 0.1, 0.2), Vec3::Y).unwrap();
    let camera = Camera::new(intrinsics, Lens::NONE, pose).unwrap();
    for y in 0..30 {
        for x in 0..40 {
            let (x, y) = (x as f32 + 0.5, y as f32 + 0.5);
            let ray = camera.ray(x, y);
            assert!((ray.dir.length() - 1.0).abs() < 3e-7);
            assert_eq!(ray.origin, pose.position);
            let (u, v) = (f64::from(x - 18.0) / 25.0, f64::from(y - 16.5) / 31.0);
            let cosine = 1.0 / (u * u + v * v + 1.0).sqrt();
            assert!((f64::from(camera.z_per_distance(&ray)) - cosine).abs() < 5e-7);
        }
    }
}

#[test]
fn projecting_a_ray_back_gives_its_pixel() {
    let intrinsics = Intrinsics { width: 64, height: 48, fx: 50.0, fy: 60.0, cx: 30.0, cy: 25.0 };
    let pose = Pose::look_at(Vec3::new(4.0, -1.0, 2.0), Vec3::ZERO, Vec3::Z).unwrap();
    let camera = Camera::new(intrinsics, Lens::NONE, pose).unwrap();
    for (x, y) in [(0.5, 0.5), (63.5, 0.5), (0.5, 47.5), (30.0, 25.0), (12.5, 40.5)] {
        let local = pose.rotation.transpose() * camera.ray(x, y).dir;
        let seen = (50.0 * local.x / -local.z + 30.0, 60.0 * -local.y / -local.z + 25.0);
        assert!((seen.0 - x).abs() < 2e-5 && (seen.1 - y).abs() < 2e-5, "{seen:?}");
    }
}

#[test]
fn looking_at_a_point_puts_it_in_the_centre_with_up_upwards() {
    let (eye, target) = (Vec3::new(2.0, 3.0, -4.0), Vec3::new(0.5, -1.0, 1.0));
    let pose = Pose::look_at(eye, target, Vec3::Y).unwrap();
    assert!((pose.forward() - (target - eye).normalize()).length() < 3e-7);
    assert!(pose.rotation.y_axis.y > 0.0);
    assert!(pose.rotation.x_axis.y.abs() < 1e-7, "the horizon is level");
    assert!((pose.rotation.determinant() - 1.0).abs() < 1e-6);
}

#[test]
fn looking_nowhere_or_along_up_is_refused() {
    let eye = Vec3::new(0.3, 0.4, 0.5);
    assert_eq!(Pose::look_at(eye, eye, Vec3::Y), None);
    assert_eq!(Pose::look_at(eye, Vec3::ZERO, Vec3::ZERO), None);
    assert_eq!(Pose::look_at(eye, Vec3::new(f32::NAN, 0.0, 0.0), Vec3::Y), None);
    // `up` is parallel to the line of sight except for rounding, so that the cross product is noise instead of 0.
    for up in [eye * 7.0, eye * -0.123, eye * 1e-3, eye * 3e18] {
        assert_eq!(Pose::look_at(eye, Vec3::ZERO, up), None, "{up}");
    }
}

#[test]
fn whatever_look_at_gives_is_a_camera() {
    for tilt in [1e-1, 1e-2, 1e-3, 2e-4, 1.1e-4] {
        for length in [1e-12, 1.0, 1e12] {
            let up = Vec3::new(0.6 + tilt, 0.8, 0.0) * length;
            if let Some(pose) = Pose::look_at(Vec3::new(0.6, 0.8, 0.0) * 3.0, Vec3::ZERO, up) {
                let made = Camera::new(Intrinsics::centred(4, 4, 4.0), Lens::NONE, pose);
                assert!(made.is_ok(), "{tilt} {length}: {made:?}");
            }
        }
    }
}

#[test]
fn size_of_what_is_looked_at_turns_no_camera() {
    let at = |size: f32| Pose::look_at(Vec3::new(3.0, 4.0, 5.0) * size, Vec3::ZERO, Vec3::Y * size).unwrap();
    // Found by `tests/fuzz`: with a size of 3e-22, squares of differences are subnormal or 0.
    for size in [1e-37, 3e-22, 1e-15, 1e-3, 1e15, 1e18, 1e37] {
        let off = (at(size).rotation - at(1.0).rotation).to_cols_array();
        assert!(off.iter().all(|x| x.abs() < 1e-6), "{size}: {off:?}");
    }
}

#[test]
fn rows_round_trip() {
    let rows = [[0.0, 0.0, 1.0, 5.0], [1.0, 0.0, 0.0, 6.0], [0.0, 1.0, 0.0, 7.0]];
    let pose = Pose::from_rows(rows);
    assert_eq!(pose.to_rows(), rows);
    assert_eq!(pose.rotation * Vec3::X, Vec3::Y, "columns are the camera's axes");
    assert_eq!(pose.position, Vec3::new(5.0, 6.0, 7.0));
}

#[test]
fn images_without_pixels_or_with_pixels_that_would_share_a_ray_are_refused() {
    for (width, height) in [(0, 4), (4, 0), (0, 0), (MAX_IMAGE_SIDE + 1, 1), (1, u32::MAX)] {
        assert_eq!(camera(width, height, 4.0), Err(CameraError::ImageSize { width, height }));
    }
    let widest = camera(MAX_IMAGE_SIDE, 1, MAX_IMAGE_SIDE as f32).unwrap();
    let last = MAX_IMAGE_SIDE as f32 - 0.5;
    assert!(widest.ray(last, 0.5).dir.x > widest.ray(last - 1.0, 0.5).dir.x);
}

#[test]
fn focal_lengths_that_are_no_positive_numbers_are_refused() {
    for value in [0.0, -1.0, f32::INFINITY, 1e-45] {
        assert_eq!(camera(4, 4, value), Err(CameraError::Focal { name: "fx", value }));
        let intrinsics = Intrinsics { fy: value, ..Intrinsics::centred(4, 4, 4.0) };
        let found = Camera::new(intrinsics, Lens::NONE, IDENTITY);
        assert_eq!(found, Err(CameraError::Focal { name: "fy", value }));
    }
    assert!(matches!(camera(4, 4, f32::NAN), Err(CameraError::Focal { name: "fx", .. })));
}

#[test]
fn principal_points_that_are_not_finite_are_refused() {
    let intrinsics = Intrinsics { cx: f32::INFINITY, ..Intrinsics::centred(4, 4, 4.0) };
    let found = Camera::new(intrinsics, Lens::NONE, IDENTITY);
    assert_eq!(found, Err(CameraError::PrincipalPoint { name: "cx", value: f32::INFINITY }));
    let intrinsics = Intrinsics { cy: f32::NAN, ..Intrinsics::centred(4, 4, 4.0) };
    let found = Camera::new(intrinsics, Lens::NONE, IDENTITY);
    assert!(matches!(found, Err(CameraError::PrincipalPoint { name: "cy", .. })));
}

#[test]
fn poses_that_are_not_finite_or_too_far_are_refused() {
    for position in [Vec3::NAN, Vec3::new(0.0, f32::INFINITY, 0.0), Vec3::new(2e9, 0.0, 0.0)] {
        let pose = Pose { position, ..IDENTITY };
        let found = Camera::new(Intrinsics::centred(4, 4, 4.0), Lens::NONE, pose);
        assert_eq!(found, Err(CameraError::PoseNotFinite));
    }
    assert_eq!(with_rotation(Mat3::NAN), Err(CameraError::PoseNotFinite));
}

#[test]
fn scaled_sheared_reflected_and_singular_poses_are_refused() {
    let shear = Mat3::from_cols(Vec3::X, Vec3::new(0.1, 1.0, 0.0), Vec3::Z);
    let reflection = Mat3::from_diagonal(Vec3::new(-1.0, 1.0, 1.0));
    let flat = Mat3::from_diagonal(Vec3::new(1.0, 1.0, 0.0));
    let huge = Mat3::from_cols(Vec3::splat(1e30), Vec3::new(1e30, -1e30, 1e30), Vec3::splat(-1e30));
    for rotation in [Mat3::IDENTITY * 1.01, shear, reflection, flat, Mat3::ZERO, huge] {
        let found = with_rotation(rotation);
        assert!(matches!(found, Err(CameraError::PoseNotRotation { .. })), "{found:?}");
    }
    assert!(with_rotation(Mat3::from_rotation_y(0.3) * 1.0004).is_ok());
}

#[test]
fn z_depth_does_not_take_up_a_pose_rounding() {
    // This rotation is accepted, with |RᵀR − I| = 8e-4. The view axis is 4e-4 too long, but the cosine must be exact.
    let camera = with_rotation(Mat3::IDENTITY * 1.0004).unwrap();
    assert!((camera.z_per_distance(&camera.ray(2.0, 2.0)) - 1.0).abs() < 2e-7);
}

#[cfg(not(feature = "lens"))]
#[test]
fn a_build_without_lenses_has_pinholes_alone() {
    let lens = Lens { k1: 1e-9, ..Lens::NONE };
    let error = Camera::new(Intrinsics::centred(4, 4, 4.0), lens, IDENTITY).unwrap_err();
    assert_eq!(error, CameraError::LensNotBuilt { lens });
    assert!(format!("{error}").contains("feature lens"), "{error}");
    assert!(camera(4, 4, 4.0).is_ok());
}

#[cfg(feature = "lens")]
#[test]
fn a_folded_lens_is_refused() {
    for lens in [Lens { k1: -1.0, ..Lens::NONE }, Lens { p1: 5.0, ..Lens::NONE }] {
        let found = Camera::new(Intrinsics::centred(20, 20, 10.0), lens, IDENTITY);
        assert!(matches!(found, Err(CameraError::LensNotInvertible { .. })), "{lens:?}");
    }
    for (name, lens) in [
        ("k1", Lens { k1: f32::NAN, ..Lens::NONE }),
        ("k2", Lens { k2: f32::INFINITY, ..Lens::NONE }),
        ("p1", Lens { p1: f32::NAN, ..Lens::NONE }),
        ("p2", Lens { p2: f32::NEG_INFINITY, ..Lens::NONE }),
    ] {
        let found = Camera::new(Intrinsics::centred(20, 20, 10.0), lens, IDENTITY);
        assert!(matches!(found, Err(CameraError::LensNotFinite { name: n, .. }) if n == name), "{found:?}");
    }
    // The lens folds only between r = 0.59 and 1.2. The image's border lies beyond and has an inverse.
    let lens = Lens { k1: -1.2, k2: 0.4, ..Lens::NONE };
    let border = |s: i8| lens.undistort(5.2, f32::from(s) * 0.65);
    assert!((-8..=8).all(|s| border(s).is_some()));
    let found = Camera::new(Intrinsics::centred(104, 104, 10.0), lens, IDENTITY);
    assert!(matches!(found, Err(CameraError::LensNotInvertible { .. })), "{found:?}");
    // First the same lens, with its fold between two checked points (5.2 focal lengths apart). Then a lens that nearly
    // folds.
    for (lens, focal) in [(lens, 1.25), (Lens { k1: -1.0, k2: 0.452, ..Lens::NONE }, 10.0)] {
        let found = Camera::new(Intrinsics::centred(104, 104, focal), lens, IDENTITY);
        assert!(matches!(found, Err(CameraError::LensNotInvertible { .. })), "{found:?}");
    }
    // Pincushion distortion: Newton's method would start behind the fold of the first lens, and jump across the axis
    // with the second.
    let pincushion = Lens { k1: 0.389, k2: -0.0057, ..Lens::NONE };
    for (lens, focal) in [(Lens { k1: 0.3, k2: -0.2, ..Lens::NONE }, 45.0), (pincushion, 10.0)] {
        let found = Camera::new(Intrinsics::centred(104, 104, focal), lens, IDENTITY);
        assert!(matches!(found, Err(CameraError::LensNotInvertible { .. })), "{found:?}");
    }
    let close = Camera::new(
        Intrinsics::centred(1920, 1080, 800.0),
        Lens { k1: 0.1, k2: -0.05, ..Lens::NONE },
        IDENTITY,
    );
    assert!(close.is_ok(), "the corner lies in front of the fold: {close:?}");
    let gentle = Lens { k1: -0.1, k2: 0.01, p1: 1e-3, p2: -1e-3, ..Lens::NONE };
    assert!(Camera::new(Intrinsics::centred(20, 20, 10.0), gentle, IDENTITY).is_ok());
}

#[test]
fn images_of_one_pixel_and_of_one_column_have_rays() {
    let one = camera(1, 1, 1.0).unwrap();
    assert_eq!(one.ray(0.5, 0.5).dir, Vec3::NEG_Z);
    let column = camera(1, 65_535, 100.0).unwrap();
    for y in [0.5, 32_767.5, 65_534.5] {
        assert!((column.ray(0.5, y).dir.length() - 1.0).abs() < 3e-7);
    }
    let lens = if Lens::BUILT { Lens { k1: 1e-6, ..Lens::NONE } } else { Lens::NONE };
    let wide = Camera::new(Intrinsics::centred(1, 65_535, 3000.0), lens, IDENTITY);
    assert!(wide.is_ok(), "{wide:?}");
}

#[test]
fn every_pixel_of_a_camera_has_a_unit_ray() {
    for (focal, cx) in [(1e-38, 2.0), (1e-20, 2.0), (4.0, 3e38), (4.0, -1e25), (1e-3, 1e3), (1e36, 2.0)] {
        let intrinsics = Intrinsics { cx, ..Intrinsics::centred(4, 4, focal) };
        match Camera::new(intrinsics, Lens::NONE, IDENTITY) {
            Ok(camera) => {
                for (x, y) in [(0.0, 0.0), (4.0, 4.0), (0.5, 3.5), (2.0, 2.0)] {
                    let dir = camera.ray(x, y).dir;
                    assert!((dir.length() - 1.0).abs() < 3e-7, "focal {focal}, cx {cx}: {dir}");
                }
            }
            Err(error) => assert!(format!("{error}").contains("expected"), "{error}"),
        }
    }
}

#[test]
fn messages_name_what_was_expected_and_found() {
    for (error, part) in [
        (CameraError::ImageSize { width: 0, height: 7 }, "0x7"),
        (CameraError::Focal { name: "fy", value: -2.0 }, "fy: expected"),
        (CameraError::PrincipalPoint { name: "cx", value: f32::NAN }, "cx: expected"),
        (CameraError::PoseNotFinite, "finite"),
        (CameraError::PoseNotRotation { off: 0.5, determinant: -1.0 }, "determinant -1"),
        (CameraError::FieldOfView { x: 8.0, y: 9.0 }, "(8, 9)"),
        (CameraError::LensNotFinite { name: "k1", value: f32::NAN }, "lens k1: expected a finite number"),
        (CameraError::LensNotInvertible { x: 3.0, y: 4.0 }, "(3, 4)"),
        (CameraError::LensNotBuilt { lens: Lens { k1: 0.5, ..Lens::NONE } }, "k1: 0.5"),
    ] {
        assert!(format!("{error}").contains(part), "{error}");
    }
}

#[test]
fn several_pixels_have_the_rays_of_each() {
    for seed in 0..50 {
        let r = noise(9, seed);
        let eye = Vec3::new(r[0], r[1], r[2]) * 5.0;
        let target = Vec3::new(r[3], r[4], r[5]);
        let Some(pose) = Pose::look_at(eye, target, Vec3::Z) else { continue };
        let (fx, fy) = (30.0 + 9.0 * r[6], 25.0 + 9.0 * r[7]);
        let intrinsics = Intrinsics { width: 16, height: 16, fx, fy, cx: 8.0 + r[8], cy: 7.5 };
        let camera = Camera::new(intrinsics, Lens::NONE, pose).unwrap();
        for isa in Isa::ALL.into_iter().filter(|isa| isa.available()) {
            for count in [1, 7, 8, 16] {
                let across = core::array::from_fn(|i| i as f32 + 0.5);
                let points: [[f32; MAX_LANES]; 2] = [across, [(seed % 16) as f32 + 0.5; MAX_LANES]];
                let mut rays = [Ray { origin: Vec3::ZERO, dir: Vec3::X }; MAX_LANES];
                let to = &mut rays[..count];
                isa.run(PinholeRays { camera: &camera, points: &points, to });
                for (i, ray) in rays[..count].iter().enumerate() {
                    let expected = camera.ray(points[0][i], points[1][i]);
                    let bits = |ray: &Ray| ray.dir.to_array().map(f32::to_bits);
                    assert_eq!((bits(ray), ray.origin), (bits(&expected), expected.origin));
                }
            }
        }
    }
}
