//! Tests of the rays through the aperture.

use super::*;
use crate::camera::{Camera, Intrinsics, Lens, Pose};
use glam::Vec3;

fn camera(eye: Vec3) -> Camera {
    let pose = Pose::look_at(eye, eye + Vec3::new(-1.0, -2.0, 0.5), Vec3::Y).unwrap();
    Camera::new(Intrinsics::centred(40, 30, 35.0), Lens::NONE, pose).unwrap()
}

fn through(camera: &Camera, lens: ThinLens, rays: u16, ray: u32, x: u32, y: u32) -> crate::camera::Ray {
    let effects = Effects { depth_of_field: Some(lens), anti_aliasing: rays, ..Effects::NONE };
    let pinhole = camera.ray(x as f32 + 0.5, y as f32 + 0.5);
    let area = area(&effects, ray);
    through_lens(&effects, camera.pose(), pinhole, (x, y), area)
}

#[test]
fn all_rays_of_an_image_point_meet_in_the_plane_of_focus() {
    for (eye, aperture_radius, focus_distance) in
        [(Vec3::ZERO, 0.1, 4.0), (Vec3::new(3.0, -1.0, 2.0), 2.0, 0.5), (Vec3::ONE * 100.0, 5.0, 300.0)]
    {
        let camera = camera(eye);
        let lens = ThinLens { aperture_radius, focus_distance };
        let forward = camera.pose().forward();
        let size = eye.length() + aperture_radius + 2.0 * focus_distance;
        for (x, y) in [(0, 0), (20, 15), (39, 29), (5, 22)] {
            let pinhole = camera.ray(x as f32 + 0.5, y as f32 + 0.5);
            let meeting = pinhole.at(focus_distance / pinhole.dir.dot(forward));
            for ray in 0..16 {
                let seen = through(&camera, lens, 16, ray, x, y);
                assert!((seen.dir.length() - 1.0).abs() < 3e-7);
                let offset = seen.origin - eye;
                assert!(offset.length() <= aperture_radius * (1.0 + 1e-6) + 2e-7 * size);
                assert!(offset.dot(forward).abs() <= 5e-7 * size, "the aperture is flat");
                // A point's z_depth is t times the cosine to the view axis. In the plane of focus, z_depth is
                // `focus_distance`.
                let t = focus_distance / camera.z_per_distance(&seen);
                assert!((seen.at(t) - meeting).length() <= 2e-6 * size, "{lens:?} ({x}, {y})");
            }
        }
    }
}

#[test]
fn the_aperture_is_covered_evenly_whatever_the_number_of_rays() {
    let camera = camera(Vec3::ZERO);
    let lens = ThinLens { aperture_radius: 1.0, focus_distance: 4.0 };
    for rays in [1u16, 4, 64] {
        let (mut sum, mut square, mut n) = (Vec3::ZERO, 0.0f64, 0.0f64);
        for pixel in 0..1200 {
            for ray in 0..rays.into() {
                let at = through(&camera, lens, rays, ray, pixel % 40, pixel / 40).origin;
                sum += at;
                square += f64::from(at.length_squared());
                n += 1.0;
            }
        }
        // Points that are uniform over the unit disc have mean 0 and mean squared radius ½. Limit: five standard
        // deviations of a coordinate's mean (variance ¼) over 1,200 independent pixels.
        let limit = 5.0 / (4.0 * 1200.0f64).sqrt();
        assert!(f64::from(sum.length()) / n <= limit * 1.5 && (square / n - 0.5).abs() <= limit);
    }
}
