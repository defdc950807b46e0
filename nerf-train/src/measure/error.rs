//! Why a study or an audit cannot be made.

use crate::data::pictures::rgb::ReportError;
use crate::measure::import::ImportError;
use crate::model::export::ExportError;
use crate::system::output::OutputError;
use nerf_core::blob::BlobError;
use nerf_core::camera::CameraError;
use nerf_core::plan::PlanError;
use nerf_core::render::RenderError;
use std::path::PathBuf;

/// Why a study or an audit cannot be made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs, reason = "the names say what they are")]
pub enum StudyError {
    #[error("{0}")]
    Blob(#[from] BlobError),
    #[error("blob: expected a scene, found a 2D field")]
    NotAScene,
    #[error("views: expected at least one, found none")]
    NoViews,
    #[error("{0}")]
    Export(#[from] ExportError),
    #[error("{0}")]
    Plan(#[from] PlanError),
    #[error("{0}")]
    Render(#[from] RenderError),
    #[error("camera: {0}")]
    Camera(#[from] CameraError),
    #[error("--source: {0}")]
    Source(#[from] ImportError),
    #[error("--source: expected the network that the blob was rounded from, found another: {found}")]
    OtherSource { found: String },
    #[error("--beside: {}: expected the points.csv of a study, found {found}", path.display())]
    Beside { path: PathBuf, found: String },
    #[error("{0}")]
    Output(#[from] OutputError),
    #[error("{0}")]
    Report(#[from] ReportError),
}
