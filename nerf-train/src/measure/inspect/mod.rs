//! Contents of a scene file, for the command `inspect`.

use crate::data::pictures::colour;
use crate::system::summary::Short;
use nerf_core::blob::{Blob, FrontPoint, StoredTables};
use nerf_core::encoding::DirectionEncoding;
use nerf_core::network::Layer;
use serde::Serialize;
use std::path::Path;

/// Contents of a scene file; parts that the file does not have are left out.
#[derive(Debug, Serialize)]
pub struct Inspection<'b> {
    pub file: String,
    pub blob_bytes: usize,
    pub format_version: u16,
    pub kind: &'static str,
    pub position_levels: u8,
    pub direction_levels: u8,
    pub view_dependent: bool,
    pub layers: Vec<LayerSummary>,
    pub parameters: usize,
    pub weight_bytes: usize,
    pub density_macs: usize,
    pub colour_macs: usize,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub harmonics_degree: Option<u8>,
    #[serde(flatten)]
    pub grid: Option<GridSummary>,
    #[serde(flatten)]
    pub scene: Option<SceneSummary>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub width_px: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub height_px: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub occupancy_resolution: Option<[f64; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub occupied_share: Option<Short>,
    #[serde(flatten)]
    pub proposal: Option<ProposalSummary>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub front: Vec<PointSummary>,
    pub data: &'b str,
    pub made_by: &'b str,
    pub steps: u32,
    pub seed: u64,
    pub trained_parameters: u32,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub psnr_db: Option<Short>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub psnr_convention: Option<&'b str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub quantisation_loss_db: Option<Short>,
}

#[derive(Debug, Serialize)]
pub struct SceneSummary {
    pub box_min: [Short; 3],
    pub box_max: [Short; 3],
    pub near: Short,
    pub far: Short,
    pub samples_per_ray: u16,
    pub step: Short,
    pub background: String,
    pub occupancy_required: bool,
    #[serde(flatten)]
    pub viewpoint: Option<ViewpointSummary>,
}

#[derive(Debug, Serialize)]
pub struct ViewpointSummary {
    pub viewpoint_eye: [Short; 3],
    pub viewpoint_target: [Short; 3],
    pub viewpoint_up: [Short; 3],
    pub viewpoint_arc_deg: Short,
}

#[derive(Debug, Serialize)]
pub struct ProposalSummary {
    pub proposal_samples_per_ray: u16,
    pub proposal_macs: usize,
    pub proposal_weight_bytes: usize,
}

