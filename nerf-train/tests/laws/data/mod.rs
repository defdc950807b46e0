//! Tests of every layout and every error on small generated data sets, and on real data if present.

mod geometry;
mod llff;
mod npz;
mod photographs;
mod pictures;
mod real;
mod shared;
mod transforms;
mod untrusted;
mod viewpoint;

use glam::Vec3;
use nerf_core::camera::{Camera, Intrinsics, Lens, Pose};
use nerf_train::data::{
    Axes, Background, Dataset, DatasetError, Format, LookAt, ReadOptions, Report, View, mean_colour, read,
};
use std::path::Path;

/// `count` poses on a golden spiral of the upper hemisphere of `radius` around `target`, looking at `target`.
fn orbit(count: usize, radius: f32, target: Vec3) -> Vec<Pose> {
    (0..count)
        .map(|i| {
            let z = 0.1 + 0.8 * (i as f32 + 0.5) / count as f32;
            let (sin, cos) = (2.4 * i as f32).sin_cos();
            let r = (1.0 - z * z).sqrt();
            let eye = target + radius * Vec3::new(r * cos, r * sin, z);
            Pose::look_at(eye, target, Vec3::Z).expect("not looking along z")
        })
        .collect()
}

fn camera(pose: Pose) -> Camera {
    Camera::new(Intrinsics::centred(8, 6, 10.0), Lens::NONE, pose).expect("an orbit")
}

fn dataset_of(poses: &[Pose], axes: Axes) -> Dataset {
    let view = |pose: &Pose| View {
        name: "v".into(),
        camera: camera(*pose),
        pixels: vec![[0; 4]; 48],
        mask: None,
        near: 0.0,
        key_points: Vec::new(),
    };
    Dataset {
        train: poses.iter().map(view).collect(),
        background: Background::Alpha,
        ..Dataset::empty("made".into(), Format::Nerfstudio, axes)
    }
}

/// Camera-to-world matrix of `pose`, 4×4, row-major.
fn matrix(pose: &Pose) -> [[f32; 4]; 4] {
    let [a, b, c] = pose.to_rows();
    [a, b, c, [0.0, 0.0, 0.0, 1.0]]
}

fn read_plain(path: &Path) -> Result<Dataset, DatasetError> {
    read(path, &ReadOptions::default())
}

/// Text of the error from reading `path`; panics if reading succeeds.
fn error_of(path: &Path) -> String {
    match read_plain(path) {
        Ok(dataset) => panic!("{} was read: {:?}", path.display(), dataset.warnings),
        Err(error) => error.to_string(),
    }
}

fn assert_names(text: &str, parts: &[&str]) {
    for part in parts {
        assert!(text.contains(part), "`{part}` is not in: {text}");
    }
}

#[test]
fn near_must_be_below_far() {
    let options = ReadOptions { near: Some(3.0), far: Some(2.0), ..Default::default() };
    let error = read(Path::new("anything"), &options).expect_err("near > far").to_string();
    assert_names(&error, &["near 3", "far 2"]);
    let options = ReadOptions { near: Some(f32::NAN), ..Default::default() };
    assert!(matches!(read(Path::new("anything"), &options), Err(DatasetError::Range(_))));
}

#[test]
fn what_is_no_data_set_is_named() {
    let folder = tempfile::tempdir().expect("tempdir");
    assert!(matches!(read_plain(&folder.path().join("none")), Err(DatasetError::Missing { .. })));
    assert_names(&error_of(folder.path()), &["transforms_train.json", "transforms.json"]);
    let file = folder.path().join("a.npz");
    std::fs::write(&file, b"hello").expect("write");
    assert_names(&error_of(&file), &["a.npz", "expected a whole .npz (zip) archive"]);
}

#[test]
fn axes_conversion_is_its_own_inverse() {
    let pose = orbit(3, 4.0, Vec3::ZERO)[1];
    assert_eq!(Axes::Opencv.to_opengl(Axes::Opencv.to_opengl(pose)), pose);
    assert_eq!(Axes::Opengl.to_opengl(pose), pose);
    assert_eq!(Axes::Opencv.to_opengl(pose).forward(), -pose.forward());
    assert_eq!("OpenCV".parse(), Ok(Axes::Opencv));
    assert!("opengl2".parse::<Axes>().is_err());
}

#[test]
fn compositing_is_straight_alpha_in_display_space() {
    let mut view = dataset_of(&orbit(1, 4.0, Vec3::ZERO), Axes::Opengl).train.remove(0);
    view.pixels[1] = [255, 0, 51, 51];
    assert_eq!(view.composite_over([1.0, 1.0, 0.5])[0], [1.0, 1.0, 0.5]);
    let [r, g, b] = view.composite_over([1.0, 1.0, 0.5])[1];
    assert!((r - 1.0).abs() < 1e-6 && (g - 0.8).abs() < 1e-6 && (b - 0.44).abs() < 1e-6);
    assert_eq!((view.size(), view.pixel(1, 0)), ((8, 6), Some([255, 0, 51, 51])));
    assert_eq!((view.pixel(8, 0), view.pixel(0, 6)), (None, None));
}

#[test]
fn background_is_alpha_or_the_border_colour_or_unknown() {
    let mut views = dataset_of(&orbit(2, 4.0, Vec3::ZERO), Axes::Opengl).train;
    assert_eq!(Background::of(&views), Background::Alpha);
    for view in &mut views {
        view.pixels.fill([9, 8, 7, 255]);
        view.pixels[10] = [1, 2, 3, 255];
    }
    assert_eq!(Background::of(&views), Background::Constant([9, 8, 7]));
    for (i, pixel) in views.iter_mut().flat_map(|v| &mut v.pixels).enumerate() {
        pixel[0] = i as u8;
    }
    assert_eq!(Background::of(&views), Background::Unknown);
}

#[test]
fn the_mean_colour_is_that_of_the_pixels_that_count() {
    let mut views = dataset_of(&orbit(2, 3.0, Vec3::ZERO), Axes::Opengl).train;
    assert_eq!(mean_colour(&views), [0.0; 3]);
    views[0].pixels[..24].fill([255, 51, 0, 255]);
    assert_eq!(mean_colour(&views), [0.25, 0.05, 0.0]);
    views[0].mask = Some((0..48).map(|i| i < 24).collect());
    views[1].mask = Some(vec![false; 48]);
    assert_eq!(mean_colour(&views), [1.0, 0.2, 0.0]);
    assert_eq!(mean_colour(&[]), [0.0; 3]);
}
