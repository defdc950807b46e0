use super::common::{Global, background_name, check_counts, cpu_name, open_blob, read_file, tell};
use super::eval::Split;
use super::options::data::DataOptions;
use super::places;
use crate::data::View;
use crate::lab::study::{Effort, Progressed, Study as Measured};
use crate::measure::bench::Variants;
use crate::measure::bench::source::unrounded;
use crate::measure::point::Clock;
use crate::show::reports::study::{Findings, Setting, front_of};
use crate::system::output::write_atomic;
use crate::system::progress::Progress;
use anyhow::bail;
use clap::Args;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::{Duration, Instant};

/// Occupancy grids to build: `(cells along the longest side of the scene box, threshold on density × sample spacing)`.
const OCCUPANCIES: [(u16, f32); 5] = [(32, 0.01), (64, 0.01), (96, 0.01), (96, 0.1), (128, 0.01)];

/// Measure time and accuracy of approximate rendering, such as fewer samples, and find the Pareto front.
///
/// Errors are measured against the images of DATA, and against the exact rendering: f32 arithmetic, no early ray
/// termination, every sample of a ray. If the occupancy grid is part of the model, samples outside occupied cells are
/// left out. A Pareto front in the scene file lets a renderer choose settings by PSNR.
#[derive(Debug, Args)]
#[command(
    after_help = "Example: nerf-train study lego.nerf lego_200x200.npz --report out/study -o lego_front.nerf"
)]
pub struct Study {
    /// Scene file (.nerf).
    file: PathBuf,
    /// Data set: a .npz file or a folder, as for `fit`.
    data: PathBuf,
    /// Report folder: points.csv, report.md, plot, images, summary.json.
    #[arg(long, value_name = "DIR")]
    report: Option<PathBuf>,
    /// points.csv of another study, to plot its Pareto front too.
    #[arg(long, value_name = "CSV", requires = "report")]
    beside: Vec<PathBuf>,
    /// Output scene file: a copy of the input with the Pareto front, from which a viewer can choose render settings by
    /// loss of PSNR or by time.
    #[arg(long, short, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Write the Pareto front into the input file itself.
    #[arg(long, conflicts_with = "output")]
    write: bool,
    /// Split to evaluate.
    #[arg(long, value_enum, default_value = "val")]
    split: Split,
    /// Maximum number of views, evenly spaced in the split.
    #[arg(long, value_name = "N", default_value_t = 10)]
    views: usize,
    /// Number of views that are timed.
    #[arg(long, value_name = "N", default_value_t = 2)]
    timing_views: usize,
    /// Maximum number of timing rounds; the median time is reported.
    #[arg(long, value_name = "N", default_value_t = 4)]
    repeats: usize,
    /// Time budget, minutes; skips timing rounds that would exceed it.
    #[arg(long, value_name = "M", default_value_t = 15.0)]
    minutes: f64,
    /// Clock for times: wall, or cpu (steadier on a shared machine).
    #[arg(long, value_enum, default_value = "wall")]
    clock: Clock,
    /// Checkpoint from which the scene file was imported, to measure its f32 weights too.
    #[arg(long, value_name = "CKPT")]
    source: Option<PathBuf>,
    /// Measure only with the occupancy grid of the file, not with other resolutions and thresholds.
    #[arg(long)]
    no_other_occupancy: bool,
    #[command(flatten)]
    data_options: DataOptions,
}

