use super::common::{Global, check_counts, open_blob, parse_background, read_file};
use super::options::data::DataOptions;
use super::options::quality::{QualityOptions, WhichBins};
use super::places;
use crate::data::names::FileNames;
use crate::data::{Dataset, RefinedPoses, View};
use crate::fit::run::spread;
use crate::measure::eval::{EvalOptions, Evaluation, own_background};
use crate::measure::frame;
use crate::measure::surfaces::Surfaces;
use crate::show::table::Table;
use crate::system::progress::Progress;
use crate::system::summary::write;
use anyhow::{Context, bail, ensure};
use clap::{Args, ValueEnum};
use nerf_core::camera::Camera;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Split {
    /// Views from which the scene is trained.
    Train,
    /// Validation views, held out to measure quality during training.
    Val,
    /// Test views, held out for the final evaluation.
    Test,
}

impl Split {
    pub fn of(self, dataset: &Dataset) -> &[View] {
        match self {
            Self::Train => &dataset.train,
            Self::Val => &dataset.val,
            Self::Test => &dataset.test,
        }
    }

    /// Returns at most `count` evenly spaced views of the split; fails if it is empty. `data`: path for the error.
    pub fn some<'d>(self, dataset: &'d Dataset, data: &Path, count: usize) -> anyhow::Result<Vec<&'d View>> {
        let views = spread(self.of(dataset), count);
        ensure!(!views.is_empty(), "{}: the split `{}` has no views", data.display(), self.name());
        Ok(views)
    }

    /// Returns the cameras of the split's views. If the test split has no views, returns [`Dataset::test_path`].
    pub fn cameras(self, dataset: &Dataset) -> Vec<Camera> {
        let views = self.of(dataset);
        if self == Self::Test && views.is_empty() {
            return dataset.test_path.clone();
        }
        views.iter().map(|view| view.camera).collect()
    }

    /// Returns the camera of view `index` of the split. `flag`: name of the flag that gave the index, for an error.
    pub fn camera(self, flag: &str, dataset: &Dataset, index: usize) -> anyhow::Result<Camera> {
        let cameras = self.cameras(dataset);
        let (count, name) = (cameras.len(), self.name());
        let fault = || format!("{flag}: expected less than {count} (split `{name}`), found {index}");
        cameras.get(index).copied().with_context(fault)
    }

    pub fn name(self) -> &'static str {
        match self {
            Self::Train => "train",
            Self::Val => "val",
            Self::Test => "test",
        }
    }
}

/// Evaluate a scene on views of a data set: PSNR and SSIM.
#[derive(Debug, Args)]
#[command(
    after_help = "Example: nerf-train eval lego.nerf lego_200x200.npz --background white --report out/eval"
)]
pub struct Eval {
    /// Scene file (.nerf).
    file: PathBuf,
    /// Data set: a .npz file or a folder, as for `fit`.
    data: PathBuf,
    /// Split to evaluate [default: val, or test if there is no val].
    #[arg(long, value_enum)]
    split: Option<Split>,
    /// Evaluate every N-th view only.
    #[arg(long, value_name = "N", default_value_t = 1)]
    every: usize,
    /// Also report PSNR on every N-th pixel of every N-th row, to compare with results on this subset of pixels.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(2..))]
    lattice: Option<u32>,
    /// Background: a name (black, white, red), #RRGGBB or R,G,B (0 to 255) [default: the scene file's].
    #[arg(long, value_name = "COLOUR", value_parser = parse_background)]
    background: Option<[f32; 3]>,
    /// Report folder: summary.json, table, images.
    #[arg(long, value_name = "DIR")]
    report: Option<PathBuf>,
    #[command(flatten)]
    quality: QualityOptions,
    #[command(flatten)]
    data_options: DataOptions,
}

