//! Tests of inputs that are easily misread: EXIF orientations, bottom rows of pose matrices, angles in degrees, alpha,
//! paths.

use super::*;
use crate::encoders::png;
use serde_json::{Value, json};
use std::path::PathBuf;
use tempfile::TempDir;

/// Width and height of the pictures as stored, pixels.
const STORED: (u32, u32) = (16, 8);

/// JPEG that is white in its lower left quarter and black elsewhere. `orientation`: value of its EXIF tag.
fn jpeg(orientation: u8) -> Vec<u8> {
    let (width, height) = STORED;
    let white = |x: u32, y: u32| image::Luma([if x < width / 2 && y >= height / 2 { 255 } else { 0 }]);
    let picture = image::GrayImage::from_fn(width, height, white);
    let mut plain = Vec::new();
    let encoder = image::codecs::jpeg::JpegEncoder::new_with_quality(&mut plain, 100);
    picture.write_with_encoder(encoder).expect("a JPEG");
    // Little-endian TIFF with one entry: tag 0x112 (orientation), a u16.
    let mut exif = b"Exif\0\0II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0".to_vec();
    exif.extend([orientation, 0, 0, 0, 0, 0, 0, 0]);
    let length = (exif.len() as u16 + 2).to_be_bytes();
    [&plain[..2], &[0xff, 0xe1], &length, &exif, &plain[2..]].concat()
}

/// Writes a `transforms.json` of `count` pictures, `a0.jpg`, `a1.jpg`…, with the additional fields `extra`.
fn write(folder: &TempDir, count: usize, extra: &Value) -> PathBuf {
    let frame = |(i, pose): (usize, &Pose)| json!({ "file_path": format!("a{i}.jpg"), "transform_matrix": matrix(pose) });
    let frames: Vec<Value> = orbit(count, 4.0, Vec3::ZERO).iter().enumerate().map(frame).collect();
    let mut value = json!({ "fl_x": 10.0, "frames": frames });
    for (key, field) in extra.as_object().expect("an object") {
        value[key] = field.clone();
    }
    let path = folder.path().join("transforms.json");
    std::fs::write(&path, value.to_string()).expect("written");
    path
}

fn pictures(count: usize, bytes: &[u8]) -> TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    for i in 0..count {
        std::fs::write(folder.path().join(format!("a{i}.jpg")), bytes).expect("written");
    }
    folder
}

/// Reads a picture that has one white corner. Returns its size in pixels, the place of the white corner, and the
/// warnings. `orientation`: value of the EXIF tag. `extra`: additional fields of the json.
fn oriented(orientation: u8, extra: &Value) -> ((u32, u32), &'static str, String) {
    let folder = pictures(3, &jpeg(orientation));
    let data = read_plain(&write(&folder, 3, extra)).expect("a data set");
    let view = &data.train[0];
    let (width, height) = view.size();
    let white = |x, y| view.pixel(x, y).expect("inside")[0] > 128;
    let corners = [
        ("top left", white(0, 0)),
        ("top right", white(width - 1, 0)),
        ("bottom left", white(0, height - 1)),
        ("bottom right", white(width - 1, height - 1)),
    ];
    let mut lit = corners.iter().filter(|corner| corner.1);
    let corner = lit.next().expect("a white corner").0;
    assert!(lit.next().is_none(), "{corners:?}");
    ((width, height), corner, data.warnings.join("\n"))
}

#[test]
fn exif_orientation_is_applied_where_the_stated_size_says_so() {
    for (orientation, corner) in [(6, "top left"), (8, "bottom right"), (5, "top right"), (7, "bottom left")]
    {
        for extra in [
            json!({ "w": 8, "h": 16 }),
            json!({ "w": 4, "h": 8 }),
            json!({ "w": 8, "h": 16, "cx": 4, "cy": 8 }),
        ] {
            let (size, found, said) = oriented(orientation, &extra);
            assert_eq!((size, found), ((8, 16), corner), "{orientation} {extra}");
            assert_names(&said, &["transforms.json: 3 views: turned as their EXIF orientation says"]);
        }
    }
}

