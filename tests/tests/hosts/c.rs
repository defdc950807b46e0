//! C and C++ programs that link the static library render what Rust renders, bit for bit.

use nerf_core::Kernel;
use nerf_core::blob::Blob;
use nerf_core::camera::{Camera, Intrinsics, Lens, Pose};
use nerf_core::math::MathBackend;
use nerf_core::memory::Line;
use nerf_core::plan::{Batch, Outputs, Plan, Quality};
use nerf_core::render::{Rect, Renderer};
use nerf_testing::build::{Language, program, run};
use nerf_testing::paths;
use nerf_testing::scenes::{Recipe, kernels, picture};
use std::path::{Path, PathBuf};
use std::process::Command;

const WIDTH: u32 = 37;
const HEIGHT: u32 = 29;

fn example(path: &str) -> PathBuf {
    paths::workspace().join("nerf-render-ffi/examples").join(path)
}

/// Renders an image with the Rust renderer. Returns the 8-bit colours and `z_depth`, row by row.
fn reference(blob: &[u8], kernel: Kernel, camera: &Camera) -> (Vec<u8>, Vec<f32>) {
    let blob = Blob::open(blob).expect("a blob");
    let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, kernel)];
    let outputs = Outputs { opacity: false, ray_distance: false, ..Outputs::ALL };
    let plan = Plan::new(&blob, &Quality::default(), outputs, Batch::FULL).expect("a plan");
    let renderer = Renderer::new(blob, kernel, &mut memory).expect("a renderer");
    let mut workspace = vec![Line::UNINIT; renderer.workspace_lines(&plan)];
    let (width, pixels) = (camera.intrinsics().width, camera.intrinsics().width * camera.intrinsics().height);
    let (mut rgb, mut z_depth) = (vec![0; 3 * pixels as usize], vec![0.0; pixels as usize]);
    let mut put = |x: u32, y: u32, pixel: &nerf_core::volume::Pixel| {
        let i = (y * width + x) as usize;
        rgb[3 * i..3 * i + 3].copy_from_slice(&pixel.rgb.map(|c| (c.clamp(0.0, 1.0) * 255.0 + 0.5) as u8));
        z_depth[i] = pixel.z_depth;
    };
    renderer.render(&plan, camera, Rect::full(camera), &mut workspace, &mut put).expect("a picture");
    (rgb, z_depth)
}

/// Returns the camera whose pose the program printed.
fn printed_camera(stdout: &[u8]) -> Camera {
    let text = String::from_utf8_lossy(stdout);
    let line = text.lines().find_map(|line| line.strip_prefix("c2w ")).expect("a line \"c2w ...\"");
    let c2w: Vec<f32> = line.split(' ').map(|number| number.parse().expect("a number")).collect();
    let pose = Pose::from_rows(std::array::from_fn(|i| std::array::from_fn(|j| c2w[4 * i + j])));
    let focal = 1.2f32 * WIDTH.max(HEIGHT) as f32;
    Camera::new(Intrinsics::centred(WIDTH, HEIGHT, focal), Lens::NONE, pose).expect("a camera")
}

/// Returns the bytes behind `header` in a file.
fn content(path: &Path, header: &str) -> Vec<u8> {
    let bytes = std::fs::read(path).expect("the program wrote it");
    bytes.strip_prefix(header.as_bytes()).unwrap_or_else(|| panic!("{}: header", path.display())).to_vec()
}

