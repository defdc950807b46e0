use super::*;
use crate::data::pictures::photograph::Photo;
use crate::data::pictures::rgb::Picture;
use crate::lab::Shard;
use crate::model::picture_config::FieldPreset;
use crate::show::reports::sweep::{table, write_report};
use crate::system::progress::ProgressStyle;
use clap::ValueEnum;
use nerf_core::Kernel;
use std::path::Path;

fn point(levels: f64, layers: f64, width: f64, rate: f64) -> Point {
    Point::of(&[(Knob::Levels, levels), (Knob::Layers, layers), (Knob::Width, width), (Knob::Rate, rate)])
}

fn combinations(mode: Mode) -> Combinations {
    let lists = vec![
        (Knob::Levels, vec![6.0, 8.0]),
        (Knob::Layers, vec![2.0, 4.0, 6.0]),
        (Knob::Rate, vec![1e-3]),
        (Knob::Width, Vec::new()),
    ];
    Combinations { base: point(10.0, 3.0, 256.0, 1e-2), lists, mode }
}

#[test]
fn full_combines_every_value_with_every_other() {
    let points = combinations(Mode::Full).points().unwrap();
    assert_eq!(points.len(), 6);
    assert!(
        points
            .iter()
            .all(|point| point.get(Knob::Width) == Some(256.0) && point.get(Knob::Rate) == Some(1e-3))
    );
    assert_eq!(points[0].name(), "L6_layers2_width256_rate0.001");
}

#[test]
fn one_at_a_time_leaves_the_others_at_the_base() {
    let points = combinations(Mode::OneAtATime).points().unwrap();
    // The base with a rate of 1e-3, two points with other levels, and three with other layers.
    assert_eq!(points.len(), 6);
    let base = point(10.0, 3.0, 256.0, 1e-3);
    let changes = |point: &Point| {
        Knob::value_variants().iter().filter(|&&knob| point.get(knob) != base.get(knob)).count()
    };
    assert!(points.iter().all(|point| changes(point) <= 1), "{points:?}");
}

#[test]
fn a_sweep_of_nothing_is_refused() {
    let empty = Combinations { lists: Default::default(), ..combinations(Mode::Full) };
    assert!(empty.points().unwrap_err().to_string().starts_with("nothing to sweep"));
}

#[test]
fn a_list_of_another_encoding_is_refused_by_its_flag() {
    let mut other = combinations(Mode::Full);
    other.lists.push((Knob::Table, vec![12.0, 14.0]));
    let error = other.points().unwrap_err().to_string();
    assert!(error.contains("--table") && error.contains("a sinusoidal encoding"), "{error}");
    let grid = Point::of(&[(Knob::Table, 14.0), (Knob::Rate, 1e-2)]);
    let error = Combinations { base: grid, ..combinations(Mode::Full) }.points().unwrap_err().to_string();
    assert!(error.contains("--levels") && error.contains("a learned grid"), "{error}");
}

