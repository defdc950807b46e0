//! Flags and settings of a learned grid, and what is said of it.

use crate::made::Folder;
use crate::{blob, fails, fit, fit_grid, has, json, ok, run};
use nerf_core::blob::Blob;

#[test]
fn flags_set_what_inspect_and_summary_say() {
    let folder = Folder::new();
    let (data, file, report) = (folder.npz("data.npz"), folder.path("a.nerf"), folder.path("report"));
    let said = ok(fit_grid(&data, &file, &["--steps", "3", "--features", "4", "--report", &report]));
    let summary = json(format!("{report}/summary.json"));
    let bytes = std::fs::read(&file).expect("a blob");
    let opened = Blob::open(&bytes).expect("a blob");
    let grid = opened.architecture().position.grid().expect("a grid");
    assert_eq!((grid.resolutions.len(), grid.features, grid.log2_entries), (4, 4, 8));
    let longest = |level: &[u16; 3]| level.iter().copied().max();
    let ends = (grid.resolutions.first().and_then(longest), grid.resolutions.last().and_then(longest));
    assert_eq!(ends, (Some(4), Some(24)));
    for said in [said, ok(["inspect", &file])] {
        assert!(has(&said, "grid_levels", "4") && has(&said, "grid_storage", "f16"), "{said}");
    }
    let fields: serde_json::Value = serde_json::from_str(&ok(["inspect", &file, "--json"])).expect("JSON");
    for of in [&summary, &fields] {
        for (field, expected) in [
            ("grid_levels", 4),
            ("grid_features", 4),
            ("grid_log2_entries", 8),
            ("grid_coarsest_cells", 4),
            ("grid_finest_cells", 24),
            ("grid_values", grid.values() as u64),
            ("grid_bytes", 2 * grid.values() as u64),
        ] {
            assert_eq!(of[field].as_u64(), Some(expected), "{field}");
        }
    }
    assert_eq!(fields["harmonics_degree"], 2);
    // Nothing of this where there is no grid.
    assert!(!ok(["inspect", &blob().1]).contains("grid"));
}

#[test]
fn flags_of_the_other_kind_of_network_are_refused_with_a_sentence() {
    let folder = Folder::new();
    let (data, file) = (folder.npz("data.npz"), folder.path("a.nerf"));
    for flag in
        ["--table", "--grid-levels", "--features", "--coarsest", "--finest", "--steps-across", "--max-bytes"]
    {
        let words = [flag, "`small`", "--preset grid"];
        fails(fit(&data, &file, &[flag, "4"]), &words);
        fails(["fit", &data, "-o", &file, "--preset", "seed", flag, "4"], &[flag, "`seed`", "--preset grid"]);
    }
    fails(fit(&data, &file, &["--export", "int8"]), &["--export", "`small`", "--preset grid"]);
    for (setting, field) in [
        ("network.position_levels=6", "network.position_levels"),
        ("network.skip_after=1", "network.skip_after"),
        ("network.density=relu", "network.density"),
    ] {
        fails(fit_grid(&data, &file, &["--set", setting]), &[field]);
    }
    fails(
        ["sweep", "scene", &data, "-o", &folder.path("s"), "--levels", "8", "--preset", "grid"],
        &["--levels", "a learned grid"],
    );
    fails(
        ["sweep", "scene", &data, "-o", &folder.path("s"), "--table", "10", "--preset", "small"],
        &["--table", "a sinusoidal encoding"],
    );
    let samples = ["sweep", "scene", &data, "-o", &folder.path("s"), "--samples", "8", "--preset", "grid"];
    fails(samples, &["--samples", "a learned grid"]);
    assert!(!std::path::Path::new(&file).exists());
}

