//! Example renderers that render a field together with their own surfaces: a ray tracer, a path tracer, a rasteriser,
//! one with Embree, and one with OpenMP threads.

use nerf_testing::build::{Language, program, run};
use nerf_testing::paths;
use nerf_testing::scenes::Recipe;
use nerf_testing::tools::there_is;
use std::path::{Path, PathBuf};
use std::process::Command;

const WIDTH: usize = 48;
const HEIGHT: usize = 36;

fn examples() -> PathBuf {
    paths::workspace().join("nerf-render-ffi/examples")
}

/// Builds an example and runs it on a scene. Returns the image, in linear light. `last`: the example's last argument, a
/// number of threads or samples.
fn drawn(directory: &Path, name: &str, scene: &str, last: &str) -> Vec<f32> {
    let source = examples().join("cpp").join(name).with_extension("cpp");
    let binary = directory.join(name);
    let binary = if binary.exists() {
        binary
    } else {
        let mut flags = vec!["-Wshadow"];
        match name {
            "embree" => flags.push("-lembree3"),
            "openmp" => flags.push("-fopenmp"),
            _ => {}
        }
        program(Language::Cpp, &source, directory, &flags)
    };
    let (width, height) = (WIDTH.to_string(), HEIGHT.to_string());
    let mut command = Command::new(binary);
    command.env_remove("NERF_KERNEL").env("OMP_NUM_THREADS", last).current_dir(directory);
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
    let (few, more, many) = (draw("2"), draw("32"), draw("128"));
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

/// Returns whether the C++ compiler has OpenMP.
fn openmp(directory: &Path) -> bool {
    let source = directory.join("probe.cpp");
    std::fs::write(&source, "#include <omp.h>\nint main() { return omp_get_max_threads() < 1; }\n")
        .expect("a file");
    let mut command = Command::new(std::env::var_os("CXX").unwrap_or_else(|| "c++".into()));
    let built = command.arg("-fopenmp").arg(source).arg("-o").arg(directory.join("probe")).output();
    built.is_ok_and(|output| output.status.success())
}

#[test]
fn openmp_s_threads_draw_the_same_with_workers_of_their_own() {
    let directory = paths::temporary();
    if !there_is("OpenMP", openmp(directory.path())) {
        return;
    }
    scenes(directory.path());
    let draw = |scene, threads| drawn(directory.path(), "openmp", scene, threads);
    let one = draw("scene.nerf", "1");
    assert!(one == draw("scene.nerf", "3"));
    assert!(mean_difference(&one, &draw("plain.nerf", "2")) > 0.01, "another field is another picture");
}
