use super::common::{Global, print_lines};
use super::options::data::{DataOptions, print_report};
use super::places;
use crate::capture::check::Diagnosis;
use crate::data::pictures::file::is_picture_name;
use crate::data::{self, Downscale, reads_data};
use crate::show::cameras::{checked, page};
use crate::system::memory;
use crate::system::output::claims::Claims;
use crate::system::output::write_atomic;
use crate::system::summary::write;
use clap::Args;
use std::path::PathBuf;
use std::process::ExitCode;

/// Smallest number of photographs for which the expected time and memory are reported before the check.
const MANY: usize = 300;
/// Memory per photograph with a long side of about 800 pixels, bytes.
const BYTES_EACH: u64 = 2_400_000;
/// Estimated number of photographs that one core compares with the others per second.
const COMPARED_PER_SECOND: u64 = 30;
/// Estimated number of bytes of image files that one core decodes per second.
const DECODED_PER_SECOND: u64 = 15_000_000;

/// Check a capture before training: coverage, blur, exposure, overlap, poses.
///
/// `fit` runs the same check before training. One possible fault is a folded reconstruction: repeated structures made
/// the reconstruction place two sides of an orbit on top of each other. Photographs that share points then show
/// different objects. Detecting a fold needs poses with point tracks, as in a COLMAP reconstruction.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  nerf-train check holiday_poses
  nerf-train check holiday_poses -o out/check --json")]
pub struct Check {
    /// Data set: a .npz file or a folder, as for `fit`.
    data: PathBuf,
    /// Output folder: check.html (cameras in 3D, coloured by findings), summary.json.
    #[arg(long, short, value_name = "DIR")]
    output: Option<PathBuf>,
    #[command(flatten)]
    data_options: DataOptions,
}

impl Check {
    pub fn run(&self, global: &Global) -> anyhow::Result<ExitCode> {
        if let Some(folder) = &self.output {
            places::check_folder("-o", folder)?;
        }
        let claims = reads_data(Claims::default(), &self.data);
        claims.writes_folder("-o", self.output.as_deref()).settle()?;
        self.say_size(global)?;
        let mut dataset = self.data_options.read(&self.data, global)?;
        print_report(&dataset, global);
        let diagnosis = Diagnosis::of(&dataset);
        let mut lines: Vec<String> = diagnosis.lines().map(str::to_owned).collect();
        if let Some(folder) = &self.output {
            let html = folder.join("check.html");
            let range = (self.data_options.near, self.data_options.far);
            let scene = checked(&mut dataset, &diagnosis, range)?;
            write_atomic(&html, page::page(&scene)?.as_bytes())?;
            write(&diagnosis, folder)?;
            lines.push(html.display().to_string());
        }
        global.finish_with(&diagnosis, || print_lines(lines))
    }

    /// Reports the expected time and memory of a check of [`MANY`] or more photographs, unless `--downscale` is given.
    /// Fails if the photographs do not fit into memory.
    fn say_size(&self, global: &Global) -> anyhow::Result<()> {
        let files = data::files(&self.data);
        let pictures: Vec<_> = files.iter().filter(|file| is_picture_name(file)).collect();
        let count = pictures.len();
        if count < MANY || self.data_options.downscale != Downscale::Auto {
            return Ok(());
        }
        let bytes: u64 = pictures.iter().filter_map(|file| Some(file.metadata().ok()?.len())).sum();
        let seconds = count as u64 / COMPARED_PER_SECOND + bytes / DECODED_PER_SECOND;
        let seconds = seconds / rayon::current_num_threads().max(1) as u64;
        let giga = count as f64 * BYTES_EACH as f64 / 1e9;
        global.say(format!(
            "{count} pictures: about {seconds} s to read and compare them and {giga:.1} GB of memory; --downscale N takes less of it"
        ));
        let what = format!("{count} pictures at about 800 pixels");
        memory::check(what, count as u64, BYTES_EACH, "give --downscale N to read them smaller")
    }
}
