//! What pages and comments name is there: flags, presets, modules, files, links, features.

use crate::program::{program, trainer};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::Command;

/// Flags of other programs.
const THEIR_FLAGS: &str = "--all --auto-scale-poses --baseline-root --bench --build --center-method --cflags \
    --cpu-prof --crate-type --define-prefix --example --features --install --lib --libdir --libs \
    --no-default-features --nocapture --orientation-method --prefix --profile --release --static --target --test";
/// Programs and scripts of ours, beside `nerf-train`, that have flags.
const PROGRAMS: &str = ".ci/release tests/miri nerf-render-ffi/examples/web/build \
    nerf-render-ffi/examples/cpp/viewer/main.cpp nerf-core/benches/support/mod.rs nerf-train/benches/panel.rs";
/// What paths in code begin with that are not of this workspace.
const THEIR_MODULES: &str = "alloc clap core f32 f64 glam image io nerf std usize";
/// Files that are made at run time, are the user's own, or another project's.
const THEIR_FILES: &str = "PAGE.html check.html curve.svg models.h other.toml out/live/index.html render_test.py report.md \
    run_nerf_helpers.py show.html src/colmap/sensor/models.h";
/// Endings of names that are taken for files of the tree.
const ENDINGS: &str = "abi c cmake cpp css h hpp html in js ld md mjs py rs sh svg toml";
/// Folders that nobody has committed.
const UNTRACKED: &str = ".git artifacts corpus coverage out target";

fn has(list: &str, word: &str) -> bool {
    list.split_whitespace().any(|listed| listed == word)
}

/// A page, or the comments of a source file.
struct Page {
    file: PathBuf,
    text: String,
}

#[derive(Default)]
struct Tree {
    root: PathBuf,
    /// Files and folders, from the root.
    paths: BTreeSet<String>,
    pages: Vec<Page>,
    /// Of each source file the path of its module, and the names that its code makes or uses.
    code: Vec<(Vec<String>, BTreeSet<String>)>,
}

impl Tree {
    fn read() -> Self {
        let root = trainer().parent().expect("a workspace").to_path_buf();
        let mut tree = Self { root: root.clone(), ..Self::default() };
        tree.walk(&root);
        assert!(tree.pages.len() > 300 && tree.code.len() > 300, "{} pages", tree.pages.len());
        tree
    }

    fn walk(&mut self, folder: &Path) {
        for entry in std::fs::read_dir(folder).expect("a folder") {
            let file = entry.expect("an entry").path();
            let name = file.file_name().and_then(|name| name.to_str()).expect("UTF-8").to_owned();
            let path = file.strip_prefix(&self.root).expect("within").to_str().expect("UTF-8").to_owned();
            // What is dated says what was so.
            let dated = path.contains("docs/journal/") || path.contains("benches/records/");
            if file.is_dir() && !has(UNTRACKED, &name) {
                self.walk(&file);
            } else if name.ends_with(".md") && !dated {
                let text = std::fs::read_to_string(&file).expect("a page");
                self.pages.push(Page { file, text });
            } else if name.ends_with(".rs") {
                let text = std::fs::read_to_string(&file).expect("a source file");
                let is_comment = |line: &&str| line.trim_start().starts_with("//");
                let (comments, code): (Vec<&str>, Vec<&str>) = text.lines().partition(is_comment);
                let module = path.trim_end_matches(".rs").replace('-', "_");
                let module = module.split('/').filter(|part| !has("src mod lib", part)).map(str::to_owned);
                let code = code.join("\n");
                let is_word = |c: char| c.is_alphanumeric() || c == '_';
                // What stands in front of `::` is only passed through.
                let code = code.split("::").map(|part| part.trim_end_matches(is_word));
                let words = code.flat_map(|part| part.split(|c| !is_word(c))).map(str::to_owned);
                self.code.push((module.collect(), words.collect()));
                let lines = comments.iter().map(|line| line.trim_start().trim_start_matches(['/', '!']));
                self.pages.push(Page { file, text: lines.collect::<Vec<_>>().join("\n") });
            }
            self.paths.insert(path);
        }
    }

