//! What the command line reads and prints, without running it: flags, settings files, summaries.

use crate::program::trainer;
use clap::{CommandFactory, Parser, ValueEnum};
use nerf_train::cli::{Cli, SetOption, commented, lines, read_config};
use nerf_train::model::config::{Jitter, Preset, Surroundings, TableConfig};
use serde::Serialize;
use serde_json::json;
use std::collections::BTreeMap;

/// Returns the arguments after `program` in a shell line, up to a comment or redirection; `None`: no `program`.
fn arguments<'l>(line: &'l str, program: &str) -> Option<Vec<&'l str>> {
    let (_, arguments) = line.split(['#', '>']).next()?.split_once(program)?;
    Some(arguments.split_whitespace().collect())
}

fn assert_parses(arguments: &[&str]) {
    let parsed = Cli::try_parse_from(["nerf-train"].iter().chain(arguments));
    assert!(parsed.is_ok(), "{arguments:?}: {}", parsed.unwrap_err());
}

#[test]
fn commands_of_the_readmes_parse() {
    for (readme, least) in [("../README.md", 8), ("README.md", 30)] {
        let readme = trainer().join(readme);
        let text = std::fs::read_to_string(readme).expect("README.md");
        let shell = text.split("```sh\n").skip(1).filter_map(|block| block.split("```").next());
        let commands: Vec<_> = shell
            .flat_map(str::lines)
            .filter_map(|line| {
                arguments(line, "cargo run --release -- ").or_else(|| arguments(line, "nerf-train "))
            })
            .collect();
        assert!(commands.len() >= least, "{commands:?}");
        commands.iter().for_each(|command| assert_parses(command));
    }
}

#[test]
fn examples_of_the_help_parse() {
    Cli::command().debug_assert();
    let cli = Cli::command();
    let nested = cli.get_subcommands().flat_map(clap::Command::get_subcommands);
    for command in cli.get_subcommands().chain(nested) {
        let help = command.get_after_help().expect("an example").to_string();
        let examples: Vec<_> = help.lines().filter_map(|line| arguments(line, "nerf-train ")).collect();
        assert!(!examples.is_empty(), "{}", command.get_name());
        examples.iter().for_each(|example| assert_parses(example));
    }
}

#[test]
fn files_of_the_firmware_are_settings_for_the_demo() {
    for (name, is_grid) in [("scene.toml", false), ("grid.toml", true)] {
        let firmware = trainer().join("../nerf-core/examples/firmware");
        let file = firmware.join(name);
        let config = read_config(Preset::Grid, Some(&file), &SetOption::default(), Surroundings::Known)
            .expect("settings");
        config.check().unwrap_or_else(|error| panic!("{name}: {error}"));
        assert_eq!(config.network.grid.is_some(), is_grid, "{name}");
    }
}

#[test]
fn a_file_without_hull_starts_as_gently_as_the_flag() {
    let folder = tempfile::tempdir().expect("a folder");
    let read = |text: &str| {
        let file = folder.path().join("run.toml");
        std::fs::write(&file, text).expect("written");
        read_config(Preset::Small, Some(&file), &SetOption::default(), Surroundings::Known).expect("a config")
    };
    let gentle =
        read_config(Preset::Small, None, &SetOption::default(), Surroundings::Unknown).expect("a config");
    assert_eq!(gentle, Preset::Small.config().without_hull());
    assert_eq!(read("[occupancy]\nhull = false"), gentle);
    assert_eq!(read("[occupancy]\nhull = true"), Preset::Small.config());
    assert_eq!(read("seed = 0"), Preset::Small.config());
    // A file without a hull changes defaults only: values that the file gives are kept.
    let mut own = gentle.clone();
    (own.occupancy.from, own.optimiser.rate) = (77, 2e-3);
    assert_eq!(read("[occupancy]\nhull = false\nfrom = 77\n[optimiser]\nrate = 2e-3"), own);
    // If a file has a grid and the preset has none, missing values come from the preset `grid`. Settings that
    // contradict a grid are refused.
    let mixed = read("[network.grid]\nlevels = 4");
    let grid = Preset::Grid.config().network.grid.expect("a grid");
    assert_eq!(mixed.network.grid, Some(TableConfig { levels: 4, ..grid }));
    assert_eq!(mixed.check().expect_err("contradictory").field, "network.position_levels");
    let whole = "[network]\nposition_levels = 0\ndensity = \"exponential\"\ndensity_scale = 1.0\n[network.grid]\n\
                 features = 4\n[occupancy]\nempty_share = 0.0";
    read(whole).check().expect("a grid with the network that goes with it");
    // To have no grid, a file names a preset without one: TOML cannot unset a value.
    let back = read("preset = \"seed\"\n[network]\nwidth = 8");
    assert_eq!(back.network.grid, None);
    // A preset written as TOML reads back unchanged.
    for preset in [Preset::Grid, Preset::Small, Preset::Seed] {
        let written = toml::to_string(&preset.config()).expect("TOML");
        assert_eq!(read(&written), preset.config());
        assert_eq!(written.contains("[network.grid]"), preset == Preset::Grid);
    }
    // The seed preset has no visual hull, so turning it off changes nothing.
    let seed = "preset = \"seed\"\n[occupancy]\nhull = false";
    assert_eq!(read(seed), Preset::Seed.config());
}

