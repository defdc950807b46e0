//! Same seed, same blob; dead ends are reported.

use crate::{fit, options, scene, tiny, tiny_grid, tiny_posed, tiny_seed};
use glam::{Mat3, Vec2, Vec3};
use nerf_core::Kernel;
use nerf_core::blob::Blob;
use nerf_core::camera::{Camera, Pose};
use nerf_train::data::Dataset;
use nerf_train::data::demo;
use nerf_train::data::demo::DemoSpec;
use nerf_train::data::{Background, over};
use nerf_train::fit::finish::Outcome;
use nerf_train::fit::run::{Ended, run};
use nerf_train::lab::sweep::Job;
use nerf_train::lab::sweep::Runner;
use nerf_train::lab::sweep::Status;
use nerf_train::measure::eval::Scores;
use nerf_train::measure::metrics::psnr_db;
use nerf_train::model::config::Config;
use nerf_train::model::config::Density;
use nerf_train::model::config::Jitter;
use nerf_train::model::config::{MovingObjects, PoseRefinement};
use nerf_train::system::progress::ProgressStyle;
use nerf_train::train::TrainError;
use nerf_train::train::Trainer;
use std::path::Path;

/// All presets, small; and the seed preset's published variants.
fn variants(steps: u32) -> Vec<(&'static str, Config)> {
    let with = |change: fn(&mut Config)| {
        let mut config = tiny_seed(steps);
        change(&mut config);
        config
    };
    vec![
        ("small", tiny(steps)),
        ("small without hull", tiny(steps).without_hull()),
        ("grid", tiny_grid(steps)),
        ("grid without hull", tiny_grid(steps).without_hull()),
        // On trial, poses are refined as in the next line.
        ("unbounded grid", tiny_posed(steps, PoseRefinement::Given)),
        ("unbounded grid, poses refined", tiny_posed(steps, PoseRefinement::Refine)),
        ("seed", tiny_seed(steps)),
        ("seed, 32 samples", with(|c| c.sampling.samples = 32)),
        ("seed, jitter 0.02", with(|c| c.sampling.jitter = Jitter::Width(0.02))),
        ("seed, rays by image", with(|c| (c.sampling.images, c.sampling.rays) = (5, 100))),
        ("seed, rate 1e-3", with(|c| c.optimiser.rate = 1e-3)),
    ]
}

#[test]
fn thread_count_changes_no_byte_of_a_blob() {
    let dataset = scene();
    for (name, config) in variants(20) {
        let blobs = [1, 2, 3].map(|threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
            pool.install(|| fit(&dataset, &config)).expect("a blob").bytes
        });
        assert!(blobs[0] == blobs[1] && blobs[0] == blobs[2], "{name}");
    }
}

#[test]
fn thread_count_changes_no_byte_of_a_grid_after_200_steps() {
    let spec = DemoSpec { train: 12, val: 1, size: 32, ..DemoSpec::default() };
    let dataset = demo::dataset(&spec).expect("a scene");
    let mut config = tiny_grid(200);
    // Enough samples for all accumulators to have some.
    config.sampling.live_samples = 4096;
    let blobs = [1, 2, 3].map(|threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        let outcome = pool.install(|| fit(&dataset, &config)).expect("a blob");
        // Curve and counters too, which say what was trained on.
        (outcome.bytes, outcome.curve.last().map(|point| point.train_psnr_db.to_bits()))
    });
    assert!(blobs[0] == blobs[1] && blobs[0] == blobs[2]);
}

#[test]
fn variants_and_seeds_differ_from_each_other() {
    let dataset = scene();
    let mut configs: Vec<Config> = variants(20).into_iter().map(|(_, config)| config).collect();
    configs.push(Config { seed: 1, ..tiny(20) });
    let mut blobs: Vec<Vec<u8>> = configs.iter().map(|c| fit(&dataset, c).expect("a blob").bytes).collect();
    let count = blobs.len();
    blobs.sort();
    blobs.dedup();
    assert_eq!(blobs.len(), count, "a setting without effect");
}

