//! 2D fields and sweeps.

use crate::made::Folder;
use crate::{blob, command, fails, has, json, ok, ran, read_picture, write_picture};
use std::path::Path;

/// A network of 2×16 on small pictures: steps of a millisecond.
const TINY: &[&str] = &["--pixels", "64", "--steps", "40", "--set", "optimiser.warm_up=0"];

/// A picture of a few colours, 12×8.
fn photo(folder: &Folder) -> String {
    let path = folder.path("photo.png");
    let pixel = |x: u32, y: u32| image::Rgb([20 * x as u8, if x > y { 200 } else { 30 }, 90u8]);
    write_picture(image::ImageBuffer::from_fn(12, 8, pixel), &path);
    path
}

fn image_fit<'a>(photo: &'a str, output: &'a str, more: &[&'a str]) -> Vec<&'a str> {
    [&["image", "fit", photo, "-o", output, "--restart", "-q", "--layers", "2", "--width", "16"], TINY, more]
        .concat()
}

fn sweep<'a>(photo: &'a str, output: &'a str, more: &[&'a str]) -> Vec<&'a str> {
    [&["sweep", "image", photo, "-o", output, "--width", "16"], TINY, more].concat()
}

#[test]
fn a_picture_is_fitted_reported_and_rendered_at_any_size() {
    for preset in ["grid", "classic"] {
        fitted_reported_and_rendered(preset);
    }
}

fn fitted_reported_and_rendered(preset: &str) {
    let folder = Folder::new();
    let (photo, file, report) = (photo(&folder), folder.path("a.nerf"), folder.path("report"));
    let more = ["--report", &report, "--snapshots", "0,20", "--preset", preset];
    let out = ok(image_fit(&photo, &file, &more));
    assert!(has(&out, "steps", "40") && has(&out, "blob", &file), "{out}");
    let summary = json(Path::new(&report).join("summary.json"));
    assert!(summary["psnr_db"].as_f64().is_some_and(|db| db > 10.0), "{summary}");
    assert_eq!((&summary["steps"], &summary["width_px"]), (&40.into(), &12.into()));
    let made =
        ["curve.csv", "curve.png", "curve.svg", "sheet.png", "picture.png", "snapshots/step_000020.png"];
    for name in made {
        assert!(Path::new(&report).join(name).exists(), "{name}");
    }
    let size = |args: &[&str], name: &str| {
        let output = folder.path(name);
        ok([&["image", "render", &file, "-o", &output], args].concat());
        image::image_dimensions(output).expect("a picture")
    };
    assert_eq!(size(&[], "same.png"), (12, 8));
    assert_eq!(size(&["--width", "30"], "wide.png"), (30, 20));
    assert_eq!(size(&["--height", "4"], "low.png"), (6, 4));
    assert_eq!(size(&["--width", "5", "--height", "7"], "odd.png"), (5, 7));
    let large = folder.path("large.png");
    fails(
        ["image", "render", &file, "-o", &large, "--height", "65535"],
        &["--height", "65535 pixels a side", "x65535"],
    );
    // What the fit shows is what its blob shows.
    let of = |path: &str| read_picture(path).into_rgb8();
    assert_eq!(of(&folder.path("same.png")), of(&format!("{report}/picture.png")));
}

#[test]
fn a_grid_is_the_default_and_its_flags_set_what_is_said_of_it() {
    let folder = Folder::new();
    let (photo, file, report) = (photo(&folder), folder.path("a.nerf"), folder.path("report"));
    let flags =
        ["--table", "5", "--grid-levels", "3", "--features", "4", "--coarsest", "2", "--finest", "10"];
    let said = ok([&image_fit(&photo, &file, &["--report", &report]), &flags[..]].concat());
    for said in [said, ok(["inspect", &file])] {
        for (field, expected) in [
            ("grid_levels", "3"),
            ("grid_coarsest_cells", "2"),
            ("grid_finest_cells", "10"),
            ("grid_features", "4"),
            ("grid_log2_entries", "5"),
        ] {
            assert!(has(&said, field, expected), "{field}: {said}");
        }
    }
    let summary = json(Path::new(&report).join("summary.json"));
    for (field, expected) in
        [("grid_levels", 3), ("grid_features", 4), ("grid_finest_cells", 10), ("levels", 0)]
    {
        assert_eq!(summary[field].as_u64(), Some(expected), "{field}");
    }
    // No finer than the picture, where nobody says how fine.
    assert!(has(&ok(image_fit(&photo, &file, &[])), "grid_finest_cells", "12"));
    // The same bytes on any number of threads.
    let bytes = |threads: &str| {
        let run = ["-q", "--steps", "20", "--pixels", "9000", "--threads", threads];
        ok([&["image", "fit", &photo, "-o", &file, "--restart"], &run[..]].concat());
        std::fs::read(&file).expect("a blob")
    };
    let one = bytes("1");
    assert!(one == bytes("2") && one == bytes("3"));
}

