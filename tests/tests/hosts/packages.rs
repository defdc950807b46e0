//! Installed packages of the library: usable by CMake and pkg-config, from C and C++, shared and static, in any folder.
//!
//! The library can be installed by `cmake --install` and by `cargo cinstall`. Without cargo-c, the tests skip the
//! second way and print a message.
#![cfg(target_os = "linux")]

use nerf_core::Kernel;
use nerf_core::blob::Blob;
use nerf_core::camera::{Camera, Intrinsics, Lens, Pose};
use nerf_core::memory::Line;
use nerf_core::plan::{Batch, Outputs, Plan, Quality};
use nerf_core::render::{Rect, Renderer};
use nerf_testing::build::run;
use nerf_testing::scenes::Recipe;
use nerf_testing::{paths, symbols, tools};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

const TOOLS: [&str; 7] = ["cmake", "make", "pkg-config", "gcc", "g++", "clang", "clang++"];
/// Pairs of a C compiler and a C++ compiler.
const COMPILERS: [[&str; 2]; 2] = [["gcc", "g++"], ["clang", "clang++"]];
const SONAME: &str = "libnerf_render.so.2";

fn ffi_crate() -> PathBuf {
    paths::workspace().join("nerf-render-ffi")
}

/// Returns the folder of a project that uses the package.
fn outside() -> PathBuf {
    paths::workspace().join("tests/outside")
}

/// Returns cargo's target directory.
fn target() -> PathBuf {
    // Beside the executable that runs: target/release/deps/test-0123.
    let own = std::env::current_exe().expect("a path");
    own.ancestors().nth(3).expect("cargo's target directory").to_path_buf()
}

/// Makes an empty folder in `target/packages`. The folder is kept, so that the installed files can be inspected.
fn fresh(name: &str) -> PathBuf {
    let path = target().join("packages").join(name);
    let _ = std::fs::remove_dir_all(&path);
    std::fs::create_dir_all(&path).expect("cargo's target directory is writable");
    path
}

/// Returns the CMake argument `-Dname=value`.
fn set(name: &str, value: impl AsRef<Path>) -> String {
    format!("-D{name}={}", value.as_ref().display())
}

/// Returns the command `cmake -S source -B build` with `settings`; does not run the command.
fn configure(source: &Path, build: &Path, settings: &[String]) -> Command {
    let mut command = Command::new("cmake");
    command.arg("-S").arg(source).arg("-B").arg(build).args(settings);
    command
}

/// Runs `cmake --build build`.
fn make(build: &Path) {
    run(Command::new("cmake").env("CARGO_NET_OFFLINE", "true").arg("--build").arg(build));
}

/// Installs the package with CMake, with libraries in `libdir`. Returns the installation prefix.
fn by_cmake(name: &str, libdir: &str) -> PathBuf {
    let (build, prefix) = (fresh(&format!("{name}-build")), fresh(name));
    let cargo = set("NERF_RENDER_CARGO_TARGET", target());
    run(&mut configure(&ffi_crate(), &build, &[cargo, set("CMAKE_INSTALL_LIBDIR", libdir)]));
    make(&build);
    run(Command::new("cmake").arg("--install").arg(build).arg("--prefix").arg(&prefix));
    prefix
}

/// Installs the package with cargo-c. Returns the installation prefix.
fn by_cargo_c(name: &str) -> PathBuf {
    let prefix = fresh(name);
    let mut command = Command::new("cargo");
    command.current_dir(ffi_crate());
    command.args(["cinstall", "--offline", "--profile", "lean", "--libdir", "lib"]);
    run(command.arg("--target-dir").arg(target().join("cargo-c")).arg("--prefix").arg(&prefix));
    prefix
}

/// Returns the installation prefixes, each with the name of its installer; empty if a tool is missing. Installs only
/// once per run.
fn installed() -> &'static [(&'static str, PathBuf)] {
    static INSTALLED: OnceLock<Vec<(&str, PathBuf)>> = OnceLock::new();
    // Asked by each test, so that each is noted as left out.
    if !tools::all_here(&TOOLS) {
        return &[];
    }
    INSTALLED.get_or_init(|| {
        let mut prefixes = vec![("CMake", by_cmake("cmake", "lib"))];
        if tools::runs(&["cargo", "cinstall"]) {
            prefixes.push(("cargo-c", by_cargo_c("cargo-c")));
        } else {
            tools::say_skipped("no cargo-c; not tested: packages that it installs");
        }
        prefixes
    })
}

