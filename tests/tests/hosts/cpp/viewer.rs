//! The viewer without its window: its images, the order of its frames, and the files that it writes.

use super::{WARNINGS, bytes_of, content, examples, numbers, printed_camera, read_png, reference};
use nerf_core::plan::Outputs;
use nerf_testing::build::{libraries, run};
use nerf_testing::paths;
use nerf_testing::scenes::{Recipe, kernels};
use nerf_testing::tools::all_here;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

/// Returns the path of the viewer without a window, which is built once.
fn viewer() -> &'static Path {
    static BUILT: OnceLock<PathBuf> = OnceLock::new();
    BUILT.get_or_init(build_viewer)
}

fn build_viewer() -> PathBuf {
    let (program, folder) =
        (Path::new(env!("CARGO_TARGET_TMPDIR")).join("viewer"), examples().join("viewer"));
    let mut command = Command::new(std::env::var_os("CXX").unwrap_or_else(|| "c++".into()));
    command.args(["-std=c++17", "-O1", "-o"]).arg(&program).args(WARNINGS);
    command.arg("-I").arg(paths::workspace().join("include"));
    command.args(["main.cpp", "painter.cpp", "script.cpp", "session.cpp"].map(|file| folder.join(file)));
    run(command.arg(libraries().archive).args(["-lpthread", "-ldl", "-lm"]));
    program
}

/// Returns the multiply-adds of a frame, from a line that the viewer prints.
fn macs(line: &str) -> f32 {
    let [macs] = numbers(line, "macs");
    macs
}

#[test]
fn viewer_is_coarse_while_it_moves_and_rests_at_the_rust_renderers_picture() {
    let (directory, [width, height]) = (paths::temporary(), [150, 131]);
    let program = viewer();
    for (name, recipe) in [("without a front", Recipe::PLAIN), ("with a front", Recipe::PROPOSAL)] {
        let blob = recipe.blob();
        std::fs::write(directory.path().join("scene.nerf"), &blob).expect("a temporary file");
        for kernel in kernels() {
            let mut command = Command::new(program);
            command.current_dir(directory.path()).env("NERF_KERNEL", kernel.to_string());
            command.args([
                "scene.nerf",
                "--headless",
                "--size",
                &format!("{width}x{height}"),
                "--threads",
                "3",
            ]);
            // Too little time for any frame: the smallest there is.
            command.args(["--moving-ms", "0.01", "--resting-ms", "50", "--screenshot", "rest.png"]);
            command.args(["--script", "turn 0.2 0.1; pan 0.01 0.02; dolly 1"]);
            let said = String::from_utf8(run(&mut command).stdout).expect("UTF-8");
            let what = format!("{name}, {}: {said}", kernel);

            let lines: Vec<&str> = said.lines().collect();
            let moving: Vec<_> = lines.iter().filter(|line| line.starts_with("moving")).collect();
            let last = lines.last().expect("frames");
            assert!(moving.len() == 4 && moving.iter().all(|line| line.contains(" complete ")), "{what}");
            assert!(last.starts_with("resting complete"), "{what}");
            assert!(moving.iter().all(|line| macs(line) > 0.0 && macs(line) < macs(last) / 50.0), "{what}");

            let camera = printed_camera(last, [width, height]);
            let outputs = Outputs { rgb: true, ..Outputs::NONE };
            let picture = read_png(&directory.path().join("rest.png"));
            assert_eq!(picture.header, [width, height, 8, 2]);
            assert!(picture.pixels == bytes_of(&reference(&blob, kernel, &camera, outputs)), "{what}");
        }
    }
}

#[test]
fn viewer_shows_whole_tiles_of_a_frame_that_was_cancelled() {
    const TILE: usize = 32; // Painter::tile_side
    let (directory, [width, height]) = (paths::temporary(), [200usize, 170]);
    let program = viewer();
    std::fs::write(directory.path().join("scene.nerf"), Recipe::PLAIN.blob()).expect("a temporary file");
    let mut command = Command::new(program);
    command.current_dir(directory.path()).args(["scene.nerf", "--headless", "--threads", "3"]);
    command.args(["--size", &format!("{width}x{height}"), "--moving-ms", "0.01"]);
    command.args([
        "--script",
        "interrupt 0; shot coarse.ppm; interrupt 4; shot a mix.ppm ; rest; shot fine.ppm",
    ]);
    let said = String::from_utf8(run(&mut command).stdout).expect("UTF-8");
    assert_eq!(said.lines().filter(|line| line.starts_with("resting cancelled")).count(), 2, "{said}");

    let shot = |name| content(&directory.path().join(name), &format!("P6\n{width} {height}\n255\n"));
    let (coarse, mixed, fine) = (shot("coarse.ppm"), shot("a mix.ppm"), shot("fine.ppm"));
    let mut finished = 0;
    for (left, top) in (0..height).step_by(TILE).flat_map(|y| (0..width).step_by(TILE).map(move |x| (x, y))) {
        let equal = |other: &[u8]| {
            (top..height.min(top + TILE)).all(|y| {
                let row = 3 * (y * width + left)..3 * (y * width + width.min(left + TILE));
                mixed[row.clone()] == other[row]
            })
        };
        assert!(equal(&coarse) || equal(&fine), "tile at {left}, {top}");
        finished += u32::from(!equal(&coarse));
    }
    // Those that were asked for, and what the other two threads had begun; of the middle, so none is flat.
    assert!((4..=6).contains(&finished), "{finished} tiles: {said}");
}

