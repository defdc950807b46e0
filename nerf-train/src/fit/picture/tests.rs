use super::*;
use crate::data::pictures::decode::DecodeError;
use crate::data::pictures::rgb::Picture;
use crate::data::pictures::testing::{jpeg, png};
use crate::fit::snapshot::SnapshotOptions;
use crate::measure::metrics::psnr_db;
use crate::model::picture_config::FieldPreset;
use crate::system::progress::ProgressStyle;
use crate::train::schedule::Clock;
use image::{DynamicImage, ImageBuffer, Luma, Rgb, Rgba};
use nerf_core::Kernel;
use nerf_core::blob::Blob;
use nerf_core::encoding::MAX_GRID_RESOLUTION;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

fn saved(image: impl Into<DynamicImage>, name: &str) -> (TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join(name);
    std::fs::write(&file, png(image)).unwrap();
    (folder, file)
}

fn read(file: &Path) -> anyhow::Result<Photo> {
    Photo::read(file, [0.0; 3], 1.0)
}

#[test]
fn grey_and_16_bit_pictures_keep_their_values() {
    let (_folder, file) = saved(ImageBuffer::from_pixel(3, 2, Luma([128u8])), "grey.png");
    assert_eq!(read(&file).unwrap().picture, Picture::filled(3, 2, [128.0 / 255.0; 3]));
    // The value 300 of 65,535 cannot be represented in 8 bits.
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
    std::fs::write(&file, jpeg(ImageBuffer::from_pixel(8, 8, Rgb([255u8, 255, 255])))).unwrap();
    assert_eq!(read(&file).unwrap().size(), [8, 8]);
}

#[test]
fn an_exif_orientation_turns_the_picture_upright() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("turned.jpg");
    let mut bytes = jpeg(ImageBuffer::from_pixel(16, 8, Rgb([9u8, 9, 9])));
    // A minimal EXIF segment behind the start marker: orientation 6, "turn right by 90 degrees".
    let tiff = [
        b"II*\0\x08\0\0\0\x01\0".as_slice(),   // little-endian, one entry at byte 8
        b"\x12\x01\x03\0\x01\0\0\0\x06\0\0\0", // tag 0x0112, one u16, 6
        b"\0\0\0\0",
    ]
    .concat();
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
    let png = png(ImageBuffer::from_pixel(40, 40, Rgb([1u8, 2, 3])));
    let missing = folder.path().join("missing.png");
    let error = |file: &Path| read(file).unwrap_err().downcast().expect("a fault of a picture");
    assert!(matches!(error(&missing), DecodeError::Read { .. }));
    for bytes in [&b"not a picture at all"[..], b""] {
        assert!(matches!(error(&at("text.jpg", bytes)), DecodeError::Format { .. }));
    }
    assert!(matches!(error(&at("half.png", &png[..png.len() / 2])), DecodeError::Damaged { .. }));
    // Most decoders fill the missing part of a truncated JPEG with grey, without an error.
    let noise = |x: u32, y: u32| Rgb([((x * 37) ^ (y * 91)) as u8, (x * y) as u8, (x ^ y) as u8]);
    let jpeg = jpeg(ImageBuffer::from_fn(64, 64, noise));
    assert!(read(&at("whole.jpg", &jpeg)).is_ok());
    let half = at("half.jpg", &jpeg[..jpeg.len() / 2]);
    assert!(matches!(error(&half), DecodeError::Damaged { .. }));
    let message = read(&at("half.png", &png[..40])).unwrap_err().to_string();
    assert!(message.contains("half.png"), "{message}");
    for scale in [0.0, -1.0, 1.5, f64::NAN] {
        let error = Photo::read(&missing, [0.0; 3], scale).unwrap_err().to_string();
        assert!(error.starts_with("--scale: "), "{error}");
    }
}

fn small_config() -> FieldConfig {
    let mut config = FieldPreset::Classic.config();
    (config.width, config.layers, config.levels, config.pixels) = (32, 2, 5, 512);
    config.optimiser.warm_up = 20;
    config
}

fn grid_config(size: [u32; 2]) -> FieldConfig {
    let mut config = FieldPreset::Grid.config().for_picture(size);
    (config.width, config.layers, config.pixels) = (16, 2, 512);
    let grid = config.grid.as_mut().unwrap();
    (grid.levels, grid.features, grid.log2_entries, grid.coarsest) = (4, 2, 9, grid.coarsest.min(4));
    config
}

/// Settings of a small sinusoidal network and of a small grid.
fn configs(photo: &Photo) -> [FieldConfig; 2] {
    [small_config(), grid_config(photo.size())]
}

fn options(steps: u32) -> RunOptions {
    let budget = Budget { steps: Some(steps), seconds: None };
    RunOptions {
        snapshots: Some(SnapshotOptions { folder: PathBuf::new(), steps: vec![0], views: Vec::new() }),
        ..RunOptions::unattended(budget, Kernel::detect(), ProgressStyle::Quiet)
    }
}

