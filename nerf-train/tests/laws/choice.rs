//! What is exported is what validation liked best.

use crate::{options, tiny};
use nerf_core::blob::Blob;
use nerf_core::kernels::Tier;
use nerf_train::config::Config;
use nerf_train::dataset::Dataset;
use nerf_train::demo_scene::{self, DemoSpec};
use nerf_train::eval::measure;
use nerf_train::train::checkpoint::Checkpoint;
use nerf_train::train::finish::Outcome;
use nerf_train::train::run::{Ended, RunOptions, run};
use nerf_train::train::snapshot::SnapshotOptions;
use nerf_train::train::trend::Trend;
use std::path::Path;

/// Three training views: few enough to learn by heart.
fn few_views() -> Dataset {
    demo_scene::dataset(&DemoSpec { train: 3, val: 4, size: 24, ..DemoSpec::default() }).expect("a scene")
}

/// A network that has room for them.
fn eager(steps: u32) -> Config {
    let mut config = tiny(steps);
    let n = &mut config.network;
    (n.depth, n.width, n.position_levels, n.direction_levels, n.colour_width) = (3, 48, 8, 4, 32);
    config.sampling.samples = 32;
    config
}

fn finished(dataset: &Dataset, config: &Config, options: &RunOptions) -> Outcome {
    match run(dataset, config.clone(), options, &|_| false).expect("a run") {
        Ended::Finished(outcome) => outcome,
        Ended::Interrupted { .. } => unreachable!("nobody stops it"),
    }
}

/// Mean PSNR of the blob from the views of these names, dB.
fn watched_psnr_db(outcome: &Outcome, dataset: &Dataset, names: &[String]) -> Option<f64> {
    let views = dataset.val.iter().filter(|view| names.contains(&view.name));
    let nothing = |_: &_, _: &_, _: &[[f32; 3]], _: &_| {};
    measure(&outcome.bytes, None, Tier::detect(), &Default::default(), outcome.background, views, nothing)
        .expect("rendered")
        .psnr_db()
}

#[test]
fn a_run_that_overfits_exports_its_best_look_however_it_is_interrupted() {
    let (dataset, folder) = (few_views(), tempfile::tempdir().expect("a folder"));
    let config = eager(800);
    let path = folder.path().join("checkpoint");
    let outcome = finished(&dataset, &config, &options(&config, None, false));
    for point in outcome.curve.iter().filter(|point| point.val_psnr_db.is_some()) {
        println!("{point:?}");
    }
    println!("{} {:?}", outcome.trend, outcome.chosen);

    let chosen = outcome.chosen.clone().expect("validation views");
    assert!(outcome.exported_step < outcome.steps, "{chosen:?}");
    assert!(chosen.val_psnr_db >= chosen.last_val_psnr_db, "{chosen:?}");
    assert_eq!(watched_psnr_db(&outcome, &dataset, &chosen.watched), Some(chosen.val_psnr_db));
    let looks = || outcome.curve.iter().filter_map(|point| Some((point.step, point.val_psnr_db?)));
    assert_eq!(looks().find(|look| look.0 == outcome.exported_step).map(|l| l.1), Some(chosen.val_psnr_db));
    assert!(looks().all(|look| look.1 <= chosen.val_psnr_db));
    let steps: Vec<u32> = looks().map(|look| look.0).collect();
    assert_eq!(steps, [100, 200, 300, 400, 500, 600, 700, 800]);
    assert!(matches!(outcome.trend, Trend::Overfitting(stop) if stop.step <= outcome.exported_step));
    let blob = Blob::open(&outcome.bytes).expect("a blob");
    assert_eq!(blob.provenance().steps, outcome.exported_step);

    // Before and after the best look, and on it.
    for stop_after in [outcome.exported_step - 1, outcome.exported_step, outcome.exported_step + 150] {
        let first = options(&config, Some(path.clone()), false);
        run(&dataset, config.clone(), &first, &|step| step == stop_after).expect("a run");
        let best = Checkpoint::read(&path).expect("a checkpoint").best.map(|best| best.candidate.step);
        assert_eq!(best == Some(outcome.exported_step), stop_after >= outcome.exported_step);
        let resumed = finished(&dataset, &config, &options(&config, Some(path.clone()), true));
        assert!(resumed.bytes == outcome.bytes, "stopped after step {stop_after}");
        assert_eq!(resumed.curve.len(), outcome.curve.len());
    }
}

