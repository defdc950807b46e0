//! The command that the tests run.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

/// Returns the path of `nerf-train`, built from the present sources with the profile of this test program. Cargo builds
/// programs for the tests of their own package alone, and these tests are another package.
pub fn program() -> &'static Path {
    static PROGRAM: OnceLock<PathBuf> = OnceLock::new();
    PROGRAM.get_or_init(|| {
        // target/release/deps/cli-0123
        let own = std::env::current_exe().expect("a path");
        let folder = own.ancestors().nth(2).expect("the profile's folder");
        let target = folder.parent().expect("cargo's target directory");
        let profile = folder.file_name().filter(|name| *name != "debug").unwrap_or("dev".as_ref());
        // From the workspace's folder, with the features of all its packages, as the tests: nothing is compiled again.
        let mut command = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
        command.current_dir(trainer().join("..")).args([
            "build",
            "--offline",
            "--quiet",
            "--bin",
            "nerf-train",
        ]);
        command.arg("--profile").arg(profile).arg("--target-dir").arg(target);
        assert!(command.status().expect("cargo starts").success(), "{command:?}");
        folder.join(format!("nerf-train{}", std::env::consts::EXE_SUFFIX))
    })
}

/// Returns the folder of the package `nerf-train`.
pub fn trainer() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("the trainer's folder")
}
