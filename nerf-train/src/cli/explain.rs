//! `nerf-train explain`

use super::common::{DataOptions, Global, QualityOptions, WhichBins, open_blob, read_file};
use super::effects::EffectOptions;
use super::eval::Split;
use crate::measure::frame;
use crate::show::orbit::Orbit;
use crate::show::summary::Summary;
use anyhow::{Context, bail};
use clap::Args;
use nerf_core::blob::Blob;
use nerf_core::camera::Camera;
use nerf_core::memory::Line;
use nerf_core::plan::{Batch, Outputs, Plan};
use nerf_core::render::{Explanation, Renderer, Switch};
use std::path::PathBuf;
use std::process::ExitCode;

/// Sides of the picture that is rendered without a data set, pixels, and its field of view, degrees.
const ORBIT: (u32, u32, f32) = (200, 200, 40.0);

/// Say what a frame does and what not, why, and where its work goes.
///
/// Renders one view for its counters: the data set's, or one from an orbit around the scene.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  nerf-train explain lego.nerf
  nerf-train explain lego.nerf --data lego_200x200.npz --view 3 --transmittance-cut 0 --no-colour")]
pub struct Explain {
    /// The blob.
    file: PathBuf,
    /// Data set whose camera --view is taken.
    #[arg(long, value_name = "DATA")]
    data: Option<PathBuf>,
    /// Split of the data set.
    #[arg(long, value_enum, default_value = "val", requires = "data")]
    split: Split,
    /// View of the split, counted from 0.
    #[arg(long, value_name = "I", default_value_t = 0, requires = "data")]
    view: usize,
    /// Ask for opacity and distances only.
    #[arg(long)]
    no_colour: bool,
    /// Ask for the median distance, too.
    #[arg(long)]
    median_distance: bool,
    /// Ask for normals, too.
    #[arg(long)]
    normals: bool,
    /// Bins whose finer ripples normals do not show; 0 for the density's gradient itself.
    #[arg(long, value_name = "BINS", default_value_t = Plan::NORMAL_BLUR)]
    normal_blur: f32,
    #[command(flatten)]
    quality: QualityOptions,
    #[command(flatten)]
    effects: EffectOptions,
    #[command(flatten)]
    data_options: DataOptions,
}

impl Explain {
    /// Runs the command.
    pub fn run(&self, global: &Global) -> anyhow::Result<ExitCode> {
        let bytes = read_file(&self.file)?;
        let blob = open_blob(&self.file, &bytes)?;
        let kernel = global.kernel();
        let outputs = Outputs {
            rgb: !self.no_colour,
            median_distance: self.median_distance,
            normals: self.normals,
            ..Outputs::ALL
        };
        let plan = Plan::new(&blob, &self.quality.quality(), outputs, Batch::FULL)
            .and_then(|plan| plan.with_normal_blur(self.normal_blur))
            .and_then(|plan| self.data_options.range_of(plan))
            .map(|plan| self.quality.bins_of(plan, WhichBins::Whole))
            .with_context(|| self.file.display().to_string())?;
        let plan = self.effects.of(plan)?;
        let camera = self.camera(&blob, global)?;
        let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, kernel)];
        let renderer = Renderer::new(blob, kernel, &mut memory)?;
        let counters = frame::render(&renderer, &plan, &camera)?.counters;
        let explanation = plan.explain(&renderer).with_counters(counters);

        let mut summary = stages(&explanation);
        let (rays, shares) = (counters.rays.max(1) as f64, counters.shares(&renderer));
        let share = |macs: u64| macs as f64 / counters.macs.max(1) as f64;
        let a = renderer.network().architecture();
        summary
            .text("kernel", kernel.to_string())
            .integer("workspace_bytes", explanation.workspace_bytes() as u64)
            .integer("macs_per_density_evaluation", a.density_macs() as u64)
            .integer(
                "macs_per_colour_evaluation",
                (a.colour_macs() - renderer.network().direction_macs()) as u64,
            )
            .integer("macs_per_normal_evaluation", a.gradient_macs() as u64)
            .integer("rays", counters.rays)
            .number("samples_kept_per_ray", counters.samples_kept as f64 / rays)
            .number("samples_skipped_per_ray", counters.samples_skipped as f64 / rays)
            .number("density_evaluations_per_ray", counters.density_evaluations as f64 / rays)
            .number("colour_evaluations_per_ray", counters.colour_evaluations as f64 / rays)
            .number("normal_evaluations_per_ray", counters.normal_evaluations as f64 / rays)
            .integer("macs", counters.macs)
            .number("proposal_evaluations_per_ray", counters.proposal_evaluations as f64 / rays)
            .number("proposal_share", share(shares.proposal))
            .number("direction_share", share(shares.direction))
            .number("density_share", share(shares.density))
            .number("colour_share", share(shares.colour))
            .number("normals_share", share(shares.normals))
            .integer("invalid_samples", counters.invalid_samples);
        global.finish(&summary, || {
            outlines!(explanation.to_string().trim_end());
            Ok(())
        })?;
        Ok(ExitCode::SUCCESS)
    }

    fn camera(&self, blob: &Blob<'_>, global: &Global) -> anyhow::Result<Camera> {
        let Some(data) = &self.data else {
            let (Some(scene), Some(bounds)) = (blob.scene(), blob.scene_box()) else {
                bail!("{}: expected a scene, found a 2D field", self.file.display());
            };
            let (width, height, fov) = ORBIT;
            return Ok(Orbit::around(bounds, scene.near, scene.far).camera(0.0, width, height, fov)?);
        };
        let dataset = self.data_options.read_for(data, blob, global)?;
        let views = self.split.of(&dataset);
        let Some(view) = views.get(self.view) else {
            let (found, name) = (self.view, self.split.name());
            bail!("--view: expected less than {} (split `{name}`), found {found}", views.len());
        };
        Ok(view.camera)
    }
}

/// Every stage by name, with a note on why where it is off.
fn stages(explanation: &Explanation<'_>) -> Summary {
    let mut stages = Summary::new();
    for stage in explanation.stages() {
        let name = stage.name.replace(' ', "_");
        match stage.switch {
            Switch::On => stages.flag(&name, true),
            off => stages.flag(&name, false).text(&format!("{name}_note"), off.name()),
        };
    }
    let mut summary = Summary::new();
    summary.section("stages", stages);
    summary
}
