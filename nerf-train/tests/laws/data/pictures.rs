//! Tests of reading pictures: reduction, masks, bit depths, and files that are refused.

use super::*;
use crate::encoders::{jpeg, png};
use image::{DynamicImage, Luma, Rgb, RgbImage};
use nerf_train::data::Downscale;
use serde_json::{Value, json};
use std::path::PathBuf;
use tempfile::TempDir;

/// Writes a `transforms.json` with the pictures `names`, of 8×4 pixels, and the additional fields `extra`.
fn write(folder: &TempDir, names: &[&str], extra: &Value) -> PathBuf {
    let poses = orbit(names.len(), 4.0, Vec3::ZERO);
    let frame = |(name, pose): (&&str, &Pose)| json!({ "file_path": name, "transform_matrix": matrix(pose) });
    let frames: Vec<Value> = names.iter().zip(&poses).map(frame).collect();
    let mut value = json!({ "fl_x": 10.0, "cx": 4.5, "w": 8, "h": 4, "frames": frames });
    for (key, field) in extra.as_object().expect("an object") {
        value[key] = field.clone();
    }
    let path = folder.path().join("transforms.json");
    std::fs::write(&path, value.to_string()).expect("written");
    path
}

fn save(folder: &TempDir, name: &str, image: impl Into<DynamicImage>) {
    let path = folder.path().join(name);
    std::fs::create_dir_all(path.parent().expect("a folder")).expect("a folder");
    std::fs::write(path, png(image)).expect("written");
}

/// Picture whose columns have the values 0, 10, 20…
fn ramp(width: u32, height: u32) -> RgbImage {
    RgbImage::from_fn(width, height, |x, _| Rgb([(10 * x) as u8; 3]))
}

fn read_at(path: &Path, downscale: Downscale) -> Dataset {
    read(path, &ReadOptions { downscale, ..ReadOptions::default() }).expect("a data set")
}

#[test]
fn photographs_are_made_smaller_with_their_intrinsics() {
    let folder = tempfile::tempdir().expect("a folder");
    for name in ["images/a.png", "images/b.png"] {
        save(&folder, name, ramp(8, 4));
    }
    let path = write(&folder, &["images/a", "images/b"], &json!({}));
    let data = read_at(&path, Downscale::By(2));
    let view = &data.train[0];
    let i = view.camera.intrinsics();
    assert_eq!((i.width, i.height, i.fx, i.cx, i.cy), (4, 2, 5.0, 2.25, 1.0));
    assert_eq!(view.pixels[..4].iter().map(|p| p[0]).collect::<Vec<_>>(), [5, 25, 45, 65]);
    assert_names(&data.notes.join("\n"), &["2 pictures of 8x4 made smaller by area, to 4x2"]);
    // The factor applies to the size in the json, 16×8; the files already have half of that.
    let path = write(&folder, &["images/a", "images/b"], &json!({ "w": 16, "h": 8, "cx": 9.0 }));
    for (factor, width) in [(1, 8), (2, 8), (4, 4)] {
        let data = read_at(&path, Downscale::By(factor));
        let i = data.train[0].camera.intrinsics();
        assert_eq!((i.width, i.fx * 16.0, i.cx * 16.0), (width, 10.0 * width as f32, 9.0 * width as f32));
    }
    // Pictures in a folder of reduced copies are not reduced further.
    save(&folder, "images_4/a.png", RgbImage::from_pixel(4, 2, Rgb([1; 3])));
    save(&folder, "images_4/b.jpg", RgbImage::from_pixel(4, 2, Rgb([2; 3])));
    let data = read_at(&path, Downscale::By(4));
    assert_eq!((data.val[0].pixels[0][0], data.train[0].pixels[0][0]), (1, 2));
    assert!(data.warnings.is_empty() && !data.notes.join("").contains("smaller"), "{:?}", data.notes);
}

