//! `--space`: scenes that end at a box, and unbounded scenes.

use crate::made::{Folder, scene};
use crate::{fails, fit, fit_grid, json, ok, run, write_picture};
use glam::{DQuat, DVec3, Mat3, Vec3};
use nerf_core::blob::Blob;
use nerf_core::camera::{Camera, Lens, Pose};
use nerf_train::data;
use nerf_train::data::Dataset;
use nerf_train::data::LookAt;
use nerf_train::data::ReadOptions;
use nerf_train::data::View;
use std::path::Path;

/// The built-in scene in front of something that no border says the colour of.
fn photographs(folder: &Folder) -> String {
    photographs_of(folder, "photographs.npz", scene())
}

/// These views, as if something of many colours were behind them.
fn photographs_of(folder: &Folder, name: &str, mut dataset: Dataset) -> String {
    for view in dataset.train.iter_mut().chain(&mut dataset.val) {
        for (i, pixel) in view.pixels.iter_mut().enumerate() {
            if pixel[3] == 0 {
                *pixel = [(i * 7 % 200) as u8, (i * 13 % 250) as u8, 90, 255];
            }
        }
    }
    folder.npz_of(name, &dataset, |_| {})
}

#[test]
fn photographs_of_one_colour_are_refused() {
    let folder = Folder::new();
    let mut black = scene();
    black.train.iter_mut().for_each(|view| view.pixels.fill([0, 0, 0, 255]));
    let data = folder.npz_of("black.npz", &black, |_| {});
    let file = folder.path("black.nerf");
    fails(["fit", &data, "-o", &file, "--steps", "20"], &["every pixel of every training photograph"]);
    assert!(!Path::new(&file).exists());
}

#[test]
fn a_camera_inside_of_the_object_leaves_the_views_around_it_as_they_are() {
    let folder = Folder::new();
    let mut inside = scene();
    let first = inside.train[0].clone();
    let middle =
        Vec3::from(LookAt::of(&inside.cameras().copied().collect::<Vec<_>>()).expect("an orbit").point);
    let position = middle - 0.2 * first.camera.pose().forward();
    let camera =
        Camera::new(*first.camera.intrinsics(), Lens::NONE, Pose { position, ..*first.camera.pose() });
    let camera = camera.expect("a camera");
    let pixels = vec![[70, 50, 30, 255]; first.pixels.len()];
    inside.train.push(View { name: "inside".into(), camera, pixels, ..first });
    let boxed = [folder.npz_of("a.npz", &scene(), |_| {}), folder.npz_of("b.npz", &inside, |_| {})];
    let unbounded = [photographs(&folder), photographs_of(&folder, "c.npz", inside)];
    for [plain, with] in [boxed, unbounded] {
        let (expected, _) = fitted(&folder, &plain);
        let (found, _) = fitted(&folder, &with);
        println!("{expected:.2} dB, with a camera inside {found:.2} dB");
        assert!(found > expected - 1.5, "{expected} dB, with a camera inside {found} dB");
    }
}

/// Distance of the wall from the plane that its cameras stand in, world units.
const DISTANCE: f32 = 3.0;

/// Eight cameras side by side in front of a wall of many colours. They look straight ahead, or at one place of it.
fn before_a_wall(converging: bool) -> Dataset {
    let mut wall = scene();
    for (i, view) in wall.train.iter_mut().chain(&mut wall.val).enumerate() {
        let places = [
            [-0.5, -0.2],
            [0.0, -0.2],
            [0.5, -0.2],
            [-0.5, 0.2],
            [0.0, 0.2],
            [0.5, 0.2],
            [-0.2, 0.0],
            [0.2, 0.1],
        ];
        let [x, y] = places[i];
        let position = Vec3::new(x, y, 0.0);
        let ahead = if converging { Vec3::ZERO } else { position } - DISTANCE * Vec3::Z;
        let pose = Pose::look_at(position, ahead, Vec3::Y).expect("a pose");
        view.camera = Camera::new(*view.camera.intrinsics(), Lens::NONE, pose).expect("a camera");
        let (width, camera) = (view.size().0, view.camera);
        for (index, pixel) in view.pixels.iter_mut().enumerate() {
            let ray = camera.ray((index as u32 % width) as f32 + 0.5, (index as u32 / width) as f32 + 0.5);
            let p = ray.at(-DISTANCE / ray.dir.z);
            let wave = |x: f32| (127.0 + 100.0 * x.sin()) as u8;
            *pixel = [wave(3.0 * p.x + p.y), wave(2.0 * p.y), wave(2.0 * p.x - 3.0 * p.y), 255];
        }
    }
    wall
}

