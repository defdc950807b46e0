//! Tests of LLFF's poses, of folders with reduced copies, and of folders that fit several layouts.

use super::photographs::Made;
use super::*;
use nerf_train::data::{Downscale, Layout};
use std::path::PathBuf;
use tempfile::TempDir;

/// Bytes of a `poses_bounds.npy` for `count` cameras on an orbit; picture size and `focal` in pixels.
fn poses_bounds(count: usize, (width, height): (f64, f64), focal: f64) -> Vec<u8> {
    let mut numbers = Vec::new();
    for pose in orbit(count, 4.0, Vec3::ZERO) {
        let rows = pose.to_rows().map(|row| row.map(f64::from));
        for (row, size) in rows.iter().zip([height, width, focal]) {
            // LLFF's columns: down, right, backward, centre, size.
            numbers.extend([-row[1], row[0], row[2], row[3], size]);
        }
        numbers.extend([2.0, 9.0]);
    }
    let data: Vec<u8> = numbers.iter().flat_map(|v| v.to_le_bytes()).collect();
    npy("<f8", &format!("({count}, 17)"), &data)
}

fn npy(descr: &str, shape: &str, data: &[u8]) -> Vec<u8> {
    let text = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}\n");
    [&b"\x93NUMPY\x01\0"[..], &(text.len() as u16).to_le_bytes(), text.as_bytes(), data].concat()
}

/// A folder with ten poses for pictures of 64×48 pixels. For each factor N, `images_N` (`images` for 1) holds pictures
/// of 64/N×48/N pixels.
fn folder(factors: &[u32]) -> TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join("poses_bounds.npy"), poses_bounds(10, (64.0, 48.0), 80.0))
        .expect("written");
    for &factor in factors {
        let name = if factor == 1 { "images".into() } else { format!("images_{factor}") };
        Made::plain(10).photographs(&folder.path().join(name), (64 / factor, 48 / factor));
    }
    folder
}

fn read_with(path: &Path, downscale: Downscale) -> Result<Dataset, DatasetError> {
    read(path, &ReadOptions { downscale, ..ReadOptions::default() })
}

#[test]
fn llff_is_read_with_its_columns_and_bounds() {
    let data = read_plain(folder(&[1]).path()).expect("poses");
    assert_eq!((data.format, data.train.len(), data.val.len()), (Format::Llff, 8, 2));
    assert_eq!((data.near, data.far), (Some(1.8), Some(9.0)));
    let poses = orbit(10, 4.0, Vec3::ZERO);
    assert_eq!(*data.val[1].camera.pose(), poses[8]);
    let i = data.val[0].camera.intrinsics();
    assert_eq!((i.width, i.height, i.fx, i.cx, i.cy), (64, 48, 80.0, 32.0, 24.0));
}

#[test]
fn copies_that_are_smaller_are_read_as_they_are() {
    let sizes = |factors: &[u32], downscale| {
        let folder = folder(factors);
        let data = read_with(folder.path(), downscale)?;
        let i = data.train[0].camera.intrinsics();
        assert_eq!((i.fx, i.cx), (80.0 * i.width as f32 / 64.0, 0.5 * i.width as f32));
        Ok::<_, DatasetError>((i.width, data.notes.join("\n").contains("made smaller")))
    };
    assert_eq!(sizes(&[1, 4, 8], Downscale::By(4)).expect("a copy"), (16, false));
    assert_eq!(sizes(&[1, 4, 8], Downscale::By(2)).expect("photographs"), (32, true));
    assert_eq!(sizes(&[4, 8], Downscale::By(8)).expect("a copy"), (8, false));
    assert_eq!(sizes(&[4], Downscale::By(8)).expect("a copy"), (8, true));
    // `Auto` aims at 800 pixels, so it takes the largest pictures.
    assert_eq!(sizes(&[1, 4], Downscale::Auto).expect("photographs"), (64, false));
    assert_eq!(sizes(&[4, 8], Downscale::Auto).expect("a copy"), (16, false));
    let error = sizes(&[4, 8], Downscale::By(2)).expect_err("no such copy").to_string();
    assert_names(&error, &["--downscale", "images_4, images_8", "found 2"]);
}

