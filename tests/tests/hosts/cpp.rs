//! `nerf_render.hpp` with each compiler, and what the C++ examples draw: what Rust draws, bit for bit.

use nerf_core::Kernel;
use nerf_core::blob::Blob;
use nerf_core::camera::{Camera, Intrinsics, Lens, Pose};
use nerf_core::memory::Line;
use nerf_core::plan::{Batch, Outputs, Plan, Preset, Quality};
use nerf_core::render::{Rect, Renderer};
use nerf_core::volume::Pixel;
use nerf_tests::build::{Language, libraries, program, run};
use nerf_tests::paths;
use nerf_tests::scenes::{Recipe, kernels};
use nerf_tests::tools::all_here;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

const WARNINGS: [&str; 6] = ["-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wshadow", "-Werror"];
/// What GCC alone knows.
const OF_GCC: &str = "-Wuseless-cast";
const LEAN: [&str; 2] = ["-fno-exceptions", "-fno-rtti"];

fn examples() -> PathBuf {
    paths::workspace().join("nerf-render-ffi/examples/cpp")
}

/// The pixels of a camera's image, row by row, by the Rust renderer.
fn reference(blob: &[u8], kernel: Kernel, camera: &Camera, outputs: Outputs) -> Vec<Pixel> {
    let blob = Blob::open(blob).expect("a blob");
    let quality = Quality::preset(&blob, Preset::High);
    let plan = Plan::new(&blob, &quality, outputs, Batch::FULL).expect("a plan");
    let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, kernel)];
    let renderer = Renderer::new(blob, kernel, &mut memory).expect("a renderer");
    let mut workspace = vec![Line::UNINIT; renderer.workspace_lines(&plan)];
    let (width, height) = (camera.intrinsics().width as usize, camera.intrinsics().height as usize);
    let mut pixels = vec![None; width * height];
    let mut put = |x: u32, y: u32, pixel: &Pixel| pixels[y as usize * width + x as usize] = Some(*pixel);
    renderer.render(&plan, camera, Rect::full(camera), &mut workspace, &mut put).expect("a picture");
    pixels.into_iter().map(|pixel| pixel.expect("every pixel")).collect()
}

fn bytes_of(pixels: &[Pixel]) -> Vec<u8> {
    pixels.iter().flat_map(|pixel| pixel.rgb.map(|c| (c.clamp(0.0, 1.0) * 255.0 + 0.5) as u8)).collect()
}

/// The numbers behind a word of a line or text.
fn numbers<const N: usize>(text: &str, word: &str) -> [f32; N] {
    let mut words = text.split_whitespace().skip_while(|&found| found != word).skip(1);
    std::array::from_fn(|_| words.next().expect(word).parse().expect("a number"))
}

/// The camera that a program printed: focal length and pose.
fn printed_camera(text: &str, [width, height]: [u32; 2]) -> Camera {
    let ([focal], c2w) = (numbers(text, "focal"), numbers::<12>(text, "c2w"));
    let pose = Pose::from_rows(std::array::from_fn(|i| std::array::from_fn(|j| c2w[4 * i + j])));
    Camera::new(Intrinsics::centred(width, height, focal), Lens::NONE, pose).expect("a camera")
}

/// What follows `header` in a file.
fn content(path: &Path, header: &str) -> Vec<u8> {
    let bytes = std::fs::read(path).expect("the program wrote it");
    bytes.strip_prefix(header.as_bytes()).unwrap_or_else(|| panic!("{}: header", path.display())).to_vec()
}

#[test]
fn cpp_compiles_with_each_compiler_and_standard_with_and_without_exceptions() {
    let source = paths::workspace().join("tests/cpp/wrapper.cpp");
    for compiler in ["g++", "clang++"] {
        if !all_here(&[compiler]) {
            continue;
        }
        for standard in ["-std=c++17", "-std=c++20"] {
            for lean in [&[][..], &LEAN] {
                let mut command = Command::new(compiler);
                command.args(["-fsyntax-only", standard]).args(WARNINGS).args(lean);
                if compiler == "g++" {
                    command.arg(OF_GCC);
                }
                run(command.arg("-I").arg(paths::workspace().join("include")).arg(&source));
            }
        }
    }
}

