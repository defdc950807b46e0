//! A floor under quality: what the default preset reaches in a few hundred steps, as it was when this was written. Who
//! makes it better by more than the band writes the new figure down.

use crate::made::Folder;
use crate::ok;
use crate::tools::data;

/// How far from its figure a run may be, dB.
const BAND_DB: f64 = 0.5;

/// Runs a command; the PSNR over all validation views that it says must be the figure.
fn reaches(figure_db: f64, args: &[&str]) {
    let said: serde_json::Value =
        serde_json::from_str(&ok([args, &["--json", "-q"]].concat())).expect("one object");
    let found = said["val_psnr_db"].as_f64().expect("a figure");
    println!("{found:.3} dB, where {figure_db} dB were measured: {args:?}");
    assert!((found - figure_db).abs() <= BAND_DB, "{args:?}: expected {figure_db} dB, found {found:.3} dB");
}

#[test]
fn the_demo_is_learned_as_well_as_ever() {
    let folder = Folder::new();
    reaches(23.26, &["demo", "--out", &folder.path("demo"), "--steps", "200"]);
}

#[test]
fn lego_is_learned_as_well_as_ever() {
    let Some(lego) = data("lego_200x200.npz") else { return };
    let (folder, lego) = (Folder::new(), lego.to_string_lossy());
    reaches(22.85, &["fit", &lego, "-o", &folder.path("lego.nerf"), "--steps", "150"]);
}

#[test]
fn fox_is_learned_as_well_as_ever() {
    let Some(fox) = data("real/fox_ngp") else { return };
    let (folder, fox) = (Folder::new(), fox.to_string_lossy());
    let smaller = ["--downscale", "8", "--steps", "200"];
    reaches(19.06, &[&["fit", &fox, "-o", &folder.path("fox.nerf")], &smaller[..]].concat());
}
