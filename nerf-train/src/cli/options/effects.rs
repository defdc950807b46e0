//! Options for a rendering's anti-aliasing, jitter, depth of field, exposure and tone curve.

use anyhow::Context;
use clap::{Args, ValueEnum, value_parser};
use nerf_core::plan::{EffectError, Effects, Jitter, Plan, PlanError, ThinLens, Tone};

/// Effects of a rendering; none by default.
#[derive(Debug, Args)]
#[command(next_help_heading = "Effects")]
pub struct EffectOptions {
    /// Anti-aliasing: rays per pixel, 1 to 256 [default: 1].
    #[arg(
        long,
        value_name = "N",
        default_value_t = 1,
        hide_default_value = true,
        value_parser = value_parser!(u16).range(1..=256)
    )]
    antialias: u16,
    /// Seed of random sample offsets, which turn banding into noise [default: no offsets].
    #[arg(long, value_name = "SEED")]
    jitter: Option<u64>,
    /// Depth of field: radius of the aperture, world units; needs --focus, and --antialias of about 16 or more.
    #[arg(long, value_name = "R", requires = "focus")]
    aperture: Option<f32>,
    /// Distance in focus, world units; needs --aperture.
    #[arg(long, value_name = "T", requires = "aperture")]
    focus: Option<f32>,
    /// Exposure, stops: multiplies linear light by 2^STOPS [default: 0].
    #[arg(
        long,
        value_name = "STOPS",
        default_value_t = 0.0,
        hide_default_value = true,
        allow_hyphen_values = true
    )]
    exposure: f32,
    /// Tone curve applied to linear light.
    #[arg(long, value_enum, value_name = "NAME", default_value = "none")]
    tone_map: ToneMap,
    /// Write linear light instead of sRGB; PNG and video are clipped at 1.
    #[arg(long)]
    linear: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum ToneMap {
    /// No tone curve.
    None,
    /// Reinhard's curve, x / (1 + x).
    Reinhard,
    /// Filmic curve: Narkowicz' fit of the ACES curve.
    Filmic,
}

impl EffectOptions {
    pub fn of<'a>(&self, plan: Plan<'a>) -> anyhow::Result<Plan<'a>> {
        self.in_light(plan, false)
    }

    /// Returns `plan` with these effects. `linear`: whether to output linear light even without `--linear`.
    pub fn in_light<'a>(&self, plan: Plan<'a>, linear: bool) -> anyhow::Result<Plan<'a>> {
        let lens = |aperture_radius| ThinLens { aperture_radius, focus_distance: self.focus.unwrap_or(0.0) };
        let effects = Effects {
            jitter: self.jitter.map(|seed| Jitter { seed }),
            anti_aliasing: self.antialias,
            depth_of_field: self.aperture.map(lens),
            tone: Tone {
                exposure: self.exposure,
                map: match self.tone_map {
                    ToneMap::None => nerf_core::plan::ToneMap::None,
                    ToneMap::Reinhard => nerf_core::plan::ToneMap::Reinhard,
                    ToneMap::Filmic => nerf_core::plan::ToneMap::Filmic,
                },
                linear: self.linear || linear,
            },
        };
        let planned = plan.with_effects(effects);
        let flag = match planned {
            Err(PlanError::Effects(EffectError::Aperture { .. })) => "--aperture",
            Err(PlanError::Effects(EffectError::Focus { .. })) => "--focus",
            _ => "--exposure",
        };
        planned.context(flag)
    }
}