#[test]
fn every_function_of_the_c_header_has_a_wrapper() {
    let names = |path: &str| -> BTreeSet<String> {
        let text = std::fs::read_to_string(paths::workspace().join(path)).expect("a header");
        let code = text.lines().filter(|line| !line.trim_start().starts_with(['*', '/'])).collect::<String>();
        let words = code.split(|c: char| !(c == '_' || c.is_alphanumeric()));
        words.filter(|word| word.starts_with("nerf_")).map(String::from).collect()
    };
    let text = std::fs::read_to_string(paths::header()).expect("include/nerf_render.h");
    let called = |name: &String| text.contains(&format!(" {name}(")) || text.contains(&format!("*{name}("));
    let (functions, wrapped) = (names("include/nerf_render.h"), names("include/nerf_render.hpp"));
    let functions: Vec<String> = functions.into_iter().filter(called).collect();
    assert!(functions.len() > 20 && functions.contains(&"nerf_render".to_owned()), "{functions:?}");
    let forgotten: Vec<&String> = functions.iter().filter(|name| !wrapped.contains(*name)).collect();
    assert!(forgotten.is_empty(), "{forgotten:?}");
}

#[test]
fn a_program_that_lends_its_memory_links_no_heap_and_no_file_system() {
    let directory = paths::temporary();
    let (source, object) = (paths::workspace().join("tests/cpp/lent.cpp"), directory.path().join("lent.o"));
    let mut command = Command::new(std::env::var_os("CXX").unwrap_or_else(|| "c++".into()));
    command.args(["-std=c++17", "-O0", "-DNDEBUG", "-c", "-o"]).arg(&object).args(WARNINGS).args(LEAN);
    run(command.arg("-I").arg(paths::workspace().join("include")).arg(source));
    let names = run(Command::new("nm").arg("-u").arg(object)).stdout;
    let names = String::from_utf8(names).expect("UTF-8");
    let names: Vec<&str> = names.split_whitespace().filter(|word| word.len() > 1).collect();
    assert!(names.contains(&"nerf_render") && names.contains(&"nerf_scene_open"), "{names:?}");
    let allowed =
        ["blob", "blob_size", "memcpy", "memmove", "memset", "sinf", "cosf", "_GLOBAL_OFFSET_TABLE_"];
    let own =
        ["nerf_render", "nerf_scene_open", "nerf_scene_describe", "nerf_worker_open", "nerf_camera_look_at"];
    assert!(names.iter().all(|name| allowed.contains(name) || own.contains(name)), "{names:?}");
}

#[test]
fn every_wrapper_keeps_its_word() {
    let directory = paths::temporary();
    let source = paths::workspace().join("tests/cpp/wrapper.cpp");
    let program = program(Language::Cpp, &source, directory.path(), &LEAN);
    let mut damaged = Recipe::PLAIN.blob();
    let last = damaged.len() - 1;
    damaged[last] ^= 1;
    let blobs = [Recipe::PROPOSAL.blob(), Recipe::PLAIN.blob(), Recipe::PICTURE.blob(), damaged];
    let names = ["front.nerf", "plain.nerf", "picture.nerf", "damaged.nerf"];
    for (name, blob) in names.iter().zip(&blobs) {
        std::fs::write(directory.path().join(name), blob).expect("a temporary file");
    }
    for kernel in kernels() {
        let mut command = Command::new(&program);
        run(command.current_dir(directory.path()).env("NERF_KERNEL", kernel.to_string()).args(names));
    }
}

