//! Where each hard case is: the page's last section, and that what it names is there.

mod boundary;
mod fields;
mod geometry;
mod training;

use nerf_tests::paths;

/// Headings with their cases, in the list's order.
const HEADINGS: &[(&str, &[Hard])] = &[
    ("Encoding", fields::ENCODING),
    ("Volume rendering", fields::VOLUME),
    ("Geometry", geometry::GEOMETRY),
    ("Sampling", geometry::SAMPLING),
    ("Numbers in small formats", training::FORMATS),
    ("Training", training::TRAINING),
    ("Blobs and the C ABI", boundary::BLOBS_AND_ABI),
];

/// A hard case of the list this system was tested against.
pub struct Hard {
    /// What it is.
    pub case: &'static str,
    /// What is allowed, in a word; "typed error", "law" and the like where it is no number.
    pub bound: &'static str,
    /// Files with the names of their tests, or of their cases in the table above.
    pub tests: &'static [(&'static str, &'static [&'static str])],
}

/// A line of the index.
const fn hard(
    case: &'static str,
    bound: &'static str,
    tests: &'static [(&'static str, &'static [&'static str])],
) -> Hard {
    Hard { case, bound, tests }
}

/// The page's last section.
pub fn section() -> String {
    let mut section = String::from(HEAD);
    for (heading, cases) in HEADINGS {
        section += &format!("\n### {heading}\n\n| hard case | bound | tests |\n| --- | --- | --- |\n");
        for Hard { case, bound, tests } in *cases {
            let names =
                |names: &[&str]| names.iter().map(|name| format!("`{name}`")).collect::<Vec<_>>().join(", ");
            let tests: Vec<_> =
                tests.iter().map(|(file, tests)| format!("{} in {file}", names(tests))).collect();
            section += &format!("| {case} | {bound} | {} |\n", tests.join("; "));
        }
    }
    section
}

const HEAD: &str = "
## Where each hard case is

Line by line of the list, with the tests that hold it and the file they are in; a test verifies that they are there.
";

#[test]
fn every_test_the_index_names_is_there() {
    for (heading, cases) in HEADINGS {
        for Hard { case, tests, .. } in *cases {
            assert!(!tests.is_empty(), "{heading}: {case}: no test");
            for (file, names) in *tests {
                let text = std::fs::read_to_string(paths::workspace().join(file));
                let text = text.unwrap_or_else(|error| panic!("{heading}: {case}: {file}: {error}"));
                for name in *names {
                    assert!(is_test(&text, name), "{heading}: {case}: no test {name} in {file}");
                }
            }
        }
    }
}

/// Whether `text` has a function of this name under `#[test]` that is not ignored, or a case of this name.
fn is_test(text: &str, name: &str) -> bool {
    let (function, case) = (format!("fn {name}("), format!("{name}: \""));
    let lines: Vec<&str> = text.lines().map(str::trim).collect();
    let under_test = |at: usize| {
        let attributes = || lines[..at].iter().rev().take_while(|line| line.starts_with("#["));
        attributes().any(|line| *line == "#[test]") && !attributes().any(|line| line.starts_with("#[ignore"))
    };
    let is = |(at, line): (usize, &&str)| {
        (line.starts_with(&function) && under_test(at))
            || (line.starts_with(&case) && lines.contains(&"cases! {"))
    };
    lines.iter().enumerate().any(is)
}

#[test]
fn a_test_that_was_renamed_is_missed() {
    let text = "#[test]\n#[should_panic]\nfn here() {}\n\n#[test]\n#[ignore = \"slow\"]\nfn idle() {}\n\n\
        fn helper() {}\ncases! {\n    case: \"what\" => f;\n}";
    assert!(is_test(text, "here") && is_test(text, "case"));
    assert!(!["helper", "idle", "her", "cas", "gone"].iter().any(|name| is_test(text, name)));
}
