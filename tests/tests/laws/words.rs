//! Wording of comments: a doc comment begins with its subject and uses the terms of the field.

use std::fs::read_to_string;
use std::path::{Path, PathBuf};

/// Words that refer to something else, and thus must not begin a comment.
const REFERRING: [&str; 9] = ["It", "That", "Those", "They", "Them", "Theirs", "Such", "So", "Both"];
/// Private terms that comments must not use, each with the term of the field.
const OWN: [(&str, &str); 12] = [
    ("as theirs", "say what holds"),
    ("both of them", "name both"),
    ("faint", "of small weight"),
    ("live cell", "occupied cell"),
    ("seek", "march to the next occupied sample"),
    ("silence", "mask"),
    ("skip grid", "occupancy grid"),
    ("so many", "a number, by its name"),
    ("stands for", "weights or represents"),
    ("the same, where", "name the thing"),
    ("walk", "march, or iterate"),
    ("way back", "backward pass"),
];

fn sources(folder: &Path, found: &mut Vec<PathBuf>) {
    let mut entries: Vec<PathBuf> =
        std::fs::read_dir(folder).expect("a folder").map(|entry| entry.expect("an entry").path()).collect();
    entries.sort();
    for path in entries {
        if path.is_dir() {
            sources(&path, found);
        } else if path.extension().is_some_and(|ending| matches!(ending.to_str(), Some("rs" | "h" | "hpp"))) {
            found.push(path);
        }
    }
}

/// Returns the text of a line that is a comment, and whether the comment documents an item; `None` for any other line.
fn comment(line: &str) -> Option<(&str, bool)> {
    let text = line.trim_start().strip_prefix("//")?;
    let documents = text.strip_prefix(['/', '!']);
    Some((documents.unwrap_or(text).trim_start(), documents.is_some()))
}

fn has_word(text: &str, words: &str) -> bool {
    let letter = |c: Option<char>| c.is_some_and(|c| c.is_alphanumeric() || c == '_' || c == '`');
    text.match_indices(words).any(|(at, _)| {
        !letter(text[..at].chars().next_back()) && !letter(text[at + words.len()..].chars().next())
    })
}

#[test]
fn comments_name_their_thing_first_in_the_words_of_the_field() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let mut files = Vec::new();
    ["nerf-core/src", "nerf-render-ffi/src", "nerf-train/src", "include"]
        .iter()
        .for_each(|folder| sources(&root.join(folder), &mut files));
    assert!(files.len() > 400, "{} files", files.len());
    let (mut faults, mut comments) = (Vec::new(), 0);
    for file in files {
        let text = read_to_string(&file).expect("a source file");
        let mut before = None;
        for (number, line) in text.lines().enumerate() {
            let found = comment(line);
            if let Some((text, documents)) = found {
                comments += 1;
                let at = || {
                    format!("{}:{}: {text}", file.strip_prefix(&root).unwrap_or(&file).display(), number + 1)
                };
                let first = text.split(|c: char| !c.is_alphabetic()).next().unwrap_or_default();
                if documents && before.is_none() && REFERRING.contains(&first) {
                    faults.push(format!("{}: begins with {first:?}: expected its noun", at()));
                }
                let lower = text.to_lowercase();
                let own = OWN.iter().filter(|(own, _)| has_word(&lower, own));
                faults.extend(own.map(|(own, field)| format!("{}: {own:?}: expected: {field}", at())));
            }
            before = found;
        }
    }
    assert!(comments > 5_000, "{comments} comments");
    assert!(faults.is_empty(), "{} comments:\n{}", faults.len(), faults.join("\n"));
}