/// What is in a PNG whose deflate blocks are stored: width, height, bits and colour type; its texts; its rows.
struct Png {
    header: [u32; 4],
    texts: Vec<String>,
    pixels: Vec<u8>,
}

fn read_png(path: &Path) -> Png {
    let file = content_bytes(path, b"\x89PNG\r\n\x1a\n");
    let (mut rest, mut header, mut texts, mut stream) = (&file[..], [0; 4], Vec::new(), Vec::new());
    let word = |bytes: &[u8]| u32::from_be_bytes(bytes[..4].try_into().expect("four bytes"));
    loop {
        let length = word(rest) as usize;
        let (named, body) = (&rest[4..8 + length], &rest[8..8 + length]);
        let crc = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(named);
        assert_eq!(crc, word(&rest[8 + length..]), "{}: CRC of a chunk", path.display());
        match &named[..4] {
            b"IHDR" => {
                header = [word(body), word(&body[4..]), body[8].into(), body[9].into()];
                assert_eq!(body[10..], [0, 0, 0]);
            }
            b"tEXt" => texts.push(String::from_utf8(body.to_vec()).expect("ASCII")),
            b"IDAT" => stream.extend_from_slice(body),
            b"IEND" => break,
            other => panic!("{}: chunk {other:?}", path.display()),
        }
        rest = &rest[12 + length..];
    }
    assert_eq!(rest.len(), 12, "{}: nothing follows the end", path.display());
    let (mut data, mut blocks) = (Vec::new(), &stream[2..stream.len() - 4]);
    assert_eq!(u16::from_be_bytes([stream[0], stream[1]]) % 31, 0, "zlib's header");
    while !blocks.is_empty() {
        let length = usize::from(u16::from_le_bytes([blocks[1], blocks[2]]));
        assert_eq!([blocks[1] ^ blocks[3], blocks[2] ^ blocks[4]], [0xff, 0xff]);
        data.extend_from_slice(&blocks[5..5 + length]);
        assert_eq!(blocks[0] == 1, blocks.len() == 5 + length, "the last block says so");
        blocks = &blocks[5 + length..];
    }
    let (a, b) = data.iter().fold((1u32, 0u32), |(a, b), &byte| {
        let a = (a + u32::from(byte)) % 65521;
        (a, (a + b) % 65521)
    });
    assert_eq!(word(&stream[stream.len() - 4..]), b << 16 | a, "Adler-32");
    let row = data.len() / header[1] as usize;
    assert!(data.chunks(row).all(|row| row[0] == 0), "no filter");
    Png { header, texts, pixels: data.chunks(row).flat_map(|row| row[1..].to_vec()).collect() }
}

fn content_bytes(path: &Path, header: &[u8]) -> Vec<u8> {
    let bytes = std::fs::read(path).expect("the program wrote it");
    bytes.strip_prefix(header).expect("its header").to_vec()
}

