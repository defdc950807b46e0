use super::*;
use crate::decode::DecodeError;
use crate::report::picture::Picture;
use crate::report::progress::ProgressStyle;
use crate::train::schedule::{Budget, Clock};
use image::{DynamicImage, ImageBuffer, ImageFormat, Luma, Rgb, Rgba};
use nerf_core::blob::Blob;
use nerf_core::kernels::Tier;
use std::path::PathBuf;
use std::time::Duration;
use tempfile::TempDir;

fn saved(image: impl Into<DynamicImage>, name: &str) -> (TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join(name);
    image.into().save(&file).unwrap();
    (folder, file)
}

fn read(file: &std::path::Path) -> Result<Photo, PhotoError> {
    Photo::read(file, [0.0; 3], 1.0)
}

#[test]
fn grey_and_16_bit_pictures_keep_their_values() {
    let (_folder, file) = saved(ImageBuffer::from_pixel(3, 2, Luma([128u8])), "grey.png");
    assert_eq!(read(&file).unwrap().picture, Picture::filled(3, 2, [128.0 / 255.0; 3]));
    // 300 of 65,535 would be lost in 8 bits.
    let (_folder, file) = saved(ImageBuffer::from_pixel(2, 2, Rgb([300u16, 0, 65_535])), "deep.png");
    assert_eq!(read(&file).unwrap().picture.rgb[0], [300.0 / 65_535.0, 0.0, 1.0]);
}

#[test]
fn transparent_parts_show_the_background() {
    let (_folder, file) = saved(ImageBuffer::from_pixel(1, 1, Rgba([255u8, 0, 0, 51])), "alpha.png");
    let photo = Photo::read(&file, [0.0, 1.0, 0.0], 1.0).unwrap();
    let expected = [0.2, 0.8, 0.0];
    assert!(photo.picture.rgb[0].iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6), "{photo:?}");
    assert_eq!(photo.notes.len(), 1);
}

#[test]
fn the_format_is_told_from_the_content() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("jpeg_named.png");
    DynamicImage::from(ImageBuffer::from_pixel(8, 8, Rgb([255u8, 255, 255])))
        .save_with_format(&file, ImageFormat::Jpeg)
        .unwrap();
    assert_eq!(read(&file).unwrap().size(), [8, 8]);
}

#[test]
fn an_exif_orientation_turns_the_picture_upright() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("turned.jpg");
    let mut jpeg = std::io::Cursor::new(Vec::new());
    DynamicImage::from(ImageBuffer::from_pixel(16, 8, Rgb([9u8, 9, 9])))
        .write_to(&mut jpeg, ImageFormat::Jpeg)
        .unwrap();
    // A minimal EXIF segment behind the start marker: orientation 6, "turn right by 90 degrees".
    let tiff = [
        b"II*\0\x08\0\0\0\x01\0".as_slice(),   // little-endian, one entry at byte 8
        b"\x12\x01\x03\0\x01\0\0\0\x06\0\0\0", // tag 0x0112, one u16, 6
        b"\0\0\0\0",
    ]
    .concat();
    let mut bytes = jpeg.into_inner();
    let mut segment = vec![0xff, 0xe1];
    segment.extend(((2 + 6 + tiff.len()) as u16).to_be_bytes());
    segment.extend(b"Exif\0\0");
    segment.extend(tiff);
    bytes.splice(2..2, segment);
    std::fs::write(&file, bytes).unwrap();
    let photo = read(&file).unwrap();
    assert_eq!(photo.size(), [8, 16]);
    assert_eq!(photo.notes.len(), 1);
}

#[test]
fn reducing_keeps_the_mean() {
    let stripes = ImageBuffer::from_fn(64, 64, |x, _| Luma([if x % 2 == 0 { 255u8 } else { 0 }]));
    let (_folder, file) = saved(stripes, "stripes.png");
    let photo = Photo::read(&file, [0.0; 3], 0.25).unwrap();
    assert_eq!(photo.size(), [16, 16]);
    assert!(photo.picture.rgb.iter().flatten().all(|c| (c - 0.5).abs() < 0.07), "{:?}", photo.picture.rgb);
}

#[test]
fn a_wrong_file_is_named_with_what_was_found() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str, bytes: &[u8]| {
        let file = folder.path().join(name);
        std::fs::write(&file, bytes).unwrap();
        file
    };
    let png = {
        let mut png = std::io::Cursor::new(Vec::new());
        DynamicImage::from(ImageBuffer::from_pixel(40, 40, Rgb([1u8, 2, 3])))
            .write_to(&mut png, ImageFormat::Png)
            .unwrap();
        png.into_inner()
    };
    let missing = folder.path().join("missing.png");
    assert!(matches!(read(&missing), Err(PhotoError::Decode(DecodeError::Read { .. }))));
    assert!(matches!(
        read(&at("text.jpg", b"not a picture at all")),
        Err(PhotoError::Decode(DecodeError::Format { .. }))
    ));
    assert!(matches!(read(&at("empty.png", b"")), Err(PhotoError::Decode(DecodeError::Format { .. }))));
    assert!(matches!(
        read(&at("half.png", &png[..png.len() / 2])),
        Err(PhotoError::Decode(DecodeError::Damaged { .. }))
    ));
    // A JPEG cut short decodes to grey with most decoders, and says nothing.
    let noise = |x: u32, y: u32| Rgb([((x * 37) ^ (y * 91)) as u8, (x * y) as u8, (x ^ y) as u8]);
    let mut jpeg = std::io::Cursor::new(Vec::new());
    let picture = DynamicImage::from(ImageBuffer::from_fn(64, 64, noise));
    picture.write_to(&mut jpeg, ImageFormat::Jpeg).unwrap();
    let jpeg = jpeg.into_inner();
    assert!(read(&at("whole.jpg", &jpeg)).is_ok());
    let half = at("half.jpg", &jpeg[..jpeg.len() / 2]);
    assert!(matches!(read(&half), Err(PhotoError::Decode(DecodeError::Damaged { .. }))));
    let message = read(&at("half.png", &png[..40])).unwrap_err().to_string();
    assert!(message.contains("half.png"), "{message}");
    for scale in [0.0, -1.0, 1.5, f64::NAN] {
        assert!(matches!(Photo::read(&missing, [0.0; 3], scale), Err(PhotoError::Scale { .. })));
    }
}

