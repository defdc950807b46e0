//! A blob seen from nearer and farther than its training cameras stood.

use crate::made::Folder;
use crate::{blob, fails, fit_grid, ok, read_picture};

/// Mean opacity of a view down the z axis from `z`, with the scene as large in it as from 4 units away.
fn opacity(file: &str, z: f32, more: &[&str]) -> f64 {
    let folder = Folder::new();
    let view = folder.path("view.png");
    let pose = format!("--pose=1,0,0,0,0,1,0,0,0,0,1,{z}");
    let focal = format!("--focal={}", 8.0 * z.max(1.0));
    let args = ["render", file, "-o", &view, &pose, &focal, "--width", "24", "--outputs", "opacity", "-q"];
    ok([&args[..], more].concat());
    let picture = read_picture(&view).into_luma16();
    let sum: f64 = picture.pixels().map(|pixel| f64::from(pixel.0[0]) / 65535.0).sum();
    sum / f64::from(picture.width() * picture.height())
}

#[test]
fn a_view_never_loses_the_scene() {
    let folder = Folder::new();
    let (data, grid) = (folder.npz("data.npz"), folder.path("a.nerf"));
    ok(fit_grid(&data, &grid, &["--steps", "30"]));
    let text = ok(["inspect", &grid]);
    assert!(text.lines().any(|line| line.starts_with("step  ")), "{text}");
    for file in [&grid, &blob().1] {
        let usual = opacity(file, 4.0, &[]);
        assert!(usual > 0.01, "{usual}");
        let (far, near) = (opacity(file, 16.0, &[]), opacity(file, 1.2, &[]));
        assert!((0.8 * usual..1.25 * usual).contains(&far), "{far}, {usual}");
        assert!(near > 0.5 * usual, "{near}, {usual}");
        // --near and --far are the caller's, in the render and in what explain counts.
        assert_eq!(opacity(file, 16.0, &["--far", "9"]), 0.0);
        assert_eq!(opacity(file, 16.0, &["--near", "22"]), 0.0);
        fails(["render", file, "-o", "x.png", "--near", "3", "--far", "2"], &["near/far", "near 3, far 2"]);
    }
    // Its own bins end 6 units away, and say so.
    assert_eq!(opacity(&blob().1, 16.0, &["--bins", "own"]), 0.0);
    let counted = |more: &[&str]| {
        let args = [&["explain", &blob().1, "--json", "-q"], more].concat();
        let frame: serde_json::Value = serde_json::from_str(&ok(args)).expect("JSON");
        frame["density_evaluations_per_ray"].as_f64().expect("a number")
    };
    assert!(counted(&["--far", "4"]) < counted(&[]));
}