fn pictures_are_the_rust_renderers(language: Language, source: &str, arguments: &[&str]) {
    let directory = paths::temporary();
    let program = program(language, &example(source), directory.path(), &[]);
    let size = format!("{WIDTH} {HEIGHT}\n");
    for (name, recipe) in [
        ("plain", Recipe::PLAIN),
        ("skip", Recipe::SKIP),
        ("occupancy", Recipe::OCCUPANCY_REQUIRED),
        ("proposal", Recipe::PROPOSAL),
        ("contracted", Recipe::CONTRACTED),
    ] {
        let (blob, file) = (recipe.blob(), directory.path().join("scene.nerf"));
        std::fs::write(&file, &blob).expect("a temporary file");
        for kernel in kernels() {
            let mut command = Command::new(&program);
            command.current_dir(directory.path()).env("NERF_KERNEL", kernel.to_string());
            command.arg(&file).arg("out").args([WIDTH.to_string(), HEIGHT.to_string()]).args(arguments);
            let camera = printed_camera(&run(&mut command).stdout);
            let (rgb, z_depth) = reference(&blob, kernel, &camera);
            let what = format!("{source}, {name}, {}", kernel);

            assert_eq!(
                content(&directory.path().join("out.ppm"), &format!("P6\n{size}255\n")),
                rgb,
                "{what}"
            );
            let upwards = z_depth.chunks(WIDTH as usize).rev().flatten();
            let expected: Vec<u8> = upwards.flat_map(|z| z.to_ne_bytes()).collect();
            let scale = if cfg!(target_endian = "little") { "-1.0" } else { "1.0" };
            let header = format!("Pf\n{size}{scale}\n");
            assert_eq!(content(&directory.path().join("out.pfm"), &header), expected, "{what}");
            let grey = content(&directory.path().join("out.pgm"), &format!("P5\n{size}255\n"));
            assert_eq!(grey.len(), z_depth.len(), "{what}");
            let different = rgb.iter().collect::<std::collections::BTreeSet<_>>().len();
            assert!(different > 50, "{what}: a flat picture proves nothing ({different} values)");
        }
    }
}

/// Renders a 2D field at `size` pixels with the Rust renderer. Returns the 8-bit colours, row by row.
fn picture_reference(blob: &[u8], kernel: Kernel, size: [u32; 2]) -> Vec<u8> {
    let pixels = picture(blob, kernel, MathBackend::Polynomial, size);
    pixels.iter().flatten().map(|c| (c * 255.0 + 0.5) as u8).collect()
}

#[test]
fn c_and_cpp_hosts_draw_the_pictures_rust_draws() {
    let directory = paths::temporary();
    let (blob, file) = (Recipe::PICTURE.blob(), directory.path().join("picture.nerf"));
    std::fs::write(&file, &blob).expect("a temporary file");
    for (language, source) in [(Language::C, "c/render.c"), (Language::Cpp, "cpp/render.cpp")] {
        let program = program(language, &example(source), directory.path(), &[]);
        // In the picture's own size, and larger than the C++ host's tiles.
        for (asked, size) in [(vec![], [33, 21]), (vec!["131", "70"], [131, 70])] {
            for kernel in kernels() {
                let mut command = Command::new(&program);
                command.current_dir(directory.path()).env("NERF_KERNEL", kernel.to_string());
                run(command.arg(&file).arg("out").args(&asked));
                let header = format!("P6\n{} {}\n255\n", size[0], size[1]);
                let found = content(&directory.path().join("out.ppm"), &header);
                assert!(found == picture_reference(&blob, kernel, size), "{source}, {}, {size:?}", kernel);
                let different = found.iter().collect::<std::collections::BTreeSet<_>>().len();
                assert!(different > 50, "{source}: a flat picture proves nothing ({different} values)");
            }
        }
        let (depth, grey) = (directory.path().join("out.pfm"), directory.path().join("out.pgm"));
        assert!(!depth.exists() && !grey.exists(), "{source}: a picture has no depth");
    }
}

#[test]
fn c_host_renders_what_rust_renders() {
    pictures_are_the_rust_renderers(Language::C, "c/render.c", &[]);
}

#[test]
fn cpp_host_renders_what_rust_renders_on_one_thread_and_on_three() {
    pictures_are_the_rust_renderers(Language::Cpp, "cpp/render.cpp", &["1"]);
    pictures_are_the_rust_renderers(Language::Cpp, "cpp/render.cpp", &["3"]);
}

