//! Data sets from hostile files: a typed error that names the file, or views whose parts fit together.
#![no_main]

use arbitrary::{Result, Unstructured};
use libfuzzer_sys::fuzz_target;
use nerf_fuzz::files::{npy, spoil, zip};
use nerf_fuzz::values::{any_f32, mostly};
use nerf_train::data::Axes;
use nerf_train::data::Dataset;
use nerf_train::data::Downscale;
use nerf_train::data::ReadOptions;
use nerf_train::data::read;
use std::path::Path;
use std::sync::LazyLock;

static FOLDER: LazyLock<tempfile::TempDir> = LazyLock::new(|| {
    let folder = nerf_fuzz::files::folder();
    for (name, width, height) in [("a.png", 4, 3), ("b.png", 3, 3)] {
        std::fs::write(folder.path().join(name), picture(width, height)).expect("room in /dev/shm");
    }
    folder
});

/// No array of these files is as large as this: what is larger is refused, not allocated.
const LIMIT: u64 = 1 << 20;

fuzz_target!(|data: &[u8]| {
    let Some((&kind, rest)) = data.split_first() else { return };
    let mut u = Unstructured::new(rest);
    let (name, bytes) = match kind % 8 {
        0 => ("raw.npz", rest.to_vec()),
        1 => ("transforms.json", rest.to_vec()),
        2 => ("picture.json", rest.to_vec()),
        3 | 4 => {
            let Ok(bytes) = archive(&mut u, kind % 8 == 3) else { return };
            ("made.npz", bytes)
        }
        5 => {
            let Ok(bytes) = transforms(&mut u) else { return };
            ("transforms.json", bytes)
        }
        _ => ("", Vec::new()),
    };
    if kind % 8 >= 6 {
        let files = if kind % 8 == 6 { colmap(&mut u) } else { llff(&mut u) };
        let Ok(files) = files else { return };
        return check_folder(kind, &files);
    }
    let file = FOLDER.path().join(name);
    let path = if kind % 8 == 2 {
        // The bytes are a picture that a sound json names.
        std::fs::write(FOLDER.path().join("c.png"), bytes).expect("room in /dev/shm");
        std::fs::write(&file, json(&[frame("c", &ROTATION)], "\"fl_x\": 5.0")).expect("room in /dev/shm");
        file
    } else {
        std::fs::write(&file, bytes).expect("room in /dev/shm");
        file
    };
    check_read(kind, &path);
});

/// What is read from `path` is sound, or refused by the name of a file.
fn check_read(kind: u8, path: &Path) {
    let axes = [None, Some(Axes::Opengl), Some(Axes::Opencv), None][usize::from(kind >> 3 & 3)];
    let downscale = [Downscale::Auto, Downscale::By(2)][usize::from(kind >> 5 & 1)];
    let options = ReadOptions { axes, downscale, max_array_bytes: Some(LIMIT), ..ReadOptions::default() };
    match read(path, &options) {
        Ok(dataset) => check(&dataset),
        Err(error) => {
            let (text, folder) = (error.to_string(), FOLDER.path().to_string_lossy().into_owned());
            assert!(text.contains(&folder) || text.contains("near"), "which file: {text}");
        }
    }
}

/// The same of a folder of two photographs, `a.png` and `b.png`, and these files.
fn check_folder(kind: u8, files: &[(&str, Vec<u8>)]) {
    let folder = FOLDER.path().join("photographs");
    // What the last input left must not be read with this one's.
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(folder.join("images")).expect("room in /dev/shm");
    for (name, width, height) in [("a.png", 4, 3), ("b.png", 8, 6)] {
        std::fs::write(folder.join("images").join(name), picture(width, height)).expect("room in /dev/shm");
    }
    for (name, bytes) in files {
        std::fs::write(folder.join(name), bytes).expect("room in /dev/shm");
    }
    check_read(kind, &folder);
}

/// A COLMAP model, binary or text, that is sound but for a few numbers and counts.
fn colmap(u: &mut Unstructured<'_>) -> Result<Vec<(&'static str, Vec<u8>)>> {
    if u.ratio(1, 4)? {
        return colmap_text(u);
    }
    let count =
        |u: &mut Unstructured<'_>, count: u64| Ok(if u.ratio(1, 32)? { u.arbitrary()? } else { count });
    let (model, parameters) =
        *u.choose(&[(0i32, 3usize), (1, 4), (4, 8), (5, 8), (6, 12), (7, 5), (99, 0)])?;
    let mut cameras = count(u, 1)?.to_le_bytes().to_vec();
    cameras.extend(1u32.to_le_bytes());
    cameras.extend(model.to_le_bytes());
    cameras.extend([4u64, 3].map(u64::to_le_bytes).concat());
    for i in 0..parameters {
        let sound = [5.0, 5.0, 2.0, 1.5].get(i).copied().unwrap_or(0.01);
        cameras.extend(f64::from(mostly(u, sound)?).to_le_bytes());
    }
    let mut images = count(u, 2)?.to_le_bytes().to_vec();
    for name in [*u.choose(&["a.png", "../x", "a", "\u{ff}", ""])?, "b.png"] {
        images.extend(1u32.to_le_bytes());
        for sound in [1.0, 0.5, 0.0, 0.0, 0.1, 0.2, 3.0] {
            images.extend(f64::from(mostly(u, sound)?).to_le_bytes());
        }
        images.extend(1u32.to_le_bytes());
        images.extend(name.as_bytes());
        images.push(0);
        images.extend(count(u, 1)?.to_le_bytes());
        images.extend([0; 24]);
    }
    let mut points = count(u, 1)?.to_le_bytes().to_vec();
    points.extend(7u64.to_le_bytes());
    for _ in 0..3 {
        points.extend(f64::from(mostly(u, 1.0)?).to_le_bytes());
    }
    points.extend([0; 11]);
    points.extend(count(u, 1)?.to_le_bytes());
    points.extend([0; 8]);
    Ok(vec![
        ("cameras.bin", spoil(cameras, u)?),
        ("images.bin", spoil(images, u)?),
        ("points3D.bin", spoil(points, u)?),
    ])
}

