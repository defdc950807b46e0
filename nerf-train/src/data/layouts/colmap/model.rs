//! COLMAP's camera models.

use crate::data::DatasetError;
use crate::data::pictures::photo::Optics;
use nerf_core::camera::{Lens, Projection};
use std::path::Path;

#[derive(Clone, Debug)]
pub(crate) struct Camera {
    kind: &'static Kind,
    width: u64,
    height: u64,
    parameters: Vec<f64>,
}

#[derive(Debug)]
pub(crate) struct Kind {
    /// Name of the camera model in text files.
    name: &'static str,
    pub(crate) parameters: usize,
    /// Whether x and y have separate focal lengths.
    two_focals: bool,
    /// Makes the lens from the parameters after the principal point; `None` if the lens is not supported.
    lens: Option<fn(&[f64]) -> Lens>,
}

/// All camera models of COLMAP 4.2, indexed by the model's number in binary files.
///
/// # Source
/// `src/colmap/sensor/models.h`
static KINDS: [Kind; 18] = {
    const fn kind(
        name: &'static str,
        parameters: usize,
        two_focals: bool,
        lens: Option<fn(&[f64]) -> Lens>,
    ) -> Kind {
        Kind { name, parameters, two_focals, lens }
    }
    [
        kind("SIMPLE_PINHOLE", 3, false, Some(radial_tangential)),
        kind("PINHOLE", 4, true, Some(radial_tangential)),
        kind("SIMPLE_RADIAL", 4, false, Some(radial_tangential)),
        kind("RADIAL", 5, false, Some(radial_tangential)),
        kind("OPENCV", 8, true, Some(radial_tangential)),
        kind("OPENCV_FISHEYE", 8, true, Some(fisheye)),
        kind("FULL_OPENCV", 12, true, Some(radial_tangential)),
        kind("FOV", 5, true, None),
        kind("SIMPLE_RADIAL_FISHEYE", 4, false, Some(fisheye)),
        kind("RADIAL_FISHEYE", 5, false, Some(fisheye)),
        kind("THIN_PRISM_FISHEYE", 12, true, None),
        kind("RAD_TAN_THIN_PRISM_FISHEYE", 16, true, None),
        kind("SIMPLE_DIVISION", 4, false, None),
        kind("DIVISION", 5, true, None),
        kind("SIMPLE_FISHEYE", 3, false, Some(fisheye)),
        kind("FISHEYE", 4, true, Some(fisheye)),
        kind("EUCM", 6, true, None),
        kind("EQUIRECTANGULAR", 2, true, None),
    ]
};

const EXPECTED: &str = "a camera model that there is a lens for: SIMPLE_PINHOLE, PINHOLE, SIMPLE_RADIAL, RADIAL, OPENCV, \
                        FULL_OPENCV, OPENCV_FISHEYE, SIMPLE_RADIAL_FISHEYE, RADIAL_FISHEYE, SIMPLE_FISHEYE, FISHEYE";

/// Makes a perspective lens from the parameters `k1 k2 p1 p2 k3 k4 k5 k6`; missing parameters are 0.
fn radial_tangential(parameters: &[f64]) -> Lens {
    let at = |i: usize| parameters.get(i).map_or(0.0, |&value| value as f32);
    let [k1, k2, p1, p2, k3, k4, k5, k6] = std::array::from_fn(at);
    Lens { k1, k2, p1, p2, k3, k4, k5, k6, projection: Projection::Perspective }
}

/// Makes a fisheye lens from the parameters `k1 k2 k3 k4`; missing parameters are 0.
fn fisheye(parameters: &[f64]) -> Lens {
    let at = |i: usize| parameters.get(i).map_or(0.0, |&value| value as f32);
    Lens { k1: at(0), k2: at(1), k3: at(2), k4: at(3), projection: Projection::Fisheye, ..Lens::NONE }
}

impl Kind {
    pub(crate) fn by_id(id: i32) -> Option<&'static Self> {
        usize::try_from(id).ok().and_then(|id| KINDS.get(id))
    }

    pub(crate) fn by_name(name: &str) -> Option<&'static Self> {
        KINDS.iter().find(|kind| kind.name == name)
    }
}

impl Camera {
    /// Makes a camera of the camera model `kind`; `None` unless `parameters` has as many numbers as this model needs.
    pub(crate) fn new(kind: &'static Kind, width: u64, height: u64, parameters: Vec<f64>) -> Option<Self> {
        (parameters.len() == kind.parameters).then_some(Self { kind, width, height, parameters })
    }

    pub(crate) fn name(&self) -> &'static str {
        self.kind.name
    }

    pub(crate) fn parameters(&self) -> usize {
        self.parameters.len()
    }

    pub(crate) fn size(&self) -> (f64, f64) {
        (self.width as f64, self.height as f64)
    }

    /// Returns intrinsics and lens of the camera. Errors name `file` and the photograph `view`.
    pub(crate) fn optics(&self, file: &Path, view: &str) -> Result<Optics, DatasetError> {
        let place = || format!("photograph `{view}`");
        let lens = self.kind.lens.ok_or_else(|| {
            DatasetError::value(file, format!("{}: camera model", place()), EXPECTED, self.kind.name)
        })?;
        if !(1..=1_000_000).contains(&self.width) || !(1..=1_000_000).contains(&self.height) {
            let field = format!("{}, size of its camera", place());
            let found = format!("{}x{}", self.width, self.height);
            return Err(DatasetError::value(file, field, "sides of 1 to 1000000 pixels", found));
        }
        let p = &self.parameters;
        let (fy, rest) = if self.kind.two_focals { (p[1], &p[2..]) } else { (p[0], &p[1..]) };
        let (width, height) = self.size();
        Ok(Optics { width, height, fx: p[0], fy, cx: rest[0], cy: rest[1], lens: lens(&rest[2..]) })
    }
}
