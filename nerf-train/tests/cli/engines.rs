//! `fit --engine`: what a run by dfdx's tape reads and leaves is what any run does.

use crate::made::Folder;
use crate::{fails, fit, fit_grid, has, json, ok};

#[test]
fn the_tape_trains_what_is_evaluated_and_resumed() {
    let folder = Folder::new();
    let data = folder.npz("data.npz");
    let config = folder.file("run.toml", "engine = \"dfdx\"\n");
    for command in [fit, fit_grid] {
        let [file, whole, report] = ["a.nerf", "whole.nerf", "report"].map(|name| folder.path(name));
        let by_flag = ["--steps", "12", "--engine", "dfdx"];
        ok(command(&data, &file, &["--steps", "5", "--engine", "dfdx", "--restart"]));
        // A run of one engine is not taken up by the other, which says whose it was.
        let words = ["a.nerf.checkpoint", "engine", "\"dfdx\"", "\"fused\""];
        fails(command(&data, &file, &["--steps", "12", "--resume"]), &words);
        ok(command(&data, &file, &[&by_flag[..], &["--resume"]].concat()));
        let said = ok(["eval", &file, &data, "-q"]);
        assert!(has(&said, "views", "2"), "{said}");
        ok(command(&data, &file, &[&by_flag[..], &["--restart"]].concat()));
        let by_file = ["--config", &config, "--steps", "12", "--report", &report, "--restart"];
        ok(command(&data, &whole, &by_file));
        let read = |file: &str| std::fs::read(file).expect("a blob");
        assert!(read(&file) == read(&whole));
        assert_eq!(json(format!("{report}/summary.json"))["engine"], "dfdx");
    }
    let file = folder.path("b.nerf");
    fails(fit(&data, &file, &["--engine", "tape"]), &["--engine", "fused", "dfdx"]);
    let config = folder.file("wrong.toml", "engine = \"tape\"\n");
    fails(fit(&data, &file, &["--config", &config]), &["wrong.toml", "engine", "fused", "dfdx"]);
}
