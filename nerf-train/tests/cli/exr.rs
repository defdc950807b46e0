//! Views as floats: what an EXR holds is what the PNG shows, and no other file is replaced.

use crate::made::Folder;
use crate::{blob, fails, ok, read_picture};
use ::exr::prelude::{FlatSamples, read_first_flat_layer_from_file};

/// The channels of an EXR by name.
fn channels(path: &str) -> Vec<(String, Vec<f32>)> {
    let image = read_first_flat_layer_from_file(path).expect("an EXR");
    let values = |samples: &FlatSamples| match samples {
        FlatSamples::F32(values) => values.clone(),
        other => panic!("expected 32-bit floats, found {other:?}"),
    };
    let list = &image.layer_data.channel_data.list;
    list.iter().map(|channel| (channel.name.to_string(), values(&channel.sample_data))).collect()
}

#[test]
fn a_view_is_written_as_floats_with_colour_in_linear_light() {
    let (_, file) = blob();
    let folder = Folder::new();
    let (floats, picture) = (folder.path("view.exr"), folder.path("view.png"));
    ok(["render", file, "-o", &floats, "--width", "20", "--outputs", "rgb,z-depth,normals"]);
    ok(["render", file, "-o", &picture, "--width", "20", "--linear"]);
    let colour = channels(&floats);
    let names: Vec<&str> = colour.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(names, ["B", "G", "R"]);
    let shown = read_picture(&picture).into_rgb8();
    for (i, pixel) in shown.pixels().enumerate() {
        for (c, name) in ["R", "G", "B"].into_iter().enumerate() {
            let values = &colour.iter().find(|(found, _)| found == name).expect("a channel").1;
            let off = (values[i].clamp(0.0, 1.0) - f32::from(pixel.0[c]) / 255.0).abs();
            assert!(off <= 0.5 / 255.0 + 1e-5, "{name}, pixel {i}: off by {off}");
        }
    }
    let depth = channels(&folder.path("view_z_depth.exr"));
    assert!(depth.len() == 1 && depth[0].0 == "Z" && depth[0].1.len() == 400);
    assert!(depth[0].1.iter().all(|z| z.is_finite() && *z > 0.0));
    let normals: Vec<String> =
        channels(&folder.path("view_normals.exr")).into_iter().map(|(name, _)| name).collect();
    assert_eq!(normals, ["N.X", "N.Y", "N.Z"]);

    // Over nothing it is premultiplied, with alpha.
    ok(["render", file, "-o", &floats, "--width", "20", "--transparent"]);
    let over_nothing = channels(&floats);
    assert_eq!(over_nothing.len(), 4);
    assert!(over_nothing[0].0 == "A" && over_nothing[0].1.iter().all(|a| (0.0..=1.0).contains(a)));
}

#[test]
fn somebody_else_s_exr_beside_the_first_is_kept() {
    let (_, file) = blob();
    let folder = Folder::new();
    let floats = folder.path("view.exr");
    let both = ["render", file, "-o", &floats, "--width", "8", "--outputs", "rgb,z-depth"];
    ok(both);
    ok(both);
    std::fs::write(folder.path("view_z_depth.exr"), b"mine").expect("a file");
    fails(both, &["view_z_depth.exr"]);
    assert_eq!(std::fs::read(folder.path("view_z_depth.exr")).expect("it"), b"mine");
    fails(["render", file, "--orbit", "2", "-o", &floats], &["-o", ".gif", ".mp4", "view.exr"]);
}
