//! The rooms of the program and of the core use each other in the order in which data flows.

use crate::program::trainer;
use std::path::{Path, PathBuf};

/// As in `lib.rs`.
const ROOMS: [&str; 10] =
    ["system", "data", "capture", "model", "train", "measure", "fit", "lab", "show", "cli"];

/// As in the core's `lib.rs`.
const CORE: [&str; 14] = [
    "memory", "simd", "math", "matrix", "camera", "space", "sampling", "encoding", "network", "volume",
    "blob", "plan", "render", "host",
];

fn sources(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).expect("a folder") {
        let path = entry.expect("an entry").path();
        let name = path.file_name().and_then(|name| name.to_str()).expect("UTF-8");
        if path.is_dir() && name != "tests" {
            sources(&path, found);
        } else if name.ends_with(".rs") && name != "tests.rs" {
            found.push(path);
        }
    }
}

/// Lines of a source file without comments: links of these may lead to any room.
fn code_alone(text: &str) -> String {
    let code: Vec<&str> = text.lines().filter(|line| !line.trim_start().starts_with("//")).collect();
    code.join("\n")
}

/// Checks the rooms of a crate, in the order of its `lib.rs`; `shared`: modules that every room uses; `part`: what is
/// checked of a source file.
fn check(source: &Path, rooms: &[&str], shared: &[&str], part: fn(&str) -> String) {
    for (place, room) in rooms.iter().enumerate() {
        let mut files = Vec::new();
        sources(&source.join(room), &mut files);
        assert!(files.len() >= 3, "{room}");
        for file in files {
            let text = std::fs::read_to_string(&file).expect("a source file");
            let text = text.split("\n#[cfg(test)]\nmod ").next().expect("a first part");
            for path in part(text).split("crate::").skip(1) {
                let used = path.split(|c: char| !c.is_ascii_lowercase()).next().expect("a first part");
                if shared.contains(&used) {
                    continue;
                }
                let used = rooms.iter().position(|room| *room == used);
                let used = used.unwrap_or_else(|| panic!("{}: crate::{path:.40}", file.display()));
                assert!(used <= place, "{} uses {}", file.display(), rooms[used]);
            }
        }
    }
}

#[test]
fn a_room_uses_only_those_in_front_of_it() {
    check(&trainer().join("src"), &ROOMS, &[], str::to_owned);
}

#[test]
fn a_room_of_the_core_uses_only_those_in_front_of_it() {
    check(&trainer().join("../nerf-core/src"), &CORE, &["absent", "errors", "names"], code_alone);
}

/// Names of the types with an inherent `impl` in this text.
fn own_impls(text: &str) -> impl Iterator<Item = &str> {
    let heads = text.split("\nimpl").skip(1).filter_map(|after| after.split('{').next());
    heads.filter(|head| !head.contains(" for ")).map(|head| {
        let generic = head.starts_with('<');
        let name = if generic { head.split_once("> ").expect("a type").1 } else { head.trim_start() };
        name.split(|c: char| !c.is_alphanumeric()).next().expect("a name")
    })
}

#[test]
fn the_impl_of_a_type_stands_in_its_file() {
    let mut files = Vec::new();
    sources(&trainer().join("src"), &mut files);
    let mut checked = 0;
    for file in files {
        let text = std::fs::read_to_string(&file).expect("a source file");
        for name in own_impls(&text) {
            let is_of = |after: &str| {
                after.strip_prefix(name).is_some_and(|rest| !rest.starts_with(char::is_alphanumeric))
            };
            let declared = ["struct ", "enum "].iter().any(|kind| text.split(kind).skip(1).any(is_of));
            assert!(declared, "{}: impl {name}", file.display());
            checked += 1;
        }
    }
    assert!(checked > 100, "{checked}");
}