#[test]
fn flags_of_the_other_kind_of_field_are_refused_with_a_sentence() {
    let folder = Folder::new();
    let (photo, file) = (photo(&folder), folder.path("a.nerf"));
    for flag in ["--table", "--grid-levels", "--features", "--coarsest", "--finest"] {
        for preset in ["classic", "sharp"] {
            let words = [flag, preset, "--preset grid"];
            fails(image_fit(&photo, &file, &[flag, "4", "--preset", preset]), &words);
        }
    }
    fails(image_fit(&photo, &file, &["--set", "levels=6"]), &["levels", "0 beside a grid"]);
    let folder_of_sweep = folder.path("sweep");
    fails(
        sweep(&photo, &folder_of_sweep, &["--levels", "2", "--preset", "grid"]),
        &["--levels", "a learned grid"],
    );
    let cases: [(&[&str], &str); 10] = [
        (&["--grid-levels", "0"], "error: grid.levels"),
        (&["--grid-levels", "33"], "error: grid.levels"),
        (&["--features", "3"], "error: grid.features"),
        (&["--table", "0"], "error: grid.log2_entries"),
        (&["--table", "25"], "error: grid.log2_entries"),
        (&["--coarsest", "0"], "error: grid.coarsest"),
        (&["--coarsest", "9", "--finest", "8"], "error: grid.finest"),
        (&["--finest", "16385"], "error: grid.finest"),
        (&["--finest", "0"], "error: grid.finest"),
        (&["--finest", "13"], "error: grid.finest: expected at most the picture's 12 pixels"),
    ];
    for (flags, field) in cases {
        fails(image_fit(&photo, &file, flags), &[field]);
    }
    assert!(!Path::new(&file).exists());
}