/// Returns the paths of all files below `directory`, each with the target of the link if the file is a link.
fn files(directory: &Path) -> BTreeMap<String, Option<PathBuf>> {
    let output = run(Command::new("find").current_dir(directory).args([".", "!", "-type", "d"])).stdout;
    let names = String::from_utf8(output).expect("UTF-8");
    let link = |name: &str| std::fs::read_link(directory.join(name)).ok();
    names.lines().map(|name| (name[2..].to_owned(), link(name))).collect()
}

/// Renders the image that the programs in `tests/outside` render, with the Rust renderer. Returns 8-bit colours.
fn picture() -> Vec<u8> {
    let blob = Recipe::PLAIN.blob();
    let blob = Blob::open(&blob).expect("a blob");
    let pose = Pose::from_rows([[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 4.0]]);
    let camera = Camera::new(Intrinsics::centred(37, 29, 44.0), Lens::NONE, pose).expect("a camera");
    let batch = Batch::FULL;
    let plan = Plan::new(&blob, &Quality::default(), Outputs::RGB, batch).expect("a plan");
    let renderer = Renderer::new(blob, Kernel::IN_PLACE, &mut []).expect("a renderer");
    let mut workspace = vec![Line::UNINIT; renderer.workspace_lines(&plan)];
    let mut rgb = vec![0; 37 * 29 * 3];
    let mut put = |x: u32, y: u32, pixel: &nerf_core::volume::Pixel| {
        let i = 3 * (37 * y + x) as usize;
        rgb[i..i + 3].copy_from_slice(&pixel.rgb.map(|c| (c.clamp(0.0, 1.0) * 255.0 + 0.5) as u8));
    };
    renderer.render(&plan, &camera, Rect::full(&camera), &mut workspace, &mut put).expect("a picture");
    rgb
}

/// Runs a program of the outside project. Verifies that it is linked as `shared` says and renders Rust's image.
fn draws(program: &Path, shared: bool, libdir: &Path) {
    let headers = run(Command::new("objdump").arg("-p").arg(program)).stdout;
    let needed = String::from_utf8_lossy(&headers).contains(SONAME);
    assert_eq!(needed, shared, "{}: needs the shared library", program.display());

    let directory = paths::temporary();
    let file = directory.path().join("scene.nerf");
    std::fs::write(&file, Recipe::PLAIN.blob()).expect("a temporary file");
    let scene = std::fs::File::open(&file).expect("a temporary file");
    let mut command = Command::new(program);
    command.env("NERF_KERNEL", "portable-f16").env("LD_LIBRARY_PATH", libdir).stdin(scene);
    let (found, expected) = (run(&mut command).stdout, picture());
    let different = expected.iter().collect::<BTreeSet<_>>().len();
    assert!(different > 50, "a flat picture proves nothing ({different} values)");
    assert!(found == expected, "{}: another picture, {} bytes", program.display(), found.len());
}

/// Builds the outside project with CMake and runs its programs. `shared`: whether a shared library is installed.
fn cmake_project(name: &str, compilers: [&str; 2], place: String, shared: bool) {
    let build = fresh(name);
    let [c, cpp] = compilers.map(PathBuf::from);
    let settings = [
        set("CMAKE_C_COMPILER", c),
        set("CMAKE_CXX_COMPILER", cpp),
        place,
        set("NERF_RENDER_CARGO_TARGET", target()),
    ];
    run(&mut configure(&outside(), &build, &settings));
    make(&build);
    for language in ["c", "cpp"] {
        draws(&build.join(format!("{language}_shared")), shared, Path::new(""));
        draws(&build.join(format!("{language}_static")), false, Path::new(""));
    }
}

