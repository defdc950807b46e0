use super::common::{Global, check_counts, open_blob, read_file};
use super::eval::Split;
use super::options::data::DataOptions;
use super::places;
use crate::data::View;
use crate::measure::audit::{self, AuditOptions, Summary, THRESHOLD_DB};
use crate::measure::bench::Variants;
use crate::measure::point::Clock;
use crate::show::table::Table;
use crate::system::progress::Progress;
use crate::system::summary::write;
use anyhow::bail;
use clap::Args;
use std::path::PathBuf;
use std::process::ExitCode;

/// Ablation: quality and cost of each component of a scene, such as view dependence.
///
/// View dependence, occupancy grid and background are left out in turn. Time and multiply-adds are relative to the
/// rendering without the component: 1.2 means that the component costs 20 % more.
#[derive(Debug, Args)]
#[command(after_help = "Example: nerf-train audit lego.nerf lego_200x200.npz --effect-threshold 0.1")]
pub struct Audit {
    /// Scene file (.nerf).
    file: PathBuf,
    /// Data set: a .npz file or a folder, as for `fit`.
    data: PathBuf,
    /// Difference in PSNR that matters, dB: a component is worth its time if it gains at least this much, or if it loses
    /// less and saves over 10 % of multiply-adds.
    #[arg(long, value_name = "DB", default_value_t = THRESHOLD_DB, allow_hyphen_values = true)]
    effect_threshold: f64,
    /// Split to evaluate.
    #[arg(long, value_enum, default_value = "val")]
    split: Split,
    /// Maximum number of views, evenly spaced in the split.
    #[arg(long, value_name = "N", default_value_t = 4)]
    views: usize,
    /// Number of timing rounds; the median time is reported.
    #[arg(long, value_name = "N", default_value_t = 3)]
    repeats: usize,
    /// Clock for times: wall, or cpu (steadier on a shared machine).
    #[arg(long, value_enum, default_value = "wall")]
    clock: Clock,
    /// Report folder: audit.csv, summary.json.
    #[arg(long, value_name = "DIR")]
    report: Option<PathBuf>,
    #[command(flatten)]
    data_options: DataOptions,
}

/// Largest number of timing rounds: the times of all rounds are kept in memory.
const MAX_REPEATS: usize = 10_000;

impl Audit {
    pub fn run(&self, global: &Global) -> anyhow::Result<ExitCode> {
        self.check()?;
        let bytes = read_file(&self.file)?;
        let blob = open_blob(&self.file, &bytes)?;
        let mut lab = Variants::new(&bytes)?;
        let dataset = self.data_options.read_for(&self.data, (&blob, &self.file), global)?;
        let views = self.split.some(&dataset, &self.data, self.views)?;
        // View dependence is replaced by its mean over the rays of the training views, if there are any.
        let rays: Vec<&View> =
            if dataset.train.is_empty() { views.clone() } else { dataset.train.iter().collect() };
        let options =
            AuditOptions { threshold_db: self.effect_threshold, repeats: self.repeats, clock: self.clock };
        let mut progress: Option<Progress> = None;
        let findings = audit::audit(&mut lab, &views, &rays, &options, &mut |done, total| {
            let new = || Progress::steps("audit", total, global.style());
            progress.get_or_insert_with(new).reach(done);
        })?;
        let on = (self.split.name(), views.len());
        let summary = Summary::of(&findings, self.effect_threshold, on, lab.scene.background);
        let table = table_of(&findings);
        if let Some(folder) = &self.report {
            table.write_csv(folder.join("audit.csv"))?;
            write(&summary, folder)?;
        }
        global.finish(&summary)
    }

    fn check(&self) -> anyhow::Result<()> {
        check_counts([("--views", self.views), ("--repeats", self.repeats)])?;
        if self.repeats > MAX_REPEATS {
            bail!("--repeats: expected at most {MAX_REPEATS}, found {}", self.repeats);
        }
        check_threshold(self.effect_threshold)?;
        places::check_report(self.report.as_ref())?;
        let claims = self.data_options.claims(&*self.data).reads("the blob", &self.file);
        Ok(claims.writes_folder("--report", self.report.as_deref()).settle()?)
    }
}

pub fn check_threshold(threshold: f64) -> anyhow::Result<()> {
    if threshold.is_nan() {
        bail!("--effect-threshold: expected a number, found {threshold}");
    }
    Ok(())
}

fn table_of(audit: &audit::Audit) -> Table {
    let columns =
        ["effect", "in its place", "with, dB", "without, dB", "gains, dB", "time", "MACs", "verdict"];
    let mut table = Table::new(columns);
    for (effect, worth) in audit {
        match worth {
            Ok(worth) => table.push([
                effect.name.to_owned(),
                effect.instead.to_owned(),
                format!("{:.3}", worth.with_db),
                format!("{:.3}", worth.without_db),
                format!("{:.3}", worth.gain_db()),
                format!("{:.3}", worth.relative_time),
                format!("{:.4}", worth.relative_macs),
                worth.verdict.name().to_owned(),
            ]),
            Err(why) => table.push([effect.name, effect.instead, "–", "–", "–", "–", "–", why]),
        };
    }
    table
}
