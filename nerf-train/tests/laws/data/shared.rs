//! Tests of shared cameras (one camera for each device) on models with one camera for each photograph.

use super::*;
use crate::encoders::png;
use crate::tools::data;
use glam::{DQuat, DVec3, EulerRot};
use nerf_train::data::{Cameras, Downscale, Layout, cameras_in_name};
use std::fmt::Write;

/// Width and height of the photographs that are not turned by 90°.
const SIZE: (u32, u32) = (80, 60);
/// True focal length, pixels.
const FOCAL: f64 = 100.0;

/// Writes a model of 12 photographs and 60 points. Each photograph has a focal length with an error of its own, and a
/// distance from the points with the same error. Every third photograph is turned by 90°. `second`: true focal length
/// of the last six photographs, divided by [`FOCAL`].
fn write_model(folder: &Path, second: f64, moved: DVec3) {
    std::fs::create_dir_all(folder.join("sparse/0")).expect("a folder");
    std::fs::create_dir_all(folder.join("images")).expect("a folder");
    let wave = |i: usize, by: f64| (by * (i + 1) as f64).sin();
    let points: Vec<DVec3> = (0..60).map(|i| DVec3::new(wave(i, 1.3), wave(i, 2.1), wave(i, 3.7))).collect();
    let (mut cameras, mut images, mut tracks) = (String::new(), String::new(), vec![String::new(); 60]);
    for i in 0..12 {
        let turned = i % 3 == 2;
        let (width, height) = if turned { (SIZE.1, SIZE.0) } else { SIZE };
        let picture = png(image::RgbImage::from_pixel(width, height, image::Rgb([20 * i as u8; 3])));
        std::fs::write(folder.join(format!("images/{i:02}.png")), picture).expect("a picture");
        let true_focal = if i < 6 { FOCAL } else { second * FOCAL };
        let quarter = if turned { 0.5 * std::f64::consts::PI } else { 0.0 };
        let tilt = 0.2 + 0.1 * (i % 4) as f64;
        let rotation = DQuat::from_euler(EulerRot::ZXY, quarter, tilt, 0.5 * i as f64);
        let away = DVec3::new(0.0, 0.0, 5.0);
        let mut seen = String::new();
        for (j, point) in points.iter().enumerate() {
            let at = rotation * *point + away;
            let x = true_focal * at.x / at.z + 0.5 * f64::from(width);
            let y = true_focal * at.y / at.z + 0.5 * f64::from(height);
            write!(seen, "{x} {y} {} ", j + 1).expect("room");
            write!(tracks[j], " {} {j}", i + 1).expect("room");
        }
        let error = 1.0 + 0.08 * wave(i, 1.7);
        writeln!(
            cameras,
            "{} SIMPLE_PINHOLE {width} {height} {} {} {}",
            i + 1,
            true_focal * error,
            width / 2,
            height / 2
        )
        .expect("room");
        let DQuat { x, y, z, w } = rotation;
        let t = away * DVec3::new(1.0, 1.0, error) - rotation * moved;
        writeln!(images, "{} {w} {x} {y} {z} {} {} {} {} {i:02}.png\n{seen}", i + 1, t.x, t.y, t.z, i + 1)
            .expect("room");
    }
    let of_point = |(j, (point, track)): (usize, (&DVec3, &String))| {
        let at = *point + moved;
        format!("{} {} {} {} 9 9 9 0.5{track}\n", j + 1, at.x, at.y, at.z)
    };
    let points: String = points.iter().zip(&tracks).enumerate().map(of_point).collect();
    for (name, text) in [("cameras", cameras), ("images", images), ("points3D", points)] {
        std::fs::write(folder.join(format!("sparse/0/{name}.txt")), text).expect("written");
    }
}

fn views(dataset: &Dataset) -> Vec<&View> {
    dataset.train.iter().chain(&dataset.val).collect()
}

/// Mean distance between key points and the projections of their 3D points, pixels of the views.
fn mean_error(dataset: &Dataset) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for view in views(dataset) {
        for key in &view.key_points {
            let point = Vec3::from(dataset.points[key.point as usize].position);
            let (x, y) = view.camera.project(point).expect("in front");
            (sum, count) = (sum + f64::from((x - key.x).hypot(y - key.y)), count + 1.0);
        }
    }
    sum / count
}

fn focals(dataset: &Dataset) -> Vec<f32> {
    let mut focals: Vec<f32> =
        views(dataset).iter().flat_map(|v| [v.camera.intrinsics().fx, v.camera.intrinsics().fy]).collect();
    focals.sort_by(f32::total_cmp);
    focals
}

