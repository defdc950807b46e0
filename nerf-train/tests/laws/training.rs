//! Same seed, same blob; damage and dead ends are reported.

use crate::{fit, options, scene, tiny, tiny_seed};
use nerf_core::blob::Blob;
use nerf_core::kernels::Tier;
use nerf_train::config::{Config, Density, Jitter};
use nerf_train::dataset::{Background, Dataset};
use nerf_train::train::checkpoint::Checkpoint;
use nerf_train::train::run::{Ended, RunError, run};
use nerf_train::train::{TrainError, Trainer};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// A name, and something done to a value.
type Change<T> = (&'static str, fn(&mut T));

/// Both presets, small; and the seed preset's published variants.
fn variants(steps: u32) -> Vec<(&'static str, Config)> {
    let with = |change: fn(&mut Config)| {
        let mut config = tiny_seed(steps);
        change(&mut config);
        config
    };
    vec![
        ("fast", tiny(steps)),
        ("fast without hull", tiny(steps).without_hull()),
        ("seed", tiny_seed(steps)),
        ("seed, 32 samples", with(|c| c.sampling.samples = 32)),
        ("seed, jitter 0.02", with(|c| c.sampling.jitter = Jitter::Width(0.02))),
        ("seed, rays by image", with(|c| (c.sampling.images, c.sampling.rays) = (5, 100))),
        ("seed, rate 1e-3", with(|c| c.optimiser.rate = 1e-3)),
    ]
}

fn resume(dataset: &Dataset, config: &Config, checkpoint: &Path) -> Result<Ended, RunError> {
    run(dataset, config.clone(), &options(config, Some(checkpoint.into()), true), &|_| false)
}

fn bytes_of(ended: Ended) -> Vec<u8> {
    match ended {
        Ended::Finished(outcome) => outcome.bytes,
        Ended::Interrupted { step, .. } => panic!("interrupted after step {step}"),
    }
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
fn variants_and_seeds_differ_from_each_other() {
    let dataset = scene();
    let mut configs: Vec<Config> = variants(5).into_iter().map(|(_, config)| config).collect();
    configs.push(Config { seed: 1, ..tiny(5) });
    let mut blobs: Vec<Vec<u8>> = configs.iter().map(|c| fit(&dataset, c).expect("a blob").bytes).collect();
    let count = blobs.len();
    blobs.sort();
    blobs.dedup();
    assert_eq!(blobs.len(), count, "a setting without effect");
}

#[test]
fn a_run_resumed_at_any_step_gives_the_undisturbed_blob() {
    let (dataset, folder) = (scene(), tempfile::tempdir().expect("a folder"));
    for (name, config) in [("fast", tiny(24)), ("seed", tiny_seed(24))] {
        let expected = fit(&dataset, &config).expect("a blob");
        let path = folder.path().join(name);
        for stop_after in [0, 1, 7, 8, 20, 23] {
            let options = options(&config, Some(path.clone()), false);
            let stopped = run(&dataset, config.clone(), &options, &|step| step == stop_after).expect("a run");
            assert!(matches!(stopped, Ended::Interrupted { step, .. } if step == stop_after));
            let resumed = bytes_of(resume(&dataset, &config, &path).expect("a run"));
            assert!(resumed == expected.bytes, "{name}, stopped after step {stop_after}");
        }
        // A run that has ended is taken up too.
        let again = bytes_of(resume(&dataset, &config, &path).expect("a run"));
        assert!(again == expected.bytes, "{name}, ended");
    }
}

#[test]
fn interruptions_at_any_moment_change_no_byte() {
    let (dataset, folder) = (scene(), tempfile::tempdir().expect("a folder"));
    let (config, path) = (tiny(300), folder.path().join("checkpoint"));
    let expected = fit(&dataset, &config).expect("a blob").bytes;
    let mut interruptions = 0;
    let found = loop {
        let (stop, first) = (AtomicBool::new(interruptions == 0), interruptions == 0);
        let options = options(&config, Some(path.clone()), !first);
        let ended = std::thread::scope(|scope| {
            scope.spawn(|| {
                std::thread::sleep(Duration::from_millis(17 * (1 + interruptions)));
                stop.store(true, Ordering::Relaxed);
            });
            run(&dataset, config.clone(), &options, &|_| stop.load(Ordering::Relaxed)).expect("a run")
        });
        match ended {
            Ended::Finished(outcome) => break outcome.bytes,
            Ended::Interrupted { checkpoint, .. } => assert_eq!(checkpoint.as_deref(), Some(path.as_path())),
        }
        interruptions += 1;
    };
    assert!(interruptions > 0 && found == expected, "after {interruptions} interruptions");
}

#[test]
fn resuming_with_other_settings_is_refused_and_keeps_the_checkpoint() {
    let (dataset, folder) = (scene(), tempfile::tempdir().expect("a folder"));
    let path = folder.path().join("checkpoint");
    // A seed beyond i64 is one that TOML cannot write.
    for seed in [0, u64::MAX] {
        let config = Config { seed, ..tiny(10) };
        let trainer = Trainer::new(&dataset, config.clone(), Tier::detect()).expect("a trainer");
        trainer.checkpoint(1.0).write(&path).expect("a checkpoint");
        let before = std::fs::read(&path).expect("a checkpoint");
        let cases: [Change<Config>; 6] = [
            ("network.width", |c| c.network.width = 17),
            ("optimiser.rate", |c| c.optimiser.rate = 0.5),
            ("seed", |c| c.seed ^= 1),
            ("sampling.near", |c| c.sampling.near = Some(1.0)),
            ("sampling.scene_box", |c| c.sampling.scene_box = Some([-1.0, -1.0, -1.0, 1.0, 1.0, 1.0])),
            ("sampling.jitter", |c| c.sampling.jitter = Jitter::None),
        ];
        for (field, change) in cases {
            let mut other = config.clone();
            change(&mut other);
            if other == config {
                continue;
            }
            let error = resume(&dataset, &other, &path).expect_err(field).to_string();
            assert!(error.contains(field) && error.contains("checkpoint"), "{field}: {error}");
        }
        assert!(std::fs::read(&path).expect("a checkpoint") == before);
        // More steps are no other run.
        assert!(resume(&dataset, &Config { optimiser: tiny(12).optimiser, ..config }, &path).is_ok());
    }
}

#[test]
fn resuming_with_other_data_is_refused_even_under_the_same_name() {
    let (dataset, folder) = (scene(), tempfile::tempdir().expect("a folder"));
    let (config, path) = (tiny(10), folder.path().join("checkpoint"));
    let trainer = Trainer::new(&dataset, config.clone(), Tier::detect()).expect("a trainer");
    trainer.checkpoint(0.0).write(&path).expect("a checkpoint");
    let changes: [Change<Dataset>; 5] = [
        // The scene box is found from all cameras.
        ("no validation views", |d| d.val.clear()),
        ("a pixel", |d| d.train[2].pixels[300] = [1, 2, 3, 255]),
        ("a view less", |d| d.train.truncate(5)),
        ("another camera", |d| d.train[0].camera = d.val[0].camera),
        ("another name", |d| d.name = "other".into()),
    ];
    for (what, change) in changes {
        let mut other = dataset.clone();
        change(&mut other);
        let error = resume(&other, &config, &path).expect_err(what).to_string();
        assert!(error.contains("data"), "{what}: {error}");
    }
    // Pictures of validation views are only looked at.
    let mut watched = dataset.clone();
    watched.val[0].pixels.fill([0; 4]);
    assert!(resume(&watched, &config, &path).is_ok());
}

#[test]
fn every_damage_to_a_checkpoint_is_an_error_naming_the_file() {
    let (dataset, folder) = (scene(), tempfile::tempdir().expect("a folder"));
    let (config, path) = (tiny(10), folder.path().join("lego.checkpoint"));
    let trainer = Trainer::new(&dataset, config.clone(), Tier::detect()).expect("a trainer");
    trainer.checkpoint(0.0).write(&path).expect("a checkpoint");
    let whole = std::fs::read(&path).expect("a checkpoint");
    let mut damaged: Vec<Vec<u8>> = [0, 1, 7, 8, 11, 12, 13, whole.len() / 2, whole.len() - 1]
        .into_iter()
        .map(|length| whole[..length].to_vec())
        .collect();
    for place in (0..whole.len()).step_by(whole.len() / 200) {
        let mut flipped = whole.clone();
        flipped[place] ^= 1 << (place % 8);
        damaged.push(flipped);
    }
    damaged.push([&whole[..], &[0]].concat());
    for bytes in damaged {
        std::fs::write(&path, &bytes).expect("written");
        let error = Checkpoint::read(&path).expect_err("damage").to_string();
        assert!(error.contains("lego.checkpoint"), "{error}");
    }
    std::fs::remove_file(&path).expect("removed");
    let error = resume(&dataset, &config, &path).expect_err("nothing there").to_string();
    assert!(error.contains("lego.checkpoint"), "{error}");
}

#[test]
fn a_network_that_stays_dead_is_given_up_with_advice() {
    let mut config = tiny_seed(2000);
    config.network.density_bias = -100.0;
    (config.sampling.rays, config.sampling.samples) = (16, 4);
    let error = fit(&scene(), &config).expect_err("dead");
    assert!(matches!(error, RunError::Train(TrainError::Dead { .. })), "{error}");
    let error = error.to_string();
    assert!(error.contains("--density softplus") && !error.contains("nerf-train show"), "{error}");
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
        let mut trainer = Trainer::new(&dataset, config.clone(), Tier::detect()).expect("a trainer");
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
            let blobs = [0, 1].map(|_| fit(&dataset, &config).expect("a blob").bytes);
            assert!(blobs[0] == blobs[1]);
            break;
        }
    }
    assert!(cured > 0, "no seed among these was cured");
}

