//! What an import says in the end.

use super::Check;
use super::probe::{Probe, name};
use crate::data::pictures::colour;
use crate::measure::audit::Verdict;
use crate::model::engine::{Dense, Part};
use crate::model::export::Exported;
use crate::model::import::{Imported, Settings, Tensors};
use crate::system::summary::Short;
use crate::train::occupancy::LiveCells;
use nerf_core::Kernel;
use nerf_core::encoding::SinusoidalEncoding;
use nerf_core::network::Architecture;
use serde::Serialize;
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
    pub(super) tensors: &'a Tensors,
    pub(super) settings: &'a Settings,
    pub(super) kernel: Kernel,
    pub(super) network: Imported,
    /// Of what was exported.
    pub(super) architecture: Architecture,
    /// What view dependence gains, dB, and what became of it; `None` if that was not asked.
    pub(super) direction: Option<(f64, Verdict)>,
    pub(super) coarse: Option<Imported>,
    /// The blob.
    pub exported: Exported,
    /// Where the occupancy grid comes from.
    pub source: OccupancySource,
    /// The occupancy grid.
    pub cells: Option<LiveCells>,
    /// Whether it is part of the model.
    pub occupancy_required: bool,
    /// What the views showed.
    pub check: Option<Check>,
    /// What other guesses would have shown, the best first.
    pub guesses: Vec<Probe>,
}

impl Outcome<'_> {
    /// As lines for people; `output` is the blob's file.
    pub fn lines(&self, output: &Path) -> Vec<String> {
        let mut lines = self.network_lines();
        lines.extend(self.guessed_lines());
        lines.push(self.occupancy_line());
        lines.extend(self.check.as_ref().map(|check| self.check_lines(check)).unwrap_or_default());
        for Probe { flag, psnr_db } in &self.guesses {
            lines.push(format!("             {psnr_db:6.2} dB on a few pixels with {flag}"));
        }
        lines.push(format!("wrote        {} ({} bytes)", output.display(), self.exported.bytes.len()));
        lines
    }

    fn network_lines(&self) -> Vec<String> {
        let (s, a) = (self.settings, &self.network.model.architecture);
        let mut lines = Vec::new();
        lines.push(format!(
            "read         {} tensors of {}",
            self.tensors.tensors.len(),
            self.tensors.file.display()
        ));
        if !self.tensors.prefix.is_empty() {
            lines.push(format!("network      {}", self.tensors.prefix));
        }
        for other in &self.tensors.others {
            lines.push(format!("left out     {other}"));
        }
        for unused in &self.network.unused {
            lines.push(format!("not used     {unused}: no output depends on it"));
        }
        for layer in self.network.model.layers() {
            lines.push(format!("layer        {}", describe(&layer)));
        }
        if let Some(position) = a.position.sinusoidal() {
            lines.push(format!("position     {}", encoding(position, s)));
        }
        match a.direction.as_ref().and_then(|direction| direction.sinusoidal()) {
            Some(direction) => lines.push(format!("direction    {}", encoding(direction, s))),
            None => lines.push("direction    none: colour does not depend on it".to_owned()),
        }
        lines
    }

    fn guessed_lines(&self) -> Vec<String> {
        let s = self.settings;
        let mut lines = Vec::new();
        lines.push(format!(
            "taken as     density {}, background {}",
            name(s.density),
            colour::name(s.background)
        ));
        lines.push(format!(
            "             near {}, far {}, {} samples a ray, box {:?}",
            s.near, s.far, s.samples, s.scene_box
        ));
        if let (Some(coarse), Some(samples)) = (&self.coarse, s.coarse_samples) {
            let a = &coarse.model.architecture;
            lines.push(format!(
                "proposal     {} layers, {} parameters of densities, {samples} samples a ray; the {} are drawn \
                 from it",
                a.trunk.len(),
                a.density_parameters(),
                s.samples
            ));
        }
        lines
    }

    fn check_lines(&self, check: &Check) -> Vec<String> {
        let mut lines = Vec::new();
        lines.push(format!(
            "check        {:.3} dB PSNR, mean over {} views on {}, every third pixel and row",
            check.psnr_db(),
            check.scores.views.len(),
            colour::name(self.settings.background)
        ));
        lines.push(format!(
            "             f16 rounding cost {:.4} dB ({} subnormal weights)",
            check.quantisation_loss_db, self.exported.subnormal_weights
        ));
        if let Some(gain) = check.occupancy_gain_db {
            lines.push(format!("             the occupancy grid brings {gain:.3} dB"));
        }
        if let Some((gain, verdict)) = self.direction {
            let what = if verdict == Verdict::Drops { ": left out, its mean is in its place" } else { "" };
            lines.push(format!("             view dependence brings {gain:.3} dB{what}"));
        }
        lines
    }

    fn occupancy_line(&self) -> String {
        let Some(cells) = &self.cells else {
            let why =
                if self.source == OccupancySource::Built { ": the network is empty everywhere" } else { "" };
            return format!("occupancy    none{why}");
        };
        let origin = if self.source == OccupancySource::Built { "asked of the network" } else { "as given" };
        let role = if self.occupancy_required { "part of the model" } else { "only skips what is empty" };
        let occupied = 100.0 * cells.lookup().occupied_share();
        format!("occupancy    {:?} cells, {occupied:.2} % occupied, {origin}; {role}", cells.resolution())
    }

    /// The same for scripts; `output` is the blob's file.
    pub fn summary(&self, output: &Path) -> Summary<'_> {
        let (s, a) = (self.settings, &self.network.model.architecture);
        let skips = a.trunk.iter().enumerate().filter(|(_, layer)| layer.skip);
        let coarse = self.coarse.as_ref().zip(s.coarse_samples);
        let direction = self.direction.filter(|_| self.check.is_some());
        Summary {
            checkpoint: self.tensors.file.display().to_string(),
            tensors: self.tensors.tensors.len(),
            prefix: &self.tensors.prefix,
            networks_left_out: &self.tensors.others,
            unused_tensors: &self.network.unused,
            trunk_layers: a.trunk.len(),
            trunk_width: a.trunk_width(),
            position_levels: a.position.sinusoidal().map_or(0, |e| e.levels),
            direction_levels: a.direction.and_then(|d| d.sinusoidal().copied()).map_or(0, |e| e.levels),
            view_dependent: self.architecture.direction.is_some(),
            angle_scale: name(s.angle),
            order: name(s.order),
            density: name(s.density),
            background: colour::name(s.background),
            near: Short(s.near),
            far: Short(s.far),
            scene_box: s.scene_box.map(Short),
            samples_per_ray: s.samples,
            trained_parameters: self.network.parameters.len(),
            parameters: self.architecture.parameters(),
            subnormal_weights: self.exported.subnormal_weights,
            occupancy_required: self.occupancy_required,
            coarse_samples_per_ray: coarse.map(|(_, samples)| samples),
            coarse_parameters: coarse.map(|(coarse, _)| coarse.model.architecture.density_parameters()),
            skip_layers: skips.map(|(i, _)| i as f64).collect(),
            occupancy_resolution: self.cells.as_ref().map(|cells| cells.resolution().map(f64::from)),
            occupied_share: self.cells.as_ref().map(|cells| Short(cells.lookup().occupied_share())),
            check: self.check.as_ref().map(|check| CheckSummary {
                check_psnr_db: check.psnr_db(),
                check_views: check.scores.views.len(),
                suspicious: check.is_suspicious(),
                quantisation_loss_db: check.quantisation_loss_db,
                occupancy_gain_db: check.occupancy_gain_db,
                view_dependence_gain_db: direction.map(|(gain, _)| gain),
                view_dependence_left_out: direction.map(|(_, verdict)| verdict == Verdict::Drops),
            }),
            other_guesses: &self.guesses,
            kernel: self.kernel.to_string(),
            blob: output.display().to_string(),
            blob_bytes: self.exported.bytes.len(),
        }
    }
}

