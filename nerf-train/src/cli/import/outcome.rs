//! What an import says in the end.

use crate::cli::common::background_name;
use crate::measure::audit::Verdict;
use crate::measure::import::Check;
use crate::measure::import::probe::{Probe, name};
use crate::model::engine::{Dense, Part};
use crate::model::export::Exported;
use crate::model::import::{Imported, Settings, Tensors};
use crate::show::summary::Summary;
use crate::train::occupancy::LiveCells;
use nerf_core::Kernel;
use nerf_core::encoding::SinusoidalEncoding;
use nerf_core::network::Architecture;
use std::path::Path;

/// Where the occupancy grid comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OccupancySource {
    /// A file.
    Given,
    /// The network.
    Built,
    /// There is to be none.
    None,
}

/// Everything there is to say.
pub struct Outcome<'a> {
    pub tensors: &'a Tensors,
    pub network: &'a Imported,
    /// Of what was written.
    pub architecture: &'a Architecture,
    /// What view dependence gains, dB, and what became of it; `None` if that was not asked.
    pub direction: Option<(f64, Verdict)>,
    pub coarse: Option<&'a Imported>,
    pub settings: &'a Settings,
    pub exported: &'a Exported,
    pub occupancy: OccupancySource,
    pub cells: Option<&'a LiveCells>,
    pub occupancy_required: bool,
    pub check: Option<&'a Check>,
    pub probes: &'a [Probe],
    pub output: &'a Path,
}