#[test]
fn a_batch_larger_than_the_data_draws_its_pixels_again() {
    let mut dataset = scene();
    dataset.train.truncate(1);
    let pixels = dataset.train[0].pixels.len();
    for (name, images, mut config) in [
        ("small", 0, tiny(10)),
        ("grid", 0, tiny_grid(10)),
        ("seed", 0, tiny_seed(10)),
        ("seed, by image", 1000, tiny_seed(10)),
    ] {
        (config.sampling.rays, config.sampling.live_samples) = (10 * pixels, 0);
        config.sampling.images = images;
        let outcome = fit(&dataset, &config).expect(name);
        assert!(Blob::open(&outcome.bytes).is_ok());
        let mut trainer = Trainer::new(&dataset, config, Kernel::detect()).expect("a trainer");
        trainer.step(0.0).expect("a step");
        assert_eq!(trainer.progressed().rays, 10 * pixels as u64, "{name}");
        assert!(trainer.pixels() <= pixels as u64);
    }
}

#[test]
fn a_perfect_picture_has_no_loss_and_needs_no_occupancy() {
    // Nothing to see, and a network that shows nothing: every PSNR is infinite, and no difference of two is NaN.
    let mut dataset = scene();
    dataset.train.iter_mut().chain(&mut dataset.val).for_each(|view| view.pixels.fill([0, 0, 0, 255]));
    dataset.background = Background::Constant([0; 3]);
    let mut config = tiny(10);
    config.sampling.scene_box = Some([-1.0, -1.0, -1.0, 1.0, 1.0, 1.0]);
    config.network.density_bias = -100.0;
    let outcome = fit(&dataset, &config).expect("a blob");
    assert_eq!(outcome.scores.psnr_db(), Some(f64::INFINITY));
    assert_eq!((outcome.occupancy_loss_db, outcome.quantisation_loss_db), (Some(0.0), Some(0.0)));
    assert!(!outcome.occupancy_required && !outcome.flat);
    let blob = Blob::open(&outcome.bytes).expect("a blob");
    // A blob holds no infinity.
    assert_eq!((blob.provenance().psnr_db, blob.provenance().quantisation_loss_db), (None, Some(0.0)));
}

#[test]
fn a_blank_view_does_not_hide_that_nothing_was_learned() {
    let mut dataset = scene();
    // After one step nothing is learned yet.
    assert!(fit(&dataset, &tiny(1)).expect("a blob").flat);
    dataset.val[0].pixels.fill([0; 4]);
    assert!(fit(&dataset, &tiny(1)).expect("a blob").flat);
    // On training views, where there are no others.
    dataset.val.clear();
    dataset.train[0].pixels.fill([0; 4]);
    let outcome = fit(&dataset, &tiny(1)).expect("a blob");
    assert!(outcome.flat && outcome.flat_psnr_db.is_finite());
}

#[test]
fn a_sweep_calls_flat_what_a_fit_calls_flat() {
    // Shows nothing, which is all there is to the first view: its PSNR is infinite, and so is the mean.
    let mut dataset = scene();
    dataset.val[0].pixels.fill([0; 4]);
    let mut unseen = tiny(2);
    unseen.network.density_bias = -100.0;
    // On training views, where there are no others.
    let mut without_val = dataset.clone();
    without_val.val.clear();
    for (name, dataset, config, flat) in [
        ("unseen", &dataset, unseen.clone(), true),
        ("unseen, no validation views", &without_val, unseen, true),
        ("learned", &dataset, tiny(300), false),
    ] {
        let fitted = fit(dataset, &config).expect("a blob");
        assert_eq!(fitted.flat, flat, "{name}: {:?}", fitted.scores.views);
        let job = Job::Scene { dataset, base: Box::new(config), seconds: None };
        let style = ProgressStyle::Quiet;
        let runner = Runner { kernel: Kernel::detect(), style, cpu: "test" };
        let (record, _) = job.run(&job.base_point(), &runner).expect("a run");
        assert_eq!(record.status == Status::Flat, flat, "{name}: {record:?}");
        assert_eq!(record.psnr_db, fitted.scores.psnr_db(), "{name}");
    }
}

#[test]
fn a_network_that_stays_dead_is_given_up_with_advice() {
    let mut config = tiny_seed(2000);
    config.network.density_bias = -100.0;
    (config.sampling.rays, config.sampling.samples) = (16, 4);
    let error = fit(&scene(), &config).expect_err("dead");
    assert!(matches!(error.downcast_ref(), Some(TrainError::Dead { .. })), "{error}");
    let error = error.to_string();
    assert!(
        error.contains("--set network.density=softplus") && !error.contains("nerf-train show"),
        "{error}"
    );
    // What is done already is no advice.
    let error = TrainError::Dead { restarts: 4, relu: false }.to_string();
    assert!(!error.contains("softplus") && error.contains("--rate"), "{error}");
}