impl Study {
    pub fn run(&self, global: &Global) -> anyhow::Result<ExitCode> {
        let start = Instant::now();
        self.check(global)?;
        let output = if self.write { Some(self.file.as_path()) } else { self.output.as_deref() };
        self.claims(output)?;
        let beside =
            self.beside.iter().map(|table| front_of(table, self.clock)).collect::<Result<Vec<_>, _>>()?;
        let bytes = read_file(&self.file)?;
        let blob = open_blob(&self.file, &bytes)?;
        let mut lab = Variants::new(&bytes)?;
        if let Some(source) = &self.source {
            lab.source = Some(unrounded(source, &blob)?);
        }
        let dataset = self.data_options.read_for(&self.data, (&blob, &self.file), global)?;
        let views = self.split.some(&dataset, &self.data, self.views)?;
        self.add_variants(&mut lab, global)?;
        let study = self.measured(&lab, views, start, global)?;
        let findings = Findings::of(&study);
        let setting = Setting {
            blob: self.file.display().to_string(),
            data: &dataset.name,
            split: self.split.name(),
            background: background_name(study.background),
            cpu: cpu_name(),
            seconds: start.elapsed().as_secs_f64(),
            beside,
        };
        if let Some(folder) = &self.report {
            findings.write(&setting, folder)?;
        }
        if let Some(output) = output {
            write_atomic(output, &lab.with_front(study.front_points())?)?;
        }
        let mut summary = findings.summary(&setting);
        summary.blob = output.map(|output| output.display().to_string());
        global.finish(&summary)
    }

    fn check(&self, global: &Global) -> anyhow::Result<()> {
        check_counts([
            ("--views", self.views),
            ("--timing-views", self.timing_views),
            ("--repeats", self.repeats),
        ])?;
        if !(self.minutes.is_finite() && self.minutes > 0.0) {
            bail!("--minutes: expected a number above 0, found {}", self.minutes);
        }
        if global.kernel.is_some() {
            bail!(
                "--kernel: a study compares all kernels of this machine; expected none (or no NERF_KERNEL)"
            );
        }
        places::check_report(self.report.as_ref())
    }

    fn claims(&self, output: Option<&Path>) -> anyhow::Result<()> {
        let mut claims = self
            .data_options
            .claims(&*self.data)
            .reads("the checkpoint", self.source.as_deref())
            .writes_folder("--report", self.report.as_deref());
        if let Some(output) = output {
            claims = claims.writes(if self.write { "--write" } else { "-o" }, output);
        }
        // Only with `--write` may the output replace the input file.
        if !self.write {
            output.map_or(Ok(()), |output| places::check_extension("-o", output, places::BLOB))?;
            claims = claims.reads("the blob", &self.file);
        }
        for table in &self.beside {
            claims = claims.reads("the table", table);
        }
        Ok(claims.settle()?)
    }

    /// Adds variants of the scene to measure: with other occupancy grids, and with the learned grid in int8.
    fn add_variants(&self, lab: &mut Variants<'_>, global: &Global) -> anyhow::Result<()> {
        if !self.no_other_occupancy && lab.has_occupancy(0) {
            global.say("asking the network which cells hold something, for other occupancy grids");
            for (resolution, threshold) in OCCUPANCIES {
                lab.add_occupancy(resolution, threshold)?;
            }
        }
        lab.add_int8()?;
        Ok(())
    }

    fn measured<'a, 'b>(
        &self,
        lab: &'a Variants<'b>,
        views: Vec<&'a View>,
        start: Instant,
        global: &Global,
    ) -> anyhow::Result<Measured<'a, 'b>> {
        let effort = Effort {
            timing_views: self.timing_views,
            repeats: self.repeats,
            limit: Duration::from_secs_f64((60.0 * self.minutes).min(1e9)),
            clock: self.clock,
        };
        let mut shown: Option<(String, Progress)> = None;
        let study = Measured::run(lab, views, effort, start, &mut |progressed: Progressed<'_>| {
            let Progressed { pass, done, total } = progressed;
            if shown.as_ref().is_none_or(|(name, _)| name != pass) {
                shown = Some((pass.to_owned(), Progress::steps(pass, total, global.style())));
            }
            if let Some((_, progress)) = &mut shown {
                progress.reach(done);
            }
        })?;
        if study.rounds_left_out > 0 {
            let (rounds, minutes) = (study.rounds_left_out, self.minutes);
            tell(&format!("note: {rounds} rounds of timing left out: --minutes {minutes}"));
        }
        Ok(study)
    }
}
