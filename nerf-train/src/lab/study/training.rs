//! How long to wait for a fit: validation PSNR over time, for presets and for single settings.

use crate::data::Dataset;
use crate::data::system::output::write_atomic;
use crate::data::system::printable::markdown;
use crate::data::system::progress::{ProgressStyle, say};
use crate::fit::run::{Ended, RunError, RunOptions, run_since};
use crate::measure::error::StudyError;
use crate::model::config::{Config, ConfigError, Preset};
use crate::model::engine::EngineError;
use crate::show::plot::{LinePlot, Marker, Series};
use crate::show::summary::Summary;
use crate::show::table::Table;
use crate::train::TrainError;
use crate::train::schedule::{Budget, Clock};
use nerf_core::Kernel;
use std::fmt::Write as _;
use std::path::Path;
use std::time::Duration;

/// Curves of a plot that can be told apart.
const MAX_SERIES: usize = 7;

/// One fit of the study.
#[derive(Clone, Debug)]
pub struct Trial {
    /// What it is compared by: `preset`, `table`, `width`, `depth` or `samples`.
    pub group: &'static str,
    /// Its name in tables: `width 64`.
    pub name: String,
    /// Its settings.
    pub config: Config,
    /// How long it is fitted, everything included.
    pub budget_seconds: f64,
}

/// What a fit came to.
#[derive(Clone, Debug)]
pub struct Fitted {
    /// What was fitted.
    pub trial: Trial,
    /// Seconds since its start, mean PSNR of the watched validation views, dB.
    pub curve: Vec<(f64, f64)>,
    /// Mean PSNR of the exported blob over the validation views, dB; NaN if it came to nothing.
    pub psnr_db: f64,
    /// Seconds until the last step.
    pub seconds: f64,
    /// Steps.
    pub steps: u32,
    /// Trained parameters.
    pub parameters: usize,
    /// Bytes of its file; 0 if it came to nothing.
    pub bytes: usize,
    /// Why it came to nothing; empty if it did not.
    pub note: String,
}

/// Which values are compared around a preset.
#[derive(Clone, Debug, Default)]
pub struct Lists {
    /// Presets, each as it is.
    pub presets: Vec<Preset>,
    /// Of the base, or of the preset `grid` where that has no learned grid: binary logarithms of the most entries a level
    /// has.
    pub tables: Vec<u8>,
    /// Channels of the trunk.
    pub widths: Vec<usize>,
    /// Trunk layers.
    pub depths: Vec<usize>,
    /// Samples a ray.
    pub samples: Vec<u16>,
}

impl Lists {
    /// The fits, each for each of the `seconds`: `of` gives a preset's settings, `base` is the one whose settings are
    /// varied.
    ///
    /// # Errors
    /// [`ConfigError`] names the setting that is out of range.
    pub fn trials(
        &self,
        base: &Config,
        seconds: &[f64],
        of: impl Fn(Preset) -> Config,
    ) -> Result<Vec<Trial>, ConfigError> {
        let mut trials = Vec::new();
        let mut add = |group, name: String, config: Config| -> Result<(), ConfigError> {
            config.check()?;
            for &budget_seconds in seconds {
                let name =
                    if seconds.len() > 1 { format!("{name}, {budget_seconds} s") } else { name.clone() };
                trials.push(Trial { group, name, config: config.clone(), budget_seconds });
            }
            Ok(())
        };
        for &preset in &self.presets {
            add("preset", format!("preset {preset:?}").to_lowercase(), of(preset))?;
        }
        for &log2_entries in &self.tables {
            let mut config = if base.network.grid.is_some() { base.clone() } else { of(Preset::Grid) };
            if let Some(grid) = &mut config.network.grid {
                grid.log2_entries = log2_entries;
            }
            add("table", format!("table 2^{log2_entries}"), config)?;
        }
        for &width in &self.widths {
            let mut config = base.clone();
            config.network.width = width;
            add("width", format!("width {width}"), config)?;
        }
        for &depth in &self.depths {
            let mut config = base.clone();
            config.network.depth = depth;
            // The skip layer stays where it is, if the trunk reaches that far.
            if config.network.skip_after >= depth {
                config.network.skip_after = 0;
            }
            add("depth", format!("depth {depth}"), config)?;
        }
        for &samples in &self.samples {
            let mut config = base.clone();
            config.sampling.samples = samples;
            add("samples", format!("samples {samples}"), config)?;
        }
        Ok(trials)
    }
}

