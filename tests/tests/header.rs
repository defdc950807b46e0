//! The committed header is what the sources say, and names what the library exports.
#![allow(unsafe_code, reason = "tests call the C interface")]

use nerf_tests::header::declared;
use nerf_tests::{build, paths};
use std::collections::BTreeSet;
use std::path::Path;
use std::process::Command;

fn generated() -> String {
    let ffi = paths::workspace().join("nerf-render-ffi");
    let config = cbindgen::Config::from_file(ffi.join("cbindgen.toml")).expect("cbindgen.toml");
    let bindings = cbindgen::Builder::new().with_crate(&ffi).with_config(config).generate();
    let mut header = Vec::new();
    bindings.expect("bindings").write(&mut header);
    String::from_utf8(header).expect("UTF-8")
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

/// What `nm` finds defined in a library.
fn exported(arguments: &[&str], library: &Path) -> BTreeSet<String> {
    let nm = Command::new("nm").args(arguments).arg(library).output().expect("nm");
    let lines = String::from_utf8_lossy(&nm.stdout).into_owned();
    // "address kind name"; an archive has headings, too.
    let name = |line: &str| line.split_whitespace().nth(2).map(String::from);
    lines.lines().filter_map(name).collect()
}

#[test]
fn header_and_libraries_name_the_same_functions() {
    let (libraries, declared) = (build::libraries(), declared());
    // GNU nm would hand the objects to an LTO plugin, which may be too old for their bitcode.
    let mut archive = exported(&["-g", "--defined-only", "--plugin", "/none"], &libraries.archive);
    archive.retain(|name| name.starts_with("nerf_"));
    assert_eq!(archive, declared);
    // The shared library exports nothing else at all.
    assert_eq!(exported(&["-D", "--defined-only"], &libraries.shared), declared);
    assert!(declared.contains("nerf_render") && declared.len() == 18, "{declared:?}");
}

#[test]
fn numbers_of_the_statuses_never_change() {
    let expected: Vec<i32> = (0..=19).chain(32..=39).collect();
    assert_eq!(nerf_render::Status::ALL.map(|status| status as i32).to_vec(), expected);
    for status in (-2..50).chain([i32::MIN, i32::MAX]) {
        let text = nerf_render::nerf_status_text(status);
        // SAFETY: a static, NUL-terminated text.
        let text = unsafe { std::ffi::CStr::from_ptr(text) }.to_str().expect("UTF-8");
        assert_eq!(text == "unknown status", !expected.contains(&status), "{status}: {text}");
    }
}