#[test]
fn bad_values_are_refused_naming_the_field() {
    let folder = Folder::new();
    let (data, file) = (folder.npz("data.npz"), folder.path("a.nerf"));
    let cases: [(&[&str], &str); 16] = [
        (&["--grid-levels", "0"], "network.grid.levels"),
        (&["--grid-levels", "33"], "network.grid.levels"),
        (&["--features", "3"], "network.grid.features"),
        (&["--features", "0"], "network.grid.features"),
        (&["--table", "0"], "network.grid.log2_entries"),
        (&["--table", "25"], "network.grid.log2_entries"),
        (&["--coarsest", "0"], "network.grid.coarsest"),
        (&["--coarsest", "400"], "network.grid.finest"),
        (&["--finest", "15"], "network.grid.finest"),
        (&["--finest", "16385"], "network.grid.finest"),
        // 8 levels of 2^24 entries of four features are more than is trained.
        (&["--table", "24", "--features", "4", "--finest", "2000"], "network.grid.log2_entries"),
        (&["--steps-across", "0"], "sampling.steps_across"),
        (&["--set", "network.direction_levels=5"], "network.direction_levels"),
        (&["--depth", "1000"], "network.depth"),
        (&["--width", "32"], "--width"),
        (&["--preset", "small", "--depth", "0"], "network.depth"),
    ];
    for (flags, field) in cases {
        fails([&["fit", &data, "-o", &file, "-q"], flags].concat(), &[field]);
    }
    for (text, field) in [
        ("[network.grid]\nlevels = 0", "network.grid.levels"),
        ("[network.grid]\nlevel = 3", "level"),
        ("[network]\ngrid = 3", "grid"),
        ("[network]\nposition_levels = 10", "network.position_levels"),
        ("[network]\ndensity = \"relu\"", "network.density"),
        ("[network]\ndensity_scale = 2.0", "network.density_scale"),
        ("[network]\nfeature = true", "network.feature"),
        ("[network]\ndepth = 2\nskip_after = 1", "network.skip_after"),
        ("[occupancy]\nempty_share = 0.1", "occupancy.empty_share"),
        // A table over a preset without a grid: the rest of the network does not go with it.
        ("preset = \"small\"\n[network.grid]\nlevels = 4", "network.position_levels"),
        ("preset = \"seed\"\n[network.grid]\nlevels = 4", "network.position_levels"),
    ] {
        let config = folder.file("run.toml", text);
        fails(["fit", &data, "-o", &file, "-q", "--config", &config], &[field]);
    }
    assert_eq!(folder.names(), ["data.npz", "run.toml"], "nothing is left of a refused run");
}

#[test]
fn toml_files_set_what_flags_do() {
    let folder = Folder::new();
    let data = folder.npz("data.npz");
    let text = "[network]\ncolour_width = 16\n[network.grid]\nlevels = 3\nlog2_entries = 9\nfinest = 40\n[occupancy]\nresolution = 12\n[optimiser]\nsteps = 3\n";
    let (config, by_file, by_flags) =
        (folder.file("run.toml", text), folder.path("a.nerf"), folder.path("b.nerf"));
    ok(["fit", &data, "-o", &by_file, "-q", "--config", &config]);
    let flags =
        ["--colour-width", "16", "--grid-levels", "3", "--table", "9", "--finest", "40", "--steps", "3"];
    let set = ["--set", "occupancy.resolution=12"];
    ok([&["fit", &data, "-o", &by_flags, "-q"], &flags[..], &set].concat());
    let read = |file: &str| std::fs::read(file).expect("a blob");
    assert!(read(&by_file) == read(&by_flags));
    // A flag replaces the file's value.
    ok(["fit", &data, "-o", &by_file, "-q", "--config", &config, "--table", "8", "--restart"]);
    assert!(has(&ok(["inspect", &by_file]), "grid_log2_entries", "8"));
}

#[test]
fn a_grid_is_rendered_evaluated_and_resumed() {
    let folder = Folder::new();
    let (data, file, whole) = (folder.npz("data.npz"), folder.path("a.nerf"), folder.path("whole.nerf"));
    ok(fit_grid(&data, &file, &["--steps", "7"]));
    ok(fit_grid(&data, &file, &["--steps", "40", "--resume"]));
    ok(fit_grid(&data, &whole, &["--steps", "40"]));
    let said = ok(["eval", &file, &data, "-q"]);
    assert!(has(&said, "views", "2"), "{said}");
    ok(["render", &file, "-q", "-o", &folder.path("a.png"), "--width", "24"]);
    ok(fit_grid(&data, &whole, &["--steps", "10", "--no-hull", "--restart"]));
}