#[test]
fn a_wall_in_front_of_cameras_side_by_side_is_fitted_where_it_is() {
    let folder = Folder::new();
    let wall = before_a_wall(false);
    let plain = folder.npz_of("wall.npz", &wall, |_| {});
    let (file, film) = (folder.path("a.nerf"), folder.path("views.gif"));
    // Of seeds 0 to 5, from 20.0 to 27.0 dB, one in the middle.
    let small = ["--table", "12", "--rays", "256", "--set", "sampling.live_samples=8192", "--steps", "600"];
    ok([
        &["fit", &plain, "-o", &file, "--near", "2", "--far", "4", "--space", "contracted"],
        &small[..],
        &["--seed", "1", "-q"],
    ]
    .concat());
    assert_eq!(power(&file), Some(1));
    let psnr = measured(&file, &plain);
    let views = ["--path", &plain, "--split", "val", "--outputs", "z-depth", "--json", "-q"];
    let said = ok([&["render", &file, "-o", &film, "--width", "24"], &views[..]].concat());
    let said: serde_json::Value = serde_json::from_str(&said).expect("one object");
    println!("{psnr:.2} dB, z-depth {}", said["z_depth_range"]);
    assert!(psnr > 23.0, "{psnr}");
    for depth in [0, 1].map(|end| said["z_depth_range"][end].as_f64().expect("a distance")) {
        assert!((depth / f64::from(DISTANCE) - 1.0).abs() < 0.35, "{said}");
    }
}

/// Converging views of the wall as a nerfstudio folder whose world is `scale` times as large, turned, and moved this far.
fn moved(folder: &Folder, name: &str, scale: f64, turn: DQuat, by: DVec3) -> String {
    let data = before_a_wall(true);
    let place = folder.path(name);
    std::fs::create_dir(&place).expect("a folder");
    let (mut frames, mut lists) = (Vec::new(), [Vec::new(), Vec::new()]);
    for (views, list) in [&data.train, &data.val].into_iter().zip(&mut lists) {
        for view in views {
            let (width, height) = view.size();
            let picture = format!("{}.png", frames.len());
            let bytes = view.pixels.iter().flat_map(|p| [p[0], p[1], p[2]]).collect();
            let image = image::RgbImage::from_raw(width, height, bytes).expect("a picture");
            write_picture(image, format!("{place}/{picture}"));
            let pose = view.camera.pose();
            let position = by + turn * (scale * pose.position.as_dvec3());
            let [a, b, c] = [pose.rotation.x_axis, pose.rotation.y_axis, pose.rotation.z_axis]
                .map(|axis| turn * axis.as_dvec3());
            let row = |i: usize| [a[i], b[i], c[i], position[i]];
            let matrix = [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]];
            frames.push(serde_json::json!({ "file_path": picture, "transform_matrix": matrix }));
            list.push(picture);
        }
    }
    let [train, val] = lists;
    let focal = data.train[0].camera.intrinsics().fx;
    let lists = serde_json::json!({
        "fl_x": focal, "frames": frames, "train_filenames": train, "val_filenames": val
    });
    std::fs::write(format!("{place}/transforms.json"), lists.to_string()).expect("written");
    place
}

/// PSNR over validation views and the smallest z-depth in these after a fit, dB and world units.
fn fitted(folder: &Folder, data: &str) -> (f64, f64) {
    let (file, report) = (format!("{data}.nerf"), format!("{data}_report"));
    let small =
        ["--table", "10", "--rays", "256", "--set", "sampling.live_samples=4096", "--steps", "300", "-q"];
    ok([&["fit", data, "-o", &file, "--report", &report], &small[..]].concat());
    let film = folder.path("views.gif");
    let views = ["--path", data, "--split", "val", "--outputs", "z-depth", "--json", "-q"];
    let said = ok([&["render", &file, "-o", &film, "--width", "24"], &views[..]].concat());
    let said: serde_json::Value = serde_json::from_str(&said).expect("one object");
    let psnr = json(format!("{report}/summary.json"))["val_psnr_db"].as_f64().expect("dB");
    (psnr, said["z_depth_range"][0].as_f64().unwrap_or_else(|| panic!("{said}")))
}

