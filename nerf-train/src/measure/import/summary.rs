//! Summary of an import, which the command `import` prints.

use super::{Check, Import};
use crate::data::pictures::colour;
use crate::measure::audit::Verdict;
use crate::model::export::Exported;
use crate::system::input::value_name;
use crate::system::summary::Short;
use serde::Serialize;
use std::path::Path;

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
    kernel: String,
    blob: String,
    blob_bytes: usize,
}

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

impl<'i> Summary<'i> {
    pub fn of(import: &'i Import<'_>, exported: &Exported, output: &Path) -> Self {
        let (tensors, s) = (import.request.tensors, import.request.settings);
        let a = &import.network.model.architecture;
        let skips = a.trunk.iter().enumerate().filter(|(_, layer)| layer.skip);
        let coarse = import.coarse.as_ref();
        let of_check = |check: &Check| CheckSummary {
            check_psnr_db: check.psnr_db(),
            check_views: check.scores.views.len(),
            suspicious: check.is_suspicious(),
            quantisation_loss_db: check.quantisation_loss_db,
            occupancy_gain_db: check.occupancy_gain_db,
            view_dependence_gain_db: import.direction.map(|(gain, _)| gain),
            view_dependence_left_out: import.direction.map(|(_, verdict)| verdict == Verdict::Drops),
        };
        Self {
            checkpoint: tensors.file.display().to_string(),
            tensors: tensors.tensors.len(),
            prefix: &tensors.prefix,
            networks_left_out: &tensors.others,
            unused_tensors: &import.network.unused,
            trunk_layers: a.trunk.len(),
            trunk_width: a.trunk_width(),
            position_levels: a.position.sinusoidal().map_or(0, |e| e.levels),
            direction_levels: a.direction.and_then(|d| d.sinusoidal().copied()).map_or(0, |e| e.levels),
            view_dependent: import.architecture.direction.is_some(),
            angle_scale: value_name(&s.angle_scale),
            order: value_name(&s.order),
            density: value_name(&s.density),
            background: colour::name(s.background),
            near: Short(s.near),
            far: Short(s.far),
            scene_box: s.scene_box.map(Short),
            samples_per_ray: s.samples(coarse.is_some()),
            trained_parameters: import.network.parameters.len(),
            parameters: import.architecture.parameters(),
            subnormal_weights: exported.subnormal_weights,
            occupancy_required: import.occupancy_required,
            coarse_samples_per_ray: coarse.map(|_| s.coarse_samples),
            coarse_parameters: coarse.map(|(coarse, _)| coarse.model.architecture.density_parameters()),
            skip_layers: skips.map(|(i, _)| i as f64).collect(),
            occupancy_resolution: import.cells.as_ref().map(|cells| cells.resolution().map(f64::from)),
            occupied_share: import.cells.as_ref().map(|cells| Short(cells.lookup().occupied_share())),
            check: import.check.as_ref().map(of_check),
            kernel: import.request.kernel.to_string(),
            blob: output.display().to_string(),
            blob_bytes: exported.bytes.len(),
        }
    }
}