#[test]
fn blender_folders_are_made_smaller_only_where_asked() {
    let folder = tempfile::tempdir().expect("a folder");
    save(&folder, "a.png", ramp(1600, 2));
    let path = write(&folder, &["a"], &json!({ "w": null, "h": null }));
    std::fs::copy(&path, folder.path().join("transforms_train.json")).expect("copied");
    let width = |path: &Path, downscale| read_at(path, downscale).train[0].size().0;
    assert_eq!((width(folder.path(), Downscale::Auto), width(folder.path(), Downscale::By(4))), (1600, 400));
    std::fs::remove_file(folder.path().join("transforms_train.json")).expect("removed");
    assert_eq!((width(&path, Downscale::Auto), width(&path, Downscale::By(1))), (800, 1600));
}

#[test]
fn what_a_mask_is_black_at_does_not_count() {
    let folder = tempfile::tempdir().expect("a folder");
    let names = ["a", "b", "c", "d"];
    for name in names {
        save(&folder, &format!("{name}.png"), ramp(8, 4));
    }
    // The masks hide the left two columns of a, nothing of b, and all of c.
    save(&folder, "masks/a.png", image::GrayImage::from_fn(8, 4, |x, _| Luma([if x < 2 { 0 } else { 255 }])));
    save(&folder, "masks/b.png", RgbImage::from_pixel(4, 2, Rgb([0, 0, 9])));
    save(&folder, "masks/c.png", image::GrayImage::new(8, 4));
    let path = write(&folder, &names, &json!({}));
    let whole: Value = serde_json::from_slice(&std::fs::read(&path).expect("read")).expect("json");
    let masked = |masks: &[(usize, &str)]| {
        let mut value = whole.clone();
        masks.iter().for_each(|&(i, mask)| value["frames"][i]["mask_path"] = mask.into());
        std::fs::write(&path, value.to_string()).expect("written");
    };
    masked(&[(0, "masks/a.png"), (1, "masks/b"), (2, "masks/c.png")]);
    for (downscale, width) in [(Downscale::By(1), 8), (Downscale::By(2), 4)] {
        let data = read_at(&path, downscale);
        let (a, b) = (&data.val[0], &data.train[0]);
        let columns: Vec<bool> = (0..width as usize).map(|i| a.counts(i)).collect();
        assert_eq!(columns.iter().filter(|counts| !**counts).count(), width as usize / 4, "{columns:?}");
        assert!(!columns[0] && columns[width as usize - 1] && b.mask.is_none());
        // `counted` leaves out the hidden quarter of the pixels.
        let rgb = a.composite_over([0.0; 3]);
        assert_eq!(a.counted(&rgb).len(), 3 * rgb.len() / 4);
        assert_eq!((data.train.len(), data.val.len()), (2, 1));
        assert_names(&data.notes.join("\n"), &["1 pictures have masks"]);
        assert_names(&data.warnings.join("\n"), &["skipped 1 pictures, whose masks leave no pixel: c"]);
    }
    masked(&[(0, "masks/none.png")]);
    assert_names(&error_of(&path), &["view `a`, mask_path", "masks/none.png"]);
    save(&folder, "masks/a.png", ramp(8, 8));
    masked(&[(0, "masks/a.png")]);
    assert_names(&error_of(&path), &["masks/a.png", "8x4", "8x8"]);
    masked(&[(0, "../a.png")]);
    assert!(!error_of(&path).is_empty());
}