#[test]
fn a_network_that_died_is_started_anew_and_still_reproducible() {
    // Without a bias, half of all starts have no density anywhere.
    let dataset = scene();
    let mut cured = 0;
    for seed in 0..12 {
        let mut config = Config { seed, ..tiny_seed(130) };
        config.network.density_bias = 0.0;
        (config.sampling.rays, config.sampling.samples) = (16, 4);
        let mut trainer = Trainer::new(&dataset, config.clone(), Kernel::detect()).expect("a trainer");
        let mut steps = 0;
        while trainer.progressed().step < config.optimiser.steps && steps < 1000 {
            let share = f64::from(trainer.progressed().step) / f64::from(config.optimiser.steps);
            match trainer.step(share) {
                Ok(()) => steps += 1,
                Err(error) => {
                    assert!(matches!(error, TrainError::Dead { .. }), "{error}");
                    break;
                }
            }
        }
        if trainer.progressed().step == config.optimiser.steps && trainer.progressed().reseeds > 0 {
            cured += 1;
            let outcomes = [0, 1].map(|_| fit(&dataset, &config).expect("a blob"));
            assert!(outcomes[0].bytes == outcomes[1].bytes);
            assert!(outcomes[0].reseeds > 0 && outcomes[0].reseeds == trainer.progressed().reseeds);
            break;
        }
    }
    assert!(cured > 0, "no seed among these was cured");
}

/// The run ends with a blob whose every view is finite, and which is said to be flat if it is, or with a message.
fn ends_well(dataset: &Dataset, config: &Config) -> Result<f64, String> {
    let outcome = fit(dataset, config).map_err(|error| error.to_string())?;
    for db in [outcome.occupancy_loss_db, outcome.quantisation_loss_db].into_iter().flatten() {
        assert!(!db.is_nan(), "{outcome:?}");
    }
    // What each view has, and what a flat colour would; views that are flat themselves do not count.
    let mut both = Vec::new();
    let flat_db = |truth: &[[f32; 3]]| {
        let mean: [f32; 3] = std::array::from_fn(|c| {
            (truth.iter().map(|p| f64::from(p[c])).sum::<f64>() / truth.len() as f64) as f32
        });
        psnr_db(&vec![mean; truth.len()], truth)
    };
    let blob = Blob::open(&outcome.bytes).expect("the trainer's own blob");
    let finite = |b: &[u8]| half::f16::from_le_bytes([b[0], b[1]]).is_finite();
    assert!(blob.weights().chunks_exact(2).all(finite));
    nerf_train::measure::eval::measure(
        &outcome.bytes,
        None,
        Kernel::detect(),
        &Default::default(),
        outcome.background,
        dataset.train.iter().chain(&dataset.val),
        |view, frame, truth, score| {
            both.push((score.psnr_db, flat_db(truth)));
            let numbers = frame.rgb.iter().flatten().chain(&frame.opacity).chain(&frame.z_depth);
            assert!(numbers.copied().all(f32::is_finite), "{}", view.name);
            assert_eq!(frame.counters.invalid_samples, 0);
        },
    )
    .expect("rendered");
    // On training views, where there are no others; but only on some of many.
    let judged = both.split_off(if dataset.val.is_empty() { 0 } else { dataset.train.len() });
    let counted: Vec<_> = judged.into_iter().filter(|(_, flat)| flat.is_finite()).collect();
    let flat = !counted.is_empty() && counted.iter().all(|(db, flat)| db <= flat);
    assert_eq!(outcome.flat, flat, "dB of each view, and of a flat colour: {counted:?}");
    Ok(outcome.scores.psnr_db().unwrap_or(f64::NAN))
}

#[test]
fn rates_far_too_high_end_in_a_message_or_a_finite_blob() {
    let dataset = scene();
    for rate in [0.1, 1.0, 10.0] {
        let sinusoidal = [Density::Relu, Density::Softplus];
        for (name, mut config, densities) in [
            ("small", tiny(90), &sinusoidal[..]),
            ("seed", tiny_seed(90), &sinusoidal),
            ("grid", tiny_grid(90), &[Density::Exponential]),
        ] {
            config.optimiser.rate = rate;
            config.optimiser.final_share = 1.0;
            for &density in densities {
                config.network.density = density;
                match ends_well(&dataset, &config) {
                    Ok(psnr) => println!("{name}, {rate}, {density:?}: {psnr:.2} dB"),
                    Err(message) => {
                        println!("{name}, {rate}, {density:?}: {message}");
                        let known = ["died", "diverged", "f16"].iter().any(|word| message.contains(word));
                        assert!(known, "{message}");
                    }
                }
            }
        }
    }
}