fn colmap_text(u: &mut Unstructured<'_>) -> Result<Vec<(&'static str, Vec<u8>)>> {
    let model = *u.choose(&["PINHOLE 4 3 5 5 2 1.5", "SIMPLE_RADIAL 4 3 5 2 1.5 0.1", "FOV 4 3", ""])?;
    let cameras = format!("# Number of cameras: {}\n1 {model}\n", if u.ratio(7, 8)? { 1 } else { 2 });
    let number = mostly(u, 0.5)?;
    let images = format!("1 1 {number} 0 0 0.1 0.2 3 1 a.png\n\n2 1 0 0 0 0 0 {number} 1 b.png\n1 2 -1\n");
    let points = format!("1 {number} 2 3 0 0 0 0.5 1 0\n");
    Ok(vec![
        ("cameras.txt", spoil(cameras.into_bytes(), u)?),
        ("images.txt", spoil(images.into_bytes(), u)?),
        ("points3D.txt", spoil(points.into_bytes(), u)?),
    ])
}

/// `poses_bounds.npy` of two photographs.
fn llff(u: &mut Unstructured<'_>) -> Result<Vec<(&'static str, Vec<u8>)>> {
    let rows = if u.ratio(1, 8)? { u.int_in_range(0..=3usize)? } else { 2 };
    let mut numbers = Vec::new();
    for _ in 0..rows {
        for sound in [0.0, 1.0, 0.0, 0.5, 3.0, -1.0, 0.0, 0.0, 0.0, 4.0, 0.0, 0.0, 1.0, 4.0, 5.0, 1.0, 9.0] {
            numbers.extend(f64::from(if u.ratio(1, 64)? { any_f32(u)? } else { sound }).to_le_bytes());
        }
    }
    let shape = if u.ratio(1, 16)? { [u.arbitrary::<u64>()? as usize, 17] } else { [rows, 17] };
    Ok(vec![("poses_bounds.npy", spoil(npy("<f8", u.ratio(1, 8)?, &shape, &numbers), u)?)])
}

/// Every view has as many pixels as its camera, and a ray for each of them.
fn check(dataset: &Dataset) {
    assert!(!dataset.train.is_empty());
    for view in [&dataset.train, &dataset.val, &dataset.test].into_iter().flatten() {
        let i = view.camera.intrinsics();
        assert_eq!(view.pixels.len() as u64, u64::from(i.width) * u64::from(i.height), "{}", view.name);
        for (x, y) in [(0.5, 0.5), (i.width as f32 - 0.5, i.height as f32 - 0.5)] {
            let ray = view.camera.ray(x, y);
            assert!(
                (ray.dir.length() - 1.0).abs() < 1e-6 && ray.origin.is_finite(),
                "{}: {ray:?}",
                view.name
            );
        }
    }
}

const ROTATION: [[f32; 4]; 4] =
    [[1.0, 0.0, 0.0, 0.5], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 4.0], [0.0, 0.0, 0.0, 1.0]];

/// A grey picture, as PNG with stored blocks.
fn picture(width: u32, height: u32) -> Vec<u8> {
    let crc = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC);
    let mut png = b"\x89PNG\r\n\x1a\n".to_vec();
    let mut chunk = |kind: &[u8], data: &[u8]| {
        png.extend((data.len() as u32).to_be_bytes());
        let body = [kind, data].concat();
        png.extend(&body);
        png.extend(crc.checksum(&body).to_be_bytes());
    };
    let header = [&width.to_be_bytes()[..], &height.to_be_bytes(), &[8, 0, 0, 0, 0]].concat();
    chunk(b"IHDR", &header);
    let rows: Vec<u8> = (0..height).flat_map(|_| [vec![0], vec![0x80; width as usize]].concat()).collect();
    let (mut a, mut b) = (1u32, 0u32);
    for &byte in &rows {
        a = (a + u32::from(byte)) % 65_521;
        b = (b + a) % 65_521;
    }
    let mut data = vec![0x78, 0x01, 1];
    data.extend((rows.len() as u16).to_le_bytes());
    data.extend((!(rows.len() as u16)).to_le_bytes());
    data.extend(rows);
    data.extend((b << 16 | a).to_be_bytes());
    chunk(b"IDAT", &data);
    chunk(b"IEND", &[]);
    png
}