#[test]
fn rays_are_drawn_of_what_counts_alone() {
    use nerf_core::space::SceneBox;
    use nerf_train::model::config::Preset;
    use nerf_train::train::Bounds;
    use nerf_train::train::rays::RayBank;
    let mut views = dataset_of(&orbit(3, 4.0, Vec3::ZERO), Axes::Opengl).train;
    views[1].mask = Some((0..48).map(|i| i % 8 == 3).collect());
    views.iter_mut().for_each(|view| view.pixels = vec![[9, 9, 9, 255]; 48]);
    views[2].pixels[5] = [200, 0, 0, 255];
    let scene_box = SceneBox { min: -Vec3::ONE, max: Vec3::ONE };
    let bounds = Bounds { near: 1.0, far: 6.0, scene_box, contraction: None, empty_before: 1.0 };
    for (background, images, pixels) in [
        (Background::Unknown, 0, Some(48 + 6 + 48)),
        (Background::Unknown, 2, Some(48 + 6 + 48)),
        (Background::Constant([9; 3]), 0, None),
        (Background::Constant([9; 3]), 1, None),
    ] {
        let mut config = Preset::Small.config();
        config.sampling.images = images;
        let bank = RayBank::new(&views, background, bounds, &config).expect("bounds");
        assert!(pixels.is_none_or(|pixels| bank.pixels() == pixels), "{}", bank.pixels());
        let mut seen = [0usize; 3];
        for index in 0..4000 {
            let (view, pixel) = bank.source(index / 100, index % 100, 100);
            assert!(views[view].counts(pixel), "{background:?}, {images}: pixel {pixel} of view {view}");
            seen[view] += 1;
        }
        assert!(images == 0 || seen[1] > 1000, "a view is as likely as others: {seen:?}");
    }
}

#[test]
fn applied_transform_and_aabb_scale_are_said() {
    let folder = tempfile::tempdir().expect("a folder");
    save(&folder, "a.png", ramp(8, 4));
    let turned = json!([[0, 1, 0, 0], [1, 0, 0, 0], [0, 0, -1, 0]]);
    let path = write(&folder, &["a", "a"], &json!({ "applied_transform": turned, "aabb_scale": 16 }));
    let data = read_plain(&path).expect("a data set");
    // Poses stay in the file's coordinates: `applied_transform` is not inverted.
    assert_eq!(*data.val[0].camera.pose(), orbit(2, 4.0, Vec3::ZERO)[0]);
    assert_names(&data.notes.join("\n"), &["applied_transform is not undone", "aabb_scale 16"]);
    let plain = json!([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]);
    let path = write(&folder, &["a"], &json!({ "applied_transform": plain }));
    assert!(!read_plain(&path).expect("a data set").notes.join("").contains("applied_transform"));
}

#[test]
fn sixteen_bits_and_palettes_and_grey_are_read() {
    let folder = tempfile::tempdir().expect("a folder");
    let deep = image::ImageBuffer::from_pixel(8, 4, Rgb([0x8080u16, 0xffff, 0]));
    save(&folder, "deep.png", DynamicImage::ImageRgb16(deep));
    save(&folder, "grey.png", image::GrayImage::from_pixel(8, 4, Luma([77])));
    let data = read_plain(&write(&folder, &["deep", "grey"], &json!({}))).expect("a data set");
    assert_eq!((data.val[0].pixels[0], data.train[0].pixels[0]), ([128, 255, 0, 255], [77, 77, 77, 255]));
    let small = read_at(&folder.path().join("transforms.json"), Downscale::By(2));
    assert_eq!((small.val[0].pixels[0], small.train[0].pixels[0]), ([128, 255, 0, 255], [77, 77, 77, 255]));
}

#[test]
fn heic_is_refused_with_what_to_do() {
    let folder = tempfile::tempdir().expect("a folder");
    for (name, brand) in [("a.HEIC", b"heic"), ("a.jpg", b"mif1"), ("a.avif", b"avif")] {
        std::fs::write(folder.path().join(name), [&b"\0\0\0\x18ftyp"[..], brand, &[0; 64]].concat())
            .expect("written");
        let error = error_of(&write(&folder, &[name], &json!({})));
        assert_names(&error, &[name, "found HEIF (HEIC)", "heif-convert", "magick mogrify"]);
    }
    for name in ["a.jpg", "a.avif"] {
        std::fs::remove_file(folder.path().join(name)).expect("removed");
    }
    assert_names(&error_of(&write(&folder, &["a"], &json!({}))), &["a.HEIC", "HEIF"]);
}

