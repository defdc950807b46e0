//! Cameras and their rays through the C ABI.

use nerf_core::camera::{Camera, Lens, Pose, Projection};
use nerf_render::{self as ffi, Status};
use nerf_testing::call::{self, Message};
use nerf_testing::scenes;
use std::ptr::{null, null_mut};

fn look_at(camera: &mut ffi::Camera, eye: &[f32; 3], target: &[f32; 3], up: &[f32; 3]) -> (Status, String) {
    let mut message = Message::default();
    let text = message.0.as_mut_ptr();
    // SAFETY: everything lives until the call returns.
    let status = unsafe {
        ffi::nerf_camera_look_at(camera, eye.as_ptr(), target.as_ptr(), up.as_ptr(), text, message.0.len())
    };
    (status, message.text())
}

#[test]
fn looking_at_something_turns_the_camera_and_nothing_else() {
    let before = call::camera(&scenes::camera(31, 17));
    let (eye, target, up) = ([3.0, -2.0, 0.5], [0.25, 0.0, -1.0], [0.0, 2.0, 0.1]);
    let mut camera = before;
    assert_eq!(look_at(&mut camera, &eye, &target, &up), (Status::Ok, String::new()));
    let rows = Pose::look_at(eye.into(), target.into(), up.into()).expect("a pose").to_rows();
    assert_eq!(camera.c2w, std::array::from_fn(|k| rows[k / 4][k % 4]));
    assert_eq!(
        (camera.width, camera.fx, camera.k1, camera.p2),
        (before.width, before.fx, before.k1, before.p2)
    );
    // The middle of the image shows the target.
    let far = [0, 4, 8].map(|row| -camera.c2w[row + 2]);
    let way: Vec<f32> = (0..3).map(|i| target[i] - eye[i]).collect();
    let length = way.iter().map(|x| x * x).sum::<f32>().sqrt();
    assert!((0..3).all(|i| (far[i] - way[i] / length).abs() < 1e-6));

    let before = camera;
    for (eye, target, up) in [
        (eye, eye, up),
        ([0.0, 5.0, 0.0], [0.0; 3], [0.0, 1.0, 0.0]),
        (eye, target, [0.0; 3]),
        ([f32::NAN, 0.0, 0.0], target, up),
        (eye, [f32::INFINITY, 0.0, 0.0], up),
    ] {
        let (status, message) = look_at(&mut camera, &eye, &target, &up);
        assert_eq!(status, Status::Camera);
        assert!(message.starts_with("eye, target, up: expected"), "{message}");
        assert_eq!(camera.c2w, before.c2w, "written without success");
    }
    let mut message = Message::default();
    // SAFETY: NULL is refused.
    let status = unsafe {
        ffi::nerf_camera_look_at(&mut camera, eye.as_ptr(), null(), up.as_ptr(), message.0.as_mut_ptr(), 256)
    };
    assert_eq!(
        (status, message.text().as_str()),
        (Status::NullPointer, "target: expected an address, found NULL")
    );
}

#[test]
fn rays_are_the_renderers() {
    let rust = scenes::camera(31, 17);
    let camera = call::camera(&rust);
    let none = null_mut();
    for (x, y) in [(0.5, 0.5), (15.5, 8.5), (30.25, 16.75), (0.0, 17.0)] {
        let (mut origin, mut dir, mut cosine) = ([9.0f32; 3], [9.0f32; 3], 9.0f32);
        // SAFETY: everything lives until the call returns.
        let status = unsafe {
            ffi::nerf_camera_ray(&camera, x, y, origin.as_mut_ptr(), dir.as_mut_ptr(), &mut cosine, none, 0)
        };
        let ray = rust.ray(x, y);
        assert_eq!(status, Status::Ok);
        assert_eq!((origin, dir), (ray.origin.to_array(), ray.dir.to_array()));
        assert_eq!(cosine, rust.z_per_distance(&ray));
    }
    // So far off that a direction has no length in f32.
    for (x, y) in [(f32::NAN, 1.0), (1.0, f32::INFINITY), (1e30, 1.0), (-1.0, f32::MAX)] {
        let (mut origin, mut dir, mut message) = ([9.0f32; 3], [9.0f32; 3], Message::default());
        let text = message.0.as_mut_ptr();
        // SAFETY: as above; NULL for what is not wanted.
        let status = unsafe {
            ffi::nerf_camera_ray(&camera, x, y, origin.as_mut_ptr(), dir.as_mut_ptr(), none.cast(), text, 256)
        };
        assert_eq!((status, origin, dir), (Status::Camera, [9.0; 3], [9.0; 3]));
        assert!(message.text().starts_with("x, y: expected"), "{}", message.text());
    }
    // A lens that folds at 0.667 of a focal length from the axis, as it is seen: beyond this image, whose edge is
    // at 0.5.
    let bent = ffi::Camera { k1: -0.3333, fx: 31.0, fy: 31.0, ..camera };
    let (mut origin, mut dir) = ([9.0f32; 3], [9.0f32; 3]);
    for (x, expected) in
        [(31.0, Status::Ok), (34.0, Status::Ok), (37.0, Status::Camera), (-80.0, Status::Camera)]
    {
        // SAFETY: as above.
        let status = unsafe {
            let (origin, dir) = (origin.as_mut_ptr(), dir.as_mut_ptr());
            ffi::nerf_camera_ray(&bent, x, 8.5, origin, dir, null_mut(), none, 0)
        };
        assert_eq!(status, expected, "{x}");
    }
    // The other lenses: the same rays as the core's.
    let plain = ffi::Camera { k1: 0.05, k2: 0.0, p1: 0.0, p2: 0.0, ..camera };
    let lens_model = ffi::LensModel::Fisheye as u32;
    let fisheye = ffi::Camera { k3: -0.002, k4: 1e-4, lens_model, ..plain };
    let rational = ffi::Camera { k1: 0.2, k3: 0.01, k4: 0.1, k5: 0.02, k6: 1e-3, ..plain };
    let lens = Lens { k1: 0.05, k3: -0.002, k4: 1e-4, projection: Projection::Fisheye, ..Lens::NONE };
    let full = Lens { k1: 0.2, k3: 0.01, k4: 0.1, k5: 0.02, k6: 1e-3, ..Lens::NONE };
    for (asked, lens) in [(fisheye, lens), (rational, full)] {
        let same = Camera::new(*rust.intrinsics(), lens, *rust.pose()).expect("a camera");
        // SAFETY: as above.
        let status = unsafe {
            let (origin, dir) = (origin.as_mut_ptr(), dir.as_mut_ptr());
            ffi::nerf_camera_ray(&asked, 1.5, 3.5, origin, dir, null_mut(), none, 0)
        };
        let dir_off = (glam::Vec3::from(dir) - same.ray(1.5, 3.5).dir).length();
        assert!(status == Status::Ok && dir_off < 1e-6, "{asked:?}: {dir:?}");
    }
    let unknown = ffi::Camera { lens_model: 2, ..camera };
    // SAFETY: as above.
    let status = unsafe {
        ffi::nerf_camera_ray(&unknown, 1.5, 3.5, origin.as_mut_ptr(), dir.as_mut_ptr(), null_mut(), none, 0)
    };
    assert_eq!(status, Status::Options);
    // SAFETY: NULL is refused.
    let status =
        unsafe { ffi::nerf_camera_ray(&camera, 1.0, 1.0, null_mut(), null_mut(), null_mut(), none, 0) };
    assert_eq!(status, Status::NullPointer);
}