/// What was imported, for scripts.
#[derive(Debug, Serialize)]
pub struct Summary<'i> {
    checkpoint: String,
    tensors: usize,
    prefix: &'i str,
    networks_left_out: &'i [String],
    unused_tensors: &'i [String],
    trunk_layers: usize,
    trunk_width: usize,
    position_levels: u8,
    direction_levels: u8,
    view_dependent: bool,
    angle_scale: String,
    order: String,
    density: String,
    background: String,
    near: Short,
    far: Short,
    #[serde(rename = "box")]
    scene_box: [Short; 6],
    samples_per_ray: u16,
    trained_parameters: usize,
    parameters: usize,
    subnormal_weights: usize,
    occupancy_required: bool,
    #[serde(skip_serializing_if = "Option::is_none")]
    coarse_samples_per_ray: Option<u16>,
    #[serde(skip_serializing_if = "Option::is_none")]
    coarse_parameters: Option<usize>,
    skip_layers: Vec<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    occupancy_resolution: Option<[f64; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    occupied_share: Option<Short>,
    #[serde(flatten)]
    check: Option<CheckSummary>,
    #[serde(skip_serializing_if = "<[Probe]>::is_empty")]
    other_guesses: &'i [Probe],
    kernel: String,
    blob: String,
    blob_bytes: usize,
}

/// What the check of an import found.
#[derive(Debug, Serialize)]
struct CheckSummary {
    check_psnr_db: f64,
    check_views: usize,
    suspicious: bool,
    quantisation_loss_db: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    occupancy_gain_db: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    view_dependence_gain_db: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    view_dependence_left_out: Option<bool>,
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
