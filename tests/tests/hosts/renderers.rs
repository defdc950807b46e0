//! The renderers among the examples, with a field in each: a ray tracer, a path tracer, a rasteriser, Embree's; and rays
//! from Python, bit for bit.

use nerf_core::blob::Blob;
use nerf_core::camera::Ray;
use nerf_core::memory::Line;
use nerf_core::plan::{Batch, Outputs, Plan, Preset, Quality};
use nerf_core::render::{RaySegment, Renderer};
use nerf_core::volume::Pixel;
use nerf_core::{Isa, Kernel, Storage};
use nerf_tests::build::{Language, libraries, program, run};
use nerf_tests::paths;
use nerf_tests::scenes::Recipe;
use nerf_tests::tools::{all_here, there_is};
use std::path::{Path, PathBuf};
use std::process::Command;

const WIDTH: usize = 48;
const HEIGHT: usize = 36;

fn examples() -> PathBuf {
    paths::workspace().join("nerf-render-ffi/examples")
}

/// Builds an example and runs it on a scene; what it wrote as linear light.
fn drawn(directory: &Path, name: &str, scene: &str, last: &str) -> Vec<f32> {
    let source = examples().join("cpp").join(name).with_extension("cpp");
    let binary = directory.join(name);
    let binary = if binary.exists() {
        binary
    } else {
        let mut flags = vec!["-Wshadow"];
        if name == "embree" {
            flags.push("-lembree3");
        }
        program(Language::Cpp, &source, directory, &flags)
    };
    let (width, height) = (WIDTH.to_string(), HEIGHT.to_string());
    let mut command = Command::new(binary);
    command.env("NERF_KERNEL", "portable").current_dir(directory);
    run(command.args([scene, "out", &width, &height, last]));
    let bytes = std::fs::read(directory.join("out.pfm")).expect("a picture");
    let header = format!("PF\n{WIDTH} {HEIGHT}\n-1.0\n");
    let values = bytes.strip_prefix(header.as_bytes()).expect("colour, little-endian");
    let value = |four: &[u8]| f32::from_le_bytes([four[0], four[1], four[2], four[3]]);
    let values: Vec<f32> = values.chunks_exact(4).map(value).collect();
    assert_eq!(values.len(), 3 * WIDTH * HEIGHT);
    assert!(values.iter().all(|x| x.is_finite() && *x >= 0.0), "{name}");
    values
}

fn scenes(directory: &Path) {
    std::fs::write(directory.join("scene.nerf"), Recipe::OCCUPANCY.blob()).expect("a file");
    std::fs::write(directory.join("plain.nerf"), Recipe::PLAIN.blob()).expect("a file");
}

fn mean_difference(a: &[f32], b: &[f32]) -> f32 {
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).sum::<f32>() / a.len() as f32
}

#[test]
fn a_ray_tracer_draws_the_same_on_any_number_of_threads() {
    let directory = paths::temporary();
    scenes(directory.path());
    let draw = |scene, threads| drawn(directory.path(), "hybrid", scene, threads);
    let one = draw("scene.nerf", "1");
    assert!(one == draw("scene.nerf", "3"));
    assert!(mean_difference(&one, &draw("plain.nerf", "2")) > 0.01, "another field is another picture");
}

#[test]
fn a_path_tracer_converges() {
    let directory = paths::temporary();
    scenes(directory.path());
    let draw = |samples| drawn(directory.path(), "path", "scene.nerf", samples);
    let (few, more, many) = (draw("2"), draw("32"), draw("256"));
    assert!(few == draw("2"), "the same numbers give the same picture");
    let (early, late) = (mean_difference(&few, &many), mean_difference(&more, &many));
    assert!(late < 0.4 * early && late < 0.05, "{early}, {late}");
}

#[test]
fn a_rasteriser_s_triangles_hide_the_field_and_are_hidden() {
    let directory = paths::temporary();
    scenes(directory.path());
    let draw = |scene| drawn(directory.path(), "raster", scene, "1");
    assert!(mean_difference(&draw("scene.nerf"), &draw("plain.nerf")) > 0.01);
}

#[test]
fn embree_s_hits_end_the_rays() {
    if !there_is("Embree 3", Path::new("/usr/include/embree3/rtcore.h").exists()) {
        return;
    }
    let directory = paths::temporary();
    scenes(directory.path());
    let draw = |scene| drawn(directory.path(), "embree", scene, "1");
    assert!(mean_difference(&draw("scene.nerf"), &draw("plain.nerf")) > 0.01);
}

/// Rays that numpy made, and what they saw: the Rust renderer sees the same, bit for bit.
#[test]
fn python_renders_rays_in_arrays_of_its_own() {
    let script = examples().join("python/render.py");
    assert!(std::fs::read_to_string(&script).expect("a script").lines().count() <= 40);
    let numpy = Command::new("python3").args(["-c", "import numpy"]).output();
    if !all_here(&["python3"]) || !there_is("numpy", numpy.is_ok_and(|output| output.status.success())) {
        return;
    }
    let directory = paths::temporary();
    scenes(directory.path());
    let library = libraries().shared;
    let mut command = Command::new("python3");
    command.env("NERF_KERNEL", "portable").current_dir(directory.path());
    run(command.arg(script).arg(library).args(["scene.nerf", "rays.npy", "24"]));
    let bytes = std::fs::read(directory.path().join("rays.npy")).expect("an array");
    const FLOATS: usize = 11;
    let values = &bytes[bytes.len() - 4 * FLOATS * 24 * 24..];
    let value = |four: &[u8]| f32::from_le_bytes([four[0], four[1], four[2], four[3]]);
    let values: Vec<f32> = values.chunks_exact(4).map(value).collect();
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
