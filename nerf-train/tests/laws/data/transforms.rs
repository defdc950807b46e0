use super::*;
use crate::encoders::{jpeg, png};
use image::DynamicImage;
use nerf_core::camera::Projection;
use serde_json::{Value, json};
use std::path::PathBuf;
use tempfile::TempDir;

/// Folder with `count` grey pictures of 8×4 pixels: `images/000.png`, `images/001.png`…
fn folder(count: usize) -> TempDir {
    let folder = tempfile::tempdir().expect("tempdir");
    std::fs::create_dir(folder.path().join("images")).expect("mkdir");
    for i in 0..count {
        picture(&folder, &format!("images/{i:03}.png"), 8, 4, i as u8);
    }
    folder
}

fn picture(folder: &TempDir, name: &str, width: u32, height: u32, grey: u8) {
    let picture = image::RgbImage::from_pixel(width, height, image::Rgb([grey; 3]));
    std::fs::write(folder.path().join(name), png(picture)).expect("written");
}

fn frames(count: usize) -> Vec<Value> {
    let poses = orbit(count, 4.0, Vec3::ZERO);
    let frame = |(i, pose): (usize, &Pose)| json!({ "file_path": format!("images/{i:03}.png"), "transform_matrix": matrix(pose) });
    poses.iter().enumerate().map(frame).collect()
}

fn write(folder: &TempDir, name: &str, value: &Value) -> PathBuf {
    let path = folder.path().join(name);
    std::fs::write(&path, serde_json::to_string_pretty(value).expect("json")).expect("write");
    path
}

/// Writes a nerfstudio file of ten views with the additional fields `extra`.
fn single(extra: &Value) -> (TempDir, PathBuf) {
    let folder = folder(10);
    let mut value = json!({ "fl_x": 10.0, "frames": frames(10) });
    for (key, field) in extra.as_object().expect("an object") {
        value[key] = field.clone();
    }
    let path = write(&folder, "transforms.json", &value);
    (folder, path)
}

fn error_with(extra: &Value) -> String {
    error_of(&single(extra).1)
}

#[test]
fn blender_reads_splits_with_and_without_extension() {
    let folder = folder(6);
    let mut all = frames(6);
    for frame in &mut all {
        let name = frame["file_path"].as_str().expect("a name").replace(".png", "");
        frame["file_path"] = json!(format!("./{name}"));
    }
    all[5]["file_path"] = json!("images\\005.png");
    let file = |frames: &[Value]| json!({ "camera_angle_x": 1.0, "frames": frames });
    let path = write(&folder, "transforms_train.json", &file(&all[..3]));
    let data = read_plain(folder.path()).expect("train alone");
    assert_eq!((data.train.len(), data.val.len(), data.test.len()), (3, 0, 0));
    assert_names(&data.warnings.join("\n"), &["no validation views"]);
    write(&folder, "transforms_val.json", &file(&all[3..5]));
    write(&folder, "transforms_test.json", &file(&all[5..]));
    for path in [folder.path().to_path_buf(), path] {
        let data = read_plain(&path).expect("whole");
        assert_eq!((data.format, data.axes), (Format::Blender, Axes::Opengl));
        assert_eq!((data.train.len(), data.val.len(), data.test.len()), (3, 2, 1));
        assert!(data.warnings.is_empty(), "{:?}", data.warnings);
        assert_eq!(*data.val[0].camera.pose(), orbit(6, 4.0, Vec3::ZERO)[3]);
        let i = data.val[0].camera.intrinsics();
        assert_eq!((i.fx, i.fy, i.cx, i.cy), (4.0 / 0.5f32.tan(), 4.0 / 0.5f32.tan(), 4.0, 2.0));
        assert_eq!(data.test[0].pixels[0], [5, 5, 5, 255]);
    }
}

#[test]
fn any_list_will_do_where_nothing_is_fitted() {
    let folder = folder(4);
    let all = frames(4);
    let path = write(&folder, "transforms_test.json", &json!({ "camera_angle_x": 1.0, "frames": all[..4] }));
    let measure = ReadOptions { to_measure: true, ..ReadOptions::default() };
    for path in [folder.path(), &path] {
        let data = read(path, &measure).expect("test alone");
        assert_eq!(
            (data.format, data.train.len(), data.val.len(), data.test.len()),
            (Format::Blender, 0, 0, 4)
        );
        assert!(data.warnings.is_empty(), "{:?}", data.warnings);
    }
    assert_names(&error_of(folder.path()), &["transforms_train.json"]);
}

