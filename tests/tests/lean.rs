//! A library built without the outputs that are features: less code, and the same pictures to the byte.

use nerf_tests::build::{Language, Libraries, lean_libraries, libraries, program_with, run};
use nerf_tests::paths;
use nerf_tests::scenes::{Recipe, tiers};
use std::path::Path;
use std::process::Command;

/// Names of functions of which a build without `median` and `normals` has none.
const OF_FEATURES: [&str; 4] = ["7network8gradient", "8encoding8gradient", "15bf16_transposed", "NormalSum"];

/// How often each of [`OF_FEATURES`] is part of a symbol's name, local ones included.
fn occurrences(library: &Path) -> [usize; 4] {
    // GNU nm would hand the objects to an LTO plugin, which may be too old for their bitcode.
    let nm = run(Command::new("nm").args(["--plugin", "/none"]).arg(library));
    let symbols = String::from_utf8_lossy(&nm.stdout).into_owned();
    OF_FEATURES.map(|name| symbols.lines().filter(|line| line.contains(name)).count())
}

#[test]
fn code_of_what_a_build_lacks_is_not_in_it() {
    let (full, lean) = (libraries(), lean_libraries());
    let (with, without) = (occurrences(&full.archive), occurrences(&lean.archive));
    println!("{OF_FEATURES:?}: {with:?}, without the features {without:?}");
    assert!(with.iter().sum::<usize>() > 0, "no such names: this test proves nothing");
    assert_eq!(without, [0; 4]);
    let bytes = |path: &Path| std::fs::metadata(path).expect("a library").len();
    let [full, lean] = [&full.shared, &lean.shared].map(|path| bytes(path));
    println!("shared library: {full} bytes, without the features {lean}");
    assert!(lean < full);
}

#[test]
fn a_picture_is_to_the_byte_that_of_a_build_that_lacks_the_rest() {
    let source = paths::workspace().join("nerf-render-ffi/examples/c/render.c");
    let directory = paths::temporary();
    let file = directory.path().join("scene.nerf");
    let pictures = |name: &str, libraries: &Libraries, recipe: Recipe, tier: &str| {
        let into = directory.path().join(name);
        std::fs::create_dir_all(&into).expect("a temporary directory");
        let program = into.join("render");
        let program = if program.is_file() {
            program
        } else {
            program_with(libraries, Language::C, &source, &into, &[])
        };
        std::fs::write(&file, recipe.blob()).expect("a temporary file");
        let prefix = into.join("view");
        run(Command::new(program).env("NERF_KERNEL", tier).arg(&file).arg(&prefix).args(["40", "30"]));
        // Colour in 8 bits, and z_depth in floats.
        ["ppm", "pfm"].map(|extension| std::fs::read(prefix.with_extension(extension)).expect("a picture"))
    };
    for (tier, recipe) in tiers().flat_map(|tier| [(tier, Recipe::PLAIN), (tier, Recipe::GRID)]) {
        let full = pictures("full", &libraries(), recipe, tier.name());
        let lean = pictures("lean", &lean_libraries(), recipe, tier.name());
        assert!(full[0].len() > 40 * 30 * 3 && full[1].len() > 40 * 30 * 4);
        assert!(full == lean, "{} {recipe:?}", tier.name());
    }
}
