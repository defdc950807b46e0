use super::*;
use std::io::Write;
use std::path::PathBuf;

/// One array: numpy's dtype, shape as numpy prints it, and the data.
struct Made(&'static str, &'static str, Vec<u8>);

fn header(dtype: &str, order: &str, shape: &str) -> Vec<u8> {
    let text = format!("{{'descr': '{dtype}', 'fortran_order': {order}, 'shape': {shape}, }}\n");
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((text.len() as u16).to_le_bytes());
    bytes.extend(text.into_bytes());
    bytes
}

fn npz(folder: &Path, arrays: &[(&str, Vec<u8>)]) -> PathBuf {
    let path = folder.join("made.npz");
    let mut writer = zip::ZipWriter::new(std::fs::File::create(&path).expect("create"));
    for (key, bytes) in arrays {
        writer.start_file(format!("{key}.npy"), zip::write::FileOptions::default()).expect("entry");
        writer.write_all(bytes).expect("write");
    }
    writer.finish().expect("finish");
    path
}

fn whole(Made(dtype, shape, data): Made) -> Vec<u8> {
    let mut bytes = header(dtype, "False", shape);
    bytes.extend(data);
    bytes
}

fn f8(values: impl IntoIterator<Item = f64>) -> Vec<u8> {
    values.into_iter().flat_map(f64::to_le_bytes).collect()
}

fn f4(values: impl IntoIterator<Item = f32>) -> Vec<u8> {
    values.into_iter().flat_map(f32::to_le_bytes).collect()
}

fn poses(count: usize, axes: Axes) -> impl Iterator<Item = f64> {
    let poses = orbit(count, 4.0, Vec3::ZERO).into_iter().map(move |pose| matrix(&axes.to_opengl(pose)));
    poses.flat_map(|m| m.into_iter().flatten().map(f64::from))
}

/// Arrays of a CS180 file: three training and two validation pictures of 4×2 pixels, and three poses without pictures.
fn cs180() -> Vec<(&'static str, Vec<u8>)> {
    vec![
        ("images_train", whole(Made("|u1", "(3, 2, 4, 3)", (0..72).collect()))),
        ("c2ws_train", whole(Made("<f8", "(3, 4, 4)", f8(poses(3, Axes::Opencv))))),
        ("images_val", whole(Made("|u1", "(2, 2, 4, 3)", (0..48).collect()))),
        ("c2ws_val", whole(Made("<f4", "(2, 4, 4)", f4(poses(2, Axes::Opencv).map(|v| v as f32))))),
        ("c2ws_test", whole(Made("<f8", "(3, 4, 4)", f8(poses(3, Axes::Opencv))))),
        ("focal", whole(Made("<f8", "()", f8([5.5])))),
    ]
}

fn with(key: &'static str, bytes: Vec<u8>) -> Vec<(&'static str, Vec<u8>)> {
    cs180().into_iter().map(|(k, b)| if k == key { (k, bytes.clone()) } else { (k, b) }).collect()
}

/// Text of the error from reading the CS180 file with the array `key` replaced by `bytes`.
fn error_with(key: &'static str, bytes: Vec<u8>) -> String {
    let folder = tempfile::tempdir().expect("tempdir");
    error_of(&npz(folder.path(), &with(key, bytes)))
}

#[test]
fn arrays_of_training_may_be_missing_where_nothing_is_fitted() {
    let folder = tempfile::tempdir().expect("tempdir");
    let of_validation: Vec<_> = cs180().into_iter().filter(|(key, _)| !key.ends_with("_train")).collect();
    let path = npz(folder.path(), &of_validation);
    let measure = ReadOptions { to_measure: true, ..ReadOptions::default() };
    let data = read(&path, &measure).expect("validation alone");
    // Without training pictures, `c2ws_test` gets the picture size of the validation pictures.
    assert_eq!((data.train.len(), data.val.len(), data.test_path.len()), (0, 2, 3));
    assert_names(&error_of(&path), &["c2ws_train"]);
    let neither: Vec<_> = of_validation.into_iter().filter(|(key, _)| !key.ends_with("_val")).collect();
    let path = npz(folder.path(), &neither);
    assert_names(&read(&path, &measure).expect_err("no pictures").to_string(), &["made.npz"]);
}

