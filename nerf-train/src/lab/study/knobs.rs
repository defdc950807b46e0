//! Knobs of a study: settings that trade accuracy for time, with functions to read, copy and vary each setting.

use crate::measure::bench::Variants;
use crate::measure::point::{MATHS, Precision, Settings};
use nerf_core::blob::MAX_SAMPLES;
use nerf_core::{Isa, Kernel, Storage};

pub struct Knob {
    pub name: &'static str,
    /// Whether points of a blob's Pareto front store this setting. If false, all of them use its base value.
    pub in_blob: bool,
    /// Whether values of this knob are also tried in combination with values of other knobs.
    pub combines: bool,
    /// Copies this setting from the first argument to the second.
    pub copy: fn(&Settings, &mut Settings),
    pub read: fn(&Variants<'_>, &Settings) -> String,
    /// Returns copies of the base settings (second argument), each with another value of this knob.
    pub values: fn(&Variants<'_>, Settings) -> Vec<Settings>,
}

/// Numbers of samples per ray to try if rays are not marched, as fractions (3/8 is `(3, 8)`) of the number in training.
const SAMPLES: [(u32, u32); 7] = [(1, 4), (3, 8), (1, 2), (5, 8), (3, 4), (3, 2), (2, 1)];
/// Lengths of the march step to try if rays are marched, in per cent of the length in training.
const STEPS: [u32; 5] = [50, 75, 125, 150, 200];
const TRANSMITTANCE: [f32; 6] = [0.0, 1e-3, 3e-2, 0.1, 0.2, 0.3];
const COLOUR: [f32; 5] = [0.0, 1e-2, 3e-2, 0.1, 0.2];

const RAYS: [u16; 2] = [2, 4];

/// All knobs, in the order of the report. An entry here adds a setting to the study.
pub const KNOBS: &[Knob] = &[
    Knob {
        name: "samples",
        in_blob: true,
        combines: true,
        copy: |from, to| to.quality.samples = from.quality.samples,
        read: |lab, s| match (lab.is_marched(), s.quality.samples) {
            // The march step sets the number of samples.
            (true, _) => String::new(),
            (false, 0) => lab.scene.samples().to_string(),
            (false, samples) => samples.to_string(),
        },
        values: |lab, base| {
            let own = u32::from(lab.scene.samples());
            let count = |(n, d): (u32, u32)| (own * n / d).clamp(1, u32::from(MAX_SAMPLES)) as u16;
            let counts = SAMPLES.into_iter().filter(|_| !lab.is_marched()).map(count);
            vary(base, counts, |s, samples| s.quality.samples = samples)
        },
    },
    Knob {
        name: "march step",
        in_blob: true,
        combines: true,
        copy: |from, to| to.quality.samples = from.quality.samples,
        read: |lab, s| match lab.is_marched() {
            true => format!("{}×", (100.0 * lab.step_share(s)).round() / 100.0),
            false => String::new(),
        },
        values: |lab, base| {
            let own = u32::from(lab.scene.samples());
            let count =
                |share: u32| ((100 * own + share / 2) / share).clamp(1, u32::from(MAX_SAMPLES)) as u16;
            let counts = STEPS.into_iter().filter(|_| lab.is_marched()).map(count);
            vary(base, counts, |s, samples| s.quality.samples = samples)
        },
    },
    Knob {
        name: "transmittance cut",
        in_blob: true,
        combines: true,
        copy: |from, to| to.quality.transmittance_cut = from.quality.transmittance_cut,
        read: |_, s| s.quality.transmittance_cut.to_string(),
        values: |_, base| vary(base, TRANSMITTANCE, |s, cut| s.quality.transmittance_cut = cut),
    },
    Knob {
        name: "colour cut",
        in_blob: true,
        combines: true,
        copy: |from, to| to.quality.colour_cut = from.quality.colour_cut,
        read: |_, s| s.quality.colour_cut.to_string(),
        values: |_, base| vary(base, COLOUR, |s, cut| s.quality.colour_cut = cut),
    },
    Knob {
        name: "occupancy",
        in_blob: true,
        combines: false,
        copy: |from, to| to.quality.occupancy = from.quality.occupancy,
        read: |_, s| if s.quality.occupancy { "on" } else { "off" }.into(),
        values: |lab, base| {
            let can = lab.has_occupancy(0) && !lab.scene.occupancy_required;
            vary(base, can.then_some(false), |s, on| s.quality.occupancy = on)
        },
    },
    Knob {
        name: "proposal",
        in_blob: true,
        combines: true,
        copy: |from, to| to.quality.proposal = from.quality.proposal,
        read: |lab, s| if lab.has_proposal() && s.quality.proposal { "on" } else { "off" }.into(),
        values: |lab, base| vary(base, lab.has_proposal().then_some(false), |s, on| s.quality.proposal = on),
    },
    Knob {
        name: "file",
        in_blob: false,
        combines: true,
        copy: |from, to| to.variant = from.variant,
        read: |lab, s| lab.variants[s.variant].name.clone(),
        values: |lab, base| vary(base, 1..lab.variants.len(), |s, variant| s.variant = variant),
    },
    Knob {
        name: "maths",
        in_blob: false,
        combines: false,
        copy: |from, to| to.quality.math = from.quality.math,
        read: |_, s| {
            let own = MATHS.iter().find(|(_, math)| *math == s.quality.math);
            own.map_or("other", |(name, _)| name).into()
        },
        values: |_, base| vary(base, MATHS.into_iter().skip(1), |s, (_, math)| s.quality.math = math),
    },
    Knob {
        name: "weights",
        in_blob: false,
        combines: false,
        copy: |from, to| to.precision = from.precision,
        read: |_, s| if s.precision == Precision::Rounded { "f16" } else { "f32" }.into(),
        values: |lab, base| {
            vary(base, lab.source.is_some().then_some(Precision::Unrounded), |s, p| s.precision = p)
        },
    },
    Knob {
        name: "kernel",
        in_blob: false,
        combines: false,
        copy: |from, to| to.kernel = from.kernel,
        read: |_, s| s.kernel.to_string(),
        values: |_, base| {
            // Kernels that read the blob's bytes render as f32 kernels do: only the portable one, the oracle, is used.
            let differs = |it: &Kernel| {
                *it == Kernel::IN_PLACE || it.isa != Isa::Portable && it.storage != Storage::F16
            };
            let kernels = Kernel::all().filter(differs).filter(|it| *it != base.kernel);
            vary(base, kernels, |s, kernel| s.kernel = kernel)
        },
    },
    Knob {
        name: "size",
        in_blob: false,
        combines: true,
        copy: |from, to| to.quarters = from.quarters,
        read: |_, s| match s.quarters {
            4 => "whole".into(),
            2 => "1/2".into(),
            quarters => format!("{quarters}/4"),
        },
        values: |_, base| vary(base, [3, 2, 1], |s, quarters| s.quarters = quarters),
    },
    Knob {
        name: "rays a pixel",
        in_blob: false,
        combines: true,
        copy: |from, to| to.rays = from.rays,
        read: |_, s| s.rays.to_string(),
        values: |_, base| vary(base, RAYS, |s, rays| s.rays = rays),
    },
];

fn vary<T>(
    base: Settings,
    values: impl IntoIterator<Item = T>,
    set: impl Fn(&mut Settings, T),
) -> Vec<Settings> {
    let with = |value| {
        let mut settings = base;
        set(&mut settings, value);
        settings
    };
    values.into_iter().map(with).collect()
}

/// Returns the knobs in which `settings` differ from `base`, with their values: "samples 48, kernel avx512-bf16".
pub fn difference(lab: &Variants<'_>, base: &Settings, settings: &Settings) -> String {
    let changed = KNOBS.iter().filter(|knob| (knob.read)(lab, base) != (knob.read)(lab, settings));
    let parts: Vec<String> =
        changed.map(|knob| format!("{} {}", knob.name, (knob.read)(lab, settings))).collect();
    parts.join(", ")
}

/// Whether a blob's Pareto front can store `settings`: all differences from `base` are in knobs with [`Knob::in_blob`].
pub fn fits_blob(lab: &Variants<'_>, base: &Settings, settings: &Settings) -> bool {
    let same = |knob: &Knob| (knob.read)(lab, base) == (knob.read)(lab, settings);
    KNOBS.iter().filter(|knob| !knob.in_blob).all(same)
}
