use super::common::{Global, open_blob, print, read_file};
use super::eval::Split;
use super::options::data::DataOptions;
use super::options::effects::EffectOptions;
use super::options::quality::{QualityOptions, WhichBins};
use crate::measure::frame;
use crate::show::orbit::Orbit;
use anyhow::{Context, bail};
use clap::Args;
use nerf_core::blob::Blob;
use nerf_core::camera::Camera;
use nerf_core::memory::Line;
use nerf_core::plan::{Outputs, Plan};
use nerf_core::render::{Counters, Explanation, Renderer, Stage, Switch};
use serde::Serialize;
use serde_json::Value;
use std::path::PathBuf;
use std::process::ExitCode;

/// Image rendered without `--data`: width and height, pixels; horizontal field of view, degrees.
const ORBIT: (u32, u32, f32) = (200, 200, 40.0);

/// Show which render stages a frame runs, why, and what each costs.
///
/// Renders one view to count its work: a view of --data, or by default a view from an orbit around the scene.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  nerf-train explain lego.nerf
  nerf-train explain lego.nerf --data lego_200x200.npz --view 3 --transmittance-cut 0 --no-colour")]
pub struct Explain {
    /// Scene file (.nerf).
    file: PathBuf,
    /// Data set from which --view selects a camera [default: a camera on an orbit around the scene].
    #[arg(long, value_name = "DATA")]
    data: Option<PathBuf>,
    /// Split of --data from which --view selects.
    #[arg(long, value_enum, default_value = "val", requires = "data")]
    split: Split,
    /// View index in the split, from 0.
    #[arg(long, value_name = "I", default_value_t = 0, requires = "data")]
    view: usize,
    /// Explain a rendering of opacity and distances alone, without colour.
    #[arg(long)]
    no_colour: bool,
    /// Also render the median distance.
    #[arg(long)]
    median_distance: bool,
    /// Also render normals.
    #[arg(long)]
    normals: bool,
    /// Blur of the density before normals are computed: width in sample spacings; 0: no blur.
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
        let plan = self.quality.plan((&blob, &self.file), outputs, &self.data_options, WhichBins::Whole)?;
        let plan =
            plan.with_normal_blur(self.normal_blur).with_context(|| self.file.display().to_string())?;
        let plan = self.effects.of(plan)?;
        let camera = self.camera(&blob, global)?;
        let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, kernel)];
        let renderer = Renderer::new(blob, kernel, &mut memory)?;
        let counters = frame::render(&renderer, &plan, &camera)?.counters;
        let explanation = renderer.explain(&plan).with_counters(counters);

        let summary = Summary::of(&explanation, &renderer, counters);
        global.finish_with(&summary, || print(explanation.to_string().trim_end()))
    }

    fn camera(&self, blob: &Blob<'_>, global: &Global) -> anyhow::Result<Camera> {
        let Some(data) = &self.data else {
            let Some(scene) = blob.scene() else {
                bail!("{}: expected a scene, found a 2D field", self.file.display());
            };
            let (width, height, fov) = ORBIT;
            return Ok(Orbit::of(scene, None).camera(0.0, width, height, fov)?);
        };
        let dataset = self.data_options.read_for(data, (blob, &self.file), global)?;
        self.split.camera("--view", &dataset, self.view)
    }
}

/// Machine-readable explanation. The `*_share` fields are fractions of all multiply-adds.
#[derive(Debug, Serialize)]
struct Summary {
    stages: serde_json::Map<String, Value>,
    kernel: String,
    workspace_bytes: usize,
    macs_per_density_evaluation: usize,
    macs_per_colour_evaluation: usize,
    macs_per_normal_evaluation: usize,
    rays: u64,
    samples_kept_per_ray: f64,
    samples_skipped_per_ray: f64,
    density_evaluations_per_ray: f64,
    colour_evaluations_per_ray: f64,
    normal_evaluations_per_ray: f64,
    macs: u64,
    proposal_evaluations_per_ray: f64,
    proposal_share: f64,
    direction_share: f64,
    density_share: f64,
    colour_share: f64,
    normals_share: f64,
    invalid_samples: u64,
}

impl Summary {
    fn of(explanation: &Explanation<'_>, renderer: &Renderer<'_>, counters: Counters) -> Self {
        let (network, shares) = (renderer.network(), renderer.shares(&counters));
        let a = network.architecture();
        let a_ray = |count: u64| count as f64 / counters.rays.max(1) as f64;
        let share = |macs: u64| macs as f64 / counters.macs.max(1) as f64;
        // A stage that is off also has a note that says why.
        let stage = |stage: Stage| {
            let (name, on) = (stage.name.replace(' ', "_"), stage.switch == Switch::On);
            let note = (!on).then(|| (format!("{name}_note"), stage.switch.name().into()));
            [(name, on.into())].into_iter().chain(note)
        };
        Self {
            stages: explanation.stages().into_iter().flat_map(stage).collect(),
            kernel: renderer.kernel().to_string(),
            workspace_bytes: explanation.workspace_bytes(),
            macs_per_density_evaluation: a.density_macs(),
            macs_per_colour_evaluation: a.colour_macs() - network.direction_macs(),
            macs_per_normal_evaluation: a.gradient_macs(),
            rays: counters.rays,
            samples_kept_per_ray: a_ray(counters.samples_kept),
            samples_skipped_per_ray: a_ray(counters.samples_skipped),
            density_evaluations_per_ray: a_ray(counters.density_evaluations),
            colour_evaluations_per_ray: a_ray(counters.colour_evaluations),
            normal_evaluations_per_ray: a_ray(counters.normal_evaluations),
            macs: counters.macs,
            proposal_evaluations_per_ray: a_ray(counters.proposal_evaluations),
            proposal_share: share(shares.proposal),
            direction_share: share(shares.direction),
            density_share: share(shares.density),
            colour_share: share(shares.colour),
            normals_share: share(shares.normals),
            invalid_samples: counters.invalid_samples,
        }
    }
}