/// Photograph with a smooth red channel, a green channel with a sharp edge, and a constant blue channel.
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
    let clock = Clock::start();
    let each = |at: Evaluation<'_>| evaluations.push((at.step, at.psnr_db));
    let ended = run(photo, config, options, None, clock, &|_| false, each);
    let Ended::Finished(outcome) = ended.unwrap() else { panic!("nobody stops it") };
    (outcome, evaluations)
}

#[test]
fn a_field_learns_its_picture_and_says_how_well() {
    let photo = test_photo(48, 32);
    for (config, least_db) in configs(&photo).into_iter().zip([26.0, 35.0]) {
        let (outcome, evaluations) = fit(&photo, config, &options(400));
        assert!(evaluations[0].0 == 0 && evaluations[0].1 < 15.0, "{evaluations:?}");
        assert!(outcome.psnr_db > least_db, "{}", outcome.psnr_db);
        assert_eq!(evaluations.last(), Some(&(400, outcome.psnr_db)));
        // The PSNR in the blob's provenance is that of this blob, rendered at the size that it states.
        let blob = Blob::open(&outcome.bytes).unwrap();
        let facts = blob.picture().unwrap();
        assert_eq!((facts.width, facts.height), (48, 32));
        let noted = blob.provenance().psnr_db.unwrap();
        assert!((f64::from(noted) - outcome.psnr_db).abs() < 1e-4);
        assert_eq!(psnr_db(&outcome.picture.rgb, &photo.picture.rgb), outcome.psnr_db);
    }
}

/// Photograph of waves; at 64 × 48 pixels, a wavelength is about ten pixels. Any size shows the same waves.
fn waves(width: usize, height: usize) -> Photo {
    let pixel = |i: usize| {
        let (x, y) = (((i % width) as f32 + 0.5) / width as f32, ((i / width) as f32 + 0.5) / height as f32);
        [(40.0 * x).sin(), (30.0 * (x + y)).sin(), (25.0 * y).cos()].map(|c| 0.5 + 0.4 * c)
    };
    let picture = Picture { width, height, rgb: (0..width * height).map(pixel).collect() };
    Photo { name: "waves".into(), picture, notes: Vec::new() }
}

#[test]
fn a_grid_shows_no_noise_between_the_pixels_it_was_trained_on() {
    let (small, large) = (waves(64, 48), waves(256, 192));
    let config = FieldConfig { pixels: 1024, ..FieldPreset::Grid.config().for_picture(small.size()) };
    let (outcome, _) = fit(&small, config, &options(1000));
    println!("{:.2} dB at its pixels", outcome.psnr_db);
    let shown = render_blob(&outcome.bytes, Kernel::detect(), large.size()).unwrap();
    let found = psnr_db(&shown.rgb, &large.picture.rgb);
    let linear = |x: f32, y: f32| {
        let at = |x: f32, y: f32| {
            let (x, y) = (x.clamp(0.0, 63.0) as usize, y.clamp(0.0, 47.0) as usize);
            small.picture.rgb[y * 64 + x]
        };
        let (x0, y0) = (x.floor(), y.floor());
        let (u, v) = (x - x0, y - y0);
        let corners = [
            (0.0, 0.0, (1.0 - u) * (1.0 - v)),
            (1.0, 0.0, u * (1.0 - v)),
            (0.0, 1.0, (1.0 - u) * v),
            (1.0, 1.0, u * v),
        ];
        corners.iter().fold([0.0; 3], |sum, (dx, dy, w)| {
            let pixel = at(x0 + dx, y0 + dy);
            std::array::from_fn(|k| sum[k] + w * pixel[k])
        })
    };
    let enlarged: Vec<[f32; 3]> = (0..256 * 192)
        .map(|i| linear((i % 256) as f32 / 4.0 - 0.375, (i / 256) as f32 / 4.0 - 0.375))
        .collect();
    let of_pixels = psnr_db(&enlarged, &large.picture.rgb);
    println!("enlarged four times: {found:.2} dB, its pixels linearly {of_pixels:.2} dB");
    assert!(found > of_pixels, "{found} {of_pixels}");
}

#[test]
fn no_level_is_finer_than_the_picture() {
    for size in [[1, 1], [1, 65_535], [65_535, 1], [3, 2], [100, 37], [1024, 689], [40_000, 30_000]] {
        let config = FieldPreset::Grid.config().for_picture(size);
        config.check_for(size).unwrap();
        let model = config.model(size);
        model.check().unwrap();
        let grid = model.architecture.position.grid().unwrap();
        for level in &grid.resolutions {
            let within = |axis: usize| (1..=size[axis]).contains(&u32::from(level[axis]));
            assert!(within(0) && within(1) && level[2] == 0, "{size:?}: {level:?}");
        }
        let finest = grid.resolutions.last().unwrap();
        let longest = size[0].max(size[1]).min(MAX_GRID_RESOLUTION.into());
        assert_eq!(u32::from(finest[0].max(finest[1])), longest, "{size:?}");
    }
    let mut finer = FieldPreset::Grid.config().for_picture([100, 37]);
    finer.grid.as_mut().unwrap().finest = 101;
    let error = FieldTrainer::new(&test_photo(100, 37), finer, Kernel::IN_PLACE).err().unwrap().to_string();
    let expected = "grid.finest: expected at most the picture's 100 pixels along its longest side, found 101";
    assert_eq!(error, expected);
    let mut many = FieldPreset::Grid.config().for_picture([30_000, 30_000]);
    (many.grid.as_mut().unwrap().log2_entries, many.grid.as_mut().unwrap().levels) = (24, 8);
    let error = many.check_for([30_000, 30_000]).err().unwrap().to_string();
    assert!(error.starts_with("grid.log2_entries: expected tables of at most 67108864 values"), "{error}");
}

