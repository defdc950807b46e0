//! Tests of COLMAP models with their photographs: valid, damaged and odd ones.

use super::*;
use crate::encoders::png;
use glam::{DQuat, DVec3, Quat};
use image::{Rgb, RgbImage};
use nerf_core::camera::Projection;
use tempfile::TempDir;

/// Width and height of the photographs in these tests, pixels.
const SIZE: (u32, u32) = (8, 6);

/// COLMAP model that a test writes to files. `cameras`: number, camera model, parameters. `images`: name, number of the
/// camera. `points`: position, number of photographs that see the point.
pub(super) struct Made {
    pub(super) cameras: Vec<(u32, i32, Vec<f64>)>,
    pub(super) images: Vec<(String, u32)>,
    pub(super) points: Vec<([f64; 3], u64)>,
    /// Shift of all cameras and points, world units.
    pub(super) moved: DVec3,
}

impl Made {
    /// Model of `count` photographs of one PINHOLE camera.
    pub(super) fn plain(count: usize) -> Self {
        Self {
            cameras: vec![(1, 1, vec![10.0, 11.0, 4.5, 2.5])],
            images: (0..count).map(|i| (format!("{i}.jpg"), 1)).collect(),
            points: vec![([1.0, 2.0, 3.0], 2), ([-1.0, 0.5, 0.0], 3), ([9.0, 9.0, 9.0], 0)],
            moved: DVec3::ZERO,
        }
    }

    /// Rotation and translation, world to camera, of photograph `i` in COLMAP's axes.
    fn world_to_camera(&self, i: usize) -> (DQuat, DVec3) {
        let pose = Axes::Opencv.to_opengl(orbit(self.images.len(), 4.0, Vec3::ZERO)[i]);
        let rotation = Quat::from_mat3(&pose.rotation.transpose()).as_dquat().normalize();
        (rotation, -(rotation * (pose.position.as_dvec3() + self.moved)))
    }

    /// For each point: index, shifted position, and number of photographs that see it.
    fn positions(&self) -> impl Iterator<Item = (usize, [f64; 3], u64)> {
        let moved = |position: [f64; 3]| (DVec3::from(position) + self.moved).to_array();
        self.points.iter().enumerate().map(move |(i, &(position, track))| (i, moved(position), track))
    }

    pub(super) fn binary(&self, folder: &Path) {
        let mut cameras = (self.cameras.len() as u64).to_le_bytes().to_vec();
        for (number, model, parameters) in &self.cameras {
            cameras.extend(number.to_le_bytes());
            cameras.extend(model.to_le_bytes());
            cameras.extend([SIZE.0, SIZE.1].map(|side| u64::from(side).to_le_bytes()).concat());
            cameras.extend(parameters.iter().flat_map(|p| p.to_le_bytes()));
        }
        let mut images = (self.images.len() as u64).to_le_bytes().to_vec();
        for (i, (name, camera)) in self.images.iter().enumerate() {
            let (q, t) = self.world_to_camera(i);
            images.extend((i as u32 + 1).to_le_bytes());
            images.extend([q.w, q.x, q.y, q.z, t.x, t.y, t.z].iter().flat_map(|v| v.to_le_bytes()));
            images.extend(camera.to_le_bytes());
            images.extend(name.as_bytes());
            images.push(0);
            images.extend(2u64.to_le_bytes());
            images.extend([7; 48]);
        }
        let mut points = (self.points.len() as u64).to_le_bytes().to_vec();
        for (i, position, track) in self.positions() {
            points.extend((i as u64).to_le_bytes());
            points.extend(position.iter().flat_map(|v| v.to_le_bytes()));
            points.extend([5; 11]);
            points.extend(track.to_le_bytes());
            points.extend(vec![1; 8 * track as usize]);
        }
        for (name, bytes) in [("cameras", cameras), ("images", images), ("points3D", points)] {
            put(folder, &format!("{name}.bin"), bytes);
        }
    }

