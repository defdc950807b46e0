//! `--json`: one object on stdout, one event a line on stderr.

use crate::{blob, ran, run};
use serde_json::Value;

/// The object on stdout, which holds nothing else, and the events on stderr.
fn object_and_events(args: &[&str]) -> (Value, Vec<Value>) {
    let ran = run([args, &["--json"]].concat());
    assert_eq!(ran.code, Some(0), "{args:?}: {}", ran.err);
    let object = serde_json::from_str(&ran.out).unwrap_or_else(|error| panic!("{error}: {}", ran.out));
    let event = |line| serde_json::from_str(line).unwrap_or_else(|error| panic!("{error}: {line}"));
    (object, ran.err.lines().map(event).collect())
}

#[test]
fn results_are_one_object_on_stdout() {
    let (folder, file) = blob();
    let data = folder.path("scene.npz");
    let (object, events) = object_and_events(&["inspect", file]);
    assert_eq!((object["steps"].as_u64(), object["kind"].as_str()), (Some(30), Some("scene")));
    assert!(object["layers"].as_array().is_some_and(|layers| layers.len() > 3) && events.is_empty());

    let (object, events) = object_and_events(&["eval", file, &data]);
    assert!(object["val_psnr_db"].as_f64().is_some_and(f64::is_finite), "{object}");
    assert_eq!(object["view_scores"].as_array().map(Vec::len), Some(2));
    let progress = events.iter().find(|event| event["event"] == "progress").expect("a first line");
    assert_eq!((progress["what"].as_str(), progress["total"].as_u64()), (Some("eval"), Some(2)));
    assert!(progress["elapsed_s"].is_number());
    assert!(events.iter().any(|event| event["event"] == "done"));

    let still = folder.path("json.png");
    let (object, _) = object_and_events(&["render", file, "-o", &still, "--width", "8"]);
    assert_eq!(object["files"], serde_json::json!([still]));
}

#[test]
fn quiet_json_says_nothing_on_stderr() {
    let (folder, file) = blob();
    let ran = run(["eval", file, &folder.path("scene.npz"), "--json", "--quiet"]);
    assert!(ran.err.is_empty() && serde_json::from_str::<Value>(&ran.out).is_ok(), "{}", ran.err);
}

#[test]
fn errors_are_an_object_on_stdout_and_text_on_stderr() {
    let cases: [(&[&str], i32, &str); 3] = [
        (&["--json", "inspect", "nowhere.nerf"], 1, "cannot read nowhere.nerf"),
        (&["inspect", "--json"], 2, "FILE"),
        (&["render", "a.nerf", "--json", "-o", "a.png", "--orbit", "many"], 2, "--orbit"),
    ];
    for (args, status, word) in cases {
        let ran = ran(&mut crate::command(args));
        assert_eq!(ran.code, Some(status), "{args:?}");
        let object: Value = serde_json::from_str(&ran.out).expect("an object");
        let error = object["error"].as_str().expect("a text");
        assert!(error.contains(word) && !error.contains("error:"), "{args:?}: {error}");
        assert!(ran.err.starts_with("error: ") && ran.err.contains(word), "{}", ran.err);
    }
    let help = run(["render", "--help", "--json"]);
    assert!(help.code == Some(0) && help.out.contains("--orbit"), "{}", help.out);
}