#[test]
fn cs180_is_converted_from_opencv() {
    let folder = tempfile::tempdir().expect("tempdir");
    let path = npz(folder.path(), &cs180());
    let data = read_plain(&path).expect("whole");
    assert_eq!((data.format, data.axes, data.name.as_str()), (Format::Cs180, Axes::Opencv, "made"));
    assert_eq!((data.train.len(), data.val.len(), data.test_path.len()), (3, 2, 3));
    for (view, pose) in data.train.iter().zip(orbit(3, 4.0, Vec3::ZERO)) {
        assert_eq!(*view.camera.pose(), pose);
        assert_eq!(*view.camera.intrinsics(), Intrinsics::centred(4, 2, 5.5));
    }
    assert_eq!(data.train[1].name, "images_train[1]");
    assert_eq!(data.train[1].pixel(1, 1), Some([24 + 15, 24 + 16, 24 + 17, 255]));
    assert_eq!((data.near, data.far), (None, None));
    let options = ReadOptions { axes: Some(Axes::Opengl), near: Some(1.0), ..Default::default() };
    let other = read(&path, &options).expect("whole");
    assert_eq!(other.train[0].camera.pose().forward(), -data.train[0].camera.pose().forward());
    assert_eq!(other.near, Some(1.0));
}

#[test]
fn fortran_order_and_big_endian_are_read() {
    let c: Vec<f64> = poses(3, Axes::Opencv).collect();
    let mut bytes = header(">f8", "True", "(3, 4, 4)");
    for (k, j, i) in (0..4).flat_map(|k| (0..4).flat_map(move |j| (0..3).map(move |i| (k, j, i)))) {
        bytes.extend(c[16 * i + 4 * j + k].to_be_bytes());
    }
    let folder = tempfile::tempdir().expect("tempdir");
    let data = read_plain(&npz(folder.path(), &with("c2ws_train", bytes))).expect("whole");
    assert_eq!(*data.train[2].camera.pose(), orbit(3, 4.0, Vec3::ZERO)[2]);
}

#[test]
fn tiny_nerf_splits_at_the_end() {
    let folder = tempfile::tempdir().expect("tempdir");
    for (count, train, val, first) in [(106, 100, 5, 101), (20, 14, 6, 14), (6, 6, 0, 0)] {
        let images = f4((0..count * 6).map(|i| (i % 6) as f32 / 5.0));
        let shape = format!("({count}, 1, 2, 3)").leak();
        let matrices = format!("({count}, 4, 4)").leak();
        let path = npz(
            folder.path(),
            &[
                ("images", whole(Made("<f4", shape, images))),
                ("poses", whole(Made("<f8", matrices, f8(poses(count, Axes::Opengl))))),
                ("focal", whole(Made("<i8", "(1,)", 7i64.to_le_bytes().to_vec()))),
            ],
        );
        let data = read_plain(&path).expect("whole");
        assert_eq!((data.format, data.train.len(), data.val.len()), (Format::TinyNerf, train, val));
        assert_eq!(data.train[0].pixels, [[0, 51, 102, 255], [153, 204, 255, 255]]);
        assert_eq!(*data.train[0].camera.pose(), orbit(count, 4.0, Vec3::ZERO)[0]);
        if let Some(view) = data.val.first() {
            assert_eq!(view.name, format!("images[{first}]"));
        }
    }
}

#[test]
fn a_missing_key_lists_those_that_exist() {
    let folder = tempfile::tempdir().expect("tempdir");
    let without: Vec<_> = cs180().into_iter().filter(|(key, _)| *key != "c2ws_train").collect();
    let text = error_of(&npz(folder.path(), &without));
    assert_names(&text, &["made.npz", "`c2ws_train`", "c2ws_test, c2ws_val, focal, images_train"]);
    assert_names(&error_of(&npz(folder.path(), &[])), &["`focal`", "[]"]);
}