#[test]
fn exif_orientation_that_is_not_applied_is_said() {
    for (extra, why) in [
        (json!({ "w": 16, "h": 8 }), "as they are stored they have the size in the json"),
        (json!({ "w": 32, "h": 16 }), "as they are stored"),
        (json!({}), "no size in the json tells"),
    ] {
        let (size, corner, said) = oriented(6, &extra);
        assert_eq!((size, corner), (STORED, "bottom left"), "{extra}");
        assert_names(&said, &["3 views: their EXIF orientation is not applied", why]);
    }
    // Turned by 180°, a picture keeps its size, which therefore does not tell whether to turn it.
    let (size, corner, said) = oriented(3, &json!({ "w": 16, "h": 8 }));
    assert_eq!((size, corner), (STORED, "bottom left"));
    assert_names(&said, &["not applied: no size in the json tells"]);
    let (.., said) = oriented(1, &json!({}));
    assert!(!said.contains("EXIF"), "{said}");
    // The size in the json fits neither the stored nor the turned picture.
    let folder = pictures(3, &jpeg(6));
    let error = error_of(&write(&folder, 3, &json!({ "w": 10, "h": 10 })));
    assert_names(&error, &["a0.jpg", "10x10", "16x8"]);
}

#[test]
fn a_bottom_row_that_is_no_0_0_0_1_is_refused_naming_the_frame() {
    let folder = pictures(3, &jpeg(1));
    let path = write(&folder, 3, &json!({}));
    let whole: Value = serde_json::from_slice(&std::fs::read(&path).expect("read")).expect("json");
    let error_with = |row: &Value| {
        let mut value = whole.clone();
        value["frames"][1]["transform_matrix"][3] = row.clone();
        std::fs::write(&path, value.to_string()).expect("written");
        error_of(&path)
    };
    for row in [json!([0, 0, 0, 2]), json!([0, 0, 0.1, 1]), json!([0, 0, 0, 0]), json!([1, 2, 3, 1])] {
        assert_names(
            &error_with(&row),
            &["view `a1.jpg`", "transform_matrix", "expected a bottom row of 0 0 0 1"],
        );
    }
    assert_names(&error_with(&json!([0, 0, 0, 2])), &["found 0 0 0 2"]);
    let mut value = whole.clone();
    for i in 0..4 {
        for j in 0..4 {
            value["frames"][1]["transform_matrix"][i][j] =
                whole["frames"][1]["transform_matrix"][j][i].clone();
        }
    }
    std::fs::write(&path, value.to_string()).expect("written");
    assert_names(&error_of(&path), &["view `a1.jpg`", "looks transposed"]);
    // Matrices of three rows, and rounding errors in the bottom row, are accepted.
    let mut value = whole.clone();
    value["frames"][1]["transform_matrix"].as_array_mut().expect("rows").truncate(3);
    value["frames"][0]["transform_matrix"][3] = json!([0.0, -1e-9, 0.0, 0.9999999]);
    std::fs::write(&path, value.to_string()).expect("written");
    read_plain(&path).expect("a data set");
}

#[test]
fn angles_in_degrees_are_refused_as_such() {
    let folder = pictures(3, &jpeg(1));
    let error = |extra: Value| error_of(&write(&folder, 3, &extra));
    let degrees = error(json!({ "fl_x": null, "camera_angle_x": 50 }));
    assert_names(
        &degrees,
        &[
            "view `a0.jpg`, camera_angle_x: expected radians above 0 and below π, found 50: looks like degrees",
            "0.8727",
        ],
    );
    assert_names(&error(json!({ "fl_x": null, "camera_angle_y": 40.5 })), &["camera_angle_y", "degrees"]);
    for (angle, word) in
        [(-0.5, "-0.5"), (0.0, "found 0"), (1e9, "1000000000"), (std::f64::consts::PI, "degrees")]
    {
        assert_names(&error(json!({ "fl_x": null, "camera_angle_x": angle })), &["camera_angle_x", word]);
    }
    // A focal length takes precedence over an angle of view.
    read_plain(&write(&folder, 3, &json!({ "camera_angle_x": 50 }))).expect("a data set");
    read_plain(&write(&folder, 3, &json!({ "fl_x": null, "camera_angle_x": 3.1 }))).expect("a data set");
}

