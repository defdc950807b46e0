//! Tests of the initial viewpoint of a scene.

use super::*;
use glam::{Mat3, Quat};
use nerf_core::blob::{SceneFacts, SceneSampling, Viewpoint};
use nerf_train::data::cameras::viewpoint::viewpoint;
use nerf_train::data::demo::{self, DemoSpec};
use nerf_train::show::orbit::Orbit;
use std::f32::consts::TAU;

const TARGET: Vec3 = Vec3::new(10.0, -20.0, 5.0);
const RANGE: (f32, f32) = (2.0, 6.0);

fn found(poses: &[Pose]) -> Viewpoint {
    viewpoint(&dataset_of(poses, Axes::Opengl), RANGE).expect("a viewpoint")
}

fn facts(viewpoint: Option<Viewpoint>) -> SceneFacts {
    SceneFacts {
        min: [-1.0; 3],
        max: [1.0; 3],
        near: RANGE.0,
        far: RANGE.1,
        sampling: SceneSampling::Bins(8),
        background: [0.0; 3],
        occupancy_required: false,
        viewpoint,
    }
}

fn turned(poses: &[Pose], by: Quat, shift: Vec3) -> Vec<Pose> {
    let turn = |pose: &Pose| Pose {
        rotation: Mat3::from_quat(by) * pose.rotation,
        position: by * pose.position + shift,
    };
    poses.iter().map(turn).collect()
}

/// Poses at distance 3 from [`TARGET`], which look at this point. Their azimuths are evenly spaced from `from` to `to`,
/// degrees; their elevation is `pitch`, degrees.
fn arc(count: usize, from: f32, to: f32, pitch: f32) -> Vec<Pose> {
    let pose = |i: usize| {
        let azimuth = (from + (to - from) * i as f32 / (count - 1) as f32).to_radians();
        let (rise, across) = pitch.to_radians().sin_cos();
        let eye = TARGET + 3.0 * Vec3::new(across * azimuth.cos(), across * azimuth.sin(), rise);
        Pose::look_at(eye, TARGET, Vec3::Z).expect("a pose")
    };
    (0..count).map(pose).collect()
}

#[test]
fn the_start_view_of_a_rotated_capture_shows_the_same_picture() {
    let spec = DemoSpec { train: 30, val: 0, size: 8, ..DemoSpec::default() };
    let dataset = demo::dataset(&spec).expect("a data set");
    let poses: Vec<Pose> = dataset.train.iter().map(|view| *view.camera.pose()).collect();
    let seen = |poses: &[Pose], back: Quat, turn: f32| {
        let orbit = Orbit::of(&facts(Some(found(poses))), None);
        let camera = orbit.camera(turn, 40, 40, 40.0).expect("a camera");
        let pose = turned(&[*camera.pose()], back, Vec3::ZERO)[0];
        let camera = Camera::new(*camera.intrinsics(), Lens::NONE, pose).expect("a camera");
        demo::render_truth(&camera).rgba
    };
    let own = found(&poses);
    assert!(Vec3::from(own.up).distance(Vec3::Z) < 1e-3 && own.arc == TAU, "{own:?}");
    assert!(Vec3::from(own.target).length() < 0.01, "{own:?}");
    assert!(poses.iter().any(|pose| pose.position.to_array() == own.eye), "{own:?}");
    for (axis, degrees) in [(Vec3::X, 90.0), (Vec3::Y, -63.0), (Vec3::new(1.0, 2.0, -3.0), 147.0)] {
        let by = Quat::from_axis_angle(axis.normalize(), f32::to_radians(degrees));
        let there = turned(&poses, by, Vec3::ZERO);
        for turn in [0.0, 0.3] {
            let expected = seen(&poses, Quat::IDENTITY, turn);
            let pixels = seen(&there, by.inverse(), turn);
            assert!(expected.iter().any(|pixel| pixel[3] > 0), "something is seen");
            let near = |(a, b): (&[u8; 4], &[u8; 4])| a.iter().zip(b).all(|(a, b)| a.abs_diff(*b) <= 3);
            let same = pixels.iter().zip(&expected).filter(|&pair| near(pair)).count();
            // Rounding may move an edge to the other side of a subsample.
            assert!(same >= 1584, "{axis} by {degrees}°, turn {turn}: {same} of 1600 pixels");
        }
    }
}