impl<'b> Inspection<'b> {
    /// Returns the contents of `blob`. `bytes`: the blob's bytes; `file`: the file that holds them.
    pub fn of(file: &Path, bytes: &[u8], blob: &'b Blob<'_>) -> Self {
        let (a, p) = (blob.architecture(), blob.provenance());
        let harmonics_degree = match a.direction {
            Some(DirectionEncoding::SphericalHarmonics { degree }) => Some(degree),
            _ => None,
        };
        let (picture, occupancy) = (blob.picture(), blob.occupancy());
        let layer = |layer: &Layer| LayerSummary {
            role: format!("{:?}", layer.role),
            main_inputs: layer.main,
            extra_inputs: layer.extra,
            outputs: layer.outputs,
        };
        let point = |p: &FrontPoint| PointSummary {
            samples_per_ray: p.samples,
            transmittance_cut: Short(p.transmittance_cut),
            colour_cut: Short(p.colour_cut),
            occupancy: p.occupancy,
            math: p.math,
            proposal: p.proposal,
            loss_db: Short(p.loss_db),
            cost: Short(p.cost),
        };
        Self {
            file: file.display().to_string(),
            blob_bytes: bytes.len(),
            format_version: nerf_core::blob::FORMAT_VERSION,
            kind: if blob.scene().is_some() { "scene" } else { "2D field" },
            position_levels: a.position.sinusoidal().map_or(0, |encoding| encoding.levels),
            direction_levels: a.direction.and_then(|d| d.sinusoidal().copied()).map_or(0, |e| e.levels),
            view_dependent: a.direction.is_some(),
            layers: blob.layers().iter().map(layer).collect(),
            parameters: a.parameters(),
            weight_bytes: blob.weights().len(),
            density_macs: a.density_macs(),
            colour_macs: a.colour_macs(),
            harmonics_degree,
            grid: GridSummary::of(blob),
            scene: blob.scene().map(|scene| SceneSummary {
                box_min: scene.min.map(Short),
                box_max: scene.max.map(Short),
                near: Short(scene.near),
                far: Short(scene.far),
                samples_per_ray: scene.samples(),
                step: Short(scene.step()),
                background: colour::name(scene.background),
                occupancy_required: scene.occupancy_required,
                viewpoint: scene.viewpoint.map(|viewpoint| ViewpointSummary {
                    viewpoint_eye: viewpoint.eye.map(Short),
                    viewpoint_target: viewpoint.target.map(Short),
                    viewpoint_up: viewpoint.up.map(Short),
                    viewpoint_arc_deg: Short(viewpoint.arc.to_degrees()),
                }),
            }),
            width_px: picture.map(|picture| picture.width),
            height_px: picture.map(|picture| picture.height),
            occupancy_resolution: occupancy.map(|occupancy| occupancy.resolution().map(f64::from)),
            occupied_share: occupancy.map(|occupancy| Short(occupancy.occupied_share())),
            proposal: blob.proposal().map(|proposal| ProposalSummary {
                proposal_samples_per_ray: proposal.samples,
                proposal_macs: proposal.architecture().density_macs(),
                proposal_weight_bytes: proposal.weights.len(),
            }),
            front: blob.front().iter().map(point).collect(),
            data: p.data,
            made_by: p.made_by,
            steps: p.steps,
            seed: p.seed,
            trained_parameters: p.trained_parameters,
            psnr_db: p.psnr_db.map(Short),
            psnr_convention: p.psnr_db.map(|_| p.psnr_convention),
            quantisation_loss_db: p.quantisation_loss_db.map(Short),
        }
    }
}

#[derive(Debug, Serialize)]
pub struct PointSummary {
    pub samples_per_ray: u16,
    pub transmittance_cut: Short,
    pub colour_cut: Short,
    pub occupancy: bool,
    pub math: u8,
    pub proposal: bool,
    pub loss_db: Short,
    pub cost: Short,
}

#[derive(Debug, Serialize)]
pub struct LayerSummary {
    pub role: String,
    pub main_inputs: usize,
    pub extra_inputs: usize,
    pub outputs: usize,
}

#[derive(Debug, Serialize)]
pub struct GridSummary {
    pub grid_levels: usize,
    pub grid_features: u8,
    pub grid_log2_entries: u8,
    pub grid_coarsest_cells: u16,
    pub grid_finest_cells: u16,
    pub grid_values: usize,
    pub grid_storage: &'static str,
    pub grid_bytes: usize,
}

impl GridSummary {
    pub fn of(blob: &Blob<'_>) -> Option<Self> {
        let grid = blob.architecture().position.grid()?;
        // Number of cells along the longest side.
        let cells =
            |level: Option<&[u16; 3]>| level.and_then(|level| level.iter().max().copied()).unwrap_or(0);
        let tables = blob.tables();
        let bytes = |tables: &StoredTables<'_>| tables.bytes().len() + tables.scales().map_or(0, <[u8]>::len);
        Some(Self {
            grid_levels: grid.resolutions.len(),
            grid_features: grid.features,
            grid_log2_entries: grid.log2_entries,
            grid_coarsest_cells: cells(grid.resolutions.first()),
            grid_finest_cells: cells(grid.resolutions.last()),
            grid_values: grid.values(),
            grid_storage: tables.as_ref().map_or("", |tables| tables.name()),
            grid_bytes: tables.as_ref().map_or(0, bytes),
        })
    }
}