/// The run ends with a blob whose every view is finite, or with a message.
fn ends_well(dataset: &Dataset, config: &Config) -> Result<f64, String> {
    let outcome = fit(dataset, config).map_err(|error| error.to_string())?;
    let blob = Blob::open(&outcome.bytes).expect("the trainer's own blob");
    let finite = |b: &[u8]| half::f16::from_le_bytes([b[0], b[1]]).is_finite();
    assert!(blob.weights().chunks_exact(2).all(finite));
    nerf_train::eval::measure(
        &outcome.bytes,
        None,
        Tier::detect(),
        &Default::default(),
        [0.0; 3],
        dataset.train.iter().chain(&dataset.val),
        |view, frame, _, _| {
            let numbers = frame.rgb.iter().flatten().chain(&frame.opacity).chain(&frame.z_depth);
            assert!(numbers.copied().all(f32::is_finite), "{}", view.name);
            assert_eq!(frame.counters.invalid_samples, 0);
        },
    )
    .expect("rendered");
    Ok(outcome.scores.psnr_db().unwrap_or(f64::NAN))
}

#[test]
fn rates_far_too_high_end_in_a_message_or_a_finite_blob() {
    let dataset = scene();
    for rate in [0.1, 1.0, 10.0] {
        for (name, mut config) in [("fast", tiny(150)), ("seed", tiny_seed(150))] {
            config.optimiser.rate = rate;
            config.optimiser.final_share = 1.0;
            for density in [Density::Relu, Density::Softplus] {
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
    let spec = |train, size| nerf_train::demo_scene::DemoSpec { train, val: 1, size, ..Default::default() };
    let made = |train, size| nerf_train::demo_scene::dataset(&spec(train, size)).expect("a scene");
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
        ("many sizes", sizes),
    ];
    for (name, dataset) in cases {
        for (preset, mut config) in [("fast", tiny(40)), ("seed", tiny_seed(40))] {
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
