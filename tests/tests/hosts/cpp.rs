//! `nerf_render.hpp` with each compiler, and the C++ examples, whose images equal the Rust renderer's bit for bit.

use nerf_core::Kernel;
use nerf_core::blob::Blob;
use nerf_core::camera::{Camera, Intrinsics, Lens, Pose};
use nerf_core::memory::Line;
use nerf_core::plan::{Batch, Outputs, Plan, Preset, Quality};
use nerf_core::render::{Rect, Renderer};
use nerf_core::volume::Pixel;
use nerf_testing::build::{Language, program, run};
use nerf_testing::paths;
use nerf_testing::scenes::{Recipe, kernels};
use nerf_testing::tools::all_here;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::Command;

mod viewer;

const WARNINGS: [&str; 6] = ["-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wshadow", "-Werror"];
/// Warning flag that only GCC has.
const OF_GCC: &str = "-Wuseless-cast";
const LEAN: [&str; 2] = ["-fno-exceptions", "-fno-rtti"];

fn examples() -> PathBuf {
    paths::workspace().join("nerf-render-ffi/examples/cpp")
}

/// Renders a camera's image with the Rust renderer. Returns the pixels, row by row.
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

/// Returns the numbers that follow `word` in a text.
fn numbers<const N: usize>(text: &str, word: &str) -> [f32; N] {
    let mut words = text.split_whitespace().skip_while(|&found| found != word).skip(1);
    std::array::from_fn(|_| words.next().expect(word).parse().expect("a number"))
}

/// Returns the camera that a program printed: focal length and pose.
fn printed_camera(text: &str, [width, height]: [u32; 2]) -> Camera {
    let ([focal], c2w) = (numbers(text, "focal"), numbers::<12>(text, "c2w"));
    let pose = Pose::from_rows(std::array::from_fn(|i| std::array::from_fn(|j| c2w[4 * i + j])));
    Camera::new(Intrinsics::centred(width, height, focal), Lens::NONE, pose).expect("a camera")
}

/// Returns the bytes behind `header` in a file.
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
    let allowed = [
        "blob",
        "blob_size",
        "memcpy",
        "memmove",
        "memset",
        "sinf",
        "cosf",
        "sqrtf",
        "_GLOBAL_OFFSET_TABLE_",
    ];
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

/// Content of a PNG with stored deflate blocks. `header`: width, height, bits per channel, colour type.
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
    let (directory, [width, height]) = (paths::temporary(), [131, 70]);
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