fn small_config() -> FieldConfig {
    let mut config = FieldPreset::Classic.config();
    (config.width, config.layers, config.levels, config.pixels) = (32, 2, 5, 512);
    config.optimiser.warm_up = 20;
    config
}

fn options(steps: u32) -> RunOptions {
    RunOptions {
        budget: Budget { steps: Some(steps), seconds: None },
        output: None,
        snapshots: vec![0],
        evaluate_every: None,
        tier: Tier::detect(),
        style: ProgressStyle::Quiet,
    }
}

/// Smooth in one channel, sharp in another, constant in the third.
fn test_photo(width: usize, height: usize) -> Photo {
    let pixel = |i: usize| {
        let (x, y) = ((i % width) as f32 / width as f32, (i / width) as f32 / height as f32);
        [x, if x + y < 1.0 { 0.9 } else { 0.1 }, 0.25]
    };
    let picture = Picture { width, height, rgb: (0..width * height).map(pixel).collect() };
    Photo { name: "test".into(), picture, notes: Vec::new() }
}

fn fit(photo: &Photo, config: FieldConfig, options: &RunOptions) -> (Outcome, Vec<(u32, f64)>) {
    let mut evaluations = Vec::new();
    let clock = Clock::resume(Duration::ZERO);
    let ended = run(photo, config, options, clock, &|_| false, |at| evaluations.push((at.step, at.psnr_db)));
    let Ended::Finished(outcome) = ended.unwrap() else { panic!("nobody stops it") };
    (outcome, evaluations)
}

#[test]
fn a_field_learns_its_picture_and_says_how_well() {
    let photo = test_photo(48, 32);
    let (outcome, evaluations) = fit(&photo, small_config(), &options(400));
    assert!(evaluations[0].0 == 0 && evaluations[0].1 < 15.0, "{evaluations:?}");
    assert!(outcome.psnr_db > 26.0, "{}", outcome.psnr_db);
    assert_eq!(evaluations.last(), Some(&(400, outcome.psnr_db)));
    // The noted figure is that of the very blob, at the size it names.
    let blob = Blob::open(&outcome.bytes).unwrap();
    let facts = blob.picture().unwrap();
    assert_eq!((facts.width, facts.height), (48, 32));
    let noted = blob.provenance().psnr_db.unwrap();
    assert!((f64::from(noted) - outcome.psnr_db).abs() < 1e-4);
    assert_eq!(crate::report::metrics::psnr_db(&outcome.picture.rgb, &photo.picture.rgb), outcome.psnr_db);
}

#[test]
fn the_same_seed_gives_the_same_bytes_and_another_gives_others() {
    let photo = test_photo(20, 20);
    let (a, _) = fit(&photo, small_config(), &options(30));
    let pool = rayon::ThreadPoolBuilder::new().num_threads(3).build().unwrap();
    let (b, _) = pool.install(|| fit(&photo, small_config(), &options(30)));
    assert_eq!(a.bytes, b.bytes);
    let (c, _) = fit(&photo, FieldConfig { seed: 1, ..small_config() }, &options(30));
    assert_ne!(a.bytes, c.bytes);
}

#[test]
fn pictures_of_odd_sizes_can_be_fitted() {
    for (width, height) in [(1, 1), (3_000, 1), (1, 7)] {
        let photo = test_photo(width, height);
        let (outcome, _) = fit(&photo, small_config(), &options(3));
        assert_eq!((outcome.picture.width, outcome.picture.height), (width, height));
    }
}

#[test]
fn a_run_that_is_stopped_keeps_what_it_has() {
    let (photo, folder) = (test_photo(8, 8), tempfile::tempdir().unwrap());
    let output = folder.path().join("a.nerf");
    for at in [0, 7] {
        let options = RunOptions { output: Some(output.clone()), ..options(1_000_000) };
        let clock = Clock::resume(Duration::ZERO);
        let ended = run(&photo, small_config(), &options, clock, &|step| step == at, |_| {}).unwrap();
        assert!(matches!(ended, Ended::Stopped { steps } if steps == at));
        let bytes = std::fs::read(&output).unwrap();
        let blob = Blob::open(&bytes).unwrap();
        assert_eq!((blob.provenance().steps, blob.provenance().psnr_db), (at, None));
    }
}

#[test]
fn settings_out_of_range_are_named() {
    let mut config = small_config();
    config.layers = 17;
    let photo = test_photo(4, 4);
    let error = FieldTrainer::new(&photo, config, Tier::Scalar).err().unwrap().to_string();
    assert_eq!(error, "layers: expected 1 to 16, found 17");
}
