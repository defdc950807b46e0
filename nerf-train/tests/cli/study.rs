//! `study` and `audit`: what accuracy costs, and what effects are worth, through the command line.

use crate::made::names;
use crate::{blob, fails, json, ok};
use nerf_core::blob::Blob;
use nerf_core::plan::Quality;
use std::path::Path;

/// A study of few frames.
const SMALL: [&str; 6] = ["--repeats", "2", "--timing-views", "1", "--no-other-occupancy", "--quiet"];

#[test]
fn a_study_reports_its_points_and_writes_a_front() {
    let (folder, file) = blob();
    let (data, report, output) =
        (folder.path("scene.npz"), folder.path("study"), folder.path("scene_front.nerf"));
    let before = std::fs::read(file).expect("a blob");
    let args = ["study", file, &data, "--report", &report, "-o", &output];
    let text = ok(args.into_iter().chain(SMALL));
    assert!(crate::has(&text, "blob", &output) && text.contains("\nblob_front\n"), "{text}");
    let all = [
        "difference_dearest_exact.png",
        "ends.png",
        "front.png",
        "front.svg",
        "points.csv",
        "report.md",
        "summary.json",
    ];
    let there = names(Path::new(&report));
    for name in all {
        assert!(there.contains(&name.to_owned()), "{name} in {there:?}");
    }
    let summary = json(Path::new(&report).join("summary.json"));
    assert!(summary["points"].as_u64().is_some_and(|n| n > 20), "{summary}");
    // Another kernel, and the rounding of sums in another order; nothing else.
    assert!(summary["oracle_max_error"].as_f64().is_some_and(|max| max < 1e-4), "{summary}");
    assert_eq!(summary["views"].as_u64(), Some(2));

    let table = std::fs::read_to_string(Path::new(&report).join("points.csv")).expect("a table");
    let mut rows = csv::Reader::from_reader(table.as_bytes());
    let head = rows.headers().expect("a head").clone();
    let rows: Vec<csv::StringRecord> = rows.records().map(|row| row.expect("a row")).collect();
    let place = |name: &str| head.iter().position(|column| column == name).expect("a column");
    let number = |row: &csv::StringRecord, name: &str| row[place(name)].parse::<f64>().expect("a number");
    let exact = &rows[0];
    assert_eq!((number(exact, "loss_db"), number(exact, "relative_macs")), (0.0, 1.0));
    assert_eq!(number(exact, "max_error_to_exact"), 0.0);
    for row in &rows {
        assert!(number(row, "macs") > 0.0 && number(row, "wall_s_median") > 0.0, "{row:?}");
        assert!(number(row, "wall_s_low") <= number(row, "wall_s_median"), "{row:?}");
    }
    // Every knob that has other values here has its rows.
    for knob in ["samples", "transmittance cut", "colour cut", "maths", "kernel", "size"] {
        assert!(rows.iter().any(|row| &row[0] == knob), "{knob}");
    }
    // What each maths backend costs, and takes, is a row.
    for math in ["libm", "micromath", "recurrence"] {
        let row = rows.iter().find(|row| row[place("label")] == *format!("maths {math}")).expect(math);
        assert!(number(row, "max_error_to_exact") > 0.0, "{row:?}");
    }
    // For the others the report says why they have none.
    let words = std::fs::read_to_string(Path::new(&report).join("report.md")).expect("a report");
    assert!(words.contains("One knob: weights") && words.contains("--source names their file"), "{words}");
    // Whatever does less shows in the counters: half the samples are about half the work.
    let half = rows.iter().find(|row| &row[place("label")] == "samples 8").expect("a row");
    let base = &rows[1];
    assert!((number(half, "macs") / number(base, "macs") - 0.5).abs() < 0.1);

    // The blob is the same but for its front.
    let (old, bytes) = (Blob::open(&before).expect("a blob"), std::fs::read(&output).expect("a blob"));
    let new = Blob::open(&bytes).expect("a blob");
    assert!(old.front().is_empty() && !new.front().is_empty());
    assert_eq!((old.weights(), old.provenance()), (new.weights(), new.provenance()));
    assert_eq!(std::fs::read(file).expect("a blob"), before, "without --write the blob stays");
    let cheapest = new.front().last().expect("a point");
    assert!(new.front().iter().all(|point| point.cost <= 1.0 && point.cost >= cheapest.cost));
    let choice = Quality::within_loss(&new, 100.0).expect("a choice");
    assert_eq!((choice.cost, choice.loss_db), (cheapest.cost, cheapest.loss_db));

    // The same again: the same bytes, whatever the clock said.
    let again = folder.path("again.nerf");
    ok(["study", file, &data, "-o", &again].into_iter().chain(SMALL));
    assert_eq!(std::fs::read(&again).expect("a blob"), bytes);
}