    pub(super) fn text(&self, folder: &Path) {
        const NAMES: [&str; 6] =
            ["SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "OPENCV_FISHEYE"];
        let words = |numbers: &[f64]| numbers.iter().map(f64::to_string).collect::<Vec<_>>().join(" ");
        let mut cameras = format!("# Camera list\n# Number of cameras: {}\n", self.cameras.len());
        for (number, model, parameters) in &self.cameras {
            let name = NAMES[*model as usize];
            cameras += &format!("{number} {name} {} {} {}\n", SIZE.0, SIZE.1, words(parameters));
        }
        let mut images =
            format!("# Number of images: {}, mean observations per image: 2\n", self.images.len());
        for (i, (name, camera)) in self.images.iter().enumerate() {
            let (q, t) = self.world_to_camera(i);
            let numbers = [q.w, q.x, q.y, q.z, t.x, t.y, t.z];
            let points = if i % 2 == 0 { "1.5 2.5 -1 3 4 7" } else { "" };
            images += &format!("{} {} {camera} {name}\n{points}\n", i + 1, words(&numbers));
        }
        let mut points = String::from("# 3D point list\n");
        for (i, position, track) in self.positions() {
            let track = " 1 0".repeat(track as usize);
            points += &format!("{i} {} 1 2 3 0.5{track}\n", words(&position));
        }
        for (name, text) in [("cameras", cameras), ("images", images), ("points3D", points)] {
            put(folder, &format!("{name}.txt"), text.into_bytes());
        }
    }

    /// Writes the photographs to `folder`, each in a grey level of its own.
    pub(super) fn photographs(&self, folder: &Path, (width, height): (u32, u32)) {
        for (i, (name, _)) in self.images.iter().enumerate() {
            grey(&folder.join(name), (width, height), i as u8);
        }
    }
}

fn put(folder: &Path, name: &str, bytes: Vec<u8>) {
    std::fs::create_dir_all(folder).expect("a folder");
    std::fs::write(folder.join(name), bytes).expect("written");
}

fn grey(path: &Path, (width, height): (u32, u32), value: u8) {
    std::fs::create_dir_all(path.parent().expect("a folder")).expect("a folder");
    let picture = RgbImage::from_pixel(width, height, Rgb([value; 3]));
    std::fs::write(path, png(picture)).expect("written");
}

/// Folder with the binary model `made` in `sparse/0`, and its photographs in `images`.
fn folder_of(made: &Made) -> TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    made.binary(&folder.path().join("sparse/0"));
    made.photographs(&folder.path().join("images"), SIZE);
    folder
}

fn said(data: &Dataset) -> String {
    [&data.notes[..], &data.warnings[..]].concat().join("\n")
}

fn assert_poses(data: &Dataset, count: usize) {
    let poses = orbit(count, 4.0, Vec3::ZERO);
    for view in data.train.iter().chain(&data.val) {
        let stem = view.name.rsplit('/').next().and_then(|name| name.split('.').next());
        let index: usize = stem.and_then(|stem| stem.parse().ok()).expect("a number");
        let (found, pose) = (view.camera.pose(), poses[index]);
        let off = found.rotation - pose.rotation;
        let off = off.to_cols_array().into_iter().fold(0.0f32, |worst, v| worst.max(v.abs()));
        assert!(off < 1e-6 && (found.position - pose.position).length() < 1e-5, "{}: {found:?}", view.name);
    }
}

#[test]
fn colmap_models_are_read_binary_and_text_wherever_they_are() {
    let made = Made::plain(10);
    for place in ["sparse/0", "sparse/1", "sparse", "."] {
        for binary in [true, false] {
            let folder = tempfile::tempdir().expect("a folder");
            let model = folder.path().join(place);
            if binary {
                made.binary(&model)
            } else {
                made.text(&model)
            }
            // Newer versions of COLMAP also write these two files.
            put(&model, "rigs.bin", vec![1]);
            put(&model, "frames.bin", vec![1]);
            let photographs =
                if place == "." { folder.path().to_owned() } else { folder.path().join("images") };
            made.photographs(&photographs, SIZE);
            let mut paths = vec![folder.path().to_owned()];
            paths.extend((place == "sparse/0").then_some(model));
            for path in paths {
                let data = read_plain(&path).unwrap_or_else(|error| panic!("{place}: {error}"));
                assert_eq!((data.format, data.axes), (Format::Colmap, Axes::Opencv));
                let names: Vec<&str> = data.val.iter().map(|view| view.name.as_str()).collect();
                assert_eq!((data.train.len(), names), (8, vec!["0.jpg", "8.jpg"]));
                let i = data.train[0].camera.intrinsics();
                assert_eq!((i.width, i.height, i.fx, i.fy, i.cx, i.cy), (8, 6, 10.0, 11.0, 4.5, 2.5));
                assert_eq!(data.train[0].pixels[0], [1, 1, 1, 255]);
                let positions: Vec<_> = data.points.iter().map(|point| point.position).collect();
                assert_eq!(positions, [[1.0, 2.0, 3.0], [-1.0, 0.5, 0.0]]);
                assert_poses(&data, 10);
                assert_names(
                    &said(&data),
                    &["10 of 10 registered", "PINHOLE", "2 of 10 held out", "skipped 1 points"],
                );
            }
        }
    }
}