#[test]
fn wrong_arrays_are_named_with_what_was_expected() {
    let cases: &[(&str, Vec<u8>, &[&str])] = &[
        ("images_train", whole(Made("<i4", "(3, 2, 4, 3)", vec![0; 288])), &["`images_train`", "i4"]),
        ("images_train", whole(Made("|u1", "(3, 2, 4)", vec![0; 24])), &["[3, 2, 4]"]),
        ("images_train", whole(Made("|u1", "(3, 0, 4, 3)", vec![])), &["[3, 0, 4, 3]"]),
        ("images_train", whole(Made("|u1", "(2, 2, 4, 3)", vec![0; 48])), &["2 poses", "found 3"]),
        ("images_train", whole(Made("|u1", "(3, 2, 4, 3)", vec![0; 71])), &["72 bytes", "found 71"]),
        ("images_train", whole(Made("|u1", "(3, 2, 4, 3)", vec![0; 73])), &["72 bytes", "found more"]),
        ("images_train", whole(Made("<f8", "(3, 2, 4, 3)", f8([300.0; 72]))), &["[0, 1]", "300"]),
        ("images_train", whole(Made("<f8", "(3, 2, 4, 3)", f8([f64::NAN; 72]))), &["[0, 1]", "NaN"]),
        ("images_train", whole(Made("<c8", "(3,)", vec![])), &["plain numbers", "c8"]),
        ("images_train", b"PNG".to_vec(), &["`images_train`", ".npy header"]),
        ("c2ws_train", whole(Made("<f8", "(3, 3, 3)", f8([0.0; 27]))), &["[n, 4, 4]", "[3, 3, 3]"]),
        ("c2ws_train", whole(Made("<f8", "(3, 3, 4)", f8([0.0; 36]))), &["images_train[0]", "determinant 0"]),
        ("c2ws_train", whole(Made("<f8", "(3, 3, 4)", f8([f64::NAN; 36]))), &["images_train[0]", "finite"]),
        ("c2ws_train", whole(Made("<f8", "(3, 3, 4)", f8([1e300; 36]))), &["images_train[0]", "finite"]),
        ("focal", whole(Made("<f8", "(2,)", f8([1.0, 1.0]))), &["`focal`", "[2]"]),
        ("focal", whole(Made("<f8", "()", f8([-1.0]))), &["fx", "-1"]),
    ];
    for (key, bytes, parts) in cases {
        assert_names(&error_with(key, bytes.clone()), parts);
    }
    let folder = tempfile::tempdir().expect("tempdir");
    let mut none = with("images_train", whole(Made("|u1", "(0, 2, 4, 3)", vec![])));
    none.retain(|(key, _)| *key != "c2ws_train");
    none.push(("c2ws_train", whole(Made("<f8", "(0, 4, 4)", vec![]))));
    assert_names(&error_of(&npz(folder.path(), &none)), &["at least one training view", "found none"]);
}

#[test]
fn huge_shapes_allocate_nothing() {
    let huge =
        ["(1000000, 1000000, 1000, 3)", "(18446744073709551615, 4, 4, 3)", "(9, 99999999999999999999, 1, 3)"];
    for shape in huge {
        let text = error_with("images_train", whole(Made("|u1", shape, vec![0; 10])));
        assert_names(&text, &["`images_train`"]);
    }
    // The shape is within the size limit, but the file has only ten bytes.
    let text = error_with("images_train", whole(Made("|u1", "(1000, 1000, 1000, 3)", vec![0; 10])));
    assert_names(&text, &["3000000000 bytes", "found 10"]);
    let mut long = b"\x93NUMPY\x02\x00".to_vec();
    long.extend(u32::MAX.to_le_bytes());
    assert_names(&error_with("images_train", long), &[".npy header"]);
}

