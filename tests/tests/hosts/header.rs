//! The committed header equals the header generated from the sources, and the header's names are exported by the
//! library.
#![allow(unsafe_code, reason = "tests call the C interface")]

use nerf_testing::{build, paths, symbols};

fn generated() -> String {
    let ffi = paths::workspace().join("nerf-render-ffi");
    let config = cbindgen::Config::from_file(ffi.join("cbindgen.toml")).expect("cbindgen.toml");
    let bindings = cbindgen::Builder::new().with_crate(&ffi).with_config(config).generate();
    let mut header = Vec::new();
    bindings.expect("bindings").write(&mut header);
    String::from_utf8(header).expect("UTF-8").lines().map(|line| with_float_literal(line) + "\n").collect()
}

/// Appends `f` to the number of a float constant. cbindgen writes an f32 as a double, and C compilers warn where a
/// double is converted to float.
fn with_float_literal(line: &str) -> String {
    let number = line.strip_prefix("#define ").and_then(|rest| rest.split(' ').nth(1)).unwrap_or_default();
    let is_float = number.contains(['.', 'e']) && number.parse::<f32>().is_ok();
    format!("{line}{}", if is_float { "f" } else { "" })
}

#[test]
fn header_is_current() {
    let (path, header) = (paths::header(), generated());
    if std::env::var_os("NERF_BLESS").is_some_and(|bless| bless == "1") {
        std::fs::write(&path, header).expect("include/nerf_render.h is writable");
        return;
    }
    let committed = std::fs::read_to_string(&path).unwrap_or_default();
    assert!(committed == header, "{} is not current: NERF_BLESS=1 cargo test renews it", path.display());
}

#[test]
fn defaults_of_floats_are_floats() {
    let source = paths::temporary();
    let file = source.path().join("defaults.c");
    let program = "#include \"nerf_render.h\"\nvoid set(nerf_render_options *options);\n\
        void set(nerf_render_options *options) {\n\
            options->transmittance_cut = 0.5f * NERF_TRANSMITTANCE_CUT_DEFAULT;\n\
            options->colour_cut = 0.5f * NERF_COLOUR_CUT_DEFAULT;\n\
            options->normal_blur = 0.3f * NERF_NORMAL_BLUR_DEFAULT;\n\
            options->near_distance = 0.3f * NERF_NONE;\n\
            options->samples = NERF_OUTPUT_RGB | NERF_OUTPUT_NORMALS;\n}\n";
    std::fs::write(&file, program).expect("a temporary file");
    let include = paths::header().parent().expect("a directory").to_path_buf();
    let mut command = std::process::Command::new(std::env::var_os("CC").unwrap_or_else(|| "cc".into()));
    let warnings =
        ["-Wall", "-Wextra", "-Wconversion", "-Wdouble-promotion", "-Wfloat-conversion", "-Werror"];
    command.args(["-std=c11", "-fsyntax-only"]).args(warnings).arg("-I").arg(include);
    build::run(command.arg(file));
}

#[test]
fn header_and_libraries_name_the_same_functions() {
    let header = std::fs::read_to_string(paths::header()).expect("include/nerf_render.h");
    let (libraries, declared) = (build::libraries(), symbols::declared(&header));
    let mut archive = symbols::of_archive(&libraries.archive);
    archive.retain(|name| name.starts_with("nerf_"));
    assert_eq!(archive, declared);
    // The shared library exports nothing else at all.
    assert_eq!(symbols::of_shared(&libraries.shared), declared);
    assert!(declared.contains("nerf_render") && declared.len() == 25, "{declared:?}");
}

#[test]
fn every_name_of_the_header_begins_with_the_librarys() {
    let names = symbols::brought(&std::fs::read_to_string(paths::header()).expect("include/nerf_render.h"));
    let foreign: Vec<_> =
        names.iter().filter(|name| !name.starts_with("nerf_") && !name.starts_with("NERF_")).collect();
    assert!(foreign.is_empty(), "{foreign:?}");
    // One of each kind, so that none is overlooked.
    for name in ["NERF_NONE", "nerf_frame", "nerf_progress", "nerf_worker", "NERF_STATUS_BUSY", "nerf_render"]
    {
        assert!(names.contains(name), "{name}");
    }
}

#[test]
fn table_of_capabilities_names_every_function() {
    let readme =
        std::fs::read_to_string(paths::workspace().join("nerf-render-ffi/README.md")).expect("the README");
    let table = readme.split("## What Rust has, C has").nth(1).and_then(|rest| rest.split("\n## ").next());
    let table = table.expect("the table");
    for name in symbols::declared(&std::fs::read_to_string(paths::header()).expect("include/nerf_render.h")) {
        assert!(table.contains(&format!("`{name}`")), "{name} is not in the table");
    }
}

#[test]
fn numbers_of_the_statuses_never_change() {
    let expected: Vec<i32> = (0..=24).chain(32..=39).collect();
    assert_eq!(nerf_render::Status::ALL.iter().map(|&status| status as i32).collect::<Vec<_>>(), expected);
    for status in (-2..50).chain([i32::MIN, i32::MAX]) {
        let text = nerf_render::nerf_status_text(status);
        // SAFETY: a static, NUL-terminated text.
        let text = unsafe { std::ffi::CStr::from_ptr(text) }.to_str().expect("UTF-8");
        assert_eq!(text == "unknown status", !expected.contains(&status), "{status}: {text}");
    }
}
