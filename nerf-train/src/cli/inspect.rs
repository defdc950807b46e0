use super::common::{Global, open_blob, print, read_file};
use super::lines::lines;
use crate::measure::inspect::Inspection;
use clap::Args;
use std::path::PathBuf;
use std::process::ExitCode;

/// Show the contents of a scene file.
#[derive(Debug, Args)]
#[command(after_help = "Example: nerf-train inspect lego.nerf")]
pub struct Inspect {
    /// Scene file (.nerf).
    file: PathBuf,
}

impl Inspect {
    pub fn run(&self, global: &Global) -> anyhow::Result<ExitCode> {
        let bytes = read_file(&self.file)?;
        let blob = open_blob(&self.file, &bytes)?;
        let found = Inspection::of(&self.file, &bytes, &blob);
        global.finish_with(&found, || {
            if let Some(contraction) = blob.scene().and_then(|scene| scene.contraction()) {
                let radius = contraction.radius();
                print(&format!("an unbounded scene, contracted beyond {radius} of its middle"))?;
            }
            print(lines(&found)?.trim_end())
        })
    }
}