#[test]
fn what_is_wrong_with_llff_is_named() {
    let folder = folder(&[1]);
    let path = folder.path().join("poses_bounds.npy");
    let whole = std::fs::read(&path).expect("read");
    let start = whole.len() - 10 * 17 * 8;
    let error_with = |bytes: &[u8]| {
        std::fs::write(&path, bytes).expect("written");
        error_of(folder.path())
    };
    for length in 0..whole.len() {
        assert_names(&error_with(&whole[..length]), &["poses_bounds"]);
    }
    let spoilt = |number: usize, value: f64| {
        let mut bytes = whole.clone();
        bytes[start + 8 * number..start + 8 * number + 8].copy_from_slice(&value.to_le_bytes());
        bytes
    };
    assert_names(&error_with(&spoilt(17 + 3, f64::NAN)), &["poses_bounds.npy", "`1.jpg`"]);
    assert_names(&error_with(&spoilt(17, 7.0)), &["`1.jpg`", "rotation"]);
    assert_names(&error_with(&spoilt(4, f64::INFINITY)), &["pose number 0", "width and height"]);
    assert_names(&error_with(&spoilt(14, -1.0)), &["`0.jpg`", "fx"]);
    assert_names(&error_with(&spoilt(15, 10.0)), &["pose number 0, bounds"]);
    assert_names(&error_with(&npy("<f8", "(10, 16)", &[0; 10 * 16 * 8])), &["[n, 17]"]);
    assert_names(&error_with(&npy("<f8", &format!("({}, 17)", u64::MAX / 17), &[])), &["poses_bounds"]);
    assert_names(
        &error_with(&poses_bounds(9, (64.0, 48.0), 80.0)),
        &["number of poses", "images, 10", "found 9"],
    );
    assert_names(&error_with(&poses_bounds(10, (64.0, 64.0), 80.0)), &["0.jpg", "64x64", "64x48"]);
    assert_names(&error_with(&npy("<f8", "(0, 17)", &[])), &["number of poses"]);
}

/// A folder that fits the layouts of nerfstudio (`transforms.json`), COLMAP and LLFF.
fn of_all() -> TempDir {
    let folder = folder(&[1]);
    let mut made = Made::plain(10);
    made.cameras[0].2 = vec![80.0, 80.0, 32.0, 24.0];
    made.binary(&folder.path().join("sparse/0"));
    made.photographs(&folder.path().join("images"), (8, 6));
    let frames: Vec<_> = orbit(10, 4.0, Vec3::ZERO)
        .iter()
        .enumerate()
        .map(|(i, pose)| serde_json::json!({ "file_path": format!("images/{i}.jpg"), "transform_matrix": matrix(pose) }))
        .collect();
    let json = serde_json::json!({ "fl_x": 10.0, "frames": frames }).to_string();
    std::fs::write(folder.path().join("transforms.json"), json).expect("written");
    folder
}

#[test]
fn of_several_layouts_the_first_is_read_and_the_others_said() {
    let folder = of_all();
    let (json, model): (PathBuf, _) = (folder.path().join("transforms.json"), folder.path().join("sparse"));
    let read_as = |layout| read(folder.path(), &ReadOptions { layout, ..ReadOptions::default() });
    let formats = [
        (Layout::Transforms, Format::Nerfstudio),
        (Layout::Colmap, Format::Colmap),
        (Layout::Llff, Format::Llff),
    ];
    let mut poses = Vec::new();
    for (layout, format) in formats {
        let data = read_as(Some(layout)).expect("a data set");
        assert!(data.format == format && !data.notes.join(" ").contains("is there, too"));
        poses.push(data.train.iter().map(|view| *view.camera.pose()).collect::<Vec<_>>());
        // The COLMAP model's points are also read with LLFF's poses, which are in the same world.
        assert_eq!(data.points.len(), if layout == Layout::Transforms { 0 } else { 2 });
    }
    for (a, b) in poses[1].iter().zip(&poses[2]) {
        assert!((a.position - b.position).length() < 1e-5 && a.forward().dot(b.forward()) > 1.0 - 1e-6);
    }
    let data = read_as(None).expect("transforms");
    assert_eq!(data.format, Format::Nerfstudio);
    assert_names(&data.notes.join("\n"), &["read as transforms; --layout colmap or llff is there, too"]);
    std::fs::remove_file(json).expect("removed");
    let data = read_as(None).expect("a model");
    assert_eq!(data.format, Format::Colmap);
    assert_names(&data.notes.join("\n"), &["read as colmap; --layout llff"]);
    std::fs::remove_dir_all(model).expect("removed");
    assert_eq!(read_as(None).expect("poses").format, Format::Llff);
    let error = read_as(Some(Layout::Colmap)).expect_err("no model").to_string();
    assert_names(&error, &["not a data set", "COLMAP model"]);
    assert!("blender".parse::<Layout>().is_err() && "llff".parse() == Ok(Layout::Llff));
}

#[test]
fn poses_far_from_the_origin_keep_their_distances() {
    let folder = folder(&[1]);
    let near = read_plain(folder.path()).expect("poses");
    let file = folder.path().join("poses_bounds.npy");
    let mut bytes = std::fs::read(&file).expect("poses");
    let start = bytes.len() - 10 * 17 * 8;
    for row in bytes[start..].chunks_exact_mut(17 * 8) {
        for (place, moved) in [(3, 1e6), (8, 2e6), (13, -3e6)] {
            let number = &mut row[8 * place..8 * place + 8];
            let value = f64::from_le_bytes(number.try_into().expect("8 bytes")) + moved;
            number.copy_from_slice(&value.to_le_bytes());
        }
    }
    std::fs::write(&file, bytes).expect("written");
    let far = read_plain(folder.path()).expect("poses");
    assert_eq!(far.origin, [1e6, 2e6, -3e6]);
    for (view, expected) in far.train.iter().zip(&near.train) {
        let off = view.camera.pose().position - expected.camera.pose().position;
        assert!(off.length() < 1e-5, "{}: {off}", view.name);
    }
    assert_eq!((far.near, far.far), (near.near, near.far));
}
