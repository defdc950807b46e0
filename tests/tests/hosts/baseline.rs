//! Comparison of the C ABI with its baseline `tests/abi/nerf_render.abi`: only additions are allowed.
//!
//! abidiff reads DWARF debug information, but C programs are compiled against the header. This test therefore compiles
//! the header's functions as C, with traps for bodies, together with a variable of each enumeration and an enumeration
//! of the integer constants. The debug information then describes every structure, argument, callback and number that a
//! host is built with, and nothing of Rust, whose own debug information names types differently and includes std. Other
//! tests verify that the library agrees with the header: the header is generated from the sources (`header.rs`), the
//! library exports exactly the header's functions (`packages.rs`), and C programs render the same images as Rust
//! (`c.rs`).
//!
//! New functions, enumerators and constants pass. A structure that grows fails, although the ABI promise allows growth
//! at the end: a person must check that `Versioned::SIZE_V2` kept the old size. After this check, or when a new
//! NERF_ABI_VERSION breaks the ABI on purpose, renew the baseline with `NERF_BLESS=abi cargo test --release -p
//! nerf-tests --test hosts baseline`.
#![cfg(all(target_arch = "x86_64", target_os = "linux"))]

use nerf_testing::build::run;
use nerf_testing::symbols::without_comments;
use nerf_testing::{paths, tools};
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::process::Command;

const TOOLS: [&str; 2] = ["abidw", "abidiff"];

fn baseline() -> PathBuf {
    paths::workspace().join("tests/abi/nerf_render.abi")
}

fn header() -> String {
    std::fs::read_to_string(paths::header()).expect("include/nerf_render.h")
}

/// Returns a C program that defines the functions of a header, and uses its enumerations and integer constants.
fn definitions(header: &str) -> String {
    let code = without_comments(header);
    let is_directive = |line: &&str| line.trim_start().starts_with('#');
    let mut program = String::from("#include \"nerf_render.h\"\n");
    let plain: Vec<&str> = code.lines().filter(|line| !is_directive(line)).collect();
    for statement in plain.join("\n").split([';', '{', '}']) {
        if statement.contains('(') && !statement.contains("typedef") {
            writeln!(program, "{} {{ __builtin_trap(); }}", statement.trim()).expect("room");
        }
    }
    for name in plain.iter().filter_map(|line| line.strip_prefix("enum ")) {
        writeln!(program, "enum {name} abi_{name};", name = name.trim()).expect("room");
    }
    program.push_str("enum abi_constants {\n");
    for line in code.lines().filter_map(|line| line.strip_prefix("#define ")) {
        if let Some((name, value)) = line.split_once(' ').filter(|(_, value)| value.parse::<i64>().is_ok()) {
            writeln!(program, "    ABI_{name} = {value},").expect("room");
        }
    }
    program.push_str("} abi_constants;\n");
    program
}

/// Builds a library that has the interface of a header, with debug information.
fn library(header: &str, directory: &Path) -> PathBuf {
    let write =
        |name: &str, text: &str| std::fs::write(directory.join(name), text).expect("a temporary file");
    write("nerf_render.h", header);
    write("interface.c", &definitions(header));
    let mut command = Command::new("cc");
    command.current_dir(directory).args(["-std=c11", "-g", "-shared", "-fPIC", "-o", "libnerf_render.so"]);
    run(command.arg("interface.c"));
    directory.join("libnerf_render.so")
}

/// Returns what abidiff reports as changed or removed since the baseline; `None` without changes.
fn changes(header: &str) -> Option<String> {
    let directory = paths::temporary();
    let mut command = Command::new("abidiff");
    command.arg("--no-added-syms").arg(baseline()).arg(library(header, directory.path()));
    let output = command.output().expect("abidiff");
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    // Bits 1 and 2: it could not compare. Bits 4 and 8: changes, and such as break programs for certain.
    let code = output.status.code().expect("an exit code");
    assert_eq!(code & 3, 0, "{command:?}: {text}{}", String::from_utf8_lossy(&output.stderr));
    (code != 0).then_some(text)
}

#[test]
fn nothing_a_program_was_built_with_has_changed() {
    if !tools::all_here(&TOOLS) {
        return;
    }
    if std::env::var_os("NERF_BLESS").is_some_and(|bless| bless == "abi") {
        let directory = paths::temporary();
        let mut command = Command::new("abidw");
        command.args(["--no-corpus-path", "--no-comp-dir-path", "--no-show-locs", "--no-elf-needed"]);
        run(command.arg("--out-file").arg(baseline()).arg(library(&header(), directory.path())));
        return;
    }
    if let Some(changes) = changes(&header()) {
        panic!(
            "not the interface of {}. Programs break, unless structures only grew at their end and \
             Versioned::SIZE_V2 kept the old size; then renew it (see {}).\n{changes}",
            baseline().display(),
            file!()
        );
    }
}

/// Returns the header with the first `from` replaced by `to`.
fn altered(from: &str, to: &str) -> String {
    let header = header();
    assert!(header.contains(from), "the header has no {from:?}");
    header.replacen(from, to, 1)
}

#[test]
fn what_breaks_programs_is_found() {
    if !tools::all_here(&TOOLS) {
        return;
    }
    for (what, from, to, named) in [
        ("a field removed", "    float fx;\n", "", "fx"),
        ("a field of another type", "float fx;", "uint32_t fx;", "fx"),
        ("a field in between", "float fx;", "float aspect;\n    float fx;", "aspect"),
        ("an array shorter", "float c2w[12];", "float c2w[11];", "c2w"),
        ("a function removed", "uint32_t nerf_abi_version(void);", "", "nerf_abi_version"),
        ("an argument more", "nerf_abi_version(void);", "nerf_abi_version(int which);", "nerf_abi_version"),
        ("another result", "uint32_t nerf_abi_version(", "uint64_t nerf_abi_version(", "nerf_abi_version"),
        ("another callback", "typedef uint64_t (*nerf_clock)", "typedef double (*nerf_clock)", "nerf_clock"),
        ("a status renumbered", "NERF_STATUS_MEMORY = 5,", "NERF_STATUS_MEMORY = 55,", "NERF_STATUS_MEMORY"),
        ("a setting removed", "    NERF_KERNEL_AVX2 = 2,\n", "", "NERF_KERNEL_AVX2"),
        ("a constant changed", "NERF_OUTPUT_OPACITY 2", "NERF_OUTPUT_OPACITY 64", "NERF_OUTPUT_OPACITY"),
    ] {
        let found = changes(&altered(from, to)).unwrap_or_else(|| panic!("{what}: not found"));
        assert!(found.contains(named), "{what}: {found}");
    }
}

#[test]
fn additions_pass_but_a_grown_structure_is_shown() {
    if !tools::all_here(&TOOLS) {
        return;
    }
    let function = "uint32_t nerf_abi_version(void);";
    for (from, to) in [
        (function, "uint32_t nerf_abi_version(void);\nint32_t nerf_added(const struct nerf_camera *camera);"),
        ("    NERF_STATUS_MEMORY = 5,", "    NERF_STATUS_MEMORY = 5,\n    NERF_STATUS_ADDED = 99,"),
        ("#define NERF_OUTPUT_RGB 1", "#define NERF_OUTPUT_RGB 1\n#define NERF_OUTPUT_ADDED 4096"),
    ] {
        assert_eq!(changes(&altered(from, to)), None, "{to}");
    }
    let grown = changes(&altered("} nerf_choice;", "    uint64_t added;\n} nerf_choice;")).expect("a change");
    assert!(grown.contains("data member insertion") && grown.contains("added"), "{grown}");
}