#[test]
fn depth_map_is_the_rust_renderers_in_floats_and_in_steps() {
    let (directory, [width, height]) = (paths::temporary(), [181, 127]);
    let program = program(Language::Cpp, &examples().join("depth_map.cpp"), directory.path(), &[]);
    let (blob, file) = (Recipe::OCCUPANCY.blob(), directory.path().join("scene.nerf"));
    std::fs::write(&file, &blob).expect("a temporary file");
    for kernel in kernels() {
        let mut command = Command::new(&program);
        command.current_dir(directory.path()).env("NERF_KERNEL", kernel.to_string()).arg(&file);
        let output = run(command.arg("out").args([width.to_string(), height.to_string()]));
        let said = String::from_utf8(output.stdout).expect("UTF-8");
        let outputs = Outputs { rgb: true, opacity: true, z_depth: true, ..Outputs::NONE };
        let pixels = reference(&blob, kernel, &printed_camera(&said, [width, height]), outputs);

        let colour = read_png(&directory.path().join("out.png"));
        assert_eq!(colour.header, [width, height, 8, 2]);
        assert!(colour.pixels == bytes_of(&pixels), "{}: colour", kernel);

        let upwards = pixels.chunks(width as usize).rev().flatten();
        let expected: Vec<u8> = upwards.flat_map(|pixel| pixel.z_depth.to_ne_bytes()).collect();
        let order = if cfg!(target_endian = "little") { "-1.0" } else { "1.0" };
        let pfm = content(&directory.path().join("out.pfm"), &format!("Pf\n{width} {height}\n{order}\n"));
        assert!(pfm == expected, "{}: floats", kernel);

        let steps = read_png(&directory.path().join("out_z_depth.png"));
        let [scale] = numbers(&said, "scale");
        assert_eq!(steps.header, [width, height, 16, 0]);
        assert!(steps.texts[0].starts_with("Scale\0") && said.contains(&steps.texts[0][6..]), "{said}");
        let mut there = 0;
        for (step, pixel) in steps.pixels.chunks(2).zip(&pixels) {
            let step = f32::from(u16::from_be_bytes([step[0], step[1]]));
            if pixel.opacity < 0.5 {
                assert_eq!(step, 0.0);
            } else {
                // Half a step, and the rounding of a quotient and a product near 2^16: 1/64 of a step.
                assert!((step * scale - pixel.z_depth).abs() <= scale * (0.5 + 1.0 / 64.0));
                there += 1;
            }
        }
        assert!(there > 100 && there < pixels.len(), "{there} opaque pixels: both kinds are to be seen");
    }
}

/// The viewer without a window, built once.
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

/// The work of a frame that the viewer reports.
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
    command
        .args(["--script", "interrupt 0; shot coarse.ppm; interrupt 4; shot mixed.ppm; rest; shot fine.ppm"]);
    let said = String::from_utf8(run(&mut command).stdout).expect("UTF-8");
    assert_eq!(said.lines().filter(|line| line.starts_with("resting cancelled")).count(), 2, "{said}");

    let shot = |name| content(&directory.path().join(name), &format!("P6\n{width} {height}\n255\n"));
    let (coarse, mixed, fine) = (shot("coarse.ppm"), shot("mixed.ppm"), shot("fine.ppm"));
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

#[test]
fn viewer_saves_the_views_that_were_chosen_as_a_camera_path() {
    let (directory, [width, height]) = (paths::temporary(), [80, 60]);
    std::fs::write(directory.path().join("scene.nerf"), Recipe::TINY.blob()).expect("a temporary file");
    let mut command = Command::new(viewer());
    command.current_dir(directory.path()).args(["scene.nerf", "--headless", "--size", "80x60"]);
    command.args(["--script", "rest; key; turn 0.1 0; key", "--path", "path.json"]);
    let said = String::from_utf8(run(&mut command).stdout).expect("UTF-8");
    let text = std::fs::read_to_string(directory.path().join("path.json")).expect("a path");
    let path: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    assert_eq!((&path["render_width"], &path["render_height"]), (&width.into(), &height.into()));
    let views = path["camera_path"].as_array().expect("views");
    assert_eq!(views.len(), 2);
    let resting = said.lines().rfind(|line| line.starts_with("resting complete")).expect("a frame");
    let camera = printed_camera(resting, [width, height]);
    let fov = 2.0 * (0.5 * height as f32 / camera.intrinsics().fy).atan().to_degrees();
    assert!((views[1]["fov"].as_f64().expect("a number") - f64::from(fov)).abs() < 1e-4);
    let matrix: Vec<f32> = views[1]["camera_to_world"]
        .as_array()
        .expect("a matrix")
        .iter()
        .map(|n| n.as_f64().expect("a number") as f32)
        .collect();
    assert_eq!(matrix[..12], numbers::<12>(resting, "c2w"));
    assert_eq!(matrix[12..], [0.0, 0.0, 0.0, 1.0]);
    assert_ne!(views[0]["camera_to_world"], views[1]["camera_to_world"]);
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