    /// Asks `wrong` of each piece of code in the pages, text in backticks and lines of shell, what in it is not there.
    fn check(&self, wrong: impl Fn(&Page, &str) -> Vec<String>) {
        let mut found = Vec::new();
        for page in &self.pages {
            for (i, part) in page.text.split("```").enumerate() {
                let pieces: Vec<String> = match part.strip_prefix("sh\n") {
                    Some(shell) if i % 2 == 1 => {
                        shell.replace("\\\n", " ").lines().map(str::to_owned).collect()
                    }
                    _ if i % 2 == 1 => Vec::new(),
                    _ => part.split('`').skip(1).step_by(2).map(|span| span.replace('\n', " ")).collect(),
                };
                for piece in pieces {
                    let things = wrong(page, &piece).join(", ");
                    if !things.is_empty() {
                        found.push(format!("{}: `{piece}`: there is no {things}", page.file.display()));
                    }
                }
            }
        }
        assert!(
            found.is_empty(),
            "correct the page, or list what is not ours (THEIR_…):\n{}",
            found.join("\n")
        );
    }

    /// Whether a file or folder that a page names exists: relative to the page's folder, or as the end of a path of the tree.
    fn has_file(&self, page: &Page, name: &str) -> bool {
        let end = format!("/{}", name.trim_end_matches('/'));
        let ends = |path: &String| path == &end[1..] || path.ends_with(&end);
        page.file.with_file_name(name).exists() || self.paths.iter().any(ends)
    }

    /// Whether `parts` begin with a module, as far as one has that path, or with a type, and go on with words of its code.
    fn has_path(&self, parts: &[&str]) -> bool {
        let of_module = |count: usize| {
            let is_type = parts.len() == 1 || parts[0].starts_with(char::is_uppercase);
            let named = move |path: &Vec<String>| match count {
                0 => is_type,
                _ => path.len() >= count && path[path.len() - count..] == parts[..count],
            };
            self.code.iter().filter(move |(path, _)| named(path)).map(|(_, words)| words)
        };
        let count = (0..=parts.len()).rev().find(|&count| of_module(count).next().is_some()).unwrap_or(0);
        of_module(count).any(|words| parts[count..].iter().all(|part| words.contains(*part)))
    }
}

fn flags_in(piece: &str) -> impl Iterator<Item = &str> {
    let words = piece.split(|c: char| !(c.is_ascii_alphanumeric() || c == '-'));
    let is_letter = |word: &str| word.len() == 2 && word.ends_with(|c: char| c.is_ascii_alphabetic());
    words.filter(move |word| {
        word.starts_with('-') && (word.starts_with("--") && word.len() > 3 || is_letter(word))
    })
}

/// Collects the flags and the values of `--preset` of the command `of` and its subcommands, from their `--help`.
fn commands(of: &str, found: &mut BTreeMap<String, (BTreeSet<String>, String)>) {
    let mut help = Command::new(program());
    let help = help.args(of.split_whitespace()).arg("--help").output().expect("the program");
    let help = String::from_utf8(help.stdout).expect("UTF-8");
    let flags = help.lines().filter(|line| line.trim_start().starts_with('-')).flat_map(flags_in);
    // "Preset: grid (learned hash grid), small (…) [default: …": the names are what stands outside of brackets.
    let presets = help.split_once(" Preset: ").and_then(|(_, behind)| behind.split('[').next());
    let named = presets.unwrap_or_default().split(')').filter_map(|part| part.split('(').next());
    let presets = named.collect::<String>().replace(',', " ");
    found.insert(of.to_owned(), (flags.map(str::to_owned).collect(), presets));
    let listed = help.split_once("Commands:\n").and_then(|(_, behind)| behind.split("\n\n").next());
    for line in listed.unwrap_or_default().lines().filter(|line| !line.starts_with("   ")) {
        match line.split_whitespace().next().expect("a name") {
            "help" => {}
            name => commands(format!("{of} {name}").trim_start(), found),
        }
    }
}