#[derive(Parser)]
struct Flags {
    #[command(flatten)]
    set: SetOption,
}

#[test]
fn what_is_set_lies_over_preset_and_file() {
    let parse = |texts: &[&str]| {
        let flags = texts.iter().flat_map(|text| ["--set", *text]);
        Flags::try_parse_from(["nerf-train"].into_iter().chain(flags))
    };
    let set = |texts: &[&str]| {
        let flags = parse(texts).expect("settings");
        read_config(Preset::Small, None, &flags.set, Surroundings::Known)
    };
    let config = set(&["network.width=64", "sampling.jitter=none", "optimiser.rate=1e-3"]).expect("settings");
    let mut expected = Preset::Small.config();
    (expected.network.width, expected.sampling.jitter, expected.optimiser.rate) = (64, Jitter::None, 1e-3);
    assert_eq!(config, expected);
    let gentle = read_config(Preset::Small, None, &SetOption::default(), Surroundings::Unknown);
    assert_eq!(set(&["occupancy.hull=false"]).expect("settings"), gentle.expect("settings"));
    for (text, word) in [("network.widht=64", "widht"), ("network.width=wide", "wide"), ("depth=1", "depth")]
    {
        let error = set(&[text]).expect_err(text).to_string();
        assert!(error.starts_with("--set: ") && error.contains(word), "{error}");
    }
    assert!(parse(&["network.width"]).is_err() && parse(&["a b=1"]).is_err());
}

#[test]
fn what_is_printed_is_the_preset_with_a_comment_on_every_setting() {
    let folder = tempfile::tempdir().expect("a folder");
    for &preset in Preset::value_variants() {
        let settings = toml::Table::try_from(preset.config()).expect("TOML");
        let text = commented(&settings).expect("text");
        let file = folder.path().join("run.toml");
        std::fs::write(&file, &text).expect("written");
        let read = read_config(Preset::Grid, Some(&file), &SetOption::default(), Surroundings::Known)
            .expect("settings");
        assert_eq!(read, preset.config());
        assert!(text.contains("# near is not set\n"), "{text}");
        let lines: Vec<&str> = text.lines().collect();
        for pair in lines.windows(2).filter(|pair| !pair[1].starts_with('#') && pair[1].contains(" = ")) {
            assert!(pair[0].starts_with("# ") && !pair[0].ends_with("is not set"), "{}", pair[1]);
        }
    }
}

#[test]
fn fields_are_aligned_and_lists_of_objects_are_tables() {
    #[derive(Serialize)]
    struct Found {
        psnr_db: f64,
        steps: u32,
        flat: bool,
        gain_db: Option<f64>,
        left_out: Vec<String>,
        size: [u32; 2],
        name: &'static str,
        at: serde_json::Value,
        views: Vec<serde_json::Value>,
    }
    let found = Found {
        psnr_db: 27.512_345,
        steps: 3,
        flat: false,
        gain_db: None,
        left_out: Vec::new(),
        size: [4, 3],
        name: "a\nb",
        at: json!({ "near": 0.25 }),
        views: vec![json!({ "view": "a", "ssim": 1.0 }), json!({ "view": "b" })],
    };
    let expected =
        "psnr_db  27.512\nsteps    3\nflat     no\nsize     4, 3\nname     a\\nb\nat.near  0.25\n\nviews\n";
    let text = lines(&found).expect("text");
    assert!(text.starts_with(expected), "{text}");
    let table = &text[expected.len()..];
    assert_eq!(table.lines().count(), 4, "{table}");
    assert!(table.starts_with("ssim  view\n") || table.starts_with("view  ssim\n"), "{table}");
}

#[test]
fn numbers_have_five_digits_and_no_zeros_behind() {
    for (number, text) in [
        (0.0, "0"),
        (1.0, "1"),
        (-0.000_123_456, "-0.00012346"),
        (123_456.7, "123457"),
        (1e-9, "1e-9"),
        (0.1f32.into(), "0.1"),
        (f64::INFINITY, "inf"),
        (f64::NAN, "NaN"),
    ] {
        assert_eq!(lines(&BTreeMap::from([("x", number)])).expect("text"), format!("x  {text}\n"));
    }
}
