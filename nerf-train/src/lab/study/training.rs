//! How long to wait for a fit: validation PSNR over time, for presets and for single settings.

use crate::data::Dataset;
use crate::fit::run::{Ended, RunError, RunOptions, run_since};
use crate::lab;
use crate::model::config::{Config, ConfigError, Preset, rule};
use crate::model::engine::EngineError;
use crate::system::progress::ProgressStyle;
use crate::train::TrainError;
use crate::train::schedule::{Budget, Clock};
use nerf_core::Kernel;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::time::Duration;

/// What a fit is compared by.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Group {
    /// Its preset.
    Preset,
    /// The size of its grid's table.
    Table,
    /// Steps between updates of a hashed level of its grid.
    Turns,
    /// Channels of its trunk.
    Width,
    /// Trunk layers.
    Depth,
    /// Samples a ray.
    Samples,
}

impl Group {
    /// As in tables and names of files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Preset => "preset",
            Self::Table => "table",
            Self::Turns => "turns",
            Self::Width => "width",
            Self::Depth => "depth",
            Self::Samples => "samples",
        }
    }
}

/// One fit of the study.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Trial {
    /// What it is compared by.
    pub group: Group,
    /// Its name in tables: `width 64`.
    pub name: String,
    /// Its settings.
    pub config: Config,
    /// How long it is fitted, everything included.
    pub budget_seconds: f64,
}

impl Trial {
    /// The stem of its file.
    pub fn file_name(&self) -> String {
        let name = self.name.split(',').next().unwrap_or_default().replace([' ', '^'], "_");
        format!("{name}_{}s", self.budget_seconds)
    }
}

impl fmt::Display for Trial {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.name)
    }
}

/// What all fits of a folder share; `study.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Header {
    /// Name of the data.
    pub data: String,
    /// Checksum of the data.
    pub fingerprint: String,
    /// The settings of the base and of the presets, of which lists vary some.
    pub settings: serde_json::Value,
}

impl lab::Header for Header {
    const FILE: &'static str = "study.json";
    const WHAT: &'static str = "study of training";
}

/// The folder of such a study.
pub type Folder = lab::Folder<Header, Fitted>;

/// What a fit came to; `runs/NAME.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Fitted {
    /// What was fitted.
    pub trial: Trial,
    /// Seconds since its start, mean PSNR of the watched validation views, dB.
    pub curve: Vec<(f64, f64)>,
    /// Mean PSNR of the exported blob over the validation views, dB; none if it came to nothing.
    pub psnr_db: Option<f64>,
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
    /// What it ran on.
    pub machine: String,
}

impl lab::Run for Fitted {
    fn name(&self) -> String {
        self.trial.file_name()
    }

    fn result(&self) -> String {
        match self.psnr_db {
            Some(db) => format!("{db:.2} dB in {:.1} s", self.seconds),
            None => self.note.clone(),
        }
    }
}

/// Which values are compared around a preset.
#[derive(Clone, Debug, Default)]
pub struct Lists {
    /// Presets, each as it is.
    pub presets: Vec<Preset>,
    /// Of the base, or of the preset `grid` where that has no learned grid: binary logarithms of the most entries a level
    /// has.
    pub tables: Vec<u8>,
    /// Of the same: steps between updates of a hashed level.
    pub turns: Vec<u32>,
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
            add(Group::Preset, format!("preset {preset:?}").to_lowercase(), of(preset))?;
        }
        let learned = if base.network.grid.is_some() { base.clone() } else { of(Preset::Grid) };
        for &log2_entries in &self.tables {
            let mut config = learned.clone();
            if let Some(grid) = &mut config.network.grid {
                grid.log2_entries = log2_entries;
            }
            add(Group::Table, format!("table 2^{log2_entries}"), config)?;
        }
        for &turns in &self.turns {
            let mut config = learned.clone();
            config.optimiser.hashed_every = turns;
            add(Group::Turns, format!("turns {turns}"), config)?;
        }
        for &width in &self.widths {
            let mut config = base.clone();
            rule("network.width", base.network.depth > 0, "none without trunk layers", width)?;
            config.network.width = width;
            add(Group::Width, format!("width {width}"), config)?;
        }
        for &depth in &self.depths {
            let mut config = base.clone();
            config.network.depth = depth;
            // The skip layer stays where it is, if the trunk reaches that far.
            if config.network.skip_after >= depth {
                config.network.skip_after = 0;
            }
            add(Group::Depth, format!("depth {depth}"), config)?;
        }
        for &samples in &self.samples {
            let mut config = base.clone();
            config.sampling.samples = samples;
            add(Group::Samples, format!("samples {samples}"), config)?;
        }
        Ok(trials)
    }
}