#[test]
fn a_cut_photograph_among_good_ones_is_named() {
    let folder = tempfile::tempdir().expect("a folder");
    for name in ["a.jpg", "b.jpg", "c.jpg"] {
        std::fs::write(folder.path().join(name), jpeg(ramp(8, 4))).expect("written");
    }
    let path = write(&folder, &["a.jpg", "b.jpg", "c.jpg"], &json!({}));
    let whole = std::fs::read(folder.path().join("b.jpg")).expect("read");
    std::fs::write(folder.path().join("b.jpg"), &whole[..whole.len() - 20]).expect("written");
    assert_names(&error_of(&path), &["b.jpg", "expected a PNG, JPEG, WebP, TIFF, BMP or GIF picture"]);
    std::fs::write(folder.path().join("b.jpg"), &whole).expect("written");
    assert_eq!(read_plain(&path).expect("three").train.len(), 2);
}

#[test]
fn a_photograph_of_another_size_among_good_ones_is_named() {
    let folder = tempfile::tempdir().expect("a folder");
    for (name, (width, height)) in [("a.png", (8, 4)), ("b.png", (6, 6)), ("c.png", (8, 4))] {
        save(&folder, name, ramp(width, height));
    }
    let names = ["a.png", "b.png", "c.png"];
    let sized = write(&folder, &names, &json!({}));
    assert_names(&error_of(&sized), &["b.png", "a picture of 8x4 pixels", "found 6x6"]);
    let focal = json!({ "w": null, "h": null });
    let angle = json!({ "w": null, "h": null, "fl_x": null, "camera_angle_x": 1.0 });
    let warnings =
        |extra: &Value| read_plain(&write(&folder, &names, extra)).expect("three").warnings.join("\n");
    assert_names(&warnings(&focal), &["transforms.json", "pictures of 2 sizes", "fl_x"]);
    // No warning for an angle of view, nor for a focal length if all pictures have one size.
    assert!(!warnings(&angle).contains("sizes"), "{}", warnings(&angle));
    save(&folder, "b.png", ramp(8, 4));
    assert!(!warnings(&focal).contains("sizes"), "{}", warnings(&focal));
}

/// Header of a BMP with 24 bits a pixel, without pixel data.
fn header_alone(width: i32, height: i32) -> Vec<u8> {
    let sizes = [54i32, 40, width, height].map(i32::to_le_bytes).concat();
    [&b"BM\x36\0\0\0\0\0\0\0"[..], &sizes, &[1, 0, 24, 0], &[0; 24]].concat()
}

#[test]
fn of_a_picture_of_another_size_only_the_header_is_read() {
    let folder = tempfile::tempdir().expect("a folder");
    save(&folder, "a.png", ramp(8, 4));
    let large = folder.path().join("large.png");
    std::fs::write(&large, header_alone(16_000, 16_000)).expect("written");
    let path = write(&folder, &["large.png"], &json!({}));
    assert_names(&error_of(&path), &["large.png", "8x4 pixels", "found 16000x16000"]);
    // A mask must have the size of its picture.
    let mut value: Value = serde_json::from_slice(&std::fs::read(&path).expect("read")).expect("JSON");
    (value["frames"][0]["file_path"], value["frames"][0]["mask_path"]) = (json!("a.png"), json!("large.png"));
    std::fs::write(&path, value.to_string()).expect("written");
    assert_names(&error_of(&path), &["large.png", "8x4 pixels", "found 16000x16000"]);
    // A picture of 4×8 pixels is decoded, because its EXIF orientation may turn it to 8×4.
    std::fs::write(&large, header_alone(4, 8)).expect("written");
    let path = write(&folder, &["large.png"], &json!({}));
    let error = error_of(&path);
    assert!(error.contains("large.png") && !error.contains("8x4"), "{error}");
}
