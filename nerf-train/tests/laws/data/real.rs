//! Tests on real scenes, as far as `crate::tools::data` finds them.

use super::*;
use crate::tools::data;

fn read_as(path: &Path, axes: Axes) -> Dataset {
    read(path, &ReadOptions { axes: Some(axes), ..Default::default() }).expect("real data")
}

fn pose_gap(a: &Camera, b: &Camera) -> f32 {
    let (a, b) = (a.pose(), b.pose());
    (a.position - b.position).length() + (a.forward() - b.forward()).length()
}

#[test]
fn lego_npz_and_lego_folder_are_the_same_scene() {
    let (Some(npz), Some(folder)) = (data("lego_200x200.npz"), data("lego_200")) else { return };
    let npz = read_plain(&npz).expect("npz");
    let folder = read_plain(&folder).expect("folder");
    assert_eq!((npz.train.len(), npz.val.len(), npz.test_path.len()), (100, 10, 60));
    assert_eq!((folder.train.len(), folder.val.len()), (100, 100));
    for (a, b) in npz.train.iter().zip(&folder.train) {
        assert!(pose_gap(&a.camera, &b.camera) < 1e-5, "{} and {}", a.name, b.name);
        let (a, b) = (a.camera.intrinsics(), b.camera.intrinsics());
        assert!((a.fx - b.fx).abs() < 1e-3 && (a.fy - b.fy).abs() < 1e-3);
        assert_eq!((a.cx, a.cy, a.width), (b.cx, b.cy, b.width));
    }
    // The .npz holds every tenth validation view of the folder.
    for (a, b) in npz.val.iter().zip(folder.val.iter().step_by(10)) {
        assert!(pose_gap(&a.camera, &b.camera) < 1e-5, "{} and {}", a.name, b.name);
    }
    // The pictures are the same, too; those in the .npz are composited over black.
    let black = folder.train[7].composite_over([0.0; 3]);
    let other = npz.train[7].composite_over([0.0; 3]);
    let mse: f32 = black.iter().zip(&other).map(|(a, b)| (a[1] - b[1]).powi(2)).sum::<f32>() / 40_000.0;
    assert!(mse < 1e-3, "{mse}");
    assert_eq!((npz.background, folder.background), (Background::Constant([0; 3]), Background::Alpha));
}

#[test]
fn reports_on_real_data_warn_only_of_wrong_axes() {
    for (name, right) in
        [("lego_200x200.npz", Axes::Opencv), ("lego_200", Axes::Opengl), ("tiny_nerf_data.npz", Axes::Opengl)]
    {
        let Some(path) = data(name) else { continue };
        let report = Report::of(&read_plain(&path).expect(name));
        println!("{report}");
        assert_eq!(report.axes, right);
        assert!(report.warnings.is_empty(), "{:?}", report.warnings);
        assert_eq!((report.near, report.far), (Some(2.0), Some(6.0)));
        let look_at = report.look_at.expect("an orbit");
        assert!((look_at.mean_distance - 4.03).abs() < 0.05, "{look_at:?}");
        assert!(Vec3::from(look_at.point).length() < 0.05, "{look_at:?}");
        let wrong = Report::of(&read_as(&path, right.other()));
        assert_names(&wrong.warnings.join("\n"), &[&format!("--axes {right}")]);
    }
}

#[test]
fn tiny_nerf_is_split_as_the_notebook_does() {
    let Some(path) = data("tiny_nerf_data.npz") else { return };
    let tiny = read_plain(&path).expect("tiny");
    assert_eq!((tiny.train.len(), tiny.val.len()), (100, 5));
    assert_eq!(tiny.val[0].name, "images[101]");
    assert_eq!(tiny.val[0].size(), (100, 100));
}