/// Fits `trial` for its time, to its end: a signal leaves nothing of it.
///
/// A fit that diverges is a result.
///
/// # Errors
/// [`RunError`] for whatever is wrong besides.
pub fn fit(
    dataset: &Dataset,
    trial: &Trial,
    kernel: Kernel,
    style: ProgressStyle,
    machine: &str,
) -> Result<Fitted, RunError> {
    let budget = Budget { steps: None, seconds: Some(trial.budget_seconds) };
    let options = RunOptions::unattended(budget, kernel, style);
    let clock = Clock::resume(Duration::ZERO);
    let nothing = |note: String| Fitted {
        trial: trial.clone(),
        curve: Vec::new(),
        psnr_db: None,
        seconds: clock.seconds(),
        steps: 0,
        parameters: trial.config.model().parameters(),
        bytes: 0,
        note,
        machine: machine.into(),
    };
    match run_since(clock, dataset, trial.config.clone(), &options, &|_| false) {
        Ok(Ended::Interrupted { .. }) => unreachable!("nobody stops it"),
        Ok(Ended::Finished(outcome)) => Ok(Fitted {
            curve: outcome.curve.iter().filter_map(|p| Some((p.seconds, p.val_psnr_db?))).collect(),
            psnr_db: outcome.scores.psnr_db(),
            seconds: outcome.train_seconds,
            steps: outcome.steps,
            bytes: outcome.bytes.len(),
            ..nothing(String::new())
        }),
        Err(RunError::Train(
            error @ (TrainError::Engine(EngineError::Diverged { .. })
            | TrainError::Dead { .. }
            | TrainError::Export(_)),
        )) => Ok(nothing(error.to_string())),
        Err(error) => Err(error),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_vary_one_setting_at_a_time() {
        let lists = Lists {
            presets: vec![Preset::Grid, Preset::Seed],
            tables: vec![12],
            turns: vec![2],
            widths: vec![64, 256],
            depths: vec![2],
            samples: vec![32],
        };
        let base = Preset::Small.config();
        let trials = lists.trials(&base, &[30.0], Preset::config).expect("settings");
        let names: Vec<&str> = trials.iter().map(|trial| trial.name.as_str()).collect();
        assert_eq!(
            names,
            [
                "preset grid",
                "preset seed",
                "table 2^12",
                "turns 2",
                "width 64",
                "width 256",
                "depth 2",
                "samples 32"
            ]
        );
        assert_eq!(trials[1].config, Preset::Seed.config());
        let mut expected = base.clone();
        expected.network.width = 64;
        assert_eq!(trials[4].config, expected);
        assert_eq!(trials[3].config.optimiser.hashed_every, 2);
        assert_eq!(trials[2].config.network.grid.as_ref().map(|grid| grid.log2_entries), Some(12));
        let twice = lists.trials(&base, &[10.0, 20.0], Preset::config).expect("settings");
        assert_eq!((twice.len(), twice[1].name.as_str()), (16, "preset grid, 20 s"));
        let wide = Lists { widths: vec![64], ..Lists::default() };
        let mut layerless = Preset::Grid.config();
        layerless.network.depth = 0;
        let refused = wide.trials(&layerless, &[30.0], Preset::config);
        assert_eq!(refused.expect_err("no layer").field, "network.width");
        let wrong = Lists { samples: vec![0], ..Lists::default() };
        assert_eq!(
            wrong.trials(&base, &[30.0], Preset::config).expect_err("no samples").field,
            "sampling.samples"
        );
    }
}
