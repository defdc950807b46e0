//! `nerf-train audit`

use super::common::{DataOptions, Global, background_name, cpu_name, read_file};
use super::eval::Split;
use super::places;
use crate::data::View;
use crate::data::system::output::claims::Claims;
use crate::data::system::progress::{Message, Progress, Total};
use crate::fit::run::spread;
use crate::measure::audit;
use crate::measure::audit::{AuditOptions, THRESHOLD_DB, Verdict, Worth};
use crate::measure::bench::Lab;
use crate::measure::point::Clock;
use crate::show::reports::audit::table as audit_table;
use crate::show::summary::write;
use anyhow::bail;
use clap::Args;
use serde::Serialize;
use std::path::PathBuf;
use std::process::ExitCode;

/// Ask a scene what it calls for: leave out each of its effects, and say what that costs and spares.
///
/// The effects: view dependence, occupancy grid, background. Time and work (multiply-adds) are with the effect over
/// without it.
#[derive(Debug, Args)]
#[command(after_help = "Example: nerf-train audit lego.nerf lego_200x200.npz --effect-threshold 0.1")]
pub struct Audit {
    /// The blob.
    file: PathBuf,
    /// The data set.
    data: PathBuf,
    /// What an effect must gain to be kept, dB; one that spares a tenth of the work may lose as much.
    #[arg(long, value_name = "DB", default_value_t = THRESHOLD_DB, allow_hyphen_values = true)]
    effect_threshold: f64,
    /// Which views.
    #[arg(long, value_enum, default_value = "val")]
    split: Split,
    /// At most so many views, spread over the split.
    #[arg(long, value_name = "N", default_value_t = 4)]
    views: usize,
    /// Rounds of timing.
    #[arg(long, value_name = "N", default_value_t = 3)]
    repeats: usize,
    /// Which clock: wall, or cpu (steadier on a machine that others use too).
    #[arg(long, value_enum, default_value = "wall")]
    clock: Clock,
    /// Folder for audit.csv and summary.json.
    #[arg(long, value_name = "DIR")]
    report: Option<PathBuf>,
    #[command(flatten)]
    data_options: DataOptions,
}

/// More rounds than any measurement takes; each has its own place in memory.
const MAX_REPEATS: usize = 10_000;

impl Audit {
    /// Runs the command.
    pub fn run(&self, global: &Global) -> anyhow::Result<ExitCode> {
        for (flag, count) in [("--views", self.views), ("--repeats", self.repeats)] {
            if count == 0 {
                bail!("{flag}: expected at least 1, found 0");
            }
        }
        if self.repeats > MAX_REPEATS {
            bail!("--repeats: expected at most {MAX_REPEATS}, found {}", self.repeats);
        }
        check_threshold(self.effect_threshold)?;
        places::check_report(self.report.as_ref())?;
        Claims::new()
            .reads("the blob", &self.file)
            .reads_data(&self.data)
            .writes_folder_if("--report", self.report.as_deref(), &places::AUDIT)
            .settle()?;
        let bytes = read_file(&self.file)?;
        let blob = super::common::open_blob(&self.file, &bytes)?;
        let mut lab = Lab::new(&bytes)?;
        let dataset = self.data_options.read_for(&self.data, &blob, global)?;
        let views: Vec<&View> = spread(self.split.of(&dataset), self.views);
        if views.is_empty() {
            bail!("{}: the split `{}` has no views", self.data.display(), self.split.name());
        }
        // Directions are averaged over what was fitted, not over what is measured.
        let rays: Vec<&View> =
            if dataset.train.is_empty() { views.clone() } else { dataset.train.iter().collect() };
        let options =
            AuditOptions { threshold_db: self.effect_threshold, repeats: self.repeats, clock: self.clock };
        let mut progress: Option<Progress> = None;
        let findings = audit::audit(&mut lab, &views, &rays, &options, &mut |done, total| {
            let new = || Progress::new("audit", Total::Steps(total), global.style());
            progress.get_or_insert_with(new).update(done, &Message::default());
        })?;
        let background = background_name(lab.scene().background);
        let summary = Summary {
            effects: findings.iter().map(|(effect, worth)| EffectSummary::of(effect.name, worth)).collect(),
            threshold_db: self.effect_threshold,
            views: views.len(),
            split: self.split.name(),
            background: background.clone(),
            threads: rayon::current_num_threads(),
            cpu: cpu_name(),
        };
        let table = audit_table(&findings);
        if let Some(folder) = &self.report {
            table.write_csv(folder.join("audit.csv"))?;
            write(&summary, folder)?;
        }
        global.finish(&summary, || {
            outlines!(table.to_text());
            outln!(
                "mean over {} views ({}) on {background}; time and MACs: with the effect over without it",
                views.len(),
                self.split.name()
            );
            Ok(())
        })?;
        Ok(ExitCode::SUCCESS)
    }
}

/// Refuses a threshold that is no number.
pub fn check_threshold(threshold: f64) -> anyhow::Result<()> {
    if threshold.is_nan() {
        bail!("--effect-threshold: expected a number, found {threshold}");
    }
    Ok(())
}

/// What an audit found, for scripts.
#[derive(Debug, Serialize)]
struct Summary {
    effects: Vec<EffectSummary>,
    threshold_db: f64,
    views: usize,
    split: &'static str,
    background: String,
    threads: usize,
    cpu: String,
}

/// What an effect is worth, or why it was not asked.
#[derive(Debug, Serialize)]
#[serde(untagged)]
enum EffectSummary {
    Asked {
        effect: &'static str,
        with_db: f64,
        without_db: f64,
        gain_db: f64,
        relative_time: f64,
        relative_macs: f64,
        kept: bool,
    },
    NotAsked {
        effect: &'static str,
        gain_db: Option<f64>,
        gain_db_note: &'static str,
    },
}

impl EffectSummary {
    fn of(effect: &'static str, worth: &Result<Worth, &'static str>) -> Self {
        match worth {
            Ok(worth) => Self::Asked {
                effect,
                with_db: worth.with_db,
                without_db: worth.without_db,
                gain_db: worth.gain_db(),
                relative_time: worth.relative_time,
                relative_macs: worth.relative_macs,
                kept: worth.verdict == Verdict::Keeps,
            },
            Err(gain_db_note) => Self::NotAsked { effect, gain_db: None, gain_db_note },
        }
    }
}
