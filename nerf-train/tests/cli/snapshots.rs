//! Pictures of validation views on the way, and the sheet of them.

use crate::made::{Folder, names};
use crate::stopping::{Running, wait_for};
use crate::{command, fails, fit, fit_grid, json, ok, ran};
use nerf_train::data::pictures::rgb::Picture;
use std::path::Path;

/// The sheet's size, pixels.
fn sheet(report: &str) -> (usize, usize) {
    let sheet = Picture::read(Path::new(report).join("snapshots.png")).expect("a sheet");
    (sheet.width, sheet.height)
}

/// Files in the folder of pictures.
fn taken(report: &str) -> usize {
    names(&Path::new(report).join("snapshots")).len()
}

#[test]
fn the_sheet_shows_chosen_views_at_chosen_steps_or_all_validations() {
    let folder = Folder::new();
    let data = folder.npz("data.npz");
    let fitted = |name: &str, more: &[&str]| {
        let (file, report) = (folder.path(&format!("{name}.nerf")), folder.path(name));
        ok(fit(&data, &file, &[&["--steps", "40", "--report", &report], more].concat()));
        report
    };
    // Rows and columns of cells 192 pixels wide: views, and steps with the truth.
    let chosen = fitted("chosen", &["--snapshots", "0,10,40", "--snapshot-views", "1"]);
    let validations = fitted("validations", &[]);
    assert_eq!((taken(&chosen), taken(&validations)), (3, 16));
    let ((w4, h1), (w9, h2)) = (sheet(&chosen), sheet(&validations));
    assert_eq!((w4 - 12, w9 - 12), (4 * (192 + 12), 9 * (192 + 12)));
    assert!(h2 > h1 + 192, "{h1} {h2}");
    let summary = json(format!("{validations}/summary.json"));
    assert_eq!((summary["validations"].as_u64(), summary["watched_views"].as_u64()), (Some(8), Some(2)));
    // All of the split is watched here, so that the final figure is the same.
    let last = summary["last_watched_psnr_db"].as_f64().expect("a figure");
    assert!((last - summary["val_psnr_db"].as_f64().expect("a figure")).abs() < 1e-9);
    assert!(summary["val_worst_psnr_db"].as_f64().expect("a figure") <= last && summary["val_lattice"] == 1);
}

#[test]
fn a_fit_keeps_its_newest_blob_where_a_page_looks() {
    let folder = Folder::new();
    let (data, live) = (folder.npz("data.npz"), folder.path("live"));
    let (plain, watched) = (folder.path("plain.nerf"), folder.path("watched.nerf"));
    ok(fit_grid(&data, &plain, &["--steps", "60"]));
    ok(fit_grid(&data, &watched, &["--steps", "60", "--live", &live]));
    let read = |path: &str| std::fs::read(path).expect("a file");
    assert!(read(&plain) == read(&watched), "looking on changes nothing");
    assert!(read(&watched) == read(&format!("{live}/live.nerf")));
    let state = json(format!("{live}/live.json"));
    assert_eq!((&state["step"], &state["done"]), (&60.into(), &true.into()), "{state}");
    let views = &json(format!("{live}/views.json"))["views"];
    assert_eq!(views.as_array().map(Vec::len), Some(2));
    assert!(views[0]["picture"].as_str().is_some_and(|uri| uri.starts_with("data:image/jpeg;base64,")));
    let camera = &views[0]["camera"];
    assert_eq!((&camera["width"], camera["c2w"].as_array().map(Vec::len)), (&24.into(), Some(12)));
    // On the way, too: after the first second.
    let (long, way) = (folder.path("long.nerf"), folder.path("way"));
    let mut running = Running::start(&fit_grid(&data, &long, &["--steps", "1000000", "--live", &way]));
    let state = format!("{way}/live.json");
    wait_for(Path::new(&state), &mut running);
    assert_eq!(json(&state)["done"], false);
    ok(["inspect", &format!("{way}/live.nerf")]);
    drop(running);
    let taken = folder.file("taken", "a file");
    fails(fit_grid(&data, &long, &["--restart", "--live", &taken]), &["--live", "taken"]);
}

#[test]
fn pictures_that_cannot_be_taken_are_refused_naming_the_flag() {
    let folder = Folder::new();
    let (data, file, report) = (folder.npz("data.npz"), folder.path("a.nerf"), folder.path("report"));
    let blind = folder.npz_with("blind.npz", |arrays| arrays.retain(|a| !a.key.ends_with("_val")));
    let args = ["--steps", "1000000000", "--report", &report];
    fails(fit(&data, &file, &["--snapshots", "1"]), &["--report"]);
    fails(fit(&data, &file, &["--snapshot-views", "1"]), &["--report"]);
    fails(
        fit(&data, &file, &[&args[..], &["--snapshot-views", "0,2"]].concat()),
        &["--snapshot-views", "below 2", "found 2"],
    );
    fails(
        fit(&blind, &file, &[&args[..], &["--snapshots", "5"]].concat()),
        &["--snapshots", "none in blind"],
    );
    std::fs::write(Path::new(&report).join("snapshots"), "a file").expect("written");
    fails(fit(&data, &file, &args), &["report/snapshots"]);
}

#[test]
fn steps_the_run_did_not_come_by_are_told() {
    let folder = Folder::new();
    let (data, file, report) = (folder.npz("data.npz"), folder.path("a.nerf"), folder.path("report"));
    let with = |steps: &'static str| ["--steps", "10", "--report", report.as_str(), "--snapshots", steps];
    let first = ran(&mut command(fit(&data, &file, &with("5,70,10,60"))));
    assert_eq!(first.code, Some(0), "{}", first.err);
    assert!(
        first.err.contains("--snapshots: no picture of step 60, 70: the run ended at step 10"),
        "{}",
        first.err
    );
    assert_eq!((taken(&report), sheet(&report).0), (4, 12 + 3 * 204));
    // Taken up again, the sheet keeps what was there, and says what it cannot show any more.
    std::fs::remove_file(folder.path("report/snapshots.png")).expect("removed");
    let again = [&with("5,7,12")[..], &["--resume"]].concat();
    let again: Vec<&str> = again.into_iter().map(|arg| if arg == "10" { "12" } else { arg }).collect();
    let second = ran(&mut command(fit(&data, &file, &again)));
    assert_eq!(second.code, Some(0), "{}", second.err);
    assert!(second.err.contains("no picture of step 7: the run had passed it"), "{}", second.err);
    assert_eq!((taken(&report), sheet(&report).0), (6, 12 + 4 * 204));
}