#[test]
fn without_validation_views_the_last_step_is_exported() {
    let mut dataset = few_views();
    dataset.val.clear();
    let config = tiny(30);
    let outcome = finished(&dataset, &config, &options(&config, None, false));
    assert_eq!((outcome.chosen, outcome.exported_step), (None, 30));
    assert_eq!(outcome.trend, Trend::TooFewLooks { looks: 0 });
    assert_eq!(outcome.curve.iter().map(|point| point.step).collect::<Vec<_>>(), [20, 30]);
    assert_eq!(Blob::open(&outcome.bytes).expect("a blob").provenance().steps, 30);
}

/// Names in the folder of pictures, sorted.
fn pictures(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder.join("snapshots")).expect("a folder");
    let name = |entry: std::io::Result<std::fs::DirEntry>| entry.expect("an entry").file_name();
    let mut names: Vec<String> = entries.map(|entry| name(entry).to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

fn with_snapshots(config: &Config, folder: &Path, steps: &[u32], views: &[usize]) -> RunOptions {
    let snapshots = SnapshotOptions { folder: folder.into(), steps: steps.into(), views: views.into() };
    RunOptions { snapshots: Some(snapshots), ..options(config, None, false) }
}

#[test]
fn pictures_on_the_way_change_no_byte_and_no_look() {
    let (dataset, folder) = (few_views(), tempfile::tempdir().expect("a folder"));
    let config = tiny(48);
    let plain = finished(&dataset, &config, &options(&config, None, false));
    let cases: [(&[u32], &[usize], usize); 4] =
        [(&[], &[], 16), (&[0, 5, 48, 5, 99], &[], 6), (&[7], &[3, 1, 3], 2), (&[], &[3], 8)];
    for (i, (steps, views, count)) in cases.into_iter().enumerate() {
        let place = folder.path().join(i.to_string());
        let outcome = finished(&dataset, &config, &with_snapshots(&config, &place, steps, views));
        assert!(outcome.bytes == plain.bytes, "{steps:?} {views:?}");
        let looks = |outcome: &Outcome| -> Vec<(u32, Option<f64>)> {
            outcome.curve.iter().map(|point| (point.step, point.val_psnr_db)).collect()
        };
        assert_eq!(looks(&outcome), looks(&plain));
        assert_eq!((outcome.snapshots.len(), pictures(&place).len()), (count, count), "{steps:?} {views:?}");
        let missed: &[u32] = if steps.contains(&99) { &[99] } else { &[] };
        assert_eq!(outcome.missed_snapshots, missed);
    }
}

#[test]
fn pictures_of_an_interrupted_run_are_those_of_an_undisturbed_one() {
    let (dataset, folder) = (few_views(), tempfile::tempdir().expect("a folder"));
    let (config, checkpoint) = (tiny(48), Some(folder.path().join("checkpoint")));
    for (name, steps) in [("looks", &[][..]), ("steps", &[0, 3, 30, 48])] {
        let place = |kind: &str| folder.path().join(format!("{name} {kind}"));
        let calm = finished(&dataset, &config, &with_snapshots(&config, &place("calm"), steps, &[]));
        let mut options = with_snapshots(&config, &place("interrupted"), steps, &[]);
        options.checkpoint = checkpoint.clone();
        for stop_after in [3, 6, 29] {
            run(&dataset, config.clone(), &options, &|step| step == stop_after).expect("a run");
            options.resume = true;
        }
        let resumed = finished(&dataset, &config, &options);
        let shown = |outcome: &Outcome| -> Vec<(u32, usize, f64)> {
            outcome.snapshots.iter().map(|taken| (taken.step, taken.view, taken.psnr_db)).collect()
        };
        assert_eq!(shown(&resumed), shown(&calm));
        for picture in pictures(&place("calm")) {
            let read = |kind: &str| std::fs::read(place(kind).join("snapshots").join(&picture));
            assert!(read("calm").expect("a picture") == read("interrupted").expect("a picture"), "{picture}");
        }
        assert!(resumed.bytes == calm.bytes && resumed.missed_snapshots.is_empty());
    }
}
