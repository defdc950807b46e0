//! Module structure of the core, read from its sources: no cycle between the files of a folder (room), and each type in
//! one file.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::read_to_string;
use std::path::{Path, PathBuf};

/// Cycles between the files of a room that are allowed.
const CIRCLES: [&str; 2] = [
    "host: {\"request\", \"scene\"}",
    // A renderer makes workers, and several of them make one.
    "render: {\"instances\", \"renderer\", \"worker\"}",
];
/// Types that have an `impl` outside of their own file, each with the file of this `impl`.
const SPLIT: [(&str, &str); 3] =
    [("Lens", "camera/lens/fisheye"), ("Lens", "camera/lens/model"), ("Network", "network/gradient")];

/// A source file of the core: its module's path from the crate's root, and its text without comments and tests.
struct Source {
    module: Vec<String>,
    text: String,
}

/// Returns the module path of a file. A `_off` file has the path of the file it replaces, and `mod.rs` has the path of
/// its folder.
fn module_of(file: &Path) -> Vec<String> {
    let parts = file.with_extension("");
    let parts = parts.iter().map(|part| part.to_str().expect("UTF-8").trim_end_matches("_off"));
    parts.filter(|part| !matches!(*part, "mod" | "lib")).map(String::from).collect()
}

fn sources(root: &Path, folder: &Path, found: &mut Vec<Source>) {
    let mut entries: Vec<PathBuf> =
        std::fs::read_dir(folder).expect("a folder").map(|entry| entry.expect("an entry").path()).collect();
    entries.sort();
    for path in entries {
        let name = path.file_stem().and_then(|name| name.to_str()).expect("UTF-8");
        if matches!(name, "tests" | "testing" | "oracle") {
            continue;
        }
        if path.is_dir() {
            sources(root, &path, found);
        } else {
            let text = read_to_string(&path).expect("a source file");
            let code = text.lines().filter(|line| !line.trim_start().starts_with("//"));
            let text = code.collect::<Vec<_>>().join("\n");
            found.push(Source { module: module_of(path.strip_prefix(root).expect("below")), text });
        }
    }
}

fn core() -> Vec<Source> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../nerf-core/src");
    let mut found = Vec::new();
    sources(&root, &root, &mut found);
    assert!(found.len() > 100, "{} files", found.len());
    found
}

/// Appends to `found` the paths that a use tree names; each begins with `front`.
fn expand(front: &str, tree: &str, found: &mut Vec<String>) {
    let tree = tree.trim();
    let Some((path, inner)) = tree.split_once('{') else {
        let name = tree.split(" as ").next().expect("a first part");
        found.push(format!("{front}{name}"));
        return;
    };
    let (inner, front) = (inner.trim_end().trim_end_matches('}'), format!("{front}{path}"));
    let (mut depth, mut start) = (0, 0);
    for (at, c) in inner.char_indices().chain([(inner.len(), ',')]) {
        match c {
            '{' => depth += 1,
            '}' => depth -= 1,
            ',' if depth == 0 => {
                if !inner[start..at].trim().is_empty() {
                    expand(&front, &inner[start..at], found);
                }
                start = at + 1;
            }
            _ => {}
        }
    }
}

/// Returns the paths in a text: those of its `use` items, and all others that begin with `crate::` or `super::`.
fn paths(text: &str) -> Vec<String> {
    let mut found = Vec::new();
    for tree in text.split("use ").skip(1) {
        expand("", tree.split(';').next().expect("a first part"), &mut found);
    }
    for start in ["crate::", "super::"] {
        for path in text.split(start).skip(1) {
            let end =
                path.find(|c: char| !(c.is_alphanumeric() || matches!(c, '_' | ':'))).unwrap_or(path.len());
            found.push(format!("{start}{}", &path[..end]));
        }
    }
    found
}