#[test]
fn hosts_say_what_is_wrong() {
    let directory = paths::temporary();
    let mut blob = Recipe::PLAIN.blob();
    let last = blob.len() - 1;
    blob[last] ^= 1;
    std::fs::write(directory.path().join("damaged.nerf"), &blob).expect("a temporary file");
    std::fs::write(directory.path().join("good.nerf"), Recipe::PLAIN.blob()).expect("a temporary file");
    for (language, source) in [(Language::C, "c/render.c"), (Language::Cpp, "cpp/render.cpp")] {
        let program = program(language, &example(source), directory.path(), &[]);
        let complains = |arguments: &[&str], kernel: &str, expected: &str| {
            let mut command = Command::new(&program);
            command.current_dir(directory.path()).env("NERF_KERNEL", kernel).args(arguments);
            let output = command.output().expect("a program");
            let said = String::from_utf8_lossy(&output.stderr);
            assert!(!output.status.success() && said.contains(expected), "{source} {arguments:?}: {said}");
        };
        complains(&[], "", "usage:");
        complains(&["good.nerf", "out", "0", "3"], "", "usage:");
        complains(&["absent.nerf", "out"], "", "cannot read absent.nerf");
        complains(&["damaged.nerf", "out"], "", "its checksum does not match");
        complains(&["damaged.nerf", "out"], "", "CRC-32: expected");
        complains(&["good.nerf", "out"], "fast", "NERF_KERNEL");
        complains(&["good.nerf", "absent/out", "8", "8"], "", "cannot write absent/out");
    }
}

#[test]
fn minimal_programs_of_the_readmes_work() {
    let holds = |readme: &str, example: &Path| {
        let source = std::fs::read_to_string(example).expect("an example");
        let text = std::fs::read_to_string(paths::workspace().join(readme)).expect(readme);
        assert!(text.contains(source.trim()), "the program in {readme} is not {}", example.display());
    };
    let (c, cpp) = (example("c/minimal.c"), example("cpp/minimal.cpp"));
    holds("README.md", &c);
    holds("nerf-render-ffi/README.md", &c);
    holds("README.md", &cpp);

    let directory = paths::temporary();
    let file = directory.path().join("scene.nerf");
    std::fs::write(&file, Recipe::PLAIN.blob()).expect("a temporary file");
    let scene = std::fs::File::open(&file).expect("a temporary file");
    let drawn = |command: &mut Command, side: usize| {
        let (output, header) = (run(command), format!("P6 {side} {side} 255\n"));
        assert_eq!(output.stdout.len(), header.len() + side * side * 3);
        assert!(output.stdout.starts_with(header.as_bytes()));
    };
    drawn(Command::new(program(Language::C, &c, directory.path(), &[])).stdin(scene), 64);
    let folder = directory.path().join("cpp");
    std::fs::create_dir(&folder).expect("a temporary folder");
    drawn(Command::new(program(Language::Cpp, &cpp, &folder, &[])).arg(&file), 400);
}

#[test]
fn no_call_allocates() {
    let source = paths::workspace().join("tests/c/no_allocation.c");
    let directory = paths::temporary();
    let wrap = ["malloc", "calloc", "realloc", "posix_memalign", "aligned_alloc"];
    let wrap = wrap.map(|name| format!("-Wl,--wrap={name}"));
    let wrap: Vec<&str> = wrap.iter().map(String::as_str).collect();
    let program = program(Language::C, &source, directory.path(), &wrap);
    let file = directory.path().join("scene.nerf");
    for recipe in [Recipe::OCCUPANCY, Recipe::PICTURE] {
        std::fs::write(&file, recipe.blob()).expect("a temporary file");
        let scene = std::fs::File::open(&file).expect("a temporary file");
        run(Command::new(&program).env_remove("NERF_KERNEL").stdin(scene));
    }
}
