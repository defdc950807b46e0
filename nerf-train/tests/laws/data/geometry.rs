use super::*;
use glam::Mat3;
use nerf_train::data::scene_bounds;

const TARGET: Vec3 = Vec3::new(10.0, -20.0, 5.0);

fn flipped(poses: &[Pose]) -> Vec<Pose> {
    poses.iter().map(|pose| Axes::Opencv.to_opengl(*pose)).collect()
}

#[test]
fn an_orbit_finds_its_target() {
    let report = Report::of(&dataset_of(&orbit(20, 3.0, TARGET), Axes::Opengl));
    let look_at = report.look_at.expect("axes cross");
    assert!((Vec3::from(look_at.point) - TARGET).length() < 1e-3, "{look_at:?}");
    assert!((look_at.mean_distance - 3.0).abs() < 1e-3 && look_at.behind == 0.0);
    assert!(report.warnings.is_empty(), "{:?}", report.warnings);
    assert!((report.near.expect("near") - 1.5).abs() < 1e-3);
    assert!((report.far.expect("far") - 4.5).abs() < 1e-3);
    let [min, max] = report.scene_box.expect("box");
    assert!((max[0] - 11.5).abs() < 1e-3 && (min[1] + 21.5).abs() < 1e-3);
    assert!(serde_json::to_string(&report).expect("serialises").contains("\"axes\":\"opengl\""));
    assert_names(&report.to_string(), &["20 train", "8x6 (20)", "10.00 px"]);
}

#[test]
fn a_few_stray_cameras_do_not_move_the_point() {
    let mut poses = orbit(20, 3.0, TARGET);
    let eye = TARGET + Vec3::new(3.0, 0.0, 1.0);
    for aside in [5.0, 9.0] {
        poses.push(Pose::look_at(eye, eye + Vec3::new(0.3, aside, 1.0), Vec3::Z).expect("a pose"));
    }
    let look_at = look_at_of(&poses);
    assert!((Vec3::from(look_at.point) - TARGET).length() < 0.02, "{look_at:?}");
}

#[test]
fn the_other_convention_is_told_in_both_directions() {
    for axes in [Axes::Opengl, Axes::Opencv] {
        let poses = flipped(&orbit(20, 3.0, TARGET));
        let report = Report::of(&dataset_of(&poses, axes));
        let warnings = report.warnings.join("\n");
        assert_names(&warnings, &["100% of the cameras look away", &format!("--axes {}", axes.other())]);
        // Cameras that look away from their common point give no scene box.
        assert_eq!(report.scene_box, None);
    }
}

#[test]
fn scattered_cameras_are_warned_of_without_blaming_the_axes() {
    let poses: Vec<Pose> = (0..30)
        .map(|i| {
            let at = |k: usize| Vec3::from_array([1.7, 2.9, 4.3].map(|f| (f * (i * 3 + k) as f32).sin()));
            Pose::look_at(5.0 * at(1), 5.0 * at(1) + at(40), Vec3::Z).expect("generic")
        })
        .collect();
    let report = Report::of(&dataset_of(&poses, Axes::Opengl));
    let warnings = report.warnings.join("\n");
    assert_names(&warnings, &["do not look at a common place", "--axes opencv would not mend"]);
    assert_eq!((report.near, report.scene_box), (None, None));
}

#[test]
fn world_to_camera_matrices_are_recognised() {
    let poses: Vec<Pose> = orbit(30, 3.0, TARGET)
        .iter()
        .map(|pose| {
            let rotation = pose.rotation.transpose();
            Pose { rotation, position: -(rotation * pose.position) }
        })
        .collect();
    let warnings = Report::of(&dataset_of(&poses, Axes::Opengl)).warnings.join("\n");
    assert_names(&warnings, &["world-to-camera"]);
}