/// Fits `trial` for its time, to its end: a signal leaves nothing of it.
///
/// A fit that diverges is a result.
///
/// # Errors
/// [`StudyError::Run`] for whatever is wrong besides.
pub fn fit(
    dataset: &Dataset,
    trial: &Trial,
    kernel: Kernel,
    style: ProgressStyle,
) -> Result<Fitted, StudyError> {
    let options = RunOptions {
        budget: Budget { steps: None, seconds: Some(trial.budget_seconds) },
        checkpoint: None,
        checkpoint_every: f64::INFINITY,
        resume: false,
        snapshots: None,
        report: false,
        validate_every: None,
        effect_threshold_db: None,
        kernel,
        style,
    };
    let clock = Clock::resume(Duration::ZERO);
    let nothing = |note: String| Fitted {
        trial: trial.clone(),
        curve: Vec::new(),
        psnr_db: f64::NAN,
        seconds: clock.seconds(),
        steps: 0,
        parameters: trial.config.model().parameters(),
        bytes: 0,
        note,
    };
    match run_since(clock, dataset, trial.config.clone(), &options, &|_| false) {
        Ok(Ended::Interrupted { .. }) => unreachable!("nobody stops it"),
        Ok(Ended::Finished(outcome)) => Ok(Fitted {
            curve: outcome.curve.iter().filter_map(|p| Some((p.seconds, p.val_psnr_db?))).collect(),
            psnr_db: outcome.scores.psnr_db().unwrap_or(f64::NAN),
            seconds: outcome.train_seconds,
            steps: outcome.steps,
            bytes: outcome.bytes.len(),
            ..nothing(String::new())
        }),
        Err(RunError::Train(
            error @ (TrainError::Engine(EngineError::Diverged { .. })
            | TrainError::Dead { .. }
            | TrainError::Export(_)),
        )) => {
            say(style, &format!("{}: {error}", trial.name));
            Ok(nothing(error.to_string()))
        }
        Err(error) => Err(error.into()),
    }
}

/// One row a fit, in their order.
pub fn table(fits: &[Fitted]) -> Table {
    let columns = ["group", "fit", "PSNR, dB", "time, s", "steps", "parameters", "file, bytes", "note"];
    let mut table = Table::new(columns);
    for fit in fits {
        let db = if fit.psnr_db.is_nan() { String::new() } else { format!("{:.2}", fit.psnr_db) };
        table.push([
            fit.trial.group.to_owned(),
            fit.trial.name.clone(),
            db,
            format!("{:.1}", fit.seconds),
            fit.steps.to_string(),
            fit.parameters.to_string(),
            fit.bytes.to_string(),
            fit.note.clone(),
        ]);
    }
    table
}

/// Writes table.csv, curves.csv, report.md, a plot a group, and summary.json into `folder`.
///
/// # Errors
/// [`StudyError`] on files that cannot be written.
pub fn write(fits: &[Fitted], data: &str, machine: &str, folder: &Path) -> Result<(), StudyError> {
    table(fits).write_csv(folder.join("table.csv"))?;
    let mut curves = Table::new(["fit", "seconds", "val_psnr_db"]);
    for fit in fits {
        for (seconds, db) in &fit.curve {
            curves.push([fit.trial.name.clone(), seconds.to_string(), db.to_string()]);
        }
    }
    curves.write_csv(folder.join("curves.csv"))?;
    let mut text = format!("# PSNR over the time of a fit: {}\n\n", markdown(data));
    // Writing into a String cannot fail.
    let _ = writeln!(text, "On {machine}.\n\n{}", table(fits).to_markdown());
    for group in groups(fits) {
        plot(fits, data, group).write(folder.join(format!("psnr_over_time_{group}")))?;
        let _ = writeln!(text, "![{group}](psnr_over_time_{group}.png)\n");
    }
    if let Some(plot) = size_plot(fits, data) {
        plot.write(folder.join("psnr_over_bytes"))?;
        let _ = writeln!(text, "![what a file holds](psnr_over_bytes.png)\n");
    }
    let _ = writeln!(
        text,
        "Curves are means over the few validation views that a fit watches; the table's PSNR is the exported blob's, \
         over all of them. A fit follows its schedule to the end of its time: a curve is not what a longer fit \
         shows on its way."
    );
    write_atomic(folder.join("report.md"), text.as_bytes())?;
    summary(fits).write(folder)?;
    Ok(())
}