#[test]
fn a_world_of_another_size_and_place_fits_as_well_in_its_own_units() {
    let folder = Folder::new();
    let turn = DQuat::from_euler(glam::EulerRot::XYZ, 0.7, -1.1, 0.4);
    let plain = moved(&folder, "plain", 1.0, DQuat::IDENTITY, DVec3::ZERO);
    let (psnr, depth) = fitted(&folder, &plain);
    println!("as it is: {psnr:.2} dB, nearest z-depth {depth:.4}");
    assert!(psnr > 24.0 && (depth / f64::from(DISTANCE) - 1.0).abs() < 0.25, "{psnr} dB, {depth}");
    // What no photograph saw shows their mean colour.
    let data = data::read(Path::new(&plain), &ReadOptions::default()).expect("a data set");
    let pixels = || data.train.iter().flat_map(|view| &view.pixels);
    let bytes = std::fs::read(format!("{plain}.nerf")).expect("a blob");
    let background = Blob::open(&bytes).expect("a blob").scene().expect("a scene").background;
    for (c, found) in background.into_iter().enumerate() {
        let mean = pixels().map(|pixel| f64::from(pixel[c]) / 255.0).sum::<f64>() / pixels().count() as f64;
        assert!((f64::from(found) - mean).abs() < 1e-6 && mean > 0.1, "{background:?}, expected {mean}");
    }
    // A grid lies along the axes of the world: a wall that is turned is fitted a little less well.
    let turned = fitted(&folder, &moved(&folder, "turned", 1.0, turn, DVec3::ZERO));
    println!("turned: {:.2} dB, nearest z-depth {:.4}", turned.0, turned.1);
    for (name, scale, turn, by, (psnr, depth)) in [
        ("small", 1e-3, DQuat::IDENTITY, DVec3::ZERO, (psnr, depth)),
        ("large", 1e3, DQuat::IDENTITY, DVec3::ZERO, (psnr, depth)),
        // In f32 all cameras would stand at one place.
        ("gps", 1e-3, turn, DVec3::new(1e6, -2e6, 5e5), turned),
    ] {
        let data = moved(&folder, name, scale, turn, by);
        let (own, own_depth) = fitted(&folder, &data);
        println!("{name}: {own:.2} dB, nearest z-depth {own_depth:.4}");
        assert!((own - psnr).abs() < 0.4, "{name}: {own} dB, as it is {psnr} dB");
        assert!((own_depth / (scale * depth) - 1.0).abs() < 0.1, "{name}: {own_depth}, as it is {depth}");
        let inspected = ok(["inspect", &format!("{data}.nerf")]);
        assert_eq!(inspected.contains("origin at ("), name == "gps", "{inspected}");
    }
}

/// PSNR of a file over the validation views of a data set, dB.
fn measured(file: &str, data: &str) -> f64 {
    let said: serde_json::Value =
        serde_json::from_str(&ok(["eval", file, data, "--json", "-q"])).expect("one object");
    said["val_psnr_db"].as_f64().unwrap_or_else(|| panic!("{said}"))
}

