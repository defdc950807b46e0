//! `export`: meshes, points and volumes of a fitted scene, and what is refused.

use crate::made::Folder;
use crate::tools::all_here;
use crate::{blob, fails, fit_grid, ok};
use std::path::Path;
use std::process::Command;

/// The text in front of a file's numbers.
fn header(path: &str) -> String {
    let bytes = std::fs::read(path).expect("a file");
    let end = bytes.windows(10).position(|w| w == b"end_header").expect("a header");
    String::from_utf8(bytes[..end].to_vec()).expect("text")
}

#[test]
fn every_format_is_written_and_the_same_run_gives_the_same_bytes() {
    let made = Folder::new();
    let (data, scene) = (made.npz("scene.npz"), made.path("scene.nerf"));
    ok(fit_grid(&data, &scene, &["--steps", "200"]));
    let export = |file: &str, more: &[&str]| -> serde_json::Value {
        let path = made.path(file);
        let args = ["export", &scene, "-o", &path, "--json", "-q"];
        let cells: &[&str] = if more.contains(&"--data") { &[] } else { &["--resolution", "24"] };
        serde_json::from_str(&ok([&args, cells, more].concat())).expect("JSON")
    };
    let mesh = export("a.ply", &[]);
    assert!(mesh["triangles"].as_u64() > Some(100), "{mesh}");
    assert!(header(&made.path("a.ply")).contains("element face"));
    export("b.ply", &["--threads", "1"]);
    let bytes = |file: &str| std::fs::read(made.path(file)).expect("a file");
    assert_eq!(bytes("a.ply"), bytes("b.ply"));
    for file in ["a.obj", "a.glb"] {
        let same = export(file, &[]);
        assert_eq!((&same["vertices"], &same["triangles"]), (&mesh["vertices"], &mesh["triangles"]));
    }
    let points = export("p.ply", &["--as", "points", "--points", "500"]);
    assert_eq!((&points["vertices"], points.get("triangles")), (&500.into(), None));
    let seen = export("q.ply", &["--as", "points", "--points", "500", "--data", &data]);
    let count = seen["vertices"].as_u64().expect("a count");
    assert!((1..=600).contains(&count) && !header(&made.path("q.ply")).contains("face"), "{seen}");
    let volume = export("v.npz", &[]);
    let file = std::fs::File::open(made.path("v.npz")).expect("a file");
    let mut archive = zip::ZipArchive::new(file).expect("an archive");
    let mut shape = |name| {
        npyz::NpyFile::new(archive.by_name(name).expect("an array")).expect("an array").shape().to_vec()
    };
    let cells: Vec<u64> = serde_json::from_value(volume["cells"].clone()).expect("cells");
    assert_eq!(shape("density.npy"), cells);
    assert_eq!(shape("rgb.npy"), [&cells[..], &[3]].concat());
    assert_eq!((shape("min.npy"), shape("cell.npy")), (vec![3], vec![]));
    assert_eq!(mesh.get("threshold_per_world_unit"), None);
    let dense = export("d.ply", &["--threshold", "5"]);
    assert_eq!(dense["threshold_per_world_unit"], 5.0);
}

/// What another reader says of a file after a word.
fn said<'t>(text: &'t str, word: &str) -> &'t str {
    let line =
        text.lines().find(|line| line.starts_with(word)).unwrap_or_else(|| panic!("no {word}: {text}"));
    line[word.len()..].trim_matches([':', ' '])
}

#[test]
fn another_reader_opens_every_mesh() {
    if !all_here(&["assimp"]) {
        return;
    }
    let (folder, (_, scene)) = (Folder::new(), blob());
    let corners = |mesh: &serde_json::Value, end: &str| -> Vec<f64> {
        serde_json::from_value(mesh[format!("box_{end}_world_units")].clone()).expect("three numbers")
    };
    for file in ["a.ply", "a.obj", "a.glb"] {
        let path = folder.path(file);
        let mesh =
            ok(["export", scene, "-o", &path, "--json", "-q", "--resolution", "16", "--threshold", "1e-3"]);
        let mesh: serde_json::Value = serde_json::from_str(&mesh).expect("JSON");
        let read = Command::new("assimp").args(["info", &path]).output().expect("assimp");
        let text = String::from_utf8_lossy(&read.stdout);
        assert!(read.status.success(), "{file}: {text}");
        assert_eq!(said(&text, "Vertices"), mesh["vertices"].to_string(), "{file}");
        assert_eq!(said(&text, "Faces"), mesh["triangles"].to_string(), "{file}");
        assert_eq!(said(&text, "Primitive Types"), "triangles", "{file}");
        let cell = mesh["cell_world_units"].as_f64().expect("a number");
        for (word, end, outward) in [("Minimum point", "min", -1.0), ("Maximum point", "max", 1.0)] {
            let point = said(&text, word)
                .trim_matches(['(', ')'])
                .split(' ')
                .map(|x| x.parse::<f64>().expect("a number"));
            for (found, bound) in point.zip(corners(&mesh, end)) {
                assert!(outward * (found - bound) <= cell, "{file}: {found} {bound}");
            }
        }
    }
}

#[test]
fn what_cannot_be_exported_is_refused_by_name() {
    let (made, scene) = blob();
    let folder = Folder::new();
    let refused = |file: &str, more: &[&str], words: &[&str]| {
        let path = folder.path(file);
        fails([&["export", scene, "-o", &path, "-q"], more].concat(), words);
        assert!(!Path::new(&path).exists(), "{file}");
    };
    refused("a.stl", &[], &["-o", ".ply, .obj, .glb or .npz", "a.stl"]);
    refused("a.vdb", &[], &["-o", ".npz", "a.vdb"]);
    refused("a.obj", &["--as", "points"], &["-o", ".ply", "points"]);
    refused("a.ply", &["--as", "volume"], &["-o", ".npz", "volume"]);
    refused("a.ply", &["--threshold", "0"], &["--threshold", "above 0"]);
    refused("a.ply", &["--threshold", "1e30", "--resolution", "8"], &["--threshold", "highest"]);
    refused("a.ply", &["--box", "0,0,0,1,1,0"], &["--box", "three sides"]);
    refused("a.ply", &["--resolution", "1"], &["--resolution"]);
    refused("a.npz", &["--resolution", "8192"], &["8192 cells", "lower --resolution"]);
    refused("a.ply", &["--data", &made.path("scene.npz")], &["--data", "a mesh"]);
    refused("a.npz", &["--points", "5"], &["--points", "a volume"]);
    refused("a.npz", &["--threshold", "5"], &["--threshold", "a volume"]);
    let points = ["--as", "points", "--data", &made.path("scene.npz")];
    refused("a.ply", &[&points[..], &["--resolution", "5"]].concat(), &["--resolution", "photographs"]);
    let outside = "--box=50,50,50,51,51,51";
    refused("a.ply", &[&points[..], &[outside]].concat(), &["--data", "opaque within the box"]);
    refused("a.ply", &[outside], &["nothing in the box is opaque"]);
    refused("a.npz", &["--box=0,0,0,1e-44,1e-44,1e-44"], &["--box", "32-bit"]);
    refused("a.ply", &["--box=100000,0,0,100000.1,0.1,0.1"], &["--box", "32-bit"]);
    let many = ["--as", "points", "--points", "18446744073709551615"];
    refused("a.ply", &many, &["the points", "lower --points"]);
    refused("a.ply", &["--as", "points", "--points", "0"], &["--points", "at least 1"]);
    fails(["export", scene, "-o", scene], &["-o"]);
}
