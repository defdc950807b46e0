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
    /// The blob, or a variant of it, cannot be opened or written.
    #[error("{0}")]
    Blob(#[from] BlobError),
    /// The blob is a 2D field.
    #[error("blob: expected a scene, found a 2D field")]
    NotAScene,
    /// There are no views to measure on.
    #[error("views: expected at least one, found none")]
    NoViews,
    /// A variant's parameters do not fit f16.
    #[error("{0}")]
    Export(#[from] ExportError),
    /// It cannot be rendered as asked.
    #[error("{0}")]
    Plan(#[from] PlanError),
    /// It could not be rendered.
    #[error("{0}")]
    Render(#[from] RenderError),
    /// A view's camera cannot be made smaller.
    #[error("camera: {0}")]
    Camera(#[from] CameraError),
    /// The unrounded network cannot be read.
    #[error("--source: {0}")]
    Source(#[from] ImportError),
    /// The unrounded network is another one.
    #[error("--source: expected the network that the blob was rounded from, found another: {found}")]
    OtherSource { found: String },
    /// What is to stand beside it is no table of a study.
    #[error("--beside: {}: expected the points.csv of a study, found {found}", path.display())]
    Beside { path: PathBuf, found: String },
    /// A file cannot be written.
    #[error("{0}")]
    Output(#[from] OutputError),
    /// A picture, plot or table cannot be made.
    #[error("{0}")]
    Report(#[from] ReportError),
}