#[test]
fn strange_pictures_end_in_a_message_or_a_finite_blob() {
    let spec = |train, size| nerf_train::data::demo::DemoSpec { train, val: 1, size, ..Default::default() };
    let made = |train, size| nerf_train::data::demo::dataset(&spec(train, size)).expect("a scene");
    let painted = |pixel: [u8; 4], background| {
        let mut dataset = made(4, 12);
        for view in dataset.train.iter_mut().chain(&mut dataset.val) {
            view.pixels.fill(pixel);
        }
        dataset.background = background;
        dataset
    };
    let mut duplicates = made(4, 12);
    for i in 1..4 {
        duplicates.train[i] = duplicates.train[0].clone();
    }
    let mut contradictory = made(4, 12);
    for i in 1..4 {
        contradictory.train[i].camera = contradictory.train[0].camera;
    }
    let mut sizes = made(4, 12);
    sizes.train.extend(made(3, 7).train);
    sizes.val.extend(made(3, 1).val);
    let mut one = made(1, 12);
    one.val.clear();
    let cases = [
        ("one picture", one),
        ("pictures of one pixel", made(6, 1)),
        ("transparent", painted([0; 4], Background::Alpha)),
        ("transparent white", painted([255, 255, 255, 0], Background::Alpha)),
        ("opaque white all over", painted([255; 4], Background::Constant([255; 3]))),
        ("opaque grey, nothing known", painted([128, 128, 128, 255], Background::Unknown)),
        ("one pose many times", duplicates),
        ("one pose with other pictures", contradictory),
        ("many sizes", sizes),
    ];
    for (name, dataset) in cases {
        for (preset, mut config) in [("small", tiny(40)), ("grid", tiny_grid(40)), ("seed", tiny_seed(40))] {
            if dataset.background == Background::Unknown {
                config = config.without_hull();
            }
            match ends_well(&dataset, &config) {
                Ok(psnr) => println!("{name}, {preset}: {psnr:.2} dB"),
                Err(message) => {
                    println!("{name}, {preset}: {message}");
                    let known = ["died", "scene bounds"].iter().any(|word| message.contains(word));
                    assert!(known, "{name}, {preset}: {message}");
                }
            }
        }
    }
}

#[test]
fn poses_that_are_off_are_refined() {
    let spec = DemoSpec { train: 16, val: 4, size: 48, ..DemoSpec::default() };
    let truth = demo::dataset(&spec).expect("a scene");
    let mut dataset = truth.clone();
    for (i, view) in dataset.train.iter_mut().enumerate() {
        // By 3 degrees, some two pixels, each about an axis of its own.
        let axis = Vec3::new((i as f32).sin(), (2.7 * i as f32).cos(), (5.1 * i as f32).sin()).normalize();
        let pose = view.camera.pose();
        let rotation = Mat3::from_axis_angle(axis, 0.05) * pose.rotation;
        view.camera = view.camera.at(Pose { rotation, ..*pose }).expect("a camera");
    }
    let [given, refined] = [PoseRefinement::Given, PoseRefinement::Refine].map(|poses| {
        let mut config = tiny_posed(600, poses);
        // A camera moves by what a few hundred of its rays say: of 30, Adam would make steps of noise.
        (config.sampling.rays, config.sampling.live_samples) = (256, 2048);
        fit(&dataset, &config).expect("a blob")
    });
    assert!(given.refined_poses.is_none() && given.refined_scores.is_none());
    let db = |scores: &Scores| scores.psnr_db().expect("validation views");
    let (before, after) = (db(&given.scores), db(refined.refined_scores.as_ref().expect("refined poses")));
    println!("{before:.2} dB, refined {after:.2} dB");
    assert!(after > before + 1.0, "{before:.2} dB, refined {after:.2} dB");
    let poses = refined.refined_poses.expect("refined poses");
    let cameras = poses.cameras(Path::new("a.nerf"), &truth.train, truth.origin).expect("cameras");
    // Turning a camera and moving it can hardly be told apart here: what counts is where points of the scene are seen.
    let apart = |a: &Camera, b: &Camera| {
        let points = (0..8).map(|i| Vec3::new((i & 1) as f32, (i >> 1 & 1) as f32, (i >> 2) as f32) - 0.5);
        let project =
            |camera: &Camera, point| Vec2::from(camera.project(point).expect("in front of the camera"));
        points.map(|point| project(a, point).distance(project(b, point))).sum::<f32>() / 8.0
    };
    let mean = |cameras: &[Camera]| {
        let pairs = cameras.iter().zip(&truth.train);
        pairs.map(|(camera, view)| apart(camera, &view.camera)).sum::<f32>() / cameras.len() as f32
    };
    let found: Vec<Camera> = cameras.into_iter().map(|camera| camera.expect("refined")).collect();
    let given: Vec<Camera> = dataset.train.iter().map(|view| view.camera).collect();
    let (before, after) = (mean(&given), mean(&found));
    println!("{before:.2} pixels, refined {after:.2} pixels");
    assert!(after < 0.6 * before, "{before:.2} pixels, refined {after:.2} pixels");
}