#[test]
fn the_same_seed_gives_the_same_bytes_and_another_gives_others() {
    let photo = test_photo(20, 20);
    for config in configs(&photo) {
        // 9,000 pixels are drawn in several parallel tasks of sixteen chunks each.
        let config = FieldConfig { pixels: 9_000, ..config };
        let (a, _) = fit(&photo, config.clone(), &options(30));
        for threads in 1..=3 {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let (b, _) = pool.install(|| fit(&photo, config.clone(), &options(30)));
            assert!(a.bytes == b.bytes, "{:?}, {threads} threads", config.preset);
        }
        let (c, _) = fit(&photo, FieldConfig { seed: 1, ..config }, &options(30));
        assert_ne!(a.bytes, c.bytes);
    }
}

#[test]
fn pictures_of_odd_sizes_can_be_fitted() {
    for (width, height) in [(1, 1), (3_000, 1), (1, 7), (1, 65_535)] {
        let photo = test_photo(width, height);
        for config in configs(&photo) {
            let (outcome, _) = fit(&photo, config, &options(3));
            assert_eq!((outcome.picture.width, outcome.picture.height), (width, height));
        }
    }
}

#[test]
fn a_run_that_is_stopped_keeps_what_it_has() {
    let (photo, folder) = (test_photo(8, 8), tempfile::tempdir().unwrap());
    let output = folder.path().join("a.nerf");
    for (at, config) in [0, 7].into_iter().flat_map(|at| configs(&photo).map(|config| (at, config))) {
        let options = options(1_000_000);
        let clock = Clock::start();
        let ended = run(&photo, config, &options, Some(&output), clock, &|step| step == at, |_| {}).unwrap();
        assert!(matches!(ended, Ended::Interrupted { step, .. } if step == at));
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
    let error = FieldTrainer::new(&photo, config, Kernel::IN_PLACE).err().unwrap().to_string();
    assert_eq!(error, "layers: expected 1 to 16, found 17");
}

/// A fit that is interrupted and resumed ends with the same bytes as one without interruption. A checkpoint of a run
/// with other settings or data is refused.
#[test]
fn a_run_that_is_taken_up_again_ends_as_if_it_had_not_stopped() {
    let (photo, folder) = (test_photo(16, 12), tempfile::tempdir().unwrap());
    let (output, checkpoint) = (folder.path().join("a.nerf"), folder.path().join("a.nerf.checkpoint"));
    for config in configs(&photo) {
        let kept =
            RunOptions { checkpoint: Some(checkpoint.clone()), validate_every: Some(15), ..options(60) };
        let start = Clock::start();
        let go = |photo: &Photo, config: FieldConfig, options: &RunOptions, at: u32| {
            run(photo, config, options, Some(&output), start, &|step| step == at, |_| {})
        };
        let ended = go(&photo, config.clone(), &kept, 37).unwrap();
        assert!(matches!(&ended, Ended::Interrupted { step: 37, checkpoint: Some(at) } if *at == checkpoint));
        let again = RunOptions { resume: true, ..kept.clone() };
        let steps = |options: &RunOptions, at| match go(&photo, config.clone(), options, at).unwrap() {
            Ended::Finished(outcome) => {
                let curve = outcome.curve.iter().map(|point| (point.step, point.val_psnr_db));
                (outcome.bytes, curve.collect::<Vec<_>>())
            }
            Ended::Interrupted { .. } => panic!("nobody stops it"),
        };
        let resumed = steps(&again, u32::MAX);
        assert_eq!(resumed, steps(&kept, u32::MAX));
        assert_eq!(std::fs::read(&output).unwrap(), resumed.0);

        let mut faster = config.clone();
        faster.optimiser.rate *= 2.0;
        let refused = go(&photo, faster, &again, u32::MAX).unwrap_err().to_string();
        assert!(refused.contains("optimiser.rate") && refused.contains("a.nerf.checkpoint"), "{refused}");
        let refused = go(&test_photo(16, 13), config, &again, u32::MAX).unwrap_err().to_string();
        assert!(refused.contains("data differs"), "{refused}");
        std::fs::write(&checkpoint, b"no checkpoint").unwrap();
        let refused = go(&photo, small_config(), &again, u32::MAX).unwrap_err().to_string();
        assert!(refused.contains("expected a whole checkpoint"), "{refused}");
    }
}
