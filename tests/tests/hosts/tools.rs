//! Missing tools are reported once, listed for `.ci/run`, and are an error in CI.

use nerf_testing::{paths, tools};
use std::process::{Command, Output};

/// Helper that the test below runs, with an empty `PATH`.
#[test]
#[ignore = "only the test below runs it"]
fn lacks_two_tools() {
    assert!(!tools::all_here(&["ffmpeg", "cmake"]));
    assert!(!tools::all_here(&["ffmpeg"]) && tools::data("nowhere").is_none());
}

#[test]
fn what_is_missing_is_said_once_and_noted_and_fails_in_ci() {
    let folder = paths::temporary();
    let list = folder.path().join("skipped");
    let program = std::env::current_exe().expect("a path");
    let run = |prepare: fn(&mut Command) -> &mut Command| -> Output {
        let mut command = Command::new(&program);
        command.args(["--exact", "--ignored", "tools::lacks_two_tools"]).current_dir(folder.path());
        command.env("PATH", "").env("NERF_DATA", "/nowhere").env("NERF_SKIPPED", &list);
        command.env("NERF_TESTS", "all").env_remove("CI");
        prepare(&mut command).output().expect("this very program")
    };
    let outside = run(|command| command);
    let said = String::from_utf8_lossy(&outside.stderr);
    assert!(outside.status.success(), "{said}");
    for line in [
        "skipped: no ffmpeg; not tested: MP4s\n",
        "skipped: no cmake; not tested: packages that CMake installs, the viewer with a window\n",
        "skipped: no data in /nowhere; not tested: real scenes and networks\n",
    ] {
        assert_eq!(said.matches(line).count(), 1, "{said}");
    }
    let place = folder.path().canonicalize().expect("a folder");
    let line = format!("{}\t{}\ttools::lacks_two_tools\n", program.display(), place.display());
    assert_eq!(std::fs::read_to_string(&list).expect("a list"), line.repeat(4));
    let unasked = run(|command| command.env_remove("NERF_TESTS"));
    let said = String::from_utf8_lossy(&unasked.stderr);
    assert!(unasked.status.success(), "{said}");
    assert_eq!(
        said.matches("skipped: ffmpeg is used with NERF_TESTS=all; not tested: MP4s\n").count(),
        1,
        "{said}"
    );
    let in_ci = run(|command| command.env("CI", "true"));
    let said = String::from_utf8_lossy(&in_ci.stdout);
    assert!(!in_ci.status.success() && said.contains("CI is set, and there is no ffmpeg"), "{said}");
}