#[test]
fn flags_and_presets_that_pages_name_are_there() {
    let tree = Tree::read();
    let mut commands_of = BTreeMap::new();
    commands("", &mut commands_of);
    assert!(commands_of.len() > 18 && has(&commands_of["image fit"].1, "sharp"), "{commands_of:?}");
    let programs = PROGRAMS.split_whitespace();
    let programs: String =
        programs.map(|file| std::fs::read_to_string(tree.root.join(file)).expect(file)).collect();
    let others: BTreeSet<&str> = flags_in(&programs).chain(THEIR_FLAGS.split_whitespace()).collect();
    tree.check(|_, line| {
        line.split("&&")
            .flat_map(|piece| {
                let ours =
                    ["nerf-train ", "cargo run --release -- "].iter().find_map(|name| piece.split_once(name));
                let arguments = ours.map_or(piece, |(_, arguments)| arguments);
                let words: Vec<&str> = arguments.split_whitespace().take(2).collect();
                let mut names = (1..=words.len()).rev().map(|count| words[..count].join(" "));
                let command = names.find_map(|name| commands_of.get(&name));
                let of = |flag: &str| match command {
                    Some((flags, _)) => flags.contains(flag),
                    None if flag.starts_with("--") => {
                        others.contains(flag) || commands_of.values().any(|(flags, _)| flags.contains(flag))
                    }
                    None => true,
                };
                let looked_at = if command.is_some() { arguments } else { piece };
                let flags = flags_in(looked_at).filter(|flag| !of(flag)).map(str::to_owned);
                let behind =
                    piece.split_once("--preset ").and_then(|(_, behind)| behind.split_whitespace().next());
                let unknown = |name: &&str| !commands_of.values().any(|(_, presets)| has(presets, name));
                let presets =
                    behind.unwrap_or_default().split(',').filter(|name| !name.is_empty()).filter(unknown);
                flags.chain(presets.map(|name| format!("preset {name}"))).collect::<Vec<_>>()
            })
            .collect()
    });
}

#[test]
fn modules_that_pages_name_are_there() {
    let tree = Tree::read();
    tree.check(|_, piece| {
        let paths = piece.split(|c: char| !c.is_alphanumeric() && c != '_' && c != ':');
        let missing = |path: &&str| {
            let parts =
                path.split("::").filter(|part| !has("Self crate self super", part) && !part.is_empty());
            let parts: Vec<&str> = parts.collect();
            let theirs = parts.first().is_none_or(|first| has(THEIR_MODULES, first));
            path.contains("::") && !theirs && !tree.has_path(&parts)
        };
        paths.filter(missing).map(str::to_owned).collect()
    });
}

#[test]
fn files_that_pages_name_are_there() {
    let tree = Tree::read();
    tree.check(|page, piece| {
        let names = piece.split(|c: char| c.is_whitespace() || "\"'(),;|<>=$".contains(c));
        let names = names.map(|name| name.trim_start_matches("./").trim_end_matches(['.', ':']));
        let missing = |name: &&str| {
            let ending = name.rsplit_once('.').map_or("", |(_, ending)| ending);
            let folder = name.split_once('/').map_or("", |(folder, _)| folder);
            let ours =
                has(ENDINGS, ending) || has(".ci include nerf-core nerf-render-ffi nerf-train tests", folder);
            let pattern = name.contains(['*', '…', '{']) || name.contains("://") || name.starts_with('/');
            let pattern = pattern || name.strip_prefix('.') == Some(ending);
            ours && !pattern && !has(THEIR_FILES, name) && !tree.has_file(page, name)
        };
        names.filter(missing).map(|name| format!("file {name}")).collect()
    });
}

#[test]
fn links_lead_somewhere() {
    let tree = Tree::read();
    let slug = |line: &str| {
        let kept = line.trim_start_matches('#').trim().to_lowercase().replace(' ', "-");
        kept.replace(|c: char| !c.is_alphanumeric() && c != '-' && c != '_', "")
    };
    for page in tree.pages.iter().filter(|page| page.file.extension().is_some_and(|ending| ending == "md")) {
        let links = page.text.split("](").skip(1).filter_map(|behind| behind.split(')').next());
        for link in links.filter(|link| !link.contains("://")) {
            let (file, heading) = link.split_once('#').unwrap_or((link, ""));
            let target = if file.is_empty() { page.file.clone() } else { page.file.with_file_name(file) };
            assert!(target.exists(), "{}: no {link}", page.file.display());
            if !heading.is_empty() {
                let text = std::fs::read_to_string(&target).expect("a page");
                let there = text.lines().any(|line| line.starts_with('#') && slug(line) == heading);
                assert!(there, "{}: no heading {link}", page.file.display());
            }
        }
    }
}

#[test]
fn the_core_documents_each_of_its_features() {
    let root = Tree::read().root;
    let read = |file: &str| std::fs::read_to_string(root.join(file)).expect("a file");
    let (manifest, page) = (read("nerf-core/Cargo.toml"), read("nerf-core/src/lib.rs"));
    let features = manifest.split_once("[features]").and_then(|(_, behind)| behind.split("\n[").next());
    let names = features.expect("features").lines().filter_map(|line| line.split_once(" = ["));
    let missing = |name: &&str| *name != "default" && !page.contains(&format!("//! | `{name}` |"));
    let missing: Vec<_> = names.map(|(name, _)| name).filter(missing).collect();
    assert!(missing.is_empty(), "nerf-core/src/lib.rs has no row for {missing:?}");
}