#[test]
fn nerfstudio_holds_every_eighth_view() {
    let (_folder, path) =
        single(&json!({ "fl_y": 11.0, "cx": 3.5, "cy": 2.5, "k1": 0.01, "p2": 0.001, "near": 0.5 }));
    let data = read_plain(&path).expect("whole");
    let names = |views: &[View]| views.iter().map(|v| v.name[7..10].to_owned()).collect::<Vec<_>>();
    assert_eq!((data.format, names(&data.val)), (Format::Nerfstudio, vec!["000".into(), "008".into()]));
    assert_eq!((data.train.len(), data.near, data.far), (8, Some(0.5), None));
    let camera = &data.train[0].camera;
    let i = camera.intrinsics();
    assert_eq!((i.fx, i.fy, i.cx, i.cy), (10.0, 11.0, 3.5, 2.5));
    assert_eq!(*camera.lens(), Lens { k1: 0.01, p2: 0.001, ..Lens::NONE });
}

#[test]
fn nerfstudio_lists_decide_the_splits() {
    let (_folder, path) = single(&json!({
        "train_filenames": ["images/001.png", "./images/002.png"],
        "val_filenames": ["images/003.png"], "test_filenames": ["images/000.png"],
    }));
    let data = read_plain(&path).expect("whole");
    assert_eq!((data.train.len(), data.val.len(), data.test.len()), (2, 1, 1));
    assert_eq!(data.test[0].name, "images/000.png");
    assert_names(&data.warnings.join("\n"), &["6 views are in none", "images/004.png"]);
}

#[test]
fn one_view_is_for_training() {
    let folder = folder(1);
    let path = write(&folder, "capture.json", &json!({ "camera_angle_y": 1.0, "frames": frames(1) }));
    let data = read_plain(&path).expect("whole");
    assert_eq!((data.train.len(), data.val.len(), data.name.as_str()), (1, 0, "capture"));
    assert!(Report::of(&data).look_at.is_none());
}

#[test]
fn a_frame_overrides_the_file() {
    let folder = folder(2);
    let mut both = frames(2);
    both[1]["fl_x"] = json!(20.0);
    both[1]["k1"] = json!(0.02);
    let lists = json!(["images/000.png", "images/001.png"]);
    let value = json!({ "fl_x": 10.0, "k2": 0.01, "train_filenames": lists, "frames": both });
    let data = read_plain(&write(&folder, "transforms.json", &value)).expect("whole");
    let focal: Vec<f32> = data.train.iter().map(|v| v.camera.intrinsics().fx).collect();
    assert_eq!(focal, [10.0, 20.0]);
    assert_eq!(*data.train[1].camera.lens(), Lens { k1: 0.02, k2: 0.01, ..Lens::NONE });
}

#[test]
fn opencv_axes_can_be_asked_for() {
    let (_folder, path) = single(&json!({}));
    let options = ReadOptions { axes: Some(Axes::Opencv), ..Default::default() };
    let report = Report::of(&read(&path, &options).expect("whole"));
    assert_names(&report.warnings.join("\n"), &["--axes opengl"]);
    assert!(Report::of(&read_plain(&path).expect("whole")).warnings.is_empty());
}

#[test]
fn scaled_pictures_scale_the_intrinsics() {
    let (_folder, path) = single(&json!({ "w": 32, "h": 16.0, "fl_x": 40.0, "cx": 18.0 }));
    let data = read_plain(&path).expect("scaled");
    let i = data.train[0].camera.intrinsics();
    assert_eq!((i.width, i.fx, i.fy, i.cx, i.cy), (8, 10.0, 10.0, 4.5, 2.0));
    assert_names(&data.warnings.join("\n"), &["10 views", "8x4", "32x16"]);
    assert_names(&error_with(&json!({ "w": 30, "h": 30 })), &["000.png", "30x30", "8x4"]);
    assert_names(&error_with(&json!({ "w": 0, "h": 4 })), &["w", "found 0"]);
}

#[test]
fn missing_pictures_are_skipped_and_named() {
    let (folder, path) = single(&json!({}));
    std::fs::remove_file(folder.path().join("images/004.png")).expect("remove");
    picture(&folder, "images/005.png", 4, 4, 0);
    let data = read_plain(&path).expect("the others");
    assert_eq!(data.train.len() + data.val.len(), 9);
    assert_names(&data.warnings.join("\n"), &["skipped 1 of 10", "images/004.png"]);
    // Picture sizes may differ if the json states none.
    let sizes = Report::of(&data).sizes;
    assert_eq!(sizes.iter().map(|s| (s.width, s.count)).collect::<Vec<_>>(), [(4, 1), (8, 8)]);
    std::fs::remove_dir_all(folder.path().join("images")).expect("remove");
    assert_names(&error_of(&path), &["at least one training view", "images/000.png", "and 2 more"]);
}