/// summary.json.
pub fn summary(fits: &[Fitted]) -> Summary {
    let fields = |fit: &Fitted| {
        let (seconds, psnr): (Vec<f64>, Vec<f64>) = fit.curve.iter().copied().unzip();
        let mut fields = Summary::new();
        fields
            .text("fit", fit.trial.name.clone())
            .text("group", fit.trial.group)
            .number("val_psnr_db", fit.psnr_db)
            .number("train_seconds", fit.seconds)
            .integer("steps", u64::from(fit.steps))
            .integer("parameters", fit.parameters as u64)
            .integer("bytes", fit.bytes as u64)
            .text("note", fit.note.clone())
            .numbers("curve_seconds", &seconds)
            .numbers("curve_val_psnr_db", &psnr);
        fields
    };
    let mut summary = Summary::new();
    summary.sections("fits", fits.iter().map(fields).collect());
    summary
}

fn groups(fits: &[Fitted]) -> Vec<&'static str> {
    let mut groups: Vec<&'static str> = fits.iter().map(|fit| fit.trial.group).collect();
    groups.dedup();
    groups
}

fn plot(fits: &[Fitted], data: &str, group: &str) -> LinePlot {
    let title = format!("{data}: PSNR over the time of a fit, by {group}");
    let mut plot = LinePlot::new(title, "seconds, everything included", "mean PSNR of watched views, dB");
    let of_group = fits.iter().filter(|fit| fit.trial.group == group).take(MAX_SERIES);
    let series = |fit: &Fitted| Series {
        name: fit.trial.name.clone(),
        points: fit.curve.clone(),
        marker: Marker::LineAndPoints,
    };
    plot.series = of_group.map(series).collect();
    plot
}

/// What files of different sizes hold after each time: the table sizes, or all fits where none are compared; `None` of
/// fewer than two.
fn size_plot(fits: &[Fitted], data: &str) -> Option<LinePlot> {
    let tables = fits.iter().any(|fit| fit.trial.group == "table");
    let shown = || fits.iter().filter(|fit| !fit.psnr_db.is_nan() && (fit.trial.group == "table" || !tables));
    let mut seconds: Vec<f64> = shown().map(|fit| fit.trial.budget_seconds).collect();
    seconds.sort_by(f64::total_cmp);
    seconds.dedup();
    let series = |&seconds: &f64| {
        let fits = shown().filter(|fit| fit.trial.budget_seconds == seconds);
        let mut points: Vec<(f64, f64)> = fits.map(|fit| (fit.bytes as f64 / 1024.0, fit.psnr_db)).collect();
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        let marker = if tables { Marker::LineAndPoints } else { Marker::Points };
        Series { name: format!("{seconds} s"), points, marker }
    };
    if shown().count() < 2 {
        return None;
    }
    let title = format!("{data}: what a file of each size holds");
    let mut plot = LinePlot::new(title, "whole file, KiB", "mean PSNR of validation views, dB");
    plot.series = seconds.iter().take(MAX_SERIES).map(series).collect();
    plot.log_x = true;
    Some(plot)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_vary_one_setting_at_a_time() {
        let lists = Lists {
            presets: vec![Preset::Grid, Preset::Seed],
            tables: vec![12],
            widths: vec![64, 256],
            depths: vec![2],
            samples: vec![32],
        };
        let base = Preset::Small.config();
        let trials = lists.trials(&base, &[30.0], Preset::config).expect("settings");
        let names: Vec<&str> = trials.iter().map(|trial| trial.name.as_str()).collect();
        assert_eq!(
            names,
            ["preset grid", "preset seed", "table 2^12", "width 64", "width 256", "depth 2", "samples 32"]
        );
        assert_eq!(trials[1].config, Preset::Seed.config());
        let mut expected = base.clone();
        expected.network.width = 64;
        assert_eq!(trials[3].config, expected);
        assert_eq!(trials[2].config.network.grid.as_ref().map(|grid| grid.log2_entries), Some(12));
        let twice = lists.trials(&base, &[10.0, 20.0], Preset::config).expect("settings");
        assert_eq!((twice.len(), twice[1].name.as_str()), (14, "preset grid, 20 s"));
        let wrong = Lists { samples: vec![0], ..Lists::default() };
        assert_eq!(
            wrong.trials(&base, &[30.0], Preset::config).expect_err("no samples").field,
            "sampling.samples"
        );
    }
}
