//! `explain`, and `eval --lattice`: figures that can be checked against each other.

use crate::{blob, fails, ok, run};
use serde_json::Value;

fn json(args: &[&str]) -> Value {
    let ran = run([args, &["--json", "--quiet"]].concat());
    assert_eq!(ran.code, Some(0), "{args:?}: {}", ran.err);
    serde_json::from_str(&ran.out).expect("an object")
}

#[test]
fn explain_says_why_and_its_shares_are_all_of_the_work() {
    let (folder, file) = blob();
    let data = folder.path("scene.npz");
    let frame = json(&["explain", file, "--data", &data, "--view", "1"]);
    let number =
        |object: &Value, name: &str| object[name].as_f64().unwrap_or_else(|| panic!("{name}: {object}"));
    let shares: f64 =
        ["direction_share", "density_share", "colour_share"].iter().map(|name| number(&frame, name)).sum();
    assert!((shares - 1.0).abs() < 1e-12, "{shares}");
    assert_eq!(frame["stages"]["colour"], true);

    let depth = json(&["explain", file, "--data", &data, "--view", "1", "--no-colour"]);
    assert_eq!(depth["stages"]["colour"], false);
    assert_eq!(depth["stages"]["colour_note"], "off: not asked for");
    assert_eq!(number(&depth, "colour_evaluations_per_ray"), 0.0);
    assert_eq!(number(&depth, "density_share"), 1.0);
    let density_of = |frame: &Value| number(frame, "density_evaluations_per_ray");
    assert_eq!(density_of(&depth), density_of(&frame), "depth costs the trunk of the colour frame");
    assert!(number(&depth, "workspace_bytes") < number(&frame, "workspace_bytes"));

    let uncut = json(&["explain", file, "--data", &data, "--view", "1", "--transmittance-cut", "0"]);
    assert_eq!(uncut["stages"]["transmittance_cut_note"], "off: switched off by the request");
    assert!(density_of(&uncut) > density_of(&frame));

    let text = ok(["explain", file]);
    for line in ["occupancy          on", "transmittance cut  on", "workspace ", "multiply-adds"] {
        assert!(text.contains(line), "{line} of\n{text}");
    }
}

#[test]
fn explain_refuses_views_and_fields_that_are_not_there() {
    let (folder, file) = blob();
    let data = folder.path("scene.npz");
    fails(["explain", file, "--data", &data, "--view", "2"], &["--view", "less than 2", "found 2"]);
    fails(["explain", file, "--view", "1"], &["--data"]);
}

#[test]
fn a_lattice_as_wide_as_the_picture_is_its_first_pixel() {
    let (folder, file) = blob();
    let data = folder.path("scene.npz");
    let all = json(&["eval", file, &data]);
    assert!(all["lattice_psnr_db"].is_null());
    let every_second = json(&["eval", file, &data, "--lattice", "2"]);
    assert_eq!(every_second["val_psnr_db"], all["val_psnr_db"], "the lattice is one figure more");
    assert_ne!(every_second["lattice_psnr_db"], all["val_psnr_db"]);
    // The corner is background: black on black, and as good as the field's emptiness there.
    let corner = json(&["eval", file, &data, "--lattice", "24"]);
    let db = corner["lattice_psnr_db"].as_f64();
    assert!(db.is_none() || db > all["val_psnr_db"].as_f64(), "{corner}");
    fails(["eval", file, &data, "--lattice", "1"], &["--lattice"]);
}