#[test]
fn a_corrupt_picture_is_named() {
    let (folder, path) = single(&json!({}));
    let victim = folder.path().join("images/006.png");
    let whole = std::fs::read(&victim).expect("read");
    for bytes in [&whole[..whole.len() / 2], b"not a picture", b""] {
        std::fs::write(&victim, bytes).expect("write");
        assert_names(&error_of(&path), &["006.png", "PNG, JPEG, WebP, TIFF, BMP or GIF"]);
    }
    for byte in 0..whole.len() {
        let mut flipped = whole.clone();
        flipped[byte] ^= 0x41;
        std::fs::write(&victim, flipped).expect("write");
        let _ = read_plain(&path);
    }
}

#[test]
fn every_kind_of_picture_is_read() {
    let folder = folder(0);
    let kinds = [
        ("l8", DynamicImage::ImageLuma8(image::ImageBuffer::from_pixel(8, 4, image::Luma([7])))),
        ("la8", DynamicImage::ImageLumaA8(image::ImageBuffer::from_pixel(8, 4, image::LumaA([7, 99])))),
        ("rgba8", DynamicImage::ImageRgba8(image::ImageBuffer::from_pixel(8, 4, image::Rgba([7, 7, 7, 99])))),
        (
            "l16",
            DynamicImage::ImageLuma16(image::ImageBuffer::from_pixel(8, 4, image::Luma([7 * 257 + 128]))),
        ),
        (
            "rgb16",
            DynamicImage::ImageRgb16(image::ImageBuffer::from_pixel(8, 4, image::Rgb([7 * 257 - 128; 3]))),
        ),
        ("jpg", DynamicImage::ImageRgb8(image::ImageBuffer::from_pixel(8, 4, image::Rgb([7; 3])))),
    ];
    let pose = matrix(&orbit(1, 4.0, Vec3::ZERO)[0]);
    let mut list = Vec::new();
    for (name, picture) in kinds {
        let (ending, bytes) = if name == "jpg" { ("jpg", jpeg(picture)) } else { ("png", png(picture)) };
        std::fs::write(folder.path().join(format!("images/{name}.{ending}")), bytes).expect("written");
        list.push(json!({ "file_path": format!("images/{name}"), "transform_matrix": pose }));
    }
    write(&folder, "transforms_train.json", &json!({ "camera_angle_x": 1.0, "frames": list }));
    let data = read_plain(folder.path()).expect("whole");
    for view in &data.train {
        let alpha = if view.name.ends_with("a8") { 99 } else { 255 };
        assert_eq!(view.pixels[31], [7, 7, 7, alpha], "{}", view.name);
    }
    assert_eq!((data.train.len(), data.background), (6, Background::Alpha));
}

#[test]
fn cameras_that_cannot_be_done_are_refused() {
    assert_names(
        &error_with(&json!({ "camera_model": "THIN_PRISM_FISHEYE" })),
        &["camera_model", "THIN_PRISM_FISHEYE"],
    );
    assert_names(
        &error_with(&json!({ "is_fisheye": true, "p1": 0.1 })),
        &["lens p1: expected 0 in a fisheye"],
    );
    assert_names(&error_with(&json!({ "k4": 5000.0 })), &["k4", "moves a corner by"]);
    assert_names(&error_with(&json!({ "k1": -5.0 })), &["images/000.png", "turn back"]);
    assert_names(&error_with(&json!({ "k1": 1e300 })), &["k1", "finite"]);
    assert_names(&error_with(&json!({ "fl_x": 0.0 })), &["fx", "found 0"]);
    assert_names(&error_with(&json!({ "fl_x": null })), &["fl_x (or camera_angle_x)"]);
    assert_names(&error_with(&json!({ "near": 2.0, "far": 1.0 })), &["near 2", "far 1"]);
    let (_folder, path) = single(&json!({ "k4": 1e-3, "camera_model": "opencv" }));
    let data = read_plain(&path).expect("a negligible k4");
    assert_names(&data.warnings.join("\n"), &["k4 is ignored"]);
}