impl Outcome<'_> {
    /// As lines.
    pub fn print(&self) -> anyhow::Result<()> {
        let (s, a) = (self.settings, &self.network.model.architecture);
        outln!("read         {} tensors of {}", self.tensors.tensors.len(), self.tensors.file.display());
        if !self.tensors.prefix.is_empty() {
            outln!("network      {}", self.tensors.prefix);
        }
        for other in &self.tensors.others {
            outln!("left out     {other}");
        }
        for unused in &self.network.unused {
            outln!("not used     {unused}: no output depends on it");
        }
        for layer in self.network.model.layers() {
            outln!("layer        {}", describe(&layer));
        }
        if let Some(position) = a.position.sinusoidal() {
            outln!("position     {}", encoding(position, s));
        }
        match a.direction.as_ref().and_then(|direction| direction.sinusoidal()) {
            Some(direction) => outln!("direction    {}", encoding(direction, s)),
            None => outln!("direction    none: colour does not depend on it"),
        }
        outln!("taken as     density {}, background {}", name(s.density), background_name(s.background));
        outln!(
            "             near {}, far {}, {} samples a ray, box {:?}",
            s.near,
            s.far,
            s.samples,
            s.scene_box
        );
        if let (Some(coarse), Some(samples)) = (self.coarse, s.coarse_samples) {
            let a = &coarse.model.architecture;
            outln!(
                "proposal     {} layers, {} parameters of densities, {samples} samples a ray; the {} are drawn \
                 from it",
                a.trunk.len(),
                a.density_parameters(),
                s.samples
            );
        }
        self.print_occupancy()?;
        if let Some(check) = self.check {
            outln!(
                "check        {:.3} dB PSNR, mean over {} views on {}, every third pixel and row",
                check.psnr_db(),
                check.scores.views.len(),
                background_name(s.background)
            );
            outln!(
                "             f16 rounding cost {:.4} dB ({} subnormal weights)",
                check.quantisation_loss_db,
                self.exported.subnormal_weights
            );
            if let Some(gain) = check.occupancy_gain_db {
                outln!("             the occupancy grid brings {gain:.3} dB");
            }
            if let Some((gain, verdict)) = self.direction {
                let what =
                    if verdict == Verdict::Drops { ": left out, its mean is in its place" } else { "" };
                outln!("             view dependence brings {gain:.3} dB{what}");
            }
        }
        for Probe { flag, psnr_db } in self.probes {
            outln!("             {psnr_db:6.2} dB on a few pixels with {flag}");
        }
        outln!("wrote        {} ({} bytes)", self.output.display(), self.exported.bytes.len());
        Ok(())
    }

    fn print_occupancy(&self) -> anyhow::Result<()> {
        let Some(cells) = self.cells else {
            let why = if self.occupancy == OccupancySource::Built {
                ": the network is empty everywhere"
            } else {
                ""
            };
            outln!("occupancy    none{why}");
            return Ok(());
        };
        let origin =
            if self.occupancy == OccupancySource::Built { "asked of the network" } else { "as given" };
        let role = if self.occupancy_required { "part of the model" } else { "only skips what is empty" };
        let occupied = 100.0 * cells.lookup().occupied_share();
        outln!("occupancy    {:?} cells, {occupied:.2} % occupied, {origin}; {role}", cells.resolution());
        Ok(())
    }

    /// As fields.
    pub fn summary(&self, kernel: Kernel) -> Summary {
        let (s, a) = (self.settings, &self.network.model.architecture);
        let mut summary = Summary::new();
        summary
            .text("checkpoint", self.tensors.file.display().to_string())
            .integer("tensors", self.tensors.tensors.len() as u64)
            .text("prefix", self.tensors.prefix.clone())
            .texts("networks_left_out", self.tensors.others.clone())
            .texts("unused_tensors", self.network.unused.clone())
            .integer("trunk_layers", a.trunk.len() as u64)
            .integer("trunk_width", a.trunk_width() as u64)
            .integer("position_levels", a.position.sinusoidal().map_or(0, |e| u64::from(e.levels)))
            .integer(
                "direction_levels",
                a.direction.and_then(|d| d.sinusoidal().copied()).map_or(0, |e| u64::from(e.levels)),
            )
            .flag("view_dependent", self.architecture.direction.is_some())
            .text("angle_scale", name(s.angle))
            .text("order", name(s.order))
            .text("density", name(s.density))
            .text("background", background_name(s.background))
            .number_f32("near", s.near)
            .number_f32("far", s.far)
            .numbers_f32("box", &s.scene_box)
            .integer("samples_per_ray", u64::from(s.samples))
            .integer("trained_parameters", self.network.parameters.len() as u64)
            .integer("parameters", self.architecture.parameters() as u64)
            .integer("subnormal_weights", self.exported.subnormal_weights as u64)
            .flag("occupancy_required", self.occupancy_required);
        if let (Some(coarse), Some(samples)) = (self.coarse, s.coarse_samples) {
            summary
                .integer("coarse_samples_per_ray", u64::from(samples))
                .integer("coarse_parameters", coarse.model.architecture.density_parameters() as u64);
        }
        let skips = a.trunk.iter().enumerate().filter(|(_, layer)| layer.skip);
        summary.numbers("skip_layers", &skips.map(|(i, _)| i as f64).collect::<Vec<_>>());
        if let Some(cells) = self.cells {
            summary
                .numbers("occupancy_resolution", &cells.resolution().map(f64::from))
                .number_f32("occupied_share", cells.lookup().occupied_share());
        }
        if let Some(check) = self.check {
            summary
                .number("check_psnr_db", check.psnr_db())
                .integer("check_views", check.scores.views.len() as u64)
                .flag("suspicious", check.is_suspicious())
                .number("quantisation_loss_db", check.quantisation_loss_db);
            if let Some(gain) = check.occupancy_gain_db {
                summary.number("occupancy_gain_db", gain);
            }
            if let Some((gain, verdict)) = self.direction {
                summary
                    .number("view_dependence_gain_db", gain)
                    .flag("view_dependence_left_out", verdict == Verdict::Drops);
            }
        }
        if !self.probes.is_empty() {
            let fields = |probe: &Probe| {
                let mut fields = Summary::new();
                fields.text("flag", probe.flag.clone()).number("psnr_db", probe.psnr_db);
                fields
            };
            summary.sections("other_guesses", self.probes.iter().map(fields).collect());
        }
        summary
            .text("kernel", kernel.to_string())
            .text("blob", self.output.display().to_string())
            .integer("blob_bytes", self.exported.bytes.len() as u64);
        summary
    }
}

fn encoding(encoding: &SinusoidalEncoding, settings: &Settings) -> String {
    let identity = if encoding.identity { "with" } else { "without" };
    format!(
        "{} levels, {identity} the inputs themselves, s = {}, order {}",
        encoding.levels,
        name(settings.angle),
        name(settings.order)
    )
}

fn describe(layer: &Dense) -> String {
    let Dense { part, main, extra, outputs, .. } = *layer;
    let inputs = if extra > 0 { format!("{main} + {extra}") } else { main.to_string() };
    let folded = if part == Part::Feature { ", folded away" } else { "" };
    format!("{part:?}: {inputs} → {outputs}{folded}")
}