/// Compiles the outside project's programs with the flags from pkg-config, and runs the programs.
fn pkg_config_project(name: &str, compilers: [&str; 2], libdir: &Path, shared: bool) {
    let into = fresh(name);
    let mut command = Command::new("pkg-config");
    // Only this prefix, and where it lies now: cargo-c writes down where it was made.
    command.env("PKG_CONFIG_LIBDIR", libdir.join("pkgconfig")).args([
        "--define-prefix",
        "--cflags",
        "--libs",
    ]);
    command.args((!shared).then_some("--static"));
    let flags = String::from_utf8(run(command.arg("nerf_render >= 1")).stdout).expect("UTF-8");
    for (compiler, standard, source) in
        [(compilers[0], "-std=c11", "host.c"), (compilers[1], "-std=c++17", "host.cpp")]
    {
        let program = into.join(source.replace('.', "_"));
        let mut command = Command::new(compiler);
        command.args([standard, "-O1", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-o"]).arg(&program);
        run(command.arg(outside().join(source)).args(flags.split_whitespace()));
        draws(&program, shared, libdir);
    }
}

/// Verifies that git ignores the build folders of the guide: a release contains only committed files, and an unignored
/// build folder would stop it.
#[test]
fn build_folders_of_the_guide_are_ignored() {
    let read = |path: &str| std::fs::read_to_string(paths::workspace().join(path)).expect(path);
    let ignored = read(".gitignore");
    for page in ["nerf-render-ffi/README.md", "nerf-render-ffi/CMakeLists.txt"] {
        let text = read(page);
        let folders = text.split(" -B ").skip(1).filter_map(|rest| rest.split_whitespace().next());
        let folders: Vec<&str> = folders.collect();
        assert!(!folders.is_empty(), "{page}");
        for folder in folders {
            assert!(ignored.lines().any(|line| line == format!("/{folder}")), "{page}: {folder}");
        }
    }
}

#[test]
fn both_ways_install_the_same_files() {
    for (by, prefix) in installed() {
        let mut expected = BTreeMap::new();
        for name in ["nerf_render.h", "nerf_render.hpp"] {
            if paths::workspace().join("include").join(name).exists() {
                expected.insert(format!("include/{name}"), None);
            }
        }
        let plain = [
            "lib/libnerf_render.a",
            "lib/libnerf_render.so.2.0.0",
            "lib/pkgconfig/nerf_render.pc",
            "share/cmake/nerf_render/nerf_renderConfig.cmake",
            "share/cmake/nerf_render/nerf_renderConfigVersion.cmake",
        ];
        expected.extend(plain.map(|name| (name.to_owned(), None)));
        let links = ["lib/libnerf_render.so", "lib/libnerf_render.so.2"];
        expected.extend(links.map(|name| (name.to_owned(), Some("libnerf_render.so.2.0.0".into()))));
        assert_eq!(files(prefix), expected, "{by}");
        let header = |root: &Path| std::fs::read(root.join("include/nerf_render.h")).expect("a header");
        assert!(header(prefix) == header(&paths::workspace()), "{by}: another header");
    }
}

#[test]
fn projects_find_the_package_with_cmake() {
    for (by, prefix) in installed() {
        for compilers in COMPILERS {
            let name = format!("cmake-of-{by}-{}", compilers[0]);
            cmake_project(&name, compilers, set("CMAKE_PREFIX_PATH", prefix), true);
        }
    }
}

#[test]
fn projects_find_the_package_with_pkg_config() {
    for (by, prefix) in installed() {
        for compilers in COMPILERS {
            let name = format!("pkg-config-of-{by}-{}", compilers[0]);
            pkg_config_project(&name, compilers, &prefix.join("lib"), true);
        }
    }
}

#[test]
fn a_prefix_may_move_and_do_without_the_shared_library() {
    for (by, prefix) in installed() {
        let moved = fresh(&format!("moved-{by}"));
        run(Command::new("cp").arg("-a").arg(prefix.join(".")).arg(&moved));
        for link in ["", ".2", ".2.0.0"] {
            std::fs::remove_file(moved.join(format!("lib/libnerf_render.so{link}")))
                .expect("it was installed");
        }
        let place = set("CMAKE_PREFIX_PATH", &moved);
        cmake_project(&format!("cmake-of-moved-{by}"), COMPILERS[0], place, false);
        for compilers in COMPILERS {
            let name = format!("pkg-config-of-moved-{by}-{}", compilers[0]);
            pkg_config_project(&name, compilers, &moved.join("lib"), false);
        }
    }
}

#[test]
fn libraries_may_lie_in_a_directory_of_the_architecture() {
    if installed().is_empty() {
        return;
    }
    // Debian's name for the place of libraries, "lib/x86_64-linux-gnu"; elsewhere there is none.
    let triple = String::from_utf8(run(Command::new("gcc").arg("-print-multiarch")).stdout).expect("UTF-8");
    let place = if triple.trim().is_empty() { "lib64".into() } else { format!("lib/{}", triple.trim()) };
    let prefix = by_cmake("multiarch", &place);
    cmake_project("cmake-of-multiarch", COMPILERS[0], set("CMAKE_PREFIX_PATH", &prefix), true);
    // --define-prefix would take lib/ for the prefix; CMake's file says itself where it lies.
    let libdir = prefix.join(place);
    let mut command = Command::new("pkg-config");
    command.env("PKG_CONFIG_LIBDIR", libdir.join("pkgconfig")).args(["--cflags", "--libs", "nerf_render"]);
    let flags = String::from_utf8(run(&mut command).stdout).expect("UTF-8");
    let mut places =
        flags.split_whitespace().filter_map(|flag| Path::new(flag.get(2..)?).canonicalize().ok());
    assert_eq!(places.next(), prefix.join("include").canonicalize().ok());
    assert_eq!(places.next(), libdir.canonicalize().ok());
}

#[test]
fn sources_may_be_a_part_of_a_cmake_project() {
    if !installed().is_empty() {
        cmake_project("subdirectory", COMPILERS[1], set("NERF_RENDER_SOURCE", ffi_crate()), true);
    }
}

#[test]
fn first_number_of_the_packages_version_is_the_abis() {
    let abi = nerf_render::NERF_ABI_VERSION.to_string();
    let version = |path: &str, before: &str, after: char| {
        let text = std::fs::read_to_string(ffi_crate().join(path)).expect(path);
        let values = text.split(before).skip(1).map(|rest| rest.split(after).next().unwrap_or("").to_owned());
        values.collect::<Vec<_>>()
    };
    let cmake = version("cmake/nerf_renderConfigVersion.cmake", "set(PACKAGE_VERSION ", ')');
    assert_eq!(cmake[0].split('.').next(), Some(abi.as_str()));
    let majors = version("cmake/nerf_renderConfigVersion.cmake", "PACKAGE_FIND_VERSION_MAJOR}\" EQUAL ", ' ');
    assert_eq!(majors, [abi.as_str()], "what find_package may ask for");
    assert_eq!(version("Cargo.toml", "\nversion = \"", '"'), [cmake[0].as_str(), &cmake[0]], "cargo-c's");

    for (by, prefix) in installed() {
        let library = prefix.join("lib/libnerf_render.so");
        let headers = run(Command::new("objdump").arg("-p").arg(&library)).stdout;
        let headers = String::from_utf8_lossy(&headers);
        let soname = headers.lines().find_map(|line| line.trim().strip_prefix("SONAME"));
        assert_eq!(soname.map(str::trim), Some(format!("libnerf_render.so.{abi}").as_str()), "{by}");

        let mut command = Command::new("pkg-config");
        command.env("PKG_CONFIG_LIBDIR", prefix.join("lib/pkgconfig")).args(["--modversion", "nerf_render"]);
        assert_eq!(String::from_utf8_lossy(&run(&mut command).stdout).trim(), cmake[0], "{by}");

        let source = paths::temporary();
        for (asked, found) in [
            ("", true),
            ("2", true),
            ("2.0.0 EXACT", true),
            ("2...3", true),
            ("1.0", false),
            ("2.99", false),
            ("3", false),
        ] {
            let project = format!(
                "cmake_minimum_required(VERSION 3.19)\nproject(asks LANGUAGES C)\n\
                 find_package(nerf_render {asked} CONFIG REQUIRED)\n"
            );
            std::fs::write(source.path().join("CMakeLists.txt"), project).expect("a temporary file");
            let settings = [set("CMAKE_PREFIX_PATH", prefix)];
            let output = configure(source.path(), &source.path().join("build"), &settings).output();
            let output = output.expect("cmake");
            let said = String::from_utf8_lossy(&output.stderr);
            assert_eq!(output.status.success(), found, "{by}: find_package(nerf_render {asked}): {said}");
        }
    }
}

#[test]
fn libraries_show_the_headers_functions_and_nothing_else() {
    let header = std::fs::read_to_string(paths::header()).expect("include/nerf_render.h");
    let declared = symbols::declared(&header);
    for (by, prefix) in installed() {
        assert_eq!(symbols::of_shared(&prefix.join("lib/libnerf_render.so")), declared, "{by}");
        let mut archive = symbols::of_archive(&prefix.join("lib/libnerf_render.a"));
        if *by == "cargo-c" {
            // An archive as rustc makes it: Rust's own names are there, mangled or of its runtime.
            archive.retain(|name| name.starts_with("nerf_"));
        }
        assert_eq!(archive, declared, "{by}");
    }
}

#[test]
fn another_rust_library_may_stand_beside_the_static_one() {
    for (by, prefix) in installed() {
        if *by == "cargo-c" {
            // Its archive shows std's functions, and the other's are the same: the linker refuses both.
            continue;
        }
        let into = fresh("beside");
        let (library, program) = (into.join("libbeside.a"), into.join("beside"));
        let mut command = Command::new("rustc");
        command.args(["--edition", "2024", "-O", "--crate-type", "staticlib", "-o"]).arg(&library);
        run(command.arg(outside().join("beside.rs")));
        let archive = prefix.join("lib/libnerf_render.a");
        // Whichever comes first.
        for libraries in [[&archive, &library], [&library, &archive]] {
            let mut command = Command::new("gcc");
            command
                .args(["-std=c11", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-I"])
                .arg(prefix.join("include"));
            command.arg(outside().join("beside.c")).args(libraries).args(["-lpthread", "-ldl", "-lm", "-o"]);
            run(command.arg(&program));
            run(&mut Command::new(&program));
        }
    }
}
