//! The Python package with the library that Cargo builds: the package's own tests, and rays from numpy arrays, whose
//! results equal Rust's bit for bit. `.ci/run` tests the wheel.

use nerf_core::blob::Blob;
use nerf_core::camera::Ray;
use nerf_core::memory::Line;
use nerf_core::plan::{Batch, Outputs, Plan, Preset, Quality};
use nerf_core::render::{RaySegment, Renderer};
use nerf_core::volume::Pixel;
use nerf_core::{Isa, Kernel, Storage};
use nerf_testing::build::{libraries, run};
use nerf_testing::paths;
use nerf_testing::scenes::Recipe;
use nerf_testing::tools::{all_here, there_is};
use std::path::{Path, PathBuf};
use std::process::Command;

fn sources() -> PathBuf {
    paths::workspace().join("nerf-render-ffi/python")
}

/// Returns whether there is a Python with these modules.
fn python_with(modules: &[&str]) -> bool {
    let imports = |module: &&&str| {
        let python = Command::new("python3").args(["-c", &format!("import {module}")]).output();
        !there_is(module, python.is_ok_and(|output| output.status.success()))
    };
    all_here(&["python3"]) && modules.iter().filter(imports).count() == 0
}

/// Installs the package, its library and a scene in `directory`. Returns a command for a Python that finds the package.
fn python(directory: &Path) -> Command {
    let package = directory.join("nerf_render");
    std::fs::create_dir(&package).expect("a folder");
    for file in std::fs::read_dir(sources().join("nerf_render")).expect("a package") {
        let file = file.expect("a file");
        if file.path().is_file() {
            std::fs::copy(file.path(), package.join(file.file_name())).expect("a copy");
        }
    }
    std::fs::copy(libraries().shared, package.join("libnerf_render.so")).expect("a library");
    std::fs::write(directory.join("scene.nerf"), Recipe::OCCUPANCY.blob()).expect("a scene");
    let mut command = Command::new("python3");
    command.current_dir(directory).env("PYTHONPATH", directory).env("PYTHONDONTWRITEBYTECODE", "1");
    command
}

/// Runs the package's tests as `.ci/run` does, except those that need the wheel.
#[test]
fn the_package_passes_its_tests() {
    if !python_with(&["numpy", "pytest"]) {
        return;
    }
    let directory = paths::temporary();
    let mut command = python(directory.path());
    command.env("NERF_SCENE", "scene.nerf").args(["-X", "dev", "-X", "faulthandler", "-m", "pytest", "-q"]);
    let done = run(command.args(["-p", "no:cacheprovider", "-W", "error"]).arg(sources().join("tests")));
    let said = String::from_utf8_lossy(&done.stdout);
    assert!(said.contains(" passed") && !said.contains("failed"), "{said}");
}

const RECORDS: &str = r#"
import nerf_render as nerf
import numpy as np
rays = np.zeros((24, 24), [("origin", "3f4"), ("dir", "3f4"), ("rgb", "3f4"), ("opacity", "f4"), ("distance", "f4")])
x, y = np.meshgrid(*2 * [(np.arange(24) + 0.5) / 24 - 0.5])
rays["origin"], rays["dir"] = [0, -4, 0.4], np.stack([x, 1.2 + 0 * x, -y - 0.15], -1)
rays["dir"] /= np.linalg.norm(rays["dir"], axis=-1, keepdims=True)
out = {"rgb": rays["rgb"], "opacity": rays["opacity"], "ray_distance": rays["distance"]}
nerf.Scene("scene.nerf").rays(rays["origin"], rays["dir"], out=out)
rays.tofile("rays.bin")
"#;

/// Renders rays from an array of numpy records; the Rust renderer gives the same results, bit for bit.
#[test]
fn rays_in_arrays_of_python_are_those_of_rust() {
    if !python_with(&["numpy"]) {
        return;
    }
    let directory = paths::temporary();
    run(python(directory.path()).env("NERF_KERNEL", "portable").args(["-c", RECORDS]));
    let bytes = std::fs::read(directory.path().join("rays.bin")).expect("an array");
    const FLOATS: usize = 11;
    let value = |four: &[u8]| f32::from_le_bytes([four[0], four[1], four[2], four[3]]);
    let values: Vec<f32> = bytes.chunks_exact(4).map(value).collect();
    let records: Vec<&[f32]> = values.chunks_exact(FLOATS).collect();
    let rays: Vec<RaySegment> = records
        .iter()
        .map(|r| Ray { origin: [r[0], r[1], r[2]].into(), dir: [r[3], r[4], r[5]].into() }.into())
        .collect();
    let file = Recipe::OCCUPANCY.blob();
    let blob = Blob::open(&file).expect("a blob");
    let kernel = Kernel::new(Isa::Portable, Storage::F32);
    let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, kernel)];
    let outputs = Outputs { z_depth: false, ..Outputs::ALL };
    let plan = Plan::new(&blob, &Quality::preset(&blob, Preset::High), outputs, Batch::FULL).expect("a plan");
    let renderer = Renderer::new(blob, kernel, &mut memory).expect("a renderer");
    let mut workspace = vec![Line::UNINIT; renderer.workspace_lines(&plan)];
    let mut seen = 0;
    let mut check = |i: usize, pixel: &Pixel| {
        assert_eq!(records[i][6..], [&pixel.rgb[..], &[pixel.opacity, pixel.ray_distance]].concat());
        seen += usize::from(pixel.opacity > 0.5);
    };
    renderer
        .worker(&plan, &mut workspace)
        .expect("a worker")
        .render_rays(&rays, None, &mut check)
        .expect("rays");
    assert!(seen > 20, "{seen} rays that meet something prove nothing");
}
