//! Which other guess would have shown the scene.

use super::thinned;
use crate::data::{Axes, View};
use crate::measure::eval::{EvalError, measure};
use crate::model::export::{Contents, Tables, export};
use crate::model::import::{AngleFactor, Identity, ImportError, Order, Settings, Tensors, network};
use clap::ValueEnum;
use nerf_core::Kernel;
use nerf_core::blob::{Content, Provenance};
use nerf_core::camera::Camera;
use nerf_core::plan::Quality;
use serde::Serialize;

/// Views that are looked at, each thinned twice.
const VIEWS: usize = 3;

/// Why the guesses could not be tried.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ProbeError {
    /// The file is no network of these settings.
    #[error(transparent)]
    Import(#[from] ImportError),
    /// It could not be rendered.
    #[error(transparent)]
    Eval(#[from] EvalError),
}

/// One change of the settings, and what it would have brought.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Probe {
    /// The flag, with its value.
    pub flag: String,
    /// Mean PSNR over some sparse pixels, dB.
    pub psnr_db: f64,
}

/// Tries every single other guess without an occupancy grid, the best first.
///
/// `views`: as they were read with `axes`.
///
/// # Errors
/// [`ProbeError`] if a network cannot be exported or rendered.
pub fn probe(
    tensors: &Tensors,
    settings: &Settings,
    axes: Axes,
    kernel: Kernel,
    views: &[View],
) -> Result<Vec<Probe>, ProbeError> {
    let sparse: Vec<View> = views.iter().take(VIEWS).map(|view| thinned(&thinned(view))).collect();
    let turned: Vec<View> = sparse.iter().map(turned).collect();
    let mut probes = Vec::new();
    for (flag, settings) in alternatives(settings) {
        // Not every order goes with every file.
        if let Ok(psnr_db) = score(tensors, &settings, kernel, &sparse) {
            probes.push(Probe { flag, psnr_db });
        }
    }
    let psnr_db = score(tensors, settings, kernel, &turned)?;
    probes.push(Probe { flag: format!("--axes {}", axes.other()), psnr_db });
    probes.sort_by(|a, b| b.psnr_db.total_cmp(&a.psnr_db));
    Ok(probes)
}

/// Settings that differ in one guess, with the flag that says so.
fn alternatives(settings: &Settings) -> Vec<(String, Settings)> {
    let mut all = Vec::new();
    let mut add = |flag: &str, value: &str, changed: Settings| {
        if changed != *settings {
            all.push((format!("--{flag} {value}"), changed));
        }
    };
    for angle in [AngleFactor::One, AngleFactor::Pi] {
        add("angle-scale", name(angle).as_str(), Settings { angle, ..settings.clone() });
    }
    for &order in Order::value_variants() {
        add("order", name(order).as_str(), Settings { order, ..settings.clone() });
    }
    if settings.identity != Some(Identity::Last) {
        add("identity", "last", Settings { identity: Some(Identity::Last), ..settings.clone() });
    }
    for (value, background) in [("black", [0.0; 3]), ("white", [1.0; 3])] {
        add("background", value, Settings { background, ..settings.clone() });
    }
    all
}

/// What the command line calls a value.
pub fn name(value: impl ValueEnum) -> String {
    value.to_possible_value().map_or_else(String::new, |value| value.get_name().to_owned())
}

fn score(tensors: &Tensors, settings: &Settings, kernel: Kernel, views: &[View]) -> Result<f64, ProbeError> {
    let network = network(tensors, settings)?;
    let blob = export(&Contents {
        architecture: &network.model.architecture,
        parameters: &network.folded(),
        tables: Tables::None,
        content: Content::Scene(settings.facts(false)),
        occupancy: None,
        provenance: Provenance::NONE,
    })
    .map_err(ImportError::from)?;
    let quality = Quality::default();
    let scores = measure(&blob.bytes, None, kernel, &quality, settings.background, views, |_, _, _, _| {})?;
    Ok(scores.psnr_db().unwrap_or(f64::NAN))
}

/// A view as it would have been read in the other convention.
fn turned(view: &View) -> View {
    let camera = &view.camera;
    let pose = Axes::Opencv.to_opengl(*camera.pose());
    let turned = Camera::new(*camera.intrinsics(), *camera.lens(), pose);
    View { camera: turned.unwrap_or(*camera), ..view.clone() }
}
