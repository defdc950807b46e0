//! Work and code size of effects: an effect that is off takes no evaluation and no workspace, changes no bit of the
//! image, and has no code in a build without its feature.

use nerf_testing::build::{build_alone, run};
use nerf_testing::paths;
use nerf_testing::scenes::Recipe;
use nerf_testing::tools::there_is;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

/// Effects, each with its feature, functions that only this feature compiles, and files of `nerf-core/src` that
/// implement it.
const EFFECTS: [(&str, &[&str], &[&str]); 7] = [
    ("jitter", &["jittered"], &["sampling/jitter"]),
    ("anti-aliasing", &["place_in_pixel", "add_ray"], &["render/pixel/anti_aliasing"]),
    ("depth-of-field", &["lens_ray"], &["render/pixel/depth_of_field"]),
    ("tone-map", &["decode_srgb", "develop"], &["render/pixel/tone"]),
    ("lens", &["undistort"], &["camera/lens/model"]),
    ("median", &["median_in_bin"], &["render/pixel/median"]),
    (
        "normals",
        &["gradient"],
        &["render/stages/normals", "network/gradient", "encoding/sinusoidal/gradient"],
    ),
];

/// Largest size of the machine code, bytes, of the file that replaces an effect in a build without it: enough to pass
/// values through.
const STAND_IN: u64 = 64;

/// Measurements of a program that was built with some of the features.
struct Build {
    /// Lines that `nerf-core/examples/checksum.rs` prints, by kernel and effect: checksum, workspace and work.
    lines: BTreeMap<(String, String), String>,
    /// Size of the machine code and constants, bytes.
    text: u64,
    /// Size of the machine code from each file of `nerf-core/src`, inlined code included, bytes.
    code: BTreeMap<String, u64>,
    /// Symbols of the program, as `nm` prints them.
    symbols: String,
}

/// Builds the program once for each of the feature lists, two at a time.
fn builds(features: &[String], scene: &Path) -> Vec<Build> {
    std::thread::scope(|scope| {
        let halves = features.chunks(features.len().div_ceil(2)).zip(["a", "b"]);
        let threads = halves.map(|(half, folder)| {
            scope.spawn(move || half.iter().map(|list| build(folder, list, scene)).collect::<Vec<_>>())
        });
        let threads: Vec<_> = threads.collect();
        threads.into_iter().flat_map(|thread| thread.join().expect("builds")).collect()
    })
}

fn build(folder: &str, features: &str, scene: &Path) -> Build {
    let example = ["-p", "nerf-core", "--example", "checksum", "--features", features];
    let own;
    let files = if features.is_empty() {
        without_effects()
    } else {
        own = build_alone(folder, &example);
        &own
    };
    let program = files.iter().find(|file| file.ends_with("checksum")).expect("the example");
    let output = run(Command::new(program).arg(scene)).stdout;
    let line = |line: &str| {
        let (name, rest) = line.split_once(": ").expect("a name");
        let (kernel, effect) = name.split_once(' ').expect("kernel and effect");
        ((kernel.to_owned(), effect.to_owned()), rest.to_owned())
    };
    let lines = String::from_utf8(output).expect("UTF-8").lines().map(line).collect();
    let symbols = String::from_utf8(run(Command::new("nm").arg(program)).stdout).expect("UTF-8");
    let size = String::from_utf8(run(Command::new("size").arg(program)).stdout).expect("UTF-8");
    let text = size.lines().nth(1).and_then(|line| line.split_whitespace().next()?.parse().ok());
    Build { lines, text: text.expect("the size of the text"), code: code(program), symbols }
}

/// Builds the program and the C library without effects, in one build of the core. Returns the files of both. Built
/// once: a second build, of the other test, would replace a program with effects while it is measured.
fn without_effects() -> &'static [PathBuf] {
    static FILES: OnceLock<Vec<PathBuf>> = OnceLock::new();
    FILES.get_or_init(|| {
        let packages = ["-p", "nerf-core", "--example", "checksum", "-p", "nerf-render-ffi", "--lib"];
        build_alone("a", &[&packages[..], &["--features", "nerf-render-ffi/std"]].concat())
    })
}

/// Returns the size of the machine code from each file of `nerf-core/src`, bytes, computed from the line table in the
/// debug information.
fn code(program: &Path) -> BTreeMap<String, u64> {
    let table = run(Command::new("objdump").arg("--dwarf=decodedline").arg(program)).stdout;
    let (mut code, mut file, mut last) = (BTreeMap::new(), None, None);
    for line in String::from_utf8_lossy(&table).lines() {
        if let Some(path) = line.strip_suffix(':') {
            file = path.split_once("nerf-core/src/").map(|(_, file)| file.to_owned());
        }
        // File name, line or `-` at the end of a sequence, and address.
        let mut columns = line.split_whitespace().skip(1);
        let (Some(number), Some(address)) = (columns.next(), columns.next()) else { continue };
        let Some(Ok(address)) = address.strip_prefix("0x").map(|it| u64::from_str_radix(it, 16)) else {
            continue;
        };
        if let Some((Some(file), from)) = last.take() {
            *code.entry(file).or_default() += address - from;
        }
        if number != "-" {
            last = Some((file.clone(), address));
        }
    }
    code
}

impl Build {
    /// Returns whether the program has a function of this name in `nerf_core`. Both of Rust's mangling schemes write
    /// the length of the name in front of the name.
    fn has(&self, function: &str) -> bool {
        let mangled = format!("{}{function}", function.len());
        self.symbols.lines().any(|line| line.contains("nerf_core") && line.contains(&mangled))
    }