#[test]
fn forward_facing_cameras_are_no_false_alarm() {
    let lattice = |tilt: f32| -> Vec<Pose> {
        (0..20)
            .map(|i| {
                let eye = Vec3::new((i % 5) as f32 * 0.2, (i / 5) as f32 * 0.2, 0.0);
                let aim = Vec3::new((7.1 * i as f32).sin(), (3.3 * i as f32).cos(), 0.0) * tilt;
                Pose::look_at(eye, eye + Vec3::NEG_Z + aim, Vec3::Y).expect("a pose")
            })
            .collect()
    };
    for tilt in [0.0, 1e-4, 0.01, 0.1] {
        for poses in [lattice(tilt), flipped(&lattice(tilt))] {
            let report = Report::of(&dataset_of(&poses, Axes::Opengl));
            let warnings = report.warnings.join("\n");
            assert!(!warnings.contains("--axes"), "tilt {tilt}: {warnings}");
            assert_names(&warnings, &["--near and --far"]);
        }
    }
    assert_eq!(Report::of(&dataset_of(&lattice(0.0), Axes::Opengl)).look_at, None);
    // With a given near and far, the box encloses the view frusta.
    let mut dataset = dataset_of(&lattice(0.0), Axes::Opengl);
    (dataset.near, dataset.far) = (Some(1.0), Some(2.0));
    let bounds = scene_bounds(&dataset).expect("a range");
    assert_eq!((bounds.near, bounds.far), (1.0, 2.0));
    assert!(bounds.scene_box.contains(Vec3::new(0.4, 0.3, -1.9)));
    assert!(!bounds.scene_box.contains(Vec3::new(0.4, 0.3, 0.5)));
}

#[test]
fn one_camera_and_duplicate_poses_make_a_report() {
    let poses = orbit(3, 4.0, Vec3::ZERO);
    for poses in [vec![poses[0]], vec![poses[0]; 5]] {
        let report = Report::of(&dataset_of(&poses, Axes::Opengl));
        assert_eq!((report.look_at, report.scene_box), (None, None));
        // Warnings: too few photographs, unknown position of the scene, and equal poses if there are several.
        assert_eq!(report.warnings.len(), 2 + usize::from(poses.len() > 1), "{:?}", report.warnings);
        assert_names(&report.warnings.join("\n"), &[&format!("photographs to fit: {}; so few", poses.len())]);
    }
    let twice: Vec<Pose> = poses.iter().chain(&poses).copied().collect();
    let look_at = look_at_of(&twice);
    assert!(Vec3::from(look_at.point).length() < 1e-4 && look_at.agrees());
    // All cameras are at one point and look in different directions: all distances from the look-at point are 0.
    let around: Vec<Pose> = poses.iter().map(|p| Pose { position: Vec3::ONE, ..*p }).collect();
    let _ = Report::of(&dataset_of(&around, Axes::Opengl)).to_string();
}

#[test]
fn the_callers_range_wins_over_the_recipe() {
    let mut dataset = dataset_of(&orbit(20, 4.0, Vec3::ZERO), Axes::Opengl);
    dataset.format = Format::Blender;
    let bounds = scene_bounds(&dataset).expect("an orbit");
    assert_eq!((bounds.near, bounds.far), (2.0, 6.0));
    assert!((bounds.scene_box.max - Vec3::splat(2.0)).abs().max_element() < 1e-4);
    dataset.near = Some(3.0);
    let bounds = scene_bounds(&dataset).expect("an orbit");
    assert_eq!((bounds.near, bounds.far), (3.0, 6.0));
    // `near` exceeds the cameras' distance of 4: the box encloses the view frusta instead of being a cube.
    dataset.near = Some(5.0);
    assert!(scene_bounds(&dataset).is_some());
    dataset.near = Some(7.0);
    assert_eq!(scene_bounds(&dataset), None);
}

#[test]
fn far_from_the_origin_the_point_keeps_its_precision() {
    let target = Vec3::new(1e4, -2e4, 3e4);
    let look_at = look_at_of(&orbit(50, 10.0, target));
    assert!((Vec3::from(look_at.point) - target).length() < 0.02, "{look_at:?}");
}

#[test]
fn rolled_cameras_do_not_matter() {
    let roll = Mat3::from_rotation_z(1.0);
    let poses: Vec<Pose> = orbit(20, 3.0, TARGET)
        .iter()
        .map(|p| Pose { rotation: p.rotation * roll, position: p.position })
        .collect();
    assert!(Report::of(&dataset_of(&poses, Axes::Opengl)).warnings.is_empty());
}

fn look_at_of(poses: &[Pose]) -> LookAt {
    LookAt::of(&poses.iter().map(|pose| camera(*pose)).collect::<Vec<_>>()).expect("axes cross")
}