#[test]
fn a_blob_is_measured_in_its_own_coordinates_whatever_the_origin_of_the_data() {
    let folder = Folder::new();
    let by = DVec3::new(1e6, -2e6, 5e5);
    let data = moved(&folder, "gps", 1.0, DQuat::IDENTITY, by);
    let (expected, _) = fitted(&folder, &data);
    let (file, path) = (format!("{data}.nerf"), format!("{data}/transforms.json"));
    assert!((measured(&file, &data) - expected).abs() < 1e-3, "{expected}");
    // One camera far away: the data alone would count from another place.
    let mut list = json(&path);
    let mut far = list["frames"][0].clone();
    far["file_path"] = "far.png".into();
    far["transform_matrix"][0][3] = 0.0.into();
    std::fs::copy(format!("{data}/0.png"), format!("{data}/far.png")).expect("copied");
    list["frames"].as_array_mut().expect("frames").push(far);
    list["train_filenames"].as_array_mut().expect("names").push("far.png".into());
    std::fs::write(&path, list.to_string()).expect("written");
    let origin = |options: &ReadOptions| data::read(Path::new(&data), options).expect("a data set").origin;
    assert_ne!(
        origin(&ReadOptions::default()),
        origin(&ReadOptions { origin: Some(by.into()), ..ReadOptions::default() })
    );
    assert!((measured(&file, &data) - expected).abs() < 1e-3, "{expected}");
    // Its views are drawn where they are.
    let picture = |of: &str| {
        let output = folder.path(of);
        ok(["render", &file, "-q", "-o", &output, "--data", &data, "--view", "1", "--width", "24"]);
        std::fs::read(output).expect("a picture")
    };
    let beside = picture("beside.png");
    std::fs::remove_file(format!("{data}/far.png")).expect("removed");
    list["frames"].as_array_mut().expect("frames").pop();
    std::fs::write(&path, list.to_string()).expect("written");
    assert_eq!(picture("alone.png"), beside);
    // What a user says is of the data's world, as its views are.
    let (width, _) = data::read(Path::new(&data), &ReadOptions::default()).expect("a data set").val[1].size();
    let view = list["val_filenames"][1].as_str().expect("a name");
    let frame = list["frames"].as_array().expect("frames").iter().find(|frame| frame["file_path"] == view);
    let rows = &frame.expect("the view")["transform_matrix"].as_array().expect("rows")[..3];
    let pose = rows.iter().flat_map(|row| row.as_array().expect("a row")).map(ToString::to_string);
    let pose = pose.collect::<Vec<_>>().join(",");
    let focal = (list["fl_x"].as_f64().expect("a length") * 24.0 / f64::from(width)).to_string();
    let posed = folder.path("posed.png");
    ok(["render", &file, "-q", "-o", &posed, "--pose", &pose, "--focal", &focal, "--width", "24"]);
    let pixels = |bytes: &[u8]| image::load_from_memory(bytes).expect("a picture").to_rgb8().into_raw();
    let (posed, beside) = (pixels(&std::fs::read(&posed).expect("a picture")), pixels(&beside));
    assert!(posed.len() == beside.len() && posed.iter().zip(&beside).all(|(a, b)| a.abs_diff(*b) < 8));
    let mesh = folder.path("part.ply");
    // Around the wall.
    let part = ["--box", "999999,-2000001,499996,1000001,-1999999,499998", "--resolution", "8"];
    let said =
        ok([&["export", &file, "-o", &mesh, "--json", "-q", "--threshold", "0.01"], &part[..]].concat());
    let said: serde_json::Value = serde_json::from_str(&said).expect("one object");
    assert_eq!(said["box_min_world_units"], serde_json::json!([999_999.0, -2_000_001.0, 499_996.0]));
}

/// The power of a file's contraction.
fn power(file: &str) -> Option<u8> {
    let bytes = std::fs::read(file).expect("a blob");
    let blob = Blob::open(&bytes).expect("a blob");
    blob.scene().expect("a scene").contraction().map(|contraction| contraction.power())
}

#[test]
fn photographs_have_unbounded_space_unless_told_otherwise() {
    let folder = Folder::new();
    let (data, file) = (photographs(&folder), folder.path("a.nerf"));
    let plain = folder.npz("plain.npz");
    let unbounded = "unbounded space, contracted around what the cameras look at";
    for (data, preset, more, expected, words) in [
        (&data, "grid", &[][..], Some(1), [unbounded, "do not say what is background"]),
        (&data, "grid", &["--space", "box"], None, ["space ends at a box", "as --space says"]),
        (&data, "grid", &["--box", "-2,-2,-2,2,2,2"], None, ["space ends at a box", "which is given"]),
        (
            &data,
            "grid",
            &["--set", "occupancy.skip=false"],
            None,
            ["space ends at a box", "skips empty space"],
        ),
        (&data, "small", &[], None, ["space ends at a box", "a contraction needs a learned grid"]),
        (&plain, "grid", &[], None, ["space ends at a box", "the pictures say what is background"]),
        (&plain, "grid", &["--space", "contracted"], Some(1), [unbounded, "as --space says"]),
    ] {
        let base =
            ["fit", data, "-o", &file, "--preset", preset, "--steps", "2", "--rays", "64", "--restart"];
        let small: &[&str] = if preset == "grid" { &["--table", "8"] } else { &["--width", "16"] };
        let ran = run([&base[..], small, more].concat());
        assert_eq!(ran.code, Some(0), "{}", ran.err);
        assert_eq!(power(&file), expected, "{preset} {more:?}");
        for word in words {
            assert!(ran.err.contains(word), "{preset} {more:?}: expected `{word}` in {}", ran.err);
        }
        assert_eq!(ok(["inspect", &file]).contains("unbounded"), expected.is_some());
    }
}