    /// Returns the size of the machine code from these files, bytes; `ending` is appended to the file names.
    fn code_of(&self, files: &[&str], ending: &str) -> u64 {
        files.iter().filter_map(|file| self.code.get(&format!("{file}{ending}"))).sum()
    }

    /// Returns the lines of one effect, each with its kernel.
    fn of(&self, effect: &str) -> Vec<(&str, &str)> {
        let lines = self.lines.iter().filter(|((_, name), _)| name == effect);
        lines.map(|((kernel, _), line)| (kernel.as_str(), line.as_str())).collect()
    }
}

#[test]
fn a_build_without_an_effect_has_none_of_its_code_and_draws_the_same_bits() {
    let directory = paths::temporary();
    let scene = directory.path().join("scene.nerf");
    std::fs::write(&scene, Recipe::OCCUPANCY.blob()).expect("a temporary file");
    // Each in turn where another tool or target may be used, too; else all of them in two builds.
    let each = there_is("a build of each effect", true);
    let parts: Vec<_> = EFFECTS.chunks(if each { 1 } else { 4 }).collect();
    let names =
        |part: &[(&str, _, _)]| part.iter().map(|(feature, ..)| *feature).collect::<Vec<_>>().join(",");
    let mut features = vec![String::new(), names(&EFFECTS), "contraction".to_owned()];
    features.truncate(if each { 3 } else { 2 });
    features.extend(parts.iter().map(|part| names(part)));
    let mut built = builds(&features, &scene).into_iter();
    let mut next = || built.next().expect("a build");
    let (none, all) = (next(), next());
    println!("text: {} bytes without effects, {} with all", none.text, all.text);
    assert_eq!(
        none.of("off"),
        all.of("off"),
        "off is the picture, the workspace and the work of a build without"
    );
    assert!(!none.of("off").is_empty());
    let of_contraction = |line: &&str| line.contains("nerf_core") && line.contains("contract");
    assert_eq!(all.symbols.lines().find(of_contraction), None);
    for (_, functions, files) in EFFECTS {
        for function in functions {
            assert!(all.has(function) && !none.has(function), "{function}");
        }
        for file in files {
            assert!(all.code_of(&[file], ".rs") > 0 && none.code_of(&[file], ".rs") == 0, "{file}");
        }
    }
    if each {
        // Unbounded space is no effect: scenes that have an end are drawn alike by a build that knows of it.
        let unbounded = next();
        assert_eq!(none.of("off"), unbounded.of("off"));
        assert!(unbounded.symbols.lines().any(|line| of_contraction(&line)));
    }
    parts.into_iter().for_each(|part| compare(part, &next(), &none, &all));
}

/// Compares `some`, a build with the effects of `part`, to a build without effects and to a build with all effects.
fn compare(part: &[(&str, &[&str], &[&str])], some: &Build, none: &Build, all: &Build) {
    let names = part.iter().map(|(feature, ..)| *feature).collect::<Vec<_>>().join(",");
    let files: Vec<&str> = part.iter().flat_map(|(.., files)| files.iter().copied()).collect();
    let (own, stand_in) = (some.code_of(&files, ".rs"), none.code_of(&files, "_off.rs"));
    println!(
        "text: {} bytes with {names} alone, {own} of them from its files; {stand_in} in their place",
        some.text
    );
    // What it adds is at least what its files become, so that nothing of it is in a build without.
    assert!(stand_in <= STAND_IN * part.len() as u64 && stand_in < own, "{names}");
    assert!(none.text + own - stand_in <= some.text && some.text < all.text, "{names}");
    assert_eq!(none.of("off"), some.of("off"), "{names}");
    for (feature, functions, files) in EFFECTS {
        let is_built = part.iter().any(|(of_part, ..)| *of_part == feature);
        for function in functions {
            assert_eq!(some.has(function), is_built, "{function} in a build with {names} alone");
        }
        if !is_built {
            assert!(some.of(feature).iter().all(|(_, line)| *line == "not built"), "{feature} in {names}");
            assert_eq!(some.code_of(files, ".rs"), 0, "{feature} in {names}");
            continue;
        }
        // What it adds is its own, and no other's business.
        assert_eq!(some.of(feature), all.of(feature), "{feature}");
        for (kernel, line) in all.of(feature) {
            let seen = line != "not built" && !all.of("off").contains(&(kernel, line));
            assert!(seen, "{feature} must be seen");
        }
    }
}

#[test]
fn the_c_library_without_effects_has_none_of_their_code() {
    let files = without_effects();
    let without = files.iter().find(|file| file.ends_with("libnerf_render.a")).expect("a static library");
    let with = nerf_testing::build::libraries().archive;
    let symbols = |library: &Path| {
        // GNU nm would hand the objects to an LTO plugin, which may be too old for their bitcode.
        let nm = Command::new("nm").args(["--plugin", "/none"]).arg(library).output().expect("nm");
        let symbols = String::from_utf8_lossy(&nm.stdout).into_owned();
        Build { lines: BTreeMap::new(), text: 0, code: BTreeMap::new(), symbols }
    };
    let (without, with) = (symbols(without), symbols(&with));
    assert!(without.symbols.contains("nerf_render") && with.symbols.contains("nerf_render"));
    for function in EFFECTS.iter().flat_map(|(_, functions, _)| *functions) {
        assert!(with.has(function) && !without.has(function), "{function}");
    }
}