#[test]
fn the_lenses_of_colmap_are_the_cores() {
    let fisheye = Lens { projection: Projection::Fisheye, ..Lens::NONE };
    let cases: [(i32, &[f64], [f32; 3], Lens); 8] = [
        (0, &[10.0, 4.0, 3.0], [10.0, 10.0, 4.0], Lens::NONE),
        (1, &[10.0, 11.0, 4.0, 3.0], [10.0, 11.0, 4.0], Lens::NONE),
        (2, &[10.0, 4.0, 3.0, 0.1], [10.0, 10.0, 4.0], Lens { k1: 0.1, ..Lens::NONE }),
        (3, &[10.0, 4.0, 3.0, 0.1, 0.02], [10.0, 10.0, 4.0], Lens { k1: 0.1, k2: 0.02, ..Lens::NONE }),
        (
            4,
            &[10.0, 11.0, 4.0, 3.0, 0.1, 0.02, 0.001, -0.002],
            [10.0, 11.0, 4.0],
            Lens { k1: 0.1, k2: 0.02, p1: 0.001, p2: -0.002, ..Lens::NONE },
        ),
        (
            5,
            &[10.0, 11.0, 4.0, 3.0, 0.1, 0.02, 0.001, -0.002],
            [10.0, 11.0, 4.0],
            Lens { k1: 0.1, k2: 0.02, k3: 0.001, k4: -0.002, ..fisheye },
        ),
        (
            6,
            &[10.0, 11.0, 4.0, 3.0, 0.1, 0.02, 0.001, -0.002, 0.3, 0.4, 0.5, 0.6],
            [10.0, 11.0, 4.0],
            Lens {
                k1: 0.1,
                k2: 0.02,
                p1: 0.001,
                p2: -0.002,
                k3: 0.3,
                k4: 0.4,
                k5: 0.5,
                k6: 0.6,
                ..Lens::NONE
            },
        ),
        (9, &[10.0, 4.0, 3.0, 0.1, 0.02], [10.0, 10.0, 4.0], Lens { k1: 0.1, k2: 0.02, ..fisheye }),
    ];
    for (model, parameters, expected, lens) in cases {
        let mut made = Made::plain(3);
        made.cameras = vec![(7, model, parameters.to_vec())];
        made.images.iter_mut().for_each(|image| image.1 = 7);
        let data = read_plain(folder_of(&made).path()).expect("a model");
        let i = data.train[0].camera.intrinsics();
        assert_eq!(([i.fx, i.fy, i.cx], *data.train[0].camera.lens()), (expected, lens));
    }
    let mut made = Made::plain(3);
    made.cameras = vec![(1, 7, vec![10.0, 10.0, 4.0, 3.0, 0.9])];
    assert_names(
        &error_of(folder_of(&made).path()),
        &["images.bin", "`0.jpg`", "camera model", "OPENCV", "found FOV"],
    );
    made.cameras = vec![(1, 99, vec![])];
    assert_names(&error_of(folder_of(&made).path()), &["cameras.bin", "model", "byte", "found 99"]);
    made.cameras = vec![(2, 1, vec![10.0, 11.0, 4.5, 2.5])];
    assert_names(&error_of(folder_of(&made).path()), &["`0.jpg`, camera", "found number 1"]);
}

#[test]
fn of_several_models_the_largest_is_read() {
    let (large, small) = (Made::plain(5), Made::plain(4));
    let folder = folder_of(&small);
    large.binary(&folder.path().join("sparse/1"));
    large.photographs(&folder.path().join("images"), SIZE);
    let data = read_plain(folder.path()).expect("a model");
    assert_eq!(data.train.len() + data.val.len(), 5);
    assert_names(&said(&data), &["of several models the largest is read: sparse/1, of 5"]);
}

