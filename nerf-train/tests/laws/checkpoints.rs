//! Runs that are interrupted and taken up again; checkpoints that are damaged or another run's.

use crate::{by_tape, fit, options, scene, tiny, tiny_grid, tiny_posed, tiny_seed, tiny_unbounded};
use nerf_core::Kernel;
use nerf_train::data::Dataset;
use nerf_train::fit::finish::Outcome;
use nerf_train::fit::run::Ended;
use nerf_train::fit::run::run;
use nerf_train::model::config::Config;
use nerf_train::model::config::Jitter;
use nerf_train::model::config::PoseRefinement;
use nerf_train::model::engine::EngineKind;
use nerf_train::train::Trainer;
use nerf_train::train::average::Average;
use nerf_train::train::checkpoint::Checkpoint;
use nerf_train::train::occupancy::Occupancy;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// A name, and something done to a value.
type Change<T> = (&'static str, fn(&mut T));

fn resume(dataset: &Dataset, config: &Config, checkpoint: &Path) -> anyhow::Result<Ended<Outcome>> {
    run(dataset, config.clone(), &options(config, Some(checkpoint.into()), true), &|_| false)
}

fn bytes_of(ended: Ended<Outcome>) -> Vec<u8> {
    match ended {
        Ended::Finished(outcome) => outcome.bytes,
        Ended::Interrupted { step, .. } => panic!("interrupted after step {step}"),
    }
}

#[test]
fn a_run_resumed_at_any_step_gives_the_undisturbed_blob() {
    let (dataset, folder) = (scene(), tempfile::tempdir().expect("a folder"));
    for (name, config) in [
        ("small", tiny(24)),
        ("grid", tiny_grid(24)),
        ("unbounded", tiny_unbounded(24)),
        ("unbounded, poses refined", tiny_posed(24, PoseRefinement::Refine)),
        ("seed", tiny_seed(24)),
        ("small by the tape", by_tape(tiny(24))),
        ("grid by the tape", by_tape(tiny_grid(24))),
        ("unbounded by the tape", by_tape(tiny_unbounded(24))),
    ] {
        let expected = fit(&dataset, &config).expect("a blob");
        let path = folder.path().join(name);
        let tape: &[u32] = &[7, 20];
        let moments = if config.engine == EngineKind::Dfdx { tape } else { &[0, 1, 7, 8, 20, 23] };
        for &stop_after in moments {
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
        let trainer = Trainer::new(&dataset, config.clone(), Kernel::detect()).expect("a trainer");
        trainer.checkpoint(1.0).write(&path).expect("a checkpoint");
        let before = std::fs::read(&path).expect("a checkpoint");
        let cases: [Change<Config>; 7] = [
            ("engine", |c| c.engine = EngineKind::Dfdx),
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
    // A grid's own settings; and a grid where there was none.
    let config = tiny_grid(10);
    let trainer = Trainer::new(&dataset, config.clone(), Kernel::detect()).expect("a trainer");
    trainer.checkpoint(1.0).write(&path).expect("a checkpoint");
    let cases: [Change<Config>; 5] = [
        ("network.grid.log2_entries", |c| c.network.grid.as_mut().expect("a grid").log2_entries = 11),
        ("network.grid.finest", |c| c.network.grid.as_mut().expect("a grid").finest = 65),
        ("sampling.steps_across", |c| c.sampling.steps_across = 49),
        ("occupancy.cells", |c| c.occupancy.cells = 2049),
        ("preset", |c| *c = tiny(10)),
    ];
    for (field, change) in cases {
        let mut other = config.clone();
        change(&mut other);
        let error = resume(&dataset, &other, &path).expect_err(field).to_string();
        let named = error.contains(field) || field == "preset" && error.contains("network.");
        assert!(named && error.contains("checkpoint"), "{field}: {error}");
    }
    assert!(resume(&dataset, &Config { optimiser: tiny_grid(12).optimiser, ..config }, &path).is_ok());
}

#[test]
fn resuming_with_other_data_is_refused_even_under_the_same_name() {
    let (dataset, folder) = (scene(), tempfile::tempdir().expect("a folder"));
    let (config, path) = (tiny(10), folder.path().join("checkpoint"));
    let trainer = Trainer::new(&dataset, config.clone(), Kernel::detect()).expect("a trainer");
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
    let trainer = Trainer::new(&dataset, config.clone(), Kernel::detect()).expect("a trainer");
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

/// A checkpoint with something wrong in it, under a checksum that is right.
fn wrong_checkpoints(whole: &Checkpoint) -> Vec<(&'static str, Checkpoint)> {
    let mut wrong = Vec::new();
    let mut with = |part, change: &dyn Fn(&mut Checkpoint)| {
        let mut checkpoint = whole.clone();
        change(&mut checkpoint);
        wrong.push((part, checkpoint));
    };
    with("parameters", &|c| _ = c.optimiser.parameters.pop());
    with("parameters", &|c| c.optimiser.parameters[7] = f32::NAN);
    with("moment1", &|c| c.optimiser.moment1[0] = f32::INFINITY);
    with("moment2", &|c| c.optimiser.moment2[3] = -1.0);
    with("counters", &|c| c.state.progressed.step += 1);
    with("counters", &|c| c.state.progressed.rays = u64::MAX);
    with("counters", &|c| c.state.progressed.reseeds = u32::MAX);
    with("counters", &|c| (c.state.progressed.step, c.optimiser.steps) = (u32::MAX, u64::MAX));
    with("averaged parameters", &|c| c.state.average = Average::new(0.98, 1, 3));
    with("averaged parameters", &|c| c.state.average = Average::new(0.0, 1, 0));
    with("occupancy cells", &|c| c.state.occupancy = None);
    let finer = |c: &Checkpoint| {
        let bounds = c.state.occupancy.clone().expect("an occupancy grid").into_live().bounds();
        Occupancy::full(bounds, 13)
    };
    with("occupancy cells", &|c| c.state.occupancy = Some(finer(c)));
    with("points of the curve", &|c| c.state.curve.reverse());
    with("points of the curve", &|c| c.state.curve.iter_mut().for_each(|point| point.step += 1000));
    wrong
}

#[test]
fn a_checkpoint_whose_parts_do_not_belong_together_is_refused_naming_the_part() {
    let (dataset, folder) = (scene(), tempfile::tempdir().expect("a folder"));
    let (config, path) = (tiny(40), folder.path().join("lego.checkpoint"));
    run(&dataset, config.clone(), &options(&config, Some(path.clone()), false), &|step| step == 30)
        .expect("a run");
    let whole = Checkpoint::read(&path).expect("whole");
    for (part, wrong) in wrong_checkpoints(&whole) {
        wrong.write(&path).expect("written");
        let before = std::fs::read(&path).expect("written");
        let error = resume(&dataset, &config, &path).expect_err(part).to_string();
        assert!(error.contains("lego.checkpoint") && error.contains(part), "{part}: {error}");
        assert!(std::fs::read(&path).expect("left") == before);
    }
    whole.write(&path).expect("written");
    assert!(
        bytes_of(resume(&dataset, &config, &path).expect("a run"))
            == fit(&dataset, &config).expect("a blob").bytes
    );
}
