//! `nerf-train inspect`

use super::common::{Global, open_blob, print_lines, read_file};
use crate::measure::inspect::{Inspection, lines};
use clap::Args;
use std::path::PathBuf;
use std::process::ExitCode;

/// Print everything a blob says of itself.
#[derive(Debug, Args)]
#[command(after_help = "Example: nerf-train inspect lego.nerf")]
pub struct Inspect {
    /// The blob.
    file: PathBuf,
}

impl Inspect {
    /// Runs the command.
    pub fn run(&self, global: &Global) -> anyhow::Result<ExitCode> {
        let bytes = read_file(&self.file)?;
        let blob = open_blob(&self.file, &bytes)?;
        global.finish_with(&Inspection::of(&self.file, &bytes, &blob), || {
            print_lines(lines(&self.file, &bytes, &blob))
        })?;
        Ok(ExitCode::SUCCESS)
    }
}
