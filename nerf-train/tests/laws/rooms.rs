//! The rooms of the program use each other in the order in which data flows.

use std::path::{Path, PathBuf};

/// As in `lib.rs`.
const ROOMS: [&str; 10] =
    ["system", "data", "capture", "model", "train", "measure", "fit", "lab", "show", "cli"];

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

#[test]
fn a_room_uses_only_those_in_front_of_it() {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    for (place, room) in ROOMS.iter().enumerate() {
        let mut files = Vec::new();
        sources(&source.join(room), &mut files);
        assert!(files.len() >= 3, "{room}");
        for file in files {
            let text = std::fs::read_to_string(&file).expect("a source file");
            let text = text.split("\n#[cfg(test)]\nmod ").next().expect("a first part");
            for path in text.split("crate::").skip(1) {
                let used = path.split(|c: char| !c.is_ascii_lowercase()).next().expect("a first part");
                let used = ROOMS.iter().position(|room| *room == used);
                let used = used.unwrap_or_else(|| panic!("{}: crate::{path:.40}", file.display()));
                assert!(used <= place, "{} uses {}", file.display(), ROOMS[used]);
            }
        }
    }
}
