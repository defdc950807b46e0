//! The names and kinds of every command's JSON, which scripts rely on: `schema.txt`.
//!
//! `NERF_BLESS=schema cargo test --release -p nerf-train-tests --test cli schema` renews the list. Notes of numbers that JSON cannot
//! hold come and go with the numbers and are not in it.

use crate::made::Folder;
use crate::program::trainer;
use crate::{blob, fit_grid, ok, write_picture};
use serde_json::Value;
use std::collections::BTreeMap;

/// What a run may leave out or write as null is told apart from numbers by nobody: it goes by its other kind.
fn kinds(value: &Value, name: &str, found: &mut BTreeMap<String, &'static str>) {
    let kind = match value {
        Value::Null => "null",
        Value::Bool(_) => "flag",
        Value::Number(_) => "number",
        Value::String(_) => "text",
        Value::Array(values) => {
            values.iter().for_each(|value| kinds(value, &format!("{name}[]"), found));
            "list"
        }
        Value::Object(entries) => {
            for (key, value) in entries.iter().filter(|(key, _)| !key.ends_with("_note")) {
                kinds(value, format!("{name}.{key}").trim_start_matches('.'), found);
            }
            "object"
        }
    };
    let known = found.entry(name.to_owned()).or_insert(kind);
    if *known == "null" {
        *known = kind;
    }
}

/// The JSON that a command prints, as lines of its name, those of its fields, and their kinds.
fn lines(name: &str, args: &[&str]) -> Vec<String> {
    let text = ok(args.iter().copied().filter(|arg| *arg != "-q").chain(["--json", "--quiet"]));
    let mut found = BTreeMap::new();
    kinds(&serde_json::from_str(&text).expect("JSON"), "", &mut found);
    found.remove("");
    found.into_iter().map(|(field, kind)| format!("{name}: {field} {kind}")).collect()
}

#[test]
fn every_commands_json_keeps_its_names_and_kinds() {
    let (made, small) = blob();
    let (data, folder) = (made.path("scene.npz"), Folder::new());
    let path = |name: &str| folder.path(name);
    let grid = path("grid.nerf");
    ok(fit_grid(&data, &grid, &["--steps", "30"]));
    let photo = path("photo.png");
    write_picture(
        image::RgbImage::from_fn(24, 16, |x, y| image::Rgb([x as u8 * 9, y as u8 * 15, 90])),
        &photo,
    );
    let field = path("field.nerf");
    let image_fit = ["image", "fit", &photo, "-o", &field, "--steps", "20", "--pixels", "64"];
    let study = ["--repeats", "1", "--timing-views", "1", "--views", "1", "--no-other-occupancy"];
    let front = path("front.nerf");
    let mut all = Vec::new();
    let mut add = |name, args: &[&str]| all.extend(lines(name, args));
    add(
        "fit small",
        &["fit", &data, "-o", &path("a.nerf"), "--preset", "small", "--steps", "20", "--width", "16"],
    );
    add("fit grid", &fit_grid(&data, &path("b.nerf"), &["--steps", "20"]));
    add("eval", &["eval", small, &data, "--lattice", "2"]);
    add(
        "render",
        &["render", small, "-o", &path("o.gif"), "--orbit", "2", "--width", "8", "--outputs", "all"],
    );
    add("inspect small", &["inspect", small]);
    add("inspect grid", &["inspect", &grid]);
    add("explain", &["explain", small]);
    add("audit", &["audit", small, &data, "--repeats", "1"]);
    add("study", &[&["study", small, &data, "-o", &front], &study[..]].concat());
    add("inspect with a front", &["inspect", &front]);
    add("sweep scene", &["sweep", "scene", &data, "-o", &path("s"), "--steps", "5", "--width", "8"]);
    add("sweep image", &["sweep", "image", &photo, "-o", &path("i"), "--steps", "5", "--table", "8"]);
    add("image fit", &image_fit);
    add("image render", &["image", "render", &field, "-o", &path("f.png")]);
    add("inspect field", &["inspect", &field]);
    let mesh = ["export", small, "-o", &path("m.ply"), "--resolution", "16", "--threshold", "1e-3"];
    add("export mesh", &mesh);
    add("export volume", &["export", small, "-o", &path("v.npz"), "--resolution", "16"]);
    add("show", &["show", &data, "-o", &path("show")]);
    add("check", &["check", &data, "-o", &path("check")]);
    add("completions", &["completions", "bash"]);

    let file = trainer().join("tests/cli/schema.txt");
    let found = all.join("\n") + "\n";
    if std::env::var_os("NERF_BLESS").is_some_and(|bless| bless == "schema") {
        std::fs::write(&file, &found).expect("written");
    }
    let committed = std::fs::read_to_string(&file).expect("schema.txt");
    let of = |text: &str| -> BTreeMap<String, String> {
        let fields = text.lines().filter_map(|line| line.rsplit_once(' '));
        fields.map(|(field, kind)| (field.to_owned(), kind.to_owned())).collect()
    };
    let (committed, found) = (of(&committed), of(&found));
    let differs = |(field, kind): (&String, &String)| {
        let now = found.get(field)?;
        (now != kind && now != "null" && kind != "null").then(|| format!("{field}: {kind}, now {now}"))
    };
    let changed: Vec<String> = committed.iter().filter_map(differs).collect();
    let gone: Vec<&String> = committed.keys().filter(|field| !found.contains_key(*field)).collect();
    let new: Vec<&String> = found.keys().filter(|field| !committed.contains_key(*field)).collect();
    assert!(
        changed.is_empty() && gone.is_empty() && new.is_empty(),
        "changed {changed:?}, gone {gone:?}, new {new:?}"
    );
}