#[test]
fn a_file_is_no_larger_than_it_was_asked_to_be() {
    let folder = Folder::new();
    let (photo, file) = (folder.path("noise.png"), folder.path("a.nerf"));
    let pixel = |x: u32, y: u32| image::Rgb([((x * 37) ^ (y * 91)) as u8, (x * y) as u8, (x + y) as u8]);
    write_picture(image::ImageBuffer::from_fn(200, 150, pixel), &photo);
    let args = ["image", "fit", &photo, "-o", &file, "--restart", "--steps", "2", "--pixels", "64"];
    let with = |flags: &[&'static str]| [&args, flags].concat();
    for (wish, bytes) in [("20k", 20 << 10), ("65536", 65_536), ("256k", 256 << 10)] {
        let said = ran(&mut command(with(&["--max-bytes", wish]))).err;
        assert!(
            said.contains(&format!("--max-bytes {bytes}: ")) && said.contains("cells, at most 2^"),
            "{said}"
        );
        let length = std::fs::metadata(&file).expect("a blob").len();
        assert!(length <= bytes, "{wish}: {length}");
        // How many bytes coded values take is theirs to say, and after two steps they are next to nothing; of int8 it is known.
        ok(with(&["-q", "--max-bytes", wish, "--export", "int8"]));
        let length = std::fs::metadata(&file).expect("a blob").len();
        assert!(length <= bytes && 5 * length > 4 * bytes, "{wish}: {length}");
    }
    // What flags say stays, and a wish beyond what the settings take changes nothing.
    let flags = ["-q", "--table", "7", "--coarsest", "8", "--grid-levels", "4"];
    let inspected = |flags: &[&str]| {
        ok([&args, flags].concat());
        (std::fs::read(&file).expect("a blob"), ok(["inspect", &file]))
    };
    let (_, said) = inspected(&[&flags[..], &["--max-bytes", "8k"]].concat());
    for (field, expected) in [
        ("grid_levels", "4"),
        ("grid_coarsest_cells", "8"),
        ("grid_finest_cells", "200"),
        ("grid_log2_entries", "7"),
        ("grid_storage", "coded"),
    ] {
        assert!(has(&said, field, expected), "{field}: {said}");
    }
    let (roomy, plain) = (inspected(&[&flags[..], &["--max-bytes", "1m"]].concat()), inspected(&flags));
    assert!(roomy.0 == plain.0, "{}", roomy.1);
    for wish in ["0", "1x", "k", "1.5k", "99999999999999999999", "20000000000000000m", ""] {
        fails([&args, &["--max-bytes", wish][..]].concat(), &["--max-bytes", "131072, 128k or 1m"]);
    }
    fails(
        with(&["--preset", "classic", "--max-bytes", "1m"]),
        &["--max-bytes", "`classic`", "--preset grid"],
    );
    let said = fails(with(&["--max-bytes", "1k"]), &["--max-bytes", "found 1024"]);
    let least = said.split_once("at least ").and_then(|(_, rest)| rest.split_once(',')).expect("a number").0;
    let less = (least.parse::<u64>().expect("a number") - 1).to_string();
    fails([&args, &["--max-bytes", &less][..]].concat(), &["--max-bytes", least]);
    ok([&args, &["-q", "--max-bytes", least][..]].concat());
    let length = std::fs::metadata(&file).expect("a blob").len();
    assert!(length <= least.parse().expect("a number"), "{least}: {length}");
}

#[test]
fn pictures_of_one_pixel_and_of_one_column_are_fitted_and_drawn() {
    let folder = Folder::new();
    for (width, height) in [(1, 1), (1, 65_535)] {
        let (photo, file, shown) = (folder.path("p.png"), folder.path("p.nerf"), folder.path("shown.png"));
        let pixel = |_: u32, y: u32| image::Rgb([(y >> 8) as u8, 100, 200]);
        write_picture(image::ImageBuffer::from_fn(width, height, pixel), &photo);
        ok(image_fit(&photo, &file, &[]));
        ok(["image", "render", &file, "-o", &shown, "-q"]);
        assert_eq!(image::image_dimensions(&shown).expect("a picture"), (width, height));
    }
}

#[test]
fn fields_and_scenes_are_not_taken_for_each_other() {
    let folder = Folder::new();
    let (photo, field, picture) = (photo(&folder), folder.path("a.nerf"), folder.path("a.png"));
    ok(image_fit(&photo, &field, &[]));
    fails(["image", "render", &blob().1, "-o", &picture], &["expected a 2D field", "scene.nerf"]);
    fails(["render", &field, "-o", &picture], &["expected a scene", "2D field", "a.nerf"]);
    assert!(!Path::new(&picture).exists());
}

#[test]
fn bad_pictures_and_settings_leave_nothing() {
    let folder = Folder::new();
    let (photo, file) = (photo(&folder), folder.path("a.nerf"));
    fails(image_fit("nowhere.png", &file, &[]), &["nowhere.png"]);
    let text = folder.file("text.png", "no picture");
    fails(image_fit(&text, &file, &[]), &["text.png", "PNG, JPEG"]);
    fails(image_fit(&photo, &file, &["--scale", "2"]), &["--scale"]);
    fails(image_fit(&photo, &file, &["--rate", "0"]), &["optimiser.rate"]);
    let levels = ["--set", "levels=40", "--preset", "classic"];
    fails(image_fit(&photo, &file, &levels), &["levels: expected at most 16, found 40"]);
    fails(image_fit(&photo, &file, &["--snapshots", "1"]), &["--report"]);
    fails(image_fit(&photo, &file, &["--max-seconds", "0"]), &["--max-seconds"]);
    fails(image_fit(&photo, &format!("{photo}/a.nerf"), &[]), &["photo.png"]);
    assert!(!Path::new(&file).exists());
}

#[test]
fn a_sweep_goes_on_where_it_stopped_and_repeats_nothing() {
    let folder = Folder::new();
    let (photo, output) = (photo(&folder), folder.path("sweep"));
    ok(sweep(&photo, &output, &["--levels", "2,4", "--layers", "1,2", "--shard", "1/2", "-q"]));
    let record = Path::new(&output).join("runs/L2_layers1_width16_rate0.01.json");
    let before = std::fs::metadata(&record).expect("a record").modified().expect("a time");
    let all = sweep(&photo, &output, &["--levels", "2,4", "--layers", "1,2"]);
    let second = ran(&mut command(&all));
    assert_eq!((second.code, second.err.matches("finished before").count()), (Some(0), 2), "{}", second.err);
    assert_eq!(std::fs::metadata(&record).expect("a record").modified().expect("a time"), before);
    let table = std::fs::read_to_string(format!("{output}/table.csv")).expect("a table");
    assert_eq!(table.lines().count(), 5, "{table}");
    for name in ["report.md", "psnr_over_L.png", "psnr_over_layers.svg", "psnr_over_time.png", "sheet.png"] {
        assert!(Path::new(&output).join(name).exists(), "{name}");
    }
    // Another sweep is refused, and this one stays.
    let other = sweep(&photo, &output, &["--levels", "2,4", "--seed", "5"]);
    fails(other, &["seed", "in the folder: 0; now: 5"]);
    assert_eq!(std::fs::read_to_string(format!("{output}/table.csv")).expect("a table"), table);
}

#[test]
fn pictures_are_swept_over_grids() {
    let folder = Folder::new();
    let (photo, output) = (photo(&folder), folder.path("tables"));
    let args = ["sweep", "image", &photo, "-o", &output, "-q", "--steps", "20", "--pixels", "64"];
    ok(args.into_iter().chain(["--table", "6,8", "--grid-levels", "2"]));
    let table = std::fs::read_to_string(format!("{output}/table.csv")).expect("a table");
    assert!(table.starts_with("rank,table,grid-levels,features,finest,rate,"), "{table}");
    assert_eq!(table.lines().filter(|row| row.contains(",12,")).count(), 2, "a cell a pixel: {table}");
    fails(args.into_iter().chain(["--finest", "12,13"]), &["error: grid.finest", "12 pixels", "13"]);
}

#[test]
fn parts_of_a_sweep_are_merged() {
    let folder = Folder::new();
    let photo = photo(&folder);
    let parts = ["one", "two"].map(|name| folder.path(name));
    for (i, part) in parts.iter().enumerate() {
        let shard = format!("{}/2", i + 1);
        ok(sweep(&photo, part, &["--rate", "1e-3,1e-2,10", "-q", "--shard", &shard]));
    }
    let whole = folder.path("whole");
    let out = ok(["sweep", "merge", "-q", "-o", &whole, &parts[0], &parts[1]]);
    assert!(out.contains("no better than one flat colour"), "{out}");
    assert_eq!(std::fs::read_to_string(format!("{whole}/table.csv")).expect("a table").lines().count(), 4);
    let other = folder.path("other");
    ok(sweep(&photo, &other, &["--rate", "1e-3", "--set", "optimiser.average=0.5", "-q"]));
    fails(["sweep", "merge", "-o", &whole, &parts[0], &other], &["average"]);
    fails(["sweep", "merge", "-o", &folder.path("new"), &photo], &["sweep.json"]);
}

#[test]
fn an_array_job_makes_the_table_of_one_process() {
    let folder = Folder::new();
    let photo = photo(&folder);
    let rates = ["--rate", "1e-3,3e-3,1e-2,3e-2", "-q"];
    let parts = ["1", "2"].map(|id| {
        let part = folder.path(&format!("part{id}"));
        let mut task = command(sweep(&photo, &part, &rates));
        task.env("SLURM_ARRAY_TASK_ID", id)
            .env("SLURM_ARRAY_TASK_MIN", "1")
            .env("SLURM_ARRAY_TASK_COUNT", "2");
        assert_eq!(ran(&mut task).code, Some(0));
        let mut beyond = command(sweep(&photo, &part, &rates));
        beyond.env("SLURM_ARRAY_TASK_ID", "5").env("SLURM_ARRAY_TASK_COUNT", "4");
        let refused = ran(&mut beyond);
        assert!(refused.code != Some(0) && refused.err.contains("SLURM_ARRAY_TASK_ID"), "{}", refused.err);
        part
    });
    let [merged, whole] = ["merged", "whole"].map(|name| folder.path(name));
    ok(["sweep", "merge", "-q", "-o", &merged, &parts[0], &parts[1]]);
    ok(sweep(&photo, &whole, &rates));
    // Time aside, which differs from run to run.
    let table = |folder: &str| -> Vec<Vec<String>> {
        let mut rows = csv::ReaderBuilder::new()
            .has_headers(false)
            .from_path(format!("{folder}/table.csv"))
            .expect("a table");
        let rows: Vec<csv::StringRecord> = rows.records().map(|row| row.expect("a row")).collect();
        let time = rows[0].iter().position(|name| name == "time, s").expect("a column");
        let others = |row: &csv::StringRecord| {
            row.iter().enumerate().filter(|(i, _)| *i != time).map(|(_, cell)| cell.to_owned()).collect()
        };
        rows.iter().map(others).collect()
    };
    assert_eq!(table(&merged).len(), 5);
    assert_eq!(table(&merged), table(&whole));
}

#[test]
fn sweeps_of_nothing_are_refused() {
    let folder = Folder::new();
    let (photo, output) = (photo(&folder), folder.path("sweep"));
    fails(sweep(&photo, &output, &["--levels", ""]), &["--levels"]);
    fails(["sweep", "image", &photo, "-o", &output], &["--levels", "--rate"]);
    fails(sweep(&photo, &output, &["--levels", "2,99"]), &["levels", "99"]);
    fails(sweep(&photo, &output, &["--levels", "2", "--shard", "3/2"]), &["--shard"]);
    assert!(!Path::new(&output).exists());
}

#[test]
fn scenes_are_swept_too() {
    let folder = Folder::new();
    let (data, output) = (folder.npz("scene.npz"), folder.path("sweep"));
    let args =
        ["sweep", "scene", &data, "-o", &output, "-q", "--steps", "20", "--width", "16,24", "--layers", "1"];
    ok(args);
    let table = std::fs::read_to_string(format!("{output}/table.csv")).expect("a table");
    assert_eq!(table.lines().count(), 3, "{table}");
    // Twenty steps teach next to nothing; they must not be called a success.
    assert!(table.lines().skip(1).all(|row| row.contains(",ok,") || row.contains(",flat,")), "{table}");
    assert!(Path::new(&output).join("psnr_over_width.png").exists());
    let tables = folder.path("tables");
    let small = ["--set", "occupancy.resolution=12"];
    let lists = ["--table", "9,10", "--features", "1,2", "--grid-levels", "3", "--finest", "32"];
    ok(["sweep", "scene", &data, "-o", &tables, "-q", "--steps", "20"].into_iter().chain(lists).chain(small));
    let table = std::fs::read_to_string(format!("{tables}/table.csv")).expect("a table");
    assert!(table.starts_with("rank,table,grid-levels,features,finest,rate,"), "{table}");
    assert_eq!(table.lines().count(), 5, "{table}");
    for file in ["psnr_over_table.png", "psnr_over_features.png", "sheet.png"] {
        assert!(Path::new(&tables).join(file).exists(), "{file}");
    }
    // Every time of a list is a run of its own, and samples are a setting of sinusoidal networks alone.
    let times = folder.path("times");
    let lists = ["--max-seconds", "0.3,0.6", "--samples", "8", "--turns", "1"];
    let args = ["sweep", "scene", &data, "-o", &times, "-q"];
    fails(args.into_iter().chain(lists), &["--turns", "a sinusoidal encoding"]);
    ok(args.into_iter().chain(["--width", "8", "--layers", "1"]).chain(lists[..4].iter().copied()));
    let table = std::fs::read_to_string(format!("{times}/table.csv")).expect("a table");
    assert!(table.starts_with("rank,L,layers,width,rate,samples,max-seconds,"), "{table}");
    assert_eq!(table.lines().count(), 3, "{table}");
    assert!(Path::new(&times).join("psnr_over_max-seconds.png").exists());
    // A layer in front of what a grid composites.
    let lists = ["--preset", "grid", "--layers", "0,1", "--table", "9", "--turns", "2", "--steps", "5"];
    ok(["sweep", "scene", &data, "-o", &folder.path("layers"), "-q"].into_iter().chain(lists).chain(small));
    let wide = ["sweep", "scene", &data, "-o", &folder.path("wide"), "--preset", "grid", "--width", "64"];
    fails(wide, &["network.width"]);
}
