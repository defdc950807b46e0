//! Names: what the header declares, what a library shows.

use crate::build::run;
use std::collections::BTreeSet;
use std::path::Path;
use std::process::Command;

/// Functions a header declares: names before a parenthesis.
pub fn declared(header: &str) -> BTreeSet<String> {
    let code = without_comments(header);
    let before = code.split('(').map(|part| part.rsplit(|c: char| !(c == '_' || c.is_alphanumeric())).next());
    before.flatten().filter(|name| name.starts_with("nerf_")).map(String::from).collect()
}

/// The code of a header alone.
pub fn without_comments(header: &str) -> String {
    header.split("/*").map(|part| part.split_once("*/").map_or(part, |(_, code)| code)).collect()
}

/// What a program finds defined that links the shared library.
pub fn of_shared(library: &Path) -> BTreeSet<String> {
    defined(Command::new("nm").args(["-D", "--defined-only"]).arg(library))
}

/// What a program finds defined that links the static library.
pub fn of_archive(library: &Path) -> BTreeSet<String> {
    // GNU nm would hand the objects to an LTO plugin, which may be too old for their bitcode.
    defined(Command::new("nm").args(["-g", "--defined-only", "--plugin", "/none"]).arg(library))
}

fn defined(nm: &mut Command) -> BTreeSet<String> {
    let lines = String::from_utf8_lossy(&run(nm).stdout).into_owned();
    // "address kind name"; an archive has headings, too.
    let name = |line: &str| line.split_whitespace().nth(2).map(String::from);
    lines.lines().filter_map(name).collect()
}