#[test]
fn points_are_written_by_flag_and_read_again() {
    let point = Point::of(&[(Knob::Table, 14.0), (Knob::GridLevels, 8.0), (Knob::Rate, 1e-2)]);
    let text = serde_json::to_string(&point).unwrap();
    assert_eq!(text, r#"{"table":14.0,"grid-levels":8.0,"rate":0.01}"#);
    assert_eq!(serde_json::from_str::<Point>(&text).unwrap(), point);
    assert!(serde_json::from_str::<Point>(r#"{"tables":14.0}"#).is_err());
    assert_eq!(point.name(), "table14_grid-levels8_rate0.01");
}

#[test]
fn shards_take_every_point_once() {
    for count in 1..=5 {
        for position in 0..12 {
            let shards = (1..=count).map(|index| Shard { index, count });
            assert_eq!(shards.filter(|shard| shard.takes(position)).count(), 1);
        }
    }
    assert_eq!("3/25".parse(), Ok(Shard { index: 3, count: 25 }));
    for wrong in ["", "3", "0/4", "5/4", "a/b", "1/0", "-1/3"] {
        assert!(wrong.parse::<Shard>().is_err(), "{wrong}");
    }
}

fn photo() -> Photo {
    let rgb = (0..12 * 8).map(|i| [(i % 12) as f32 / 12.0, 0.5, (i / 12) as f32 / 8.0]).collect();
    Photo { name: "p".into(), picture: Picture { width: 12, height: 8, rgb }, notes: Vec::new() }
}

fn job(photo: &Photo, steps: u32) -> Job<'_> {
    let mut base = FieldPreset::Classic.config();
    (base.width, base.layers, base.pixels, base.optimiser.steps) = (16, 1, 64, steps);
    base.optimiser.warm_up = 0;
    Job::Image { photo, base }
}

fn sweep(job: &Job<'_>, path: &Path, points: &[Point], shard: Shard) -> Folder {
    let folder = Folder::open(path, job.header(Mode::Full)).unwrap();
    let (kernel, style) = (Kernel::detect(), ProgressStyle::Quiet);
    let runner = Runner { kernel, style, cpu: "test" };
    for (i, point) in points.iter().enumerate() {
        if shard.takes(i) && folder.run(&point.name()).unwrap().is_none() {
            let (record, picture) = job.run(point, &runner).unwrap();
            folder.keep(&record, picture.as_ref()).unwrap();
        }
    }
    folder
}

fn points(rates: &[f64]) -> Vec<Point> {
    rates.iter().map(|&rate| point(2.0, 1.0, 16.0, rate)).collect()
}

#[test]
fn shards_merge_to_what_one_process_finds() {
    let (photo, root) = (photo(), tempfile::tempdir().unwrap());
    let (job, points) = (job(&photo, 20), points(&[1e-3, 3e-3, 1e-2]));
    let at = |name: &str| root.path().join(name);
    let whole = sweep(&job, &at("whole"), &points, Shard::WHOLE);
    let parts =
        [1, 2].map(|index| sweep(&job, &at(&format!("part{index}")), &points, Shard { index, count: 2 }));
    assert_eq!(parts.each_ref().map(|part| records(part).unwrap().len()), [2, 1]);
    let merged = Folder::open(&at("merged"), parts[0].header.clone()).unwrap();
    assert_eq!(parts.each_ref().map(|part| merged.take_in(part).unwrap()), [2, 1]);
    assert_eq!(parts.each_ref().map(|part| merged.take_in(part).unwrap()), [0, 0]);
    // Records without the time of the run, which alone differs from run to run.
    let timeless = |folder: &Folder| -> Vec<Record> {
        let records = records(folder).unwrap().into_iter();
        records.map(|record| Record { train_seconds: 0.0, ..record }).collect()
    };
    assert_eq!(timeless(&merged), timeless(&whole));
    assert_eq!(write_report(&merged).unwrap().len(), 3);
    for file in [
        "table.csv",
        "report.md",
        "psnr_over_rate.png",
        "psnr_over_rate.svg",
        "psnr_over_time.png",
        "sheet.png",
    ] {
        assert!(at("merged").join(file).exists(), "{file}");
    }
}

#[test]
fn a_run_at_too_fast_a_rate_is_a_row_that_says_so() {
    let (photo, root) = (photo(), tempfile::tempdir().unwrap());
    let folder = sweep(&job(&photo, 60), root.path(), &points(&[1e-2, 10.0]), Shard::WHOLE);
    let records = write_report(&folder).unwrap();
    assert_eq!(records.iter().map(|r| r.status).collect::<Vec<_>>(), [Status::Ok, Status::Flat]);
    // The sigmoid keeps the loss finite: the network collapses to one colour.
    assert!(records[1].note.contains("no better than one flat colour"), "{}", records[1].note);
    let rows = table(&records).to_csv().unwrap();
    let rows = String::from_utf8(rows).unwrap();
    assert!(rows.lines().last().unwrap().contains("flat"), "{rows}");
}

#[test]
fn another_sweep_is_refused_and_nothing_is_changed() {
    let (photo, root) = (photo(), tempfile::tempdir().unwrap());
    sweep(&job(&photo, 3), root.path(), &points(&[1e-2]), Shard::WHOLE);
    let before = std::fs::read(root.path().join("sweep.json")).unwrap();
    let error = Folder::open(root.path(), job(&photo, 4).header(Mode::Full)).unwrap_err().to_string();
    assert!(error.contains("optimiser.steps") && error.contains("in the folder: 3; now: 4"), "{error}");
    assert_eq!(std::fs::read(root.path().join("sweep.json")).unwrap(), before);
    // The same sweep can be resumed, also with more values in its lists.
    let folder = sweep(&job(&photo, 3), root.path(), &points(&[1e-2, 1e-3]), Shard::WHOLE);
    assert_eq!(records(&folder).unwrap().len(), 2);
}

#[test]
fn of_two_sweeps_that_begin_at_once_one_wins_whole() {
    let (photo, root) = (photo(), tempfile::tempdir().unwrap());
    for round in 0..20 {
        let path = root.path().join(round.to_string());
        let barrier = std::sync::Barrier::new(4);
        // Two threads for each of two sweeps.
        let opened = std::thread::scope(|scope| {
            let open = |steps: u32| {
                let (photo, path, barrier) = (&photo, &path, &barrier);
                scope.spawn(move || {
                    let header = job(photo, steps).header(Mode::Full);
                    barrier.wait();
                    Folder::open(path, header).map(|_| steps)
                })
            };
            [3, 4, 3, 4].map(open).map(|thread| thread.join().unwrap())
        });
        let won: Vec<u32> = opened.iter().filter_map(|folder| folder.as_ref().ok().copied()).collect();
        assert!(won.len() == 2 && won[0] == won[1], "{opened:?}");
        let other = |error: &anyhow::Error| error.to_string().contains("has another");
        let lost = opened.iter().filter(|folder| folder.as_ref().is_err_and(other));
        assert_eq!(lost.count(), 2, "{opened:?}");
        assert!(Folder::existing(&path).unwrap().header == job(&photo, won[0]).header(Mode::Full));
    }
}

#[test]
fn damaged_records_are_named() {
    let (photo, root) = (photo(), tempfile::tempdir().unwrap());
    let point = points(&[1e-2])[0];
    let folder = sweep(&job(&photo, 3), root.path(), &[point], Shard::WHOLE);
    let file = root.path().join("runs").join(format!("{}.json", point.name()));
    std::fs::write(&file, "{\"point\":").unwrap();
    let error = folder.run(&point.name()).unwrap_err().to_string();
    assert!(error.contains("L2_layers1_width16_rate0.01.json"), "{error}");
    let none = Folder::existing(&root.path().join("runs")).unwrap_err();
    assert!(none.to_string().contains("found no sweep.json"), "{none}");
}