#[test]
fn names_hold_folders_and_spaces_and_missing_photographs_are_not_counted() {
    let mut made = Made::plain(9);
    for (i, (name, _)) in made.images.iter_mut().enumerate() {
        *name = format!("left cam/deep er/{i}.JPG");
    }
    for binary in [true, false] {
        let folder = tempfile::tempdir().expect("a folder");
        let model = folder.path().join("sparse/0");
        if binary {
            made.binary(&model)
        } else {
            made.text(&model)
        }
        made.photographs(&folder.path().join("images"), SIZE);
        std::fs::remove_file(folder.path().join("images").join(&made.images[0].0)).expect("removed");
        let data = read_plain(folder.path()).expect("a model");
        // The first photograph that exists is held out.
        assert_eq!((data.train.len(), data.val[0].name.as_str()), (7, "left cam/deep er/1.JPG"));
        assert_names(&said(&data), &["skipped 1 of 9 registered", "left cam/deep er/0.JPG"]);
        let options = ReadOptions { hold_offset: 4, ..ReadOptions::default() };
        let other = read(folder.path(), &options).expect("a model");
        assert_eq!(
            other.val.iter().map(|view| view.name.as_str()).collect::<Vec<_>>(),
            ["left cam/deep er/5.JPG"]
        );
    }
}

#[test]
fn photographs_of_colmap_lie_in_its_folder_unless_the_flag_says_otherwise() {
    let mut made = Made::plain(3);
    made.images[1].0 = "../../outside.jpg".into();
    let above = tempfile::tempdir().expect("a folder");
    let folder = above.path().join("data");
    made.binary(&folder.join("sparse/0"));
    made.photographs(&folder.join("images"), SIZE);
    assert_names(&error_of(&folder), &["images.bin", "outside.jpg", "--outside-files"]);
    let options = ReadOptions { outside_files: true, ..ReadOptions::default() };
    assert_eq!(read(&folder, &options).expect("a model").train.len(), 2);
}

#[test]
fn a_model_cut_at_any_byte_is_refused_with_its_file() {
    let made = Made::plain(3);
    for (binary, names) in [
        (true, ["cameras.bin", "images.bin", "points3D.bin"]),
        (false, ["cameras.txt", "images.txt", "points3D.txt"]),
    ] {
        let folder = tempfile::tempdir().expect("a folder");
        let model = folder.path().join("sparse/0");
        if binary {
            made.binary(&model)
        } else {
            made.text(&model)
        }
        made.photographs(&folder.path().join("images"), SIZE);
        let mut accepted = Vec::new();
        for name in names {
            let path = model.join(name);
            let whole = std::fs::read(&path).expect("read");
            for length in 0..whole.len() {
                std::fs::write(&path, &whole[..length]).expect("written");
                match read_plain(folder.path()) {
                    Ok(_) => accepted.push((name, length, whole[..length].ends_with(b"\n"))),
                    Err(error) => assert_names(&error.to_string(), &[name]),
                }
            }
            std::fs::write(&path, &whole).expect("written");
        }
        // A shortened points3D.txt may be read if it ends with a whole line. The other text files state the number of
        // items in a comment, so that shortening is an error.
        assert!(
            accepted.iter().all(|(name, length, line)| *name == "points3D.txt" && (*line || *length == 0)),
            "{accepted:?}"
        );
        assert!(read_plain(folder.path()).is_ok());
    }
}

#[test]
fn counts_near_the_end_of_u64_take_no_memory() {
    let made = Made::plain(3);
    let folder = folder_of(&made);
    let model = folder.path().join("sparse/0");
    // Tests three kinds of counts: of a file's items, of a photograph's key points, and of the photographs in a point's
    // track.
    let images = std::fs::read(model.join("images.bin")).expect("read");
    let points_of_first = 8 + 4 + 56 + 4 + "0.jpg".len() + 1;
    for (name, at) in [
        ("cameras.bin", 0),
        ("images.bin", 0),
        ("points3D.bin", 0),
        ("images.bin", points_of_first),
        ("points3D.bin", 8 + 8 + 24 + 11),
    ] {
        for count in [u64::MAX, u64::MAX / 24, u64::MAX / 24 + 2, u64::MAX / 8 + 2, 1 << 40, 4] {
            let path = model.join(name);
            let whole = std::fs::read(&path).expect("read");
            let mut bytes = whole.clone();
            bytes[at..at + 8].copy_from_slice(&count.to_le_bytes());
            std::fs::write(&path, bytes).expect("written");
            assert_names(&error_of(folder.path()), &[name]);
            std::fs::write(&path, whole).expect("written");
        }
    }
    assert_eq!(std::fs::read(model.join("images.bin")).expect("read"), images);
}

