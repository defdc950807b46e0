//! Options that trade the quality of a rendering for time.

use super::data::DataOptions;
use crate::measure::point::MATHS;
use anyhow::Context;
use clap::{Args, ValueEnum};
use nerf_core::blob::Blob;
use nerf_core::math::MathBackend;
use nerf_core::plan::{Batch, Outputs, Plan, Quality};
use std::path::Path;

/// Options that trade the quality of a rendering for time.
#[derive(Debug, Args)]
#[command(next_help_heading = "Quality and speed")]
pub struct QualityOptions {
    /// Samples per ray; with a hash grid, march steps on the diagonal of the scene box [default: the scene file's].
    #[arg(long, value_name = "N", default_value_t = 0, hide_default_value = true)]
    pub samples: u16,
    /// Early ray termination: transmittance below which a ray ends; 0: never.
    #[arg(long, value_name = "T", default_value_t = Quality::default().transmittance_cut)]
    pub transmittance_cut: f32,
    /// Evaluate the colour network once per group of samples whose compositing weights add up to W: larger is faster, less
    /// exact; 0: at every sample.
    #[arg(long, value_name = "W", default_value_t = Quality::default().colour_cut)]
    pub colour_cut: f32,
    /// Do not skip empty space: ignore the occupancy grid.
    #[arg(long)]
    pub no_occupancy: bool,
    /// Place samples uniformly, without the file's proposal (coarse) network.
    #[arg(long)]
    pub no_proposal: bool,
    /// Exact rendering: --no-occupancy --transmittance-cut 0 --colour-cut 0.
    #[arg(long, conflicts_with_all = ["no_occupancy", "transmittance_cut", "colour_cut"])]
    pub exact: bool,
    /// Implementation of exp, sin and other functions: polynomial (fast), libm (reference), micromath (small code),
    /// recurrence (as polynomial, but sines of an encoding by angle doubling).
    #[arg(long, value_name = "BACKEND", default_value = "polynomial", value_parser = parse_math)]
    pub math: MathBackend,
    /// Interval of a ray to sample (networks without a hash grid): own (from near to far, as in training) or whole (within the
    /// scene box, for cameras at other distances than in training) [default: whole; own in eval].
    #[arg(long, value_enum, value_name = "WHICH")]
    pub bins: Option<WhichBins>,
}

/// Part of a ray that the samples cover, in a scene sampled in bins; ignored for ray-marched scenes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum WhichBins {
    /// Bins between the scene's near and far planes.
    Own,
    /// Bins over the whole scene box.
    Whole,
}

pub fn parse_math(name: &str) -> Result<MathBackend, String> {
    let found = MATHS.into_iter().find(|(known, _)| *known == name);
    found.map(|(_, math)| math).ok_or_else(|| {
        let names = MATHS.map(|(known, _)| known);
        format!("expected {} or {}", names[..3].join(", "), names[3])
    })
}

impl QualityOptions {
    /// Returns the plan that renders `outputs` of `blob`, between the distances `--near` and `--far` of `data`. `file`:
    /// path of the scene file, for errors. `default`: sampled part of a ray if `--bins` is not given.
    pub fn plan<'b>(
        &self,
        (blob, file): (&Blob<'b>, &Path),
        outputs: Outputs,
        data: &DataOptions,
        default: WhichBins,
    ) -> anyhow::Result<Plan<'b>> {
        let plan = Plan::new(blob, &self.quality(), outputs, Batch::FULL);
        let plan = plan.and_then(|plan| data.range_of(plan)).with_context(|| file.display().to_string())?;
        Ok(match self.bins.unwrap_or(default) {
            WhichBins::Own => plan.with_own_bins(),
            WhichBins::Whole => plan,
        })
    }

    fn quality(&self) -> Quality {
        let base =
            Quality { samples: self.samples, math: self.math, proposal: !self.no_proposal, ..Quality::EXACT };
        if self.exact {
            base
        } else {
            Quality {
                transmittance_cut: self.transmittance_cut,
                colour_cut: self.colour_cut,
                occupancy: !self.no_occupancy,
                ..base
            }
        }
    }
}