fn same_cameras(a: &Dataset, b: &Dataset) -> bool {
    let cameras = |dataset: &Dataset| dataset.cameras().cloned().collect::<Vec<_>>();
    format!("{:?}{:?}", cameras(a), a.points) == format!("{:?}{:?}", cameras(b), b.points)
}

#[test]
fn a_focal_length_for_each_photograph_becomes_one_also_of_turned_ones() {
    for moved in [DVec3::ZERO, DVec3::new(5e6, -3e6, 100.0)] {
        let folder = tempfile::tempdir().expect("a folder");
        write_model(folder.path(), 1.0, moved);
        let own =
            read(folder.path(), &ReadOptions { cameras: Cameras::Own, ..Default::default() }).expect("own");
        let shared = read(folder.path(), &ReadOptions::default()).expect("shared");
        let [first, last] = [0, 23].map(|i| focals(&shared)[i]);
        assert!((first - 100.0).abs() < 0.1 && first == last, "{first} {last}");
        assert!(focals(&own)[23] > 106.0 && focals(&own)[0] < 94.0);
        assert!(
            mean_error(&own) > 0.1 && mean_error(&shared) < 0.02,
            "{} {}",
            mean_error(&own),
            mean_error(&shared)
        );
        assert_names(
            &shared.notes.join("\n"),
            &["one camera for 12 photographs: focal length 100.0 px", "--cameras own"],
        );
        assert_eq!(
            (cameras_in_name(&own.name), cameras_in_name(&shared.name)),
            (Cameras::Own, Cameras::Shared)
        );
    }
}

#[test]
fn shared_cameras_are_kept_once_and_read_from_there() {
    let folder = tempfile::tempdir().expect("a folder");
    let (scene, kept) = (folder.path().join("scene"), folder.path().join("a.cameras.json"));
    write_model(&scene, 1.0, DVec3::ZERO);
    let options = ReadOptions { shared_cameras: Some(kept.clone()), ..Default::default() };
    let evaluated = read(&scene, &ReadOptions { to_measure: true, ..options.clone() }).expect("a model");
    assert!(!kept.exists(), "written by whoever only reads");
    let first = read(&scene, &options).expect("a model");
    let written = std::fs::read(&kept).expect("kept");
    let again = read(&scene, &options).expect("a model");
    assert_names(&again.notes.join("\n"), &["read from", "a.cameras.json"]);
    assert!(same_cameras(&first, &again) && same_cameras(&first, &evaluated));
    assert_eq!(written, std::fs::read(&kept).expect("kept"));
    // For another model, the cameras are adjusted and stored again.
    write_model(&scene, 1.0, DVec3::new(1.0, 0.0, 0.0));
    read(&scene, &ReadOptions { to_measure: true, ..options.clone() }).expect("a model");
    assert_eq!(written, std::fs::read(&kept).expect("kept"));
    read(&scene, &options).expect("a model");
    assert_ne!(written, std::fs::read(&kept).expect("kept"));
    // A file with other contents is not overwritten.
    std::fs::write(&kept, "mine").expect("written");
    let refused = read(&scene, &options).expect_err("another file").to_string();
    assert_names(&refused, &["a.cameras.json", "shared cameras"]);
    assert_eq!(std::fs::read(&kept).expect("there"), b"mine");
}

#[test]
fn photographs_of_two_lenses_keep_their_cameras() {
    let folder = tempfile::tempdir().expect("a folder");
    write_model(folder.path(), 1.6, DVec3::ZERO);
    let read = read(folder.path(), &ReadOptions::default()).expect("a model");
    assert_names(
        &read.warnings.join("\n"),
        &["12 photographs with 12 cameras keep them", "reprojection error"],
    );
    assert!(focals(&read)[23] > 150.0 && focals(&read)[0] < 94.0);
    assert_eq!(cameras_in_name(&read.name), Cameras::Own);
}

#[test]
fn real_captures_have_one_focal_length_with_much_the_same_error() {
    for (name, middle) in [("cup_colmap", 593.3), ("mouse", 1385.1), ("can", 1117.0)] {
        let Some(path) = data(&format!("real/{name}")) else { continue };
        let with = |cameras| {
            let layout = Some(Layout::Colmap);
            let options = ReadOptions { downscale: Downscale::By(8), layout, cameras, ..Default::default() };
            read(&path, &options).expect(name)
        };
        let (own, shared) = (with(Cameras::Own), with(Cameras::Shared));
        println!("{name}: {}", shared.notes[1]);
        let focal = 8.0 * f64::from(focals(&shared)[0]);
        assert!((focal / middle - 1.0).abs() < 0.02, "{name}: {focal}");
        let (before, after) = (mean_error(&own), mean_error(&shared));
        println!("{:.3} px instead of {:.3}", 8.0 * after, 8.0 * before);
        assert!(after <= 1.1 * before, "{name}: {after} {before}");
    }
}