#[test]
fn numbers_that_are_none_are_named() {
    let made = Made::plain(3);
    let folder = folder_of(&made);
    let model = folder.path().join("sparse/0");
    for (name, at, words) in [
        ("images.bin", 12, &["`0.jpg`, pose"][..]),
        ("images.bin", 12 + 32, &["`0.jpg`, pose"]),
        ("cameras.bin", 8 + 24, &["`0.jpg`", "fx"]),
        ("points3D.bin", 16, &["point number 0", "finite"]),
    ] {
        let path = model.join(name);
        let whole = std::fs::read(&path).expect("read");
        let mut bytes = whole.clone();
        bytes[at..at + 8].copy_from_slice(&f64::NAN.to_le_bytes());
        std::fs::write(&path, bytes).expect("written");
        assert_names(&error_of(folder.path()), words);
        std::fs::write(&path, whole).expect("written");
    }
}

#[test]
fn odd_sets_of_cameras_are_named() {
    // Tests a name that occurs twice, a valid model, two equal poses, and cameras that look away from each other.
    let mut made = Made::plain(3);
    made.images[2].0 = "0.jpg".into();
    assert_names(&error_of(folder_of(&made).path()), &["images.bin", "photograph `0.jpg`", "one pose"]);
    let folder = folder_of(&Made::plain(3));
    let data = read_plain(folder.path()).expect("a model");
    assert_eq!((data.train.len(), data.val.len()), (2, 1));
    assert!(!Report::of(&data).warnings.join("").contains("pose of another"));
    let path = folder.path().join("sparse/0/images.bin");
    let mut bytes = std::fs::read(&path).expect("read");
    let record = (bytes.len() - 8) / 3;
    // Copies the first pose (7 × 8 bytes) over the second; a pose follows the photograph's number (4 bytes).
    bytes.copy_within(8 + 4..8 + 4 + 56, 8 + record + 4);
    std::fs::write(&path, bytes).expect("written");
    let twins = Report::of(&read_plain(folder.path()).expect("a model"));
    assert_names(&twins.warnings.join("\n"), &["1 views have the pose of another", "0.jpg and 1.jpg"]);
    let options = ReadOptions { axes: Some(Axes::Opengl), ..ReadOptions::default() };
    let away = Report::of(&read(folder_of(&Made::plain(9)).path(), &options).expect("a model"));
    assert_names(&away.warnings.join("\n"), &["look away from the point", "--axes opencv"]);
    assert!(away.near.is_none());
}

#[test]
fn a_world_far_from_its_origin_is_counted_from_near_its_cameras() {
    let near = read_plain(folder_of(&Made::plain(10)).path()).expect("a model");
    assert_eq!(near.origin, [0.0; 3]);
    for moved in [DVec3::new(1e6, -2e6, 5e5), DVec3::new(0.0, 4e9, 0.0)] {
        let text = tempfile::tempdir().expect("a folder");
        let made = Made { moved, ..Made::plain(10) };
        made.text(&text.path().join("sparse/0"));
        made.photographs(&text.path().join("images"), SIZE);
        for folder in [folder_of(&made), text] {
            let far = read_plain(folder.path()).expect("a model");
            let origin = DVec3::from(far.origin);
            assert!((origin - moved).abs().max_element() <= 10.0, "{origin}");
            let shown = format!("({}, {}, {})", origin.x, origin.y, origin.z);
            assert!(far.name.ends_with(&shown) && said(&far).contains(&shown), "{} {}", far.name, said(&far));
            let here = |position: Vec3| (position.as_dvec3() + (moved - origin)).as_vec3();
            for (view, expected) in far.train.iter().zip(&near.train) {
                let expected = here(expected.camera.pose().position);
                assert!((view.camera.pose().position - expected).length() < 1e-5, "{moved}: {}", view.name);
            }
            for (point, expected) in far.points.iter().zip(&near.points) {
                let expected = here(expected.position.into());
                assert!((Vec3::from(point.position) - expected).length() < 1e-5, "{moved}");
            }
        }
    }
}