#[test]
fn an_unbounded_scene_is_fitted_rendered_and_shown() {
    let folder = Folder::new();
    let (data, file, report) = (photographs(&folder), folder.path("a.nerf"), folder.path("report"));
    ok(fit_grid(&data, &file, &["--steps", "60", "--near", "0.3", "--far", "50", "--report", &report]));
    assert_eq!(power(&file), Some(1));
    let bytes = std::fs::read(&file).expect("a blob");
    let facts = Blob::open(&bytes).expect("a blob").scene().cloned().expect("a scene");
    assert_eq!((facts.near, facts.far), (0.3, 50.0));
    assert!(json(format!("{report}/summary.json")).is_object());
    ok(["eval", &file, &data, "-q"]);
    let picture = folder.path("picture");
    ok(["render", &file, "-q", "-o", &picture, "--width", "12", "--outputs", "rgb,z-depth"]);
    // There is no outside to look from, and no end of it.
    let mesh = folder.path("a.ply");
    fails(["export", &file, "-o", &mesh], &["--box", "unbounded"]);
    ok([
        "export",
        &file,
        "-q",
        "-o",
        &mesh,
        "--resolution",
        "16",
        "--box",
        "-1,-1,-1,1,1,1",
        "--threshold",
        "1e-3",
    ]);
    let shown = folder.path("show");
    ok(["show", &data, "-o", &shown, "-q", "--preset", "grid", "--rays", "12"]);
    let summary = json(format!("{shown}/summary.json"));
    let (live, near) = (&summary["live_samples_shown"], summary["near_world_units"].as_f64());
    assert!(live.as_u64() > Some(0) && near == Some(0.0), "{summary}");
    // What is drawn ends at the cameras' surroundings.
    let radius = summary["ball_radius_world_units"].as_f64();
    let far = summary["far_world_units"].as_f64().zip(radius).map(|(far, radius)| far / radius);
    assert!(far.is_some_and(|times| (1.5..=4.0).contains(&times)), "{summary}");
}

#[test]
fn cameras_side_by_side_need_only_say_where_rays_begin() {
    let folder = Folder::new();
    let mut dataset = scene();
    for (i, view) in dataset.train.iter_mut().chain(&mut dataset.val).enumerate() {
        let pose = Pose { rotation: Mat3::IDENTITY, position: Vec3::new(0.1 * i as f32, 0.0, 0.0) };
        view.camera = Camera::new(*view.camera.intrinsics(), Lens::NONE, pose).expect("a camera");
    }
    let (data, file) = (folder.npz_of("data.npz", &dataset, |_| {}), folder.path("a.nerf"));
    let contracted = ["--space", "contracted"];
    fails(fit_grid(&data, &file, &contracted), &["do not look at a common place", "--near"]);
    ok(fit_grid(&data, &file, &[&contracted[..], &["--near", "0.5", "--steps", "20"]].concat()));
    assert_eq!(power(&file), Some(1));
}

#[test]
fn contractions_that_cannot_be_are_refused_by_name() {
    let folder = Folder::new();
    let (data, file) = (folder.npz("data.npz"), folder.path("a.nerf"));
    let contracted = ["--space", "contracted"];
    fails(fit(&data, &file, &contracted), &["sampling.contraction", "none without a learned grid"]);
    let boxed = [&contracted[..], &["--box", "-2,-2,-2,2,2,2"]].concat();
    fails(fit_grid(&data, &file, &boxed), &["sampling.contraction", "none beside a scene box"]);
    let dense = [&contracted[..], &["--set", "occupancy.skip=false"]].concat();
    fails(fit_grid(&data, &file, &dense), &["sampling.contraction", "none where occupancy.skip is false"]);
    fails(fit_grid(&data, &file, &["--space", "sphere"]), &["--space", "auto, box, contracted"]);
    for (text, words) in [
        ("[sampling]\ncontraction = 3", ["sampling.contraction", "1, 2 or 4"]),
        ("[sampling]\ncontraction = 4\nsteps_across = 820", ["sampling.steps_across", "2 to 819"]),
    ] {
        let settings = folder.file("run.toml", text);
        fails(["fit", &data, "-o", &file, "--config", &settings], &words);
    }
}