#[test]
fn a_byte_order_mark_is_accepted() {
    let folder = pictures(3, &jpeg(1));
    let path = write(&folder, 3, &json!({}));
    let plain = std::fs::read(&path).expect("read");
    std::fs::write(&path, [b"\xef\xbb\xbf", &plain[..]].concat()).expect("written");
    assert_eq!(read_plain(&path).expect("a data set").train.len(), 2);
    std::fs::write(&path, b"\xef\xbb\xbf").expect("written");
    assert_names(&error_of(&path), &["transforms.json", "line 1"]);
}

#[test]
fn alpha_in_only_some_photographs_is_said() {
    let folder = pictures(6, &jpeg(1));
    let path = write(&folder, 6, &json!({}));
    let save = |name: &str, alpha: u8| {
        let (width, height) = STORED;
        let picture = image::RgbaImage::from_pixel(width, height, image::Rgba([9, 9, 9, alpha]));
        std::fs::write(folder.path().join(name), png(picture)).expect("written");
    };
    let said = || read_plain(&path).expect("a data set").warnings.join("\n");
    assert!(!said().contains("alpha"));
    save("a0.jpg", 255);
    assert!(!said().contains("alpha"), "a channel that says nothing is none: {}", said());
    save("a1.jpg", 100);
    assert_names(&said(), &["alpha in only 2 of 6 pictures", "a2.jpg, a3.jpg, a4.jpg, a5.jpg"]);
    (2..6).for_each(|i| save(&format!("a{i}.jpg"), 255));
    assert!(!said().contains("alpha"), "an object may fill its picture: {}", said());
}

/// Writes a data set of two frames to `<folder>/data`. `file_path`: picture of the second frame.
fn naming(folder: &TempDir, file_path: &str) -> PathBuf {
    let data = folder.path().join("data");
    std::fs::create_dir_all(&data).expect("a folder");
    for name in ["inside.jpg", "../outside.jpg"] {
        std::fs::write(data.join(name), jpeg(1)).expect("written");
    }
    let poses = orbit(2, 4.0, Vec3::ZERO);
    let frames = json!([
        { "file_path": "./inside.jpg", "transform_matrix": matrix(&poses[0]) },
        { "file_path": file_path, "transform_matrix": matrix(&poses[1]) },
    ]);
    let path = data.join("transforms.json");
    std::fs::write(&path, json!({ "fl_x": 10.0, "frames": frames }).to_string()).expect("written");
    path
}

#[test]
fn pictures_outside_of_the_data_folder_need_the_flag() {
    let folder = tempfile::tempdir().expect("a folder");
    let outside = folder.path().join("outside.jpg").to_str().expect("UTF-8").to_owned();
    let mut cases = vec!["../outside.jpg", "..\\outside.jpg", "./../data/../outside", outside.as_str()];
    #[cfg(unix)]
    {
        std::fs::create_dir_all(folder.path().join("data")).expect("a folder");
        std::os::unix::fs::symlink("../outside.jpg", folder.path().join("data/link.jpg")).expect("a link");
        std::os::unix::fs::symlink("..", folder.path().join("data/up")).expect("a link");
        cases.extend(["link.jpg", "up/outside.jpg"]);
    }
    for file_path in cases {
        let path = naming(&folder, file_path);
        let error = error_of(&path);
        assert_names(
            &error,
            &[&format!("view `{file_path}`"), "expected a picture inside", "--outside-files"],
        );
        let options = ReadOptions { outside_files: true, ..Default::default() };
        let data = read(&path, &options).expect(file_path);
        assert_eq!(data.train.len() + data.val.len(), 2);
    }
    // Paths that lead back into the folder are accepted. A missing picture is skipped even if it is outside.
    let inside = folder.path().join("data/inside.jpg").to_str().expect("UTF-8").to_owned();
    for file_path in ["../data/inside.jpg", "././inside", inside.as_str()] {
        read_plain(&naming(&folder, file_path)).expect(file_path);
    }
    let data = read_plain(&naming(&folder, "../missing.jpg")).expect("the other view");
    assert_names(&data.warnings.join("\n"), &["skipped 1 of 2", "../missing.jpg"]);
}