#[test]
fn photographs_from_one_side_are_swayed_over_and_not_left() {
    for pitch in [0.0, 40.0] {
        let view = found(&arc(31, 20.0, 120.0, pitch));
        assert!(Vec3::from(view.up).distance(Vec3::Z) < 1e-3, "a pitch of {pitch}°: {view:?}");
        assert!(Vec3::from(view.target).distance(TARGET) < 1e-2, "{view:?}");
        // The arc covers 95 % of the cameras: 30 of 31, which span 96.7°.
        assert!((85.0..=100.0).contains(&view.arc.to_degrees()), "{view:?}");
        let orbit = Orbit::of(&facts(Some(view)), None);
        for i in 0..40 {
            let eye = orbit.camera(i as f32 / 40.0, 8, 8, 40.0).expect("a camera").pose().position - TARGET;
            let azimuth = eye.y.atan2(eye.x).to_degrees();
            assert!((19.0..=121.0).contains(&azimuth), "{azimuth}");
            assert!((eye.length() - 3.0).abs() < 1e-2);
            assert!((eye.z - 3.0 * pitch.to_radians().sin()).abs() < 2e-2, "{eye}");
        }
        let start = orbit.camera(0.0, 8, 8, 40.0).expect("a camera").pose().position;
        assert!(start.distance(Vec3::from(view.eye)) < 1e-4);
    }
    let all = found(&arc(31, 0.0, 300.0, 20.0));
    assert_eq!(all.arc, TAU, "most of a circle is a circle");
}

#[test]
fn a_few_strays_and_cameras_held_upright_change_little() {
    let mut poses = arc(38, 20.0, 120.0, 20.0);
    poses.extend(arc(2, 250.0, 260.0, 20.0));
    let view = found(&poses);
    assert!(view.arc.to_degrees() <= 100.5, "{view:?}");
    // Every third camera is turned by 90°: the x axes do not determine the up direction, and the median is used.
    let mut poses = orbit(60, 3.0, TARGET);
    for pose in poses.iter_mut().step_by(3) {
        pose.rotation = Mat3::from_cols(pose.rotation.y_axis, -pose.rotation.x_axis, pose.rotation.z_axis);
    }
    let up = Vec3::from(found(&poses).up);
    assert!(up.dot(Vec3::Z) > 0.95, "{up}");
}

#[test]
fn cameras_that_look_one_way_are_led_by_the_one_in_their_middle() {
    let grid = (0..15).map(|i| TARGET + 0.2 * Vec3::new((i % 5) as f32 - 2.0, 0.0, (i / 5) as f32 - 1.0));
    let poses: Vec<Pose> =
        grid.map(|eye| Pose::look_at(eye, eye + Vec3::Y, Vec3::Z).expect("a pose")).collect();
    let view = found(&poses);
    assert_eq!(view.eye, TARGET.to_array());
    assert!(Vec3::from(view.up).distance(Vec3::Z) < 1e-3, "{view:?}");
    // The inverse distance of the target, 1/3, is the mean of 1/near = 1/2 and 1/far = 1/6.
    assert!(Vec3::from(view.target).distance(TARGET + 3.0 * Vec3::Y) < 1e-4, "{view:?}");
    let half = 0.5 * view.arc;
    assert!((0.05..=(0.4f32 / 3.0).atan() + 1e-3).contains(&half), "{view:?}");
    let none = viewpoint(&dataset_of(&poses, Axes::Opengl), (0.0, 0.0));
    assert_eq!(none, None, "nowhere to look");
    assert_eq!(viewpoint(&dataset_of(&[], Axes::Opengl), RANGE), None, "nobody to look");
}

#[test]
fn orbits_without_a_viewpoint_are_around_the_middle_of_the_box() {
    let orbit = Orbit::of(&facts(None), None);
    let eye = orbit.camera(0.0, 8, 8, 40.0).expect("a camera").pose().position;
    let (rise, across) = 25f32.to_radians().sin_cos();
    assert!(eye.distance(4.0 * Vec3::new(across, 0.0, rise)) < 1e-5, "{eye}");
    // The eye is exactly above the target and gives no direction for the start of the orbit: any horizontal one is
    // used.
    let above = Viewpoint { eye: [0.0, 0.0, 3.0], target: [0.0; 3], up: [0.0, 1.0, 0.0], arc: TAU };
    let orbit = Orbit::of(&facts(Some(above)), Some(Vec3::Z));
    assert!(orbit.camera(0.5, 8, 8, 40.0).is_ok());
}