/// Converts a path, as written in `module`, to a path from the crate's root; `None` for a path of another crate.
fn from_root(module: &[String], path: &str) -> Option<Vec<String>> {
    let (mut at, mut own) = (module.to_vec(), false);
    let mut parts = path.split("::").map(str::trim).filter(|part| !part.is_empty()).peekable();
    while let Some(part) = parts.peek() {
        match *part {
            "crate" => at.clear(),
            "super" => drop(at.pop()),
            "self" => {}
            _ => break,
        }
        own = true;
        parts.next();
    }
    at.extend(parts.map(String::from));
    own.then_some(at)
}

/// Returns the names that each `mod.rs` re-exports: a map from folder and name to the file of the folder that defines
/// the name.
fn handed_on(sources: &[Source]) -> BTreeMap<Vec<String>, String> {
    let mut names = BTreeMap::new();
    for Source { module, text } in sources {
        for path in text.split("use ").skip(1) {
            let mut found = Vec::new();
            expand("", path.split(';').next().expect("a first part"), &mut found);
            for path in found {
                let parts: Vec<&str> = path.split("::").collect();
                if let [file, .., name] = parts[..]
                    && sources.iter().any(|it| it.module == [&module[..], &[file.to_string()]].concat())
                {
                    names.insert([&module[..], &[name.to_string()]].concat(), file.to_string());
                }
            }
        }
    }
    names
}

#[test]
fn files_of_a_room_use_each_other_in_one_order() {
    let sources = core();
    let names = handed_on(&sources);
    let rooms: BTreeSet<&[String]> = sources
        .iter()
        .filter(|it| it.module.len() > 1)
        .flat_map(|it| (1..it.module.len()).map(|depth| &it.module[..depth]))
        .collect();
    assert!(rooms.len() > 12, "{rooms:?}");
    for room in rooms {
        let mut uses: BTreeMap<&str, BTreeSet<String>> = BTreeMap::new();
        for Source { module, text } in &sources {
            let Some(file) = module.strip_prefix(room).and_then(|rest| rest.first()) else { continue };
            for path in paths(text).iter().filter_map(|path| from_root(module, path)) {
                let Some(name) = path.strip_prefix(room).and_then(|rest| rest.first()) else { continue };
                let used = names.get(&[room, std::slice::from_ref(name)].concat()).unwrap_or(name);
                let is_file = sources
                    .iter()
                    .any(|it| it.module.starts_with(&[room, std::slice::from_ref(used)].concat()));
                if used != file && is_file {
                    uses.entry(file).or_default().insert(used.clone());
                }
            }
        }
        // What is left uses another that is left, and is used by one.
        let mut left: BTreeSet<&str> = uses.keys().copied().collect();
        let is_outside = |file: &str, left: &BTreeSet<&str>| {
            let uses_one = uses[file].iter().any(|used| left.contains(&**used));
            !uses_one || !left.iter().any(|other| uses[other].contains(file))
        };
        while let Some(&file) = left.iter().find(|file| is_outside(file, &left)) {
            left.remove(file);
        }
        let circle = format!("{}: {left:?}", room.join("/"));
        assert!(left.is_empty() || CIRCLES.contains(&&*circle), "{circle} {uses:#?}");
    }
}

#[test]
fn a_type_has_its_functions_in_its_own_file() {
    let mut found = 0;
    for Source { module, text } in core() {
        for line in text.lines().filter(|line| line.starts_with("impl")) {
            let mut depth = 0;
            // Without parameters: `<`s are no comparisons here.
            let plain = |c: &char| {
                depth += i32::from(*c == '<');
                let outside = depth == 0;
                depth -= i32::from(*c == '>');
                outside
            };
            let plain: String = line.replace("->", "").chars().filter(plain).collect();
            let name = plain.trim_start_matches("impl").trim().trim_end_matches('{').trim();
            if plain.contains(" for ") || !name.chars().all(char::is_alphanumeric) {
                continue;
            }
            found += 1;
            let defines = |kind: &&str| text.contains(&format!("{kind} {name}"));
            let file = module.join("/");
            assert!(
                ["struct", "enum", "union", "trait"].iter().any(defines) || SPLIT.contains(&(name, &*file)),
                "{file}: {line}"
            );
        }
    }
    assert!(found > 100, "{found}");
}