#[test]
fn what_moved_is_left_out() {
    let spec = DemoSpec { train: 60, val: 6, size: 48, ..DemoSpec::default() };
    let mut dataset = demo::dataset(&spec).expect("a scene");
    let in_front = |i: usize, pixel: usize| {
        let (x, y) = (pixel % 48, pixel / 48);
        let (left, top) = (7 * i % 28, 11 * i % 24);
        i.is_multiple_of(3) && (left..left + 20).contains(&x) && (top..top + 24).contains(&y)
    };
    for view in dataset.train.iter_mut().chain(&mut dataset.val) {
        for pixel in &mut view.pixels {
            let [r, g, b] = over(*pixel, [0.5; 3]).map(|c| (255.0 * c + 0.5) as u8);
            *pixel = [r, g, b, 255];
        }
    }
    dataset.background = Background::Unknown;
    for (i, view) in dataset.train.iter_mut().enumerate() {
        let pixels = view.pixels.iter_mut().enumerate();
        pixels.filter(|&(pixel, _)| in_front(i, pixel)).for_each(|(_, rgba)| *rgba = [40, 220, 90, 255]);
    }
    let with = |moving| {
        let mut config = tiny_posed(1500, PoseRefinement::Given);
        config.network.grid.as_mut().expect("a grid").log2_entries = 13;
        config.sampling.live_samples = 2048;
        // With more, so few pixels' colours a ray tell every photograph by its direction, and nothing contradicts another.
        config.network.direction_levels = 2;
        // With decay the fit that keeps what moved gains 0.2 dB, and this law's question is the other fit's gain.
        config.optimiser.weight_decay = 0.0;
        config.capture.moving = moving;
        config
    };
    let db = |outcome: &Outcome| outcome.scores.psnr_db().expect("validation views");
    let [off, auto] =
        [MovingObjects::Off, MovingObjects::Auto].map(|moving| fit(&dataset, &with(moving)).expect("a blob"));
    println!("{:.2} dB, without what moved {:.2} dB", db(&off), db(&auto));
    assert!(off.moved.is_empty() && db(&auto) > db(&off) + 1.0, "{:.2} dB, {:.2} dB", db(&off), db(&auto));
    let right = auto.moved.iter().filter(|moved| moved.view.is_multiple_of(3)).count();
    assert!(right >= 12 && auto.moved.len() == right, "{right} of 20, {} in all", auto.moved.len());

    // The same bytes by one thread, and after a stop between decisions.
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a pool");
    let config = with(MovingObjects::Auto);
    assert!(pool.install(|| fit(&dataset, &config)).expect("a blob").bytes == auto.bytes);
    let folder = tempfile::tempdir().expect("a folder");
    let file = |resume| options(&config, Some(folder.path().join("a.checkpoint")), resume);
    run(&dataset, config.clone(), &file(false), &|step| step == 777).expect("a run");
    let Ended::Finished(resumed) = run(&dataset, config.clone(), &file(true), &|_| false).expect("a run")
    else {
        unreachable!("nobody stops it")
    };
    assert!(resumed.bytes == auto.bytes && resumed.moved == auto.moved);
}