#[test]
fn a_grid_is_studied_with_its_file_in_other_forms() {
    let folder = Folder::new();
    let (data, file, front) = (folder.npz("data.npz"), folder.path("a.nerf"), folder.path("front.nerf"));
    let report = folder.path("study");
    ok(fit_grid(&data, &file, &["--steps", "200"]));
    let few = ["--repeats", "1", "--timing-views", "1", "--quiet", "--report", &report, "-o", &front];
    ok(["study", &file, &data].into_iter().chain(few));
    let points = std::fs::read_to_string(format!("{report}/points.csv")).expect("a table");
    for label in ["file with int8 tables", "file with occupancy of", "file_bytes"] {
        assert!(points.contains(label), "expected `{label}` in: {points}");
    }
    // The plot has a colour for the bytes of each file.
    let plot = std::fs::read_to_string(format!("{report}/front.svg")).expect("a plot");
    assert!(plot.matches("file of ").count() >= 2 && plot.contains(" KiB"), "{plot}");
    // Longer steps than the trained one are rows with their price, and in no point within a small loss.
    let share = |row: &str| row.strip_prefix("march step,march step ")?.split_once('×')?.0.parse().ok();
    let shares: Vec<f64> = points.lines().filter_map(share).collect();
    assert!(shares.len() == 5 && shares.iter().filter(|&&share| share > 1.0).count() == 3, "{shares:?}");
    let words = std::fs::read_to_string(format!("{report}/report.md")).expect("a report");
    assert!(words.contains("their samples follow from the step"), "{words}");
    let bytes = std::fs::read(&front).expect("a blob");
    let blob = Blob::open(&bytes).expect("a blob");
    let (own, points) = (blob.scene().expect("a scene").samples(), blob.front());
    assert!(points.iter().any(|point| point.samples >= own), "{points:?}");
    for point in points {
        assert!(point.samples >= own || point.loss_db > 0.1, "{point:?}");
    }
    ok(["audit", &file, &data, "--views", "1", "--quiet"]);
}

#[test]
fn int8_halves_the_tables_and_says_what_it_loses() {
    let folder = Folder::new();
    let data = folder.npz("data.npz");
    let fitted = |name: &str, flags: &[&str]| {
        let file = folder.path(name);
        ok(fit_grid(&data, &file, &[&["--steps", "40"], flags].concat()));
        let fields: serde_json::Value =
            serde_json::from_str(&ok(["inspect", &file, "--json"])).expect("JSON");
        (std::fs::read(&file).expect("a blob"), fields)
    };
    // Scales are taken from the values as trained, not from their average.
    let last = "[optimiser]\naverage = 0.0\n";
    let config = folder.file("last.toml", last);
    let (half, half_fields) = fitted("f16.nerf", &["--export", "f16", "--config", &config]);
    let (byte, fields) = fitted("int8.nerf", &["--export", "int8", "--config", &config]);
    let config = folder.file("int8.toml", format!("{last}[network.grid]\nstorage = \"int8\""));
    assert_eq!(fitted("toml.nerf", &["--config", &config]).0, byte);
    let (half, byte) = (Blob::open(&half).expect("a blob"), Blob::open(&byte).expect("a blob"));
    let levels = byte.architecture().position.grid().expect("a grid").resolutions.len();
    let tables = [half, byte].map(|blob| blob.tables().expect("tables"));
    assert_eq!(tables.map(|tables| tables.scales().map(<[u8]>::len)), [None, Some(4 * levels)]);
    assert_eq!(tables[0].bytes().len(), 2 * tables[1].bytes().len());
    // The values are the same ones: training does not depend on how they are stored.
    let scales = tables[1].scales().expect("scales").as_chunks().0;
    let grid = fields["grid_values"].as_u64().expect("a number") as usize;
    assert_eq!(
        (half_fields["grid_storage"].as_str(), fields["grid_storage"].as_str()),
        (Some("f16"), Some("int8"))
    );
    assert_eq!(fields["grid_bytes"].as_u64(), Some((grid + 4 * levels) as u64));
    let largest = scales.iter().map(|&scale| f32::from_le_bytes(scale)).fold(0.0, f32::max);
    let halves = tables[0].bytes().as_chunks().0.iter().map(|&bits| half::f16::from_le_bytes(bits).to_f32());
    let reach = halves.fold(0.0f32, |most, value| most.max(value.abs()));
    assert!(largest > 0.0 && 127.0 * largest <= 1.001 * reach, "{largest}, {reach}");
    assert!(fields["quantisation_loss_db"].as_f64().is_some_and(|db| db.abs() < 0.5), "{fields}");
}