#[test]
fn wrong_poses_name_their_view() {
    let cases = [
        (json!([[1, 0, 0], [0, 1, 0]]), "rows of lengths [3, 3]"),
        (json!([[2, 0, 0, 0], [0, 2, 0, 0], [0, 0, 2, 0], [0, 0, 0, 1]]), "determinant 8"),
        (json!([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, -1, 0]]), "determinant -1"),
        (json!([[1, 0, 0, 1e39], [0, 1, 0, 0], [0, 0, 1, 0]]), "finite"),
    ];
    for (pose, part) in cases {
        let mut list = frames(10);
        list[3]["transform_matrix"] = pose;
        assert_names(&error_with(&json!({ "frames": list })), &["images/003.png", part]);
    }
    let mut list = frames(10);
    list[3]["transform_matrix"][1][1] =
        json!(list[3]["transform_matrix"][1][1].as_f64().expect("a number") + 1e-4);
    assert!(read_plain(&single(&json!({ "frames": list })).1).is_ok(), "rounding is no error");
}

#[test]
fn json_errors_have_a_line() {
    let (folder, path) = single(&json!({}));
    for (text, parts) in [
        ("{\n  \"frames\": [\n", &["transforms.json", "line 3", "EOF"][..]),
        ("{\n \"fl_x\": NaN }", &["line 2"]),
        ("{\n}", &["line 2", "missing field `frames`"]),
        ("{ \"frames\": [\n { \"file_path\": \"a\" }\n] }", &["line 2", "missing field `transform_matrix`"]),
        (
            "{ \"frames\": [\n { \"file_path\": 3, \"transform_matrix\": [] }\n] }",
            &["line 2", "expected a string"],
        ),
        // A null in an optional field is not reported as NaN.
        (
            "{ \"frames\": [\n { \"file_path\": \"a\", \"mask_path\": null }\n] }",
            &["line 2", "missing field `transform_matrix`"],
        ),
        ("{ \"fl_x\": \"ten\",\n \"frames\": [] }", &["line 1", "f64"]),
        ("", &["line 1"]),
        ("{ \"frames\": [] }", &["at least one training view"]),
    ] {
        std::fs::write(&path, text).expect("write");
        assert_names(&error_of(&path), parts);
    }
    // NaN and Infinity as Python's json module writes them.
    for (word, name) in [("NaN", "a.jpg"), ("-Infinity", "b, NaN.jpg"), ("Infinity", "c.jpg")] {
        let frame = |name: &str, value: &str| {
            format!(
                "{{ \"file_path\": \"{name}\",\n \"transform_matrix\": [[1, 0, 0, {value}], [0, 1, 0, 0], [0, 0, 1, 0]] }}"
            )
        };
        let text = format!("{{ \"frames\": [{}, {}] }}", frame("whole.jpg", "3"), frame(name, word));
        std::fs::write(&path, text).expect("write");
        let place = format!("transforms.json: line 3, view `{name}`, transform_matrix");
        assert_names(&error_of(&path), &[&place, "expected finite numbers", "NaN or Infinity"]);
    }
    std::fs::write(&path, "[".repeat(100_000)).expect("write");
    assert!(read_plain(&path).is_err());
    std::fs::write(folder.path().join("transforms.json"), [0xff, 0xfe, 0x00]).expect("write");
    assert!(read_plain(folder.path()).is_err());
}

#[test]
fn fisheyes_and_full_opencv_are_lenses() {
    let all = json!({ "k1": 0.1, "k2": 0.02, "k3": 0.003, "k4": 0.0004 });
    let with = |extra: Value| {
        let mut fields = all.clone();
        extra.as_object().expect("an object").iter().for_each(|(key, value)| fields[key] = value.clone());
        *read_plain(&single(&fields).1).expect("a data set").train[0].camera.lens()
    };
    let fisheye =
        Lens { k1: 0.1, k2: 0.02, k3: 0.003, k4: 0.0004, projection: Projection::Fisheye, ..Lens::NONE };
    assert_eq!(with(json!({ "is_fisheye": true })), fisheye);
    assert_eq!(with(json!({ "camera_model": "OPENCV_FISHEYE" })), fisheye);
    let full = Lens { k5: 0.05, k6: 0.006, p1: 0.001, projection: Projection::Perspective, ..fisheye };
    assert_eq!(with(json!({ "camera_model": "full_opencv", "k5": 0.05, "k6": 0.006, "p1": 0.001 })), full);
    assert_eq!(with(json!({ "k4": 0.0 })), Lens { k4: 0.0, projection: Projection::Perspective, ..fisheye });
    assert_names(
        &error_with(&json!({ "camera_model": "EQUIRECTANGULAR" })),
        &["camera_model", "OPENCV_FISHEYE"],
    );
}