impl Eval {
    pub fn run(&self, global: &Global) -> anyhow::Result<ExitCode> {
        check_counts([("--every", self.every)])?;
        places::check_report(self.report.as_ref())?;
        self.data_options
            .claims(&*self.data)
            .reads("the blob", &self.file)
            .writes_folder("--report", self.report.as_deref())
            .settle()?;
        let bytes = read_file(&self.file)?;
        let blob = open_blob(&self.file, &bytes)?;
        let (outputs, data) = (Surfaces::OUTPUTS, &self.data_options);
        let plan = self.quality.plan((&blob, &self.file), outputs, data, WhichBins::Own)?;
        let dataset = self.data_options.read_given_for(&self.data, (&blob, &self.file), global)?;
        let split = self.split_of(&dataset);
        let views = self.views(&dataset, split)?;
        let refined = self.refined(&dataset, &views)?;
        self.say_opaque(&views, own_background(&blob), global);
        let names = FileNames::of(split.of(&dataset));
        let options = EvalOptions { background: self.background, lattice: self.lattice };
        let mut progress = Progress::steps("eval", views.len(), global.style());
        let (mut table, mut written) = (Table::new(["view", "psnr_db", "aligned_psnr_db", "ssim"]), Ok(()));
        let views = (split.name(), views);
        let (kernel, points) = (global.kernel(), &dataset.points);
        let mut found =
            Evaluation::of(&bytes, &plan, kernel, options, views, points, |view, frame, score| {
                let db = [score.psnr_db, score.aligned_psnr_db].map(|db| format!("{db:.3}"));
                let [raw, aligned] = db;
                table.push([score.view.clone(), raw, aligned, format!("{:.4}", score.ssim)]);
                progress.reach(table.rows.len());
                if let (Some(folder), Ok(())) = (&self.report, &written) {
                    written =
                        frame::picture(frame).write_png(folder.join(format!("{}.png", names.stem(view))));
                }
            })?;
        written?;
        if let Some(views) = &refined {
            found.add_refined(&bytes, &plan, kernel, options, views)?;
        }
        progress.finish(format!("{} views", found.views));
        if let Some(folder) = &self.report {
            table.write_csv(folder.join("views.csv"))?;
            write(&found, folder)?;
        }
        global.finish(&found)
    }

    /// Returns the split to evaluate: `--split`, by default val. If val is empty and test is not, the default is test.
    fn split_of(&self, dataset: &Dataset) -> Split {
        let there = if dataset.val.is_empty() && !dataset.test.is_empty() { Split::Test } else { Split::Val };
        self.split.unwrap_or(there)
    }

    fn views<'d>(&self, dataset: &'d Dataset, split: Split) -> anyhow::Result<Vec<&'d View>> {
        let views: Vec<&View> = split.of(dataset).iter().step_by(self.every).collect();
        if views.is_empty() {
            bail!(
                "{}: the split `{}` has no views; it has {} train, {} val and {} test: choose with --split",
                self.data.display(),
                split.name(),
                dataset.train.len(),
                dataset.val.len(),
                dataset.test.len()
            );
        }
        Ok(views)
    }

    /// Returns `views` with the refined poses stored next to the scene file; `None` if any view has no refined pose.
    fn refined(&self, dataset: &Dataset, views: &[&View]) -> anyhow::Result<Option<Vec<View>>> {
        let Some(refined) = RefinedPoses::beside(&self.file)? else { return Ok(None) };
        let cameras = refined.cameras(&self.file, views.iter().copied(), dataset.origin)?;
        Ok(views.iter().zip(cameras).map(|(view, camera)| Some(view.seen_from(camera?))).collect())
    }

    /// Prints a note if `--background` has no effect because all photographs are opaque: opaque photographs keep their
    /// own background. Prints nothing if `--background` equals `own`, the scene file's background.
    fn say_opaque(&self, views: &[&View], own: [f32; 3], global: &Global) {
        let other = self.background.is_some_and(|background| background != own);
        if other && views.iter().all(|view| !view.has_alpha()) {
            global.say(
                "note: these pictures have no alpha, so their own background stays in the truth whatever \
                 --background says",
            );
        }
    }
}