#[test]
fn coded_tables_are_smaller_again_and_a_host_draws_what_was_measured() {
    let folder = Folder::new();
    let data = folder.npz("data.npz");
    let fitted = |name: &str, storage: &str| {
        let file = folder.path(name);
        ok(fit_grid(&data, &file, &["--steps", "40", "--export", storage]));
        let fields: serde_json::Value =
            serde_json::from_str(&ok(["inspect", &file, "--json"])).expect("JSON");
        (file, fields)
    };
    let [(_, byte), (file, fields)] =
        [("int8.nerf", "int8"), ("coded.nerf", "coded")].map(|(n, s)| fitted(n, s));
    assert_eq!(fields["grid_storage"].as_str(), Some("coded"));
    assert_eq!(fields["grid_values"], byte["grid_values"]);
    let bytes = |fields: &serde_json::Value| fields["grid_bytes"].as_u64().expect("a number");
    assert!(4 * bytes(&fields) < 3 * bytes(&byte), "{} of {}", bytes(&fields), bytes(&byte));
    assert!(fields["quantisation_loss_db"].as_f64().is_some_and(|db| db.abs() < 0.5), "{fields}");
    // The figure in the file is that of the file.
    let scored: serde_json::Value =
        serde_json::from_str(&ok(["eval", &file, &data, "--json"])).expect("JSON");
    let [said, found] = [&fields["psnr_db"], &scored["val_psnr_db"]].map(|db| db.as_f64().expect("dB"));
    assert!((said - found).abs() < 1e-3, "{said} and {found}");
    let blob = std::fs::read(&file).expect("a blob");
    assert!(Blob::open(&blob).is_ok_and(|blob| blob.decoded_len() > 0));
}

#[test]
fn a_file_is_no_larger_than_it_was_asked_to_be() {
    let folder = Folder::new();
    let (data, file) = (folder.npz("data.npz"), folder.path("a.nerf"));
    for (wish, bytes) in [("20k", 20 << 10), ("65536", 65_536), ("256k", 256 << 10)] {
        let ran = run(["fit", &data, "-o", &file, "--restart", "--steps", "2", "--max-bytes", wish]);
        let said = ran.err;
        assert_eq!(ran.code, Some(0), "{said}");
        let length = std::fs::metadata(&file).expect("a blob").len();
        assert!(length <= bytes && 2 * length > bytes, "{wish}: {length}");
        assert!(
            said.contains(&format!("--max-bytes {bytes}: ")) && said.contains("cells of occupancy"),
            "{said}"
        );
    }
    // What flags say stays; what is there suffices for f16 where nothing is asked to be larger.
    let flags = ["--table", "9", "--set", "occupancy.resolution=24", "--max-bytes", "1m"];
    ok([&["fit", &data, "-o", &file, "--restart", "-q", "--steps", "2"], &flags[..]].concat());
    let bytes = std::fs::read(&file).expect("a blob");
    let blob = Blob::open(&bytes).expect("a blob");
    assert_eq!(blob.architecture().position.grid().map(|grid| grid.log2_entries), Some(9));
    assert_eq!(blob.tables().and_then(|tables| tables.scales()), None);
    assert_eq!(blob.occupancy().and_then(|cells| cells.resolution().into_iter().max()), Some(24));
    for wish in ["0", "1x", "k", "1.5k", "99999999999999999999", "20000000000000000m", ""] {
        fails(["fit", &data, "-o", &file, "--max-bytes", wish], &["--max-bytes", "131072, 128k or 1m"]);
    }
    let said =
        fails(["fit", &data, "-o", &file, "--restart", "--max-bytes", "1k"], &["--max-bytes", "found 1024"]);
    let least: u64 = said
        .split_once("at least ")
        .and_then(|(_, rest)| rest.split_once(','))
        .expect("a number")
        .0
        .parse()
        .expect("a number");
    let (just, less) = (least.to_string(), (least - 1).to_string());
    fails(["fit", &data, "-o", &file, "--restart", "--max-bytes", &less], &["--max-bytes", &just]);
    ok(["fit", &data, "-o", &file, "--restart", "-q", "--steps", "2", "--max-bytes", &just]);
    assert!(std::fs::metadata(&file).expect("a blob").len() <= least);
}
