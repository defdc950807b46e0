//! Names that the C header declares, and symbols that the library defines.

use crate::build::run;
use std::collections::BTreeSet;
use std::path::Path;
use std::process::Command;

/// Returns the functions that a header declares: names before a parenthesis that begin with `nerf_`.
pub fn declared(header: &str) -> BTreeSet<String> {
    let code = without_comments(header);
    let before = code.split('(').map(|part| part.rsplit(|c: char| !(c == '_' || c.is_alphanumeric())).next());
    before.flatten().filter(|name| name.starts_with("nerf_")).map(String::from).collect()
}

/// Returns the names that a C header adds to every program that includes it: macros, types, enumerators and functions.
pub fn brought(header: &str) -> BTreeSet<String> {
    const LANGUAGE: [&str; 11] = [
        "char", "const", "enum", "float", "int32_t", "size_t", "struct", "typedef", "uint32_t", "uint64_t",
        "void",
    ];
    let code = without_comments(header);
    let lines = code.lines().map(|line| line.split("//").next().unwrap_or_default());
    let (macros, code): (Vec<_>, Vec<_>) = lines.partition(|line| line.starts_with('#'));
    let defined = macros.iter().filter_map(|line| line.strip_prefix("#define ")?.split_whitespace().next());
    let mut names: BTreeSet<String> = defined.map(String::from).collect();
    // `(*name)(...)`, a pointer to a function, as `name(...)`.
    let mut code = code.join("\n").replace("extern \"C\" {", "");
    while let Some(at) = code.find("(*") {
        code = code[..at].to_owned() + &code[at + 2..].replacen(')', "", 1);
    }
    // For each open brace or parenthesis: whether names inside are added to the program (enumerators are, fields and
    // arguments are not).
    let (mut open, mut word, mut of_enum) = (Vec::new(), String::new(), false);
    for c in code.chars() {
        if c == '_' || c.is_ascii_alphanumeric() {
            word.push(c);
            continue;
        }
        of_enum = word == "enum" || (of_enum && word != "struct" && c != ';');
        if open.iter().all(|enumerators| *enumerators) && word.starts_with(|c: char| !c.is_ascii_digit()) {
            names.insert(word.clone());
        }
        word.clear();
        match c {
            '{' => open.push(of_enum),
            '(' => open.push(false),
            '}' | ')' => _ = open.pop(),
            _ => {}
        }
    }
    names.retain(|name| !LANGUAGE.contains(&name.as_str()));
    names
}

/// Returns the code of a header without its comments.
pub fn without_comments(header: &str) -> String {
    header.split("/*").map(|part| part.split_once("*/").map_or(part, |(_, code)| code)).collect()
}

/// Returns the symbols that a shared library defines for the programs that link it.
pub fn of_shared(library: &Path) -> BTreeSet<String> {
    defined(Command::new("nm").args(["-D", "--defined-only"]).arg(library))
}

/// Returns the symbols that a static library defines for the programs that link it.
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