/// A pose that is sound but for a number.
fn pose(u: &mut Unstructured<'_>) -> Result<[[f32; 4]; 4]> {
    let mut rows = ROTATION;
    if u.ratio(1, 4)? {
        rows[u.choose_index(4)?][u.choose_index(4)?] = any_f32(u)?;
    }
    Ok(rows)
}

/// An archive of the CS180 layout, or of the original notebook's.
fn archive(u: &mut Unstructured<'_>, splits: bool) -> Result<Vec<u8>> {
    let names = if splits {
        &[("images_train", "c2ws_train"), ("images_val", "c2ws_val"), ("images_test", "c2ws_test")][..]
    } else {
        &[("images", "poses")][..]
    };
    let mut entries = Vec::new();
    let focal = mostly(u, 5.0)?;
    let shape: &[usize] = u.choose(&[&[][..], &[1], &[1, 1], &[2], &[0]])?;
    entries.push(("focal.npy".to_string(), npy("<f4", false, shape, &focal.to_le_bytes())));
    for &(images, poses) in names {
        if u.ratio(1, 8)? {
            continue;
        }
        let (count, height, width) =
            (u.int_in_range(0..=9usize)?, u.int_in_range(0..=3usize)?, u.int_in_range(0..=3usize)?);
        let channels = *u.choose(&[3usize, 3, 4, 1])?;
        let (descr, size) = *u.choose(&[("|u1", 1usize), ("<f4", 4), (">f8", 8), ("<i2", 2), ("|b1", 1)])?;
        let value: Vec<u8> = match size {
            4 => mostly(u, 0.5)?.to_le_bytes().to_vec(),
            8 => f64::from(mostly(u, 0.5)?).to_be_bytes().to_vec(),
            _ => vec![0x7f; size],
        };
        let pixels = value.repeat(count * height * width * channels);
        let mut sides = vec![count, height, width, channels];
        if u.ratio(1, 16)? {
            *sides.first_mut().expect("four") = u.arbitrary::<u64>()? as usize;
        }
        entries.push((format!("{images}.npy"), npy(descr, u.ratio(1, 8)?, &sides, &pixels)));
        let (poses_here, rows) = (if u.ratio(1, 8)? { count + 1 } else { count }, *u.choose(&[4usize, 3])?);
        let mut numbers = Vec::new();
        for _ in 0..poses_here {
            numbers.extend(pose(u)?.into_iter().take(rows).flatten().flat_map(f32::to_le_bytes));
        }
        entries.push((format!("{poses}.npy"), npy("<f4", false, &[poses_here, rows, 4], &numbers)));
    }
    spoil(zip(&entries), u)
}

/// A frame of a json; its numbers are what a json can hold, and what it cannot.
fn frame(name: &str, pose: &[[f32; 4]]) -> String {
    format!("{{\"file_path\": {name:?}, \"transform_matrix\": {pose:?}}}")
}

fn json(frames: &[String], fields: &str) -> Vec<u8> {
    format!("{{{fields}, \"frames\": [{}]}}", frames.join(", ")).into_bytes()
}

/// A `transforms.json` of nerfstudio or instant-ngp.
fn transforms(u: &mut Unstructured<'_>) -> Result<Vec<u8>> {
    let mut frames = Vec::new();
    for _ in 0..u.int_in_range(0..=4u8)? {
        let name = *u.choose(&["a", "a.png", "./b.png", "b", "missing", "../a", "", "/dev/null", "\0"])?;
        let mut rows = pose(u)?.to_vec();
        if u.ratio(1, 8)? {
            rows.truncate(u.int_in_range(0..=4)?);
        }
        frames.push(frame(name, &rows));
    }
    let mut fields = vec![format!("\"fl_x\": {}", mostly(u, 5.0)?)];
    const NAMES: [&str; 16] = [
        "camera_angle_x",
        "camera_angle_y",
        "fl_y",
        "cx",
        "cy",
        "w",
        "h",
        "k1",
        "k2",
        "k3",
        "k4",
        "p1",
        "p2",
        "near",
        "far",
        "fl_x",
    ];
    for _ in 0..u.int_in_range(0..=4u8)? {
        let value = if u.arbitrary()? { any_f32(u)? } else { f32::from(u.arbitrary::<i8>()?) / 16.0 };
        fields.push(format!("\"{}\": {value}", u.choose(&NAMES)?));
    }
    if u.ratio(1, 8)? {
        let model = *u.choose(&["OPENCV", "pinhole", "OPENCV_FISHEYE", ""])?;
        fields.push(format!("\"camera_model\": {model:?}"));
    }
    if u.ratio(1, 8)? {
        fields.push("\"train_filenames\": [\"a\"], \"val_filenames\": []".into());
    }
    spoil(json(&frames, &fields.join(", ")), u)
}
