//! The program `nerf-train`, which the tests run, and the folder of its package.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

/// Builds `nerf-train` with the profile of this test program, once per test program, and returns its path. Cargo only
/// builds a program before tests of the same package, and these tests are a package of their own.
pub fn program() -> &'static Path {
    static PROGRAM: OnceLock<PathBuf> = OnceLock::new();
    PROGRAM.get_or_init(|| {
        // target/release/deps/cli-0123
        let own = std::env::current_exe().expect("a path");
        let folder = own.ancestors().nth(2).expect("the profile's folder");
        let target = folder.parent().expect("cargo's target directory");
        let profile = folder.file_name().filter(|name| *name != "debug").unwrap_or("dev".as_ref());
        // In the workspace's folder, dependencies have the same features as for all tests, so none is compiled again.
        let mut command = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
        command.current_dir(trainer().join("..")).args(["build", "--offline", "--quiet"]);
        command.args(["--bin", "nerf-train", "--profile"]).arg(profile).arg("--target-dir").arg(target);
        assert!(command.status().expect("cargo starts").success(), "{command:?}");
        folder.join(format!("nerf-train{}", std::env::consts::EXE_SUFFIX))
    })
}

/// Returns the folder of the package `nerf-train`.
pub fn trainer() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("the trainer's folder")
}