/// Returns the smallest scene's file with another name for its data; the name must be shorter than 128 bytes.
fn scene_of(data: &str) -> Vec<u8> {
    const HEADER: usize = 32;
    let mut blob = Recipe::TINY.blob();
    let old = b"\x05noise";
    let at = blob.windows(old.len()).position(|bytes| bytes == old).expect("the name of its data");
    let name = [&[data.len() as u8], data.as_bytes()].concat();
    blob.splice(at..at + old.len(), name);
    let body = (blob.len() - HEADER) as u64;
    blob[16..24].copy_from_slice(&body.to_le_bytes());
    blob[24..HEADER].fill(0);
    let crc = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(&blob);
    blob[24..28].copy_from_slice(&crc.to_le_bytes());
    blob
}

#[test]
fn viewer_saves_the_views_that_were_chosen_as_a_camera_path() {
    let [width, height] = [80, 60];
    for (data, origin) in [
        ("noise", [0.0; 3]),
        ("a, origin at (7, 8, 9), origin at (123456.5, -2000000, 0.125)", [123_456.5, -2e6, 0.125]),
        ("a, origin at (1, 2)", [0.0; 3]),
    ] {
        let directory = paths::temporary();
        std::fs::write(directory.path().join("scene.nerf"), scene_of(data)).expect("a temporary file");
        let mut command = Command::new(viewer());
        command.current_dir(directory.path()).args(["scene.nerf", "--headless", "--size", "80x60"]);
        command.args(["--script", "rest; key; turn 0.1 0; key", "--path", "a path; whole.json"]);
        let said = String::from_utf8(run(&mut command).stdout).expect("UTF-8");
        let text = std::fs::read_to_string(directory.path().join("a path; whole.json")).expect("a path");
        is_path_of(&serde_json::from_str(&text).expect("JSON"), &said, [width, height], origin);
    }
}

/// Verifies that `path` has two views, the last of which is the view at rest, in coordinates relative to `origin`.
fn is_path_of(path: &serde_json::Value, said: &str, [width, height]: [u32; 2], origin: [f64; 3]) {
    assert_eq!((&path["render_width"], &path["render_height"]), (&width.into(), &height.into()));
    let views = path["camera_path"].as_array().expect("views");
    assert_eq!(views.len(), 2);
    let resting = said.lines().rfind(|line| line.starts_with("resting complete")).expect("a frame");
    let camera = printed_camera(resting, [width, height]);
    let fov = 2.0 * (0.5 * height as f32 / camera.intrinsics().fy).atan().to_degrees();
    assert!((views[1]["fov"].as_f64().expect("a number") - f64::from(fov)).abs() < 1e-4);
    let matrix: Vec<f64> = views[1]["camera_to_world"]
        .as_array()
        .expect("a matrix")
        .iter()
        .map(|n| n.as_f64().expect("a number"))
        .collect();
    for (i, expected) in numbers::<12>(resting, "c2w").into_iter().enumerate() {
        let from = if i % 4 == 3 { origin[i / 4] } else { 0.0 };
        assert!((matrix[i] - from - f64::from(expected)).abs() < 1e-8, "{i}: {matrix:?}");
    }
    assert_eq!(matrix[12..], [0.0, 0.0, 0.0, 1.0]);
    assert_ne!(views[0]["camera_to_world"], views[1]["camera_to_world"]);
    assert_eq!(path["keyframes"][1]["matrix"], views[1]["camera_to_world"]);
    assert_eq!(path["keyframes"][1]["fov"], views[1]["fov"]);
}

#[test]
fn viewer_says_what_is_wrong() {
    let directory = paths::temporary();
    let program = viewer();
    std::fs::write(directory.path().join("scene.nerf"), Recipe::TINY.blob()).expect("a temporary file");
    std::fs::write(directory.path().join("picture.nerf"), Recipe::TINY_PICTURE.blob())
        .expect("a temporary file");
    let complains = |arguments: &[&str], expected: &str| {
        let output = Command::new(program).current_dir(directory.path()).args(arguments).output();
        let output = output.expect("a program");
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(!output.status.success() && said.contains(expected), "{arguments:?}: {said}");
    };
    complains(&[], "usage:");
    complains(&["scene.nerf", "--size", "0x3"], "--size 0x3 is not understood");
    complains(&["absent.nerf", "--headless"], "absent.nerf");
    complains(&["picture.nerf", "--headless"], "expected a scene");
    complains(&["scene.nerf"], "--headless");
    complains(&["scene.nerf", "--headless", "--size", "8x8", "--script", "jump"], "\"jump\"");
    complains(&["scene.nerf", "--headless", "--size", "8x8", "--path", "a.json"], "at least one view");
    complains(
        &["scene.nerf", "--headless", "--size", "8x8", "--script", "key; path no/a.json"],
        "cannot write no/a.json",
    );
    complains(
        &["scene.nerf", "--headless", "--size", "8x8", "--screenshot", "no/a.png"],
        "cannot write no/a.png",
    );
}

#[test]
fn viewer_with_a_window_is_built_by_cmake() {
    if !all_here(&["cmake", "make", "sdl2-config"]) {
        return;
    }
    let directory = paths::temporary();
    let mut command = Command::new("cmake");
    command.arg("-S").arg(examples().join("viewer")).arg("-B").arg(directory.path());
    run(command.args(["-DCMAKE_BUILD_TYPE=Debug", "-DCMAKE_CXX_FLAGS=-Werror"]));
    run(Command::new("cmake").arg("--build").arg(directory.path()));
    let scene = directory.path().join("scene.nerf");
    std::fs::write(&scene, Recipe::TINY.blob()).expect("a temporary file");
    let mut command = Command::new(directory.path().join("viewer"));
    command.env("SDL_VIDEODRIVER", "absent").arg(&scene);
    let said = command.output().expect("the viewer").stderr;
    assert!(String::from_utf8_lossy(&said).contains("expected a display"), "it has a window");
    run(Command::new(directory.path().join("viewer")).arg(&scene).args(["--headless", "--size", "20x10"]));
}
