//! What is exported is the last step; validation and pictures on the way change nothing.

use crate::{options, tiny};
use nerf_core::blob::Blob;
use nerf_train::data::Dataset;
use nerf_train::data::demo;
use nerf_train::data::demo::DemoSpec;
use nerf_train::fit::finish::Outcome;
use nerf_train::fit::run::Ended;
use nerf_train::fit::run::RunOptions;
use nerf_train::fit::run::run;
use nerf_train::fit::run::run_since;
use nerf_train::fit::snapshot::SnapshotOptions;
use nerf_train::model::config::Config;
use nerf_train::train::CurvePoint;
use nerf_train::train::schedule::Budget;
use nerf_train::train::schedule::Clock;
use std::path::Path;

/// Three training views: few enough to learn by heart.
fn few_views() -> Dataset {
    demo::dataset(&DemoSpec { train: 3, val: 4, size: 24, ..DemoSpec::default() }).expect("a scene")
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

#[test]
fn a_run_that_overfits_says_so_and_exports_its_last_step_however_it_is_interrupted() {
    let (dataset, folder) = (few_views(), tempfile::tempdir().expect("a folder"));
    let config = eager(800);
    let path = folder.path().join("checkpoint");
    let outcome = finished(&dataset, &config, &options(&config, None, false));
    let validated: Vec<&CurvePoint> =
        outcome.curve.iter().filter(|point| point.val_psnr_db.is_some()).collect();
    let steps: Vec<u32> = validated.iter().map(|point| point.step).collect();
    assert_eq!(steps, [100, 200, 300, 400, 500, 600, 700, 800]);
    assert!(validated.iter().all(|point| (point.val_views, point.val_lattice) == (2, 1)), "{validated:?}");
    assert!(outcome.overfitting.is_some_and(|stop| stop.step < 800), "{:?}", outcome.overfitting);
    assert_eq!(Blob::open(&outcome.bytes).expect("a blob").provenance().steps, 800);
    assert_eq!((outcome.scores.views.len(), outcome.lattice), (4, 1));
    let worst = outcome.scores.worst_psnr_db().expect("views");
    assert!(outcome.scores.views.iter().all(|view| view.psnr_db >= worst));

    // Before, on and after a validation.
    for stop_after in [99, 100, 250] {
        let first = options(&config, Some(path.clone()), false);
        run(&dataset, config.clone(), &first, &|step| step == stop_after).expect("a run");
        let resumed = finished(&dataset, &config, &options(&config, Some(path.clone()), true));
        assert!(resumed.bytes == outcome.bytes, "stopped after step {stop_after}");
        assert_eq!(resumed.curve.len(), outcome.curve.len());
    }
}

#[test]
fn what_is_exported_does_not_depend_on_the_validation_views() {
    let dataset = few_views();
    let mut other = few_views();
    other.val.iter_mut().for_each(|view| view.pixels.reverse());
    let config = tiny(60);
    let asked =
        |config: &Config| RunOptions { effect_threshold_db: Some(0.05), ..options(config, None, false) };
    let [a, b] = [&dataset, &other].map(|dataset| finished(dataset, &config, &asked(&config)));
    assert_ne!(a.scores.psnr_db(), b.scores.psnr_db());
    assert_eq!(a.view_dependence, b.view_dependence);
    let [a, b] = [&a.bytes, &b.bytes].map(|bytes| Blob::open(bytes).expect("a blob"));
    assert!(a.weights() == b.weights() && a.architecture() == b.architecture());
}

#[test]
fn without_validation_views_there_is_no_trend() {
    let mut dataset = few_views();
    dataset.val.clear();
    let config = tiny(30);
    let outcome = finished(&dataset, &config, &options(&config, None, false));
    assert!(outcome.watched.is_empty() && outcome.scores.psnr_db().is_none());
    assert_eq!(outcome.overfitting, None);
    assert_eq!(outcome.curve.iter().map(|point| point.step).collect::<Vec<_>>(), [20, 30]);
    assert_eq!(Blob::open(&outcome.bytes).expect("a blob").provenance().steps, 30);
}

#[test]
fn a_limit_in_seconds_counts_everything() {
    let spec = DemoSpec { train: 8, val: 20, size: 160, ..DemoSpec::default() };
    let dataset = demo::dataset(&spec).expect("a scene");
    let config = tiny(1);
    let budget = Budget { steps: None, seconds: Some(4.0) };
    let options = RunOptions { budget, report: true, ..options(&config, None, false) };
    let clock = Clock::start();
    let outcome = match run_since(clock, &dataset, config, &options, &|_| false).expect("a run") {
        Ended::Finished(outcome) => outcome,
        Ended::Interrupted { .. } => unreachable!("nobody stops it"),
    };
    // No bound on the time: other tests run beside this one. What was planned is looked at.
    assert!(outcome.train_seconds < 4.0, "{}", outcome.train_seconds);
    assert_eq!((outcome.scores.views.len(), outcome.shown.len()), (20, 4));
    assert!(outcome.lattice % 2 == 1);
    let validated = outcome.curve.iter().filter(|point| point.val_psnr_db.is_some());
    assert!(validated.clone().count() > 0 && validated.clone().all(|point| point.val_lattice % 2 == 1));
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
        let validations = |outcome: &Outcome| -> Vec<(u32, Option<f64>)> {
            outcome.curve.iter().map(|point| (point.step, point.val_psnr_db)).collect()
        };
        assert_eq!(validations(&outcome), validations(&plain));
        assert_eq!((outcome.snapshots.len(), pictures(&place).len()), (count, count), "{steps:?} {views:?}");
        let missed: &[u32] = if steps.contains(&99) { &[99] } else { &[] };
        assert_eq!(outcome.missed_snapshots, missed);
    }
}

#[test]
fn pictures_of_an_interrupted_run_are_those_of_an_undisturbed_one() {
    let (dataset, folder) = (few_views(), tempfile::tempdir().expect("a folder"));
    let (config, checkpoint) = (tiny(48), Some(folder.path().join("checkpoint")));
    for (name, steps) in [("validations", &[][..]), ("steps", &[0, 3, 30, 48])] {
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
