use super::common::Global;
use super::places;
use crate::capture::check::Diagnosis;
use crate::data::poses::{Found, Request, find};
use crate::system::output::claims::Claims;
use crate::system::stop::Note;
use anyhow::anyhow;
use clap::Args;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::{Duration, Instant};

/// Find camera poses with an installed COLMAP.
///
/// The output folder gets a COLMAP reconstruction in `sparse/0`, and copies of the photographs in `images`. Photographs
/// of one device and size share intrinsics. If photographs are missing from the reconstruction, COLMAP is run again:
/// with matches between neighbours only, with another initial pair, or with stricter matching. COLMAP works on the CPU;
/// 77 photographs of 800x600 take about six minutes on two cores.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  nerf-train poses holiday
  nerf-train fit holiday_poses -o holiday.nerf")]
pub struct Poses {
    /// Folder of photographs, or a folder that contains `images/`.
    photographs: PathBuf,
    /// Output folder [default: PHOTOGRAPHS_poses].
    #[arg(long, short, value_name = "DIR")]
    output: Option<PathBuf>,
    /// Sequential matching, for video frames in the order of their names.
    #[arg(long)]
    sequential: bool,
    /// Stop COLMAP after this many minutes without output.
    #[arg(long, value_name = "MINUTES", default_value_t = 30.0)]
    patience: f64,
}

impl Poses {
    pub fn run(&self, global: &Global) -> anyhow::Result<ExitCode> {
        let begun = Instant::now();
        let output = self.output.clone().unwrap_or_else(|| beside(&self.photographs));
        places::check_folder("-o", &output)?;
        Claims::default()
            .reads("the folder of photographs", &self.photographs)
            .writes_folder("-o", &output)
            .check()?;
        let _note = Note::new("interrupted; nothing is written");
        let request = Request {
            photographs: &self.photographs,
            output: &output,
            sequential: self.sequential,
            threads: global.threads.map(|_| rayon::current_num_threads()),
            patience: Duration::try_from_secs_f64(60.0 * self.patience)
                .map_err(|_| anyhow!("--patience: expected a number of minutes, found {}", self.patience))?,
            folded: &|dataset| {
                let diagnosis = Diagnosis::of(dataset);
                (diagnosis.folded == Some(true)).then_some(diagnosis.groups)
            },
            style: global.style(),
        };
        let found = find(&request)?;
        let folder = output.display().to_string();
        let summary = Summary { folder, found, total_seconds: begun.elapsed().as_secs_f64() };
        global.finish(&summary)
    }
}

fn beside(photographs: &Path) -> PathBuf {
    // The paths `.` and `a/..` have no file name: their canonical path is used.
    let real = std::fs::canonicalize(photographs).unwrap_or_else(|_| photographs.to_owned());
    let path = if photographs.file_name().is_some() { photographs } else { &real };
    let mut name = path.file_name().unwrap_or_default().to_owned();
    name.push("_poses");
    path.with_file_name(name)
}

#[derive(Debug, Serialize)]
struct Summary {
    folder: String,
    #[serde(flatten)]
    found: Found,
    total_seconds: f64,
}