#[test]
fn a_zip_bomb_stops_at_the_limit() {
    let folder = tempfile::tempdir().expect("tempdir");
    let bomb = whole(Made("|u1", "(10000, 10, 10, 3)", vec![0; 3_000_000]));
    let path = npz(folder.path(), &with("images_train", bomb));
    let options = ReadOptions { max_array_bytes: Some(1_000_000), ..Default::default() };
    let error = read(&path, &options).expect_err("too large").to_string();
    assert_names(&error, &["`images_train`", "at most 1000000 bytes", "found 3000000"]);
}

#[test]
fn no_truncation_and_no_bit_flip_panics() {
    let folder = tempfile::tempdir().expect("tempdir");
    let path = npz(folder.path(), &cs180());
    let whole = std::fs::read(&path).expect("read");
    for end in (0..whole.len()).step_by(7) {
        std::fs::write(&path, &whole[..end]).expect("write");
        assert!(read_plain(&path).is_err(), "{end} of {} bytes were read", whole.len());
    }
    for bit in (0..8 * whole.len()).step_by(5) {
        let mut flipped = whole.clone();
        flipped[bit / 8] ^= 1 << (bit % 8);
        std::fs::write(&path, &flipped).expect("write");
        if let Err(error) = read_plain(&path) {
            assert!(!error.to_string().is_empty());
        }
    }
}

#[test]
fn no_bit_flip_in_an_array_header_panics() {
    // The zip is written after the bit flip, so that its checksum is right and the array header is parsed.
    let folder = tempfile::tempdir().expect("tempdir");
    let good = whole(Made("|u1", "(3, 2, 4, 3)", (0..72).collect()));
    for bit in 0..8 * (good.len() - 72) {
        let mut flipped = good.clone();
        flipped[bit / 8] ^= 1 << (bit % 8);
        let _ = read_plain(&npz(folder.path(), &with("images_train", flipped)));
    }
}

#[test]
fn matrices_must_end_with_0_0_0_1() {
    let mut numbers: Vec<f64> = poses(3, Axes::Opencv).collect();
    numbers[2 * 16 + 15] = 2.0;
    let error = error_with("c2ws_train", whole(Made("<f8", "(3, 4, 4)", f8(numbers.clone()))));
    assert_names(&error, &["view `c2ws_train[2]`: expected a bottom row of 0 0 0 1, found 0 0 0 2"]);
    numbers[2 * 16 + 15] = f64::NAN;
    let error = error_with("c2ws_test", whole(Made("<f8", "(3, 4, 4)", f8(numbers.clone()))));
    assert_names(&error, &["view `c2ws_test[2]`", "NaN"]);
    let folder = tempfile::tempdir().expect("tempdir");
    let images = Made("<f4", "(3, 2, 4, 3)", f4([0.5; 72]));
    let arrays = [
        ("images", whole(images)),
        ("poses", whole(Made("<f8", "(3, 4, 4)", f8(numbers.clone())))),
        ("focal", whole(Made("<f8", "()", f8([5.5])))),
    ];
    assert_names(&error_of(&npz(folder.path(), &arrays)), &["view `poses[2]`", "bottom row"]);
    // Matrices without a bottom row are accepted.
    let rows = numbers.chunks_exact(16).flat_map(|m| m[..12].to_vec());
    let path = npz(folder.path(), &with("c2ws_train", whole(Made("<f8", "(3, 3, 4)", f8(rows)))));
    read_plain(&path).expect("3 x 4");
}

#[test]
fn alpha_in_only_some_arrays_is_said() {
    let folder = tempfile::tempdir().expect("tempdir");
    let clear = whole(Made("|u1", "(3, 2, 4, 4)", vec![7; 96]));
    let data = read_plain(&npz(folder.path(), &with("images_train", clear))).expect("a data set");
    assert_names(&data.warnings.join("\n"), &["alpha in only some of the arrays: `images_val`"]);
    let data = read_plain(&npz(folder.path(), &cs180())).expect("a data set");
    assert!(!data.warnings.join("\n").contains("alpha"));
}