#[test]
fn an_audit_says_what_each_effect_is_worth() {
    let (folder, file) = blob();
    let (data, report) = (folder.path("scene.npz"), folder.path("audit"));
    let args = ["audit", file, &data, "--repeats", "1", "--quiet"];
    let text = ok(args.into_iter().chain(["--report", &report]));
    for word in ["view dependence", "occupancy", "background", "gain_db"] {
        assert!(text.contains(word), "expected `{word}` in: {text}");
    }
    assert!(crate::has(&text, "views", "2"), "{text}");
    let effects = json(Path::new(&report).join("summary.json"))["effects"].clone();
    let effect = |name: &str| {
        let all = effects.as_array().expect("a list");
        all.iter().find(|effect| effect["effect"] == name).expect("an effect").clone()
    };
    let direction = effect("view dependence");
    let share = direction["relative_macs"].as_f64().expect("a number");
    assert!(share > 1.0 && share < 1.5, "{direction}");
    assert!(effect("occupancy")["relative_macs"].as_f64().is_none_or(|share| share < 1.0));
    // By a threshold that nothing reaches, and by one that everything does.
    let kept = |threshold: &str| {
        let text = ok(args.into_iter().chain(["--json", "--effect-threshold", threshold]));
        let object: serde_json::Value = serde_json::from_str(&text).expect("an object");
        object["effects"][0]["kept"].as_bool().expect("a verdict")
    };
    assert!(!kept("1000") && kept("-1000"));
}

#[test]
fn what_does_not_earn_its_cost_is_left_out_and_said_to_be() {
    let (folder, file) = blob();
    let (data, output) = (folder.path("scene.npz"), folder.path("flat.nerf"));
    let with = std::fs::read(file).expect("a blob");
    let with = Blob::open(&with).expect("a blob");
    assert!(with.architecture().direction.is_some());
    let report = folder.path("flat");
    let more = ["--steps", "30", "--effect-threshold", "1000", "--report", &report];
    let args = crate::fit(&data, &output, &more);
    // The last of a flag that comes twice would be refused: only the own threshold.
    let args = [&args[..5], &args[7..]].concat();
    let text = ok(args);
    assert!(crate::has(&text, "view_dependence_left_out", "yes"), "{text}");
    let flat = std::fs::read(&output).expect("a blob");
    let flat = Blob::open(&flat).expect("a blob");
    assert_eq!(flat.architecture().direction, None);
    let rows = |blob: &Blob<'_>| blob.layers().iter().map(|layer| layer.outputs).collect::<Vec<_>>();
    assert_eq!(rows(&flat), rows(&with));
    let summary = json(Path::new(&report).join("summary.json"));
    assert_eq!(summary["view_dependence_left_out"].as_bool(), Some(true));
    // The same trunk: nothing else was left out.
    let trunk = 2 * flat.architecture().density_parameters();
    assert_eq!(flat.weights()[..trunk], with.weights()[..trunk]);
    let text = ok(["audit", &output, &data, "--repeats", "1", "--quiet"]);
    assert!(text.contains("colour does not depend on direction"), "{text}");
}

#[test]
fn what_cannot_be_studied_is_said() {
    let (folder, file) = blob();
    let data = folder.path("scene.npz");
    for (flags, word) in [
        (["--views", "0"], "--views"),
        (["--repeats", "0"], "--repeats"),
        (["--minutes", "nan"], "--minutes"),
        (["--split", "test"], "no views"),
        (["--source", "nowhere.npz"], "nowhere.npz"),
        (["--kernel", "portable"], "--kernel"),
    ] {
        fails(["study", file, &data, "--quiet"].into_iter().chain(flags), &[word]);
    }
    fails(["study", file], &["DATA"]);
    fails(["audit", file, &data, "--effect-threshold", "nan"], &["--effect-threshold"]);
    fails(["audit", file, &data, "--views", "0"], &["--views"]);
    fails(["audit", file, &data, "--repeats", "18446744073709551615"], &["--repeats", "at most"]);
}
