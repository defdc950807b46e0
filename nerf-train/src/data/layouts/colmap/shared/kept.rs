//! File of shared cameras next to a `.nerf` blob: a reconstruction adjusted to one camera per device.

use crate::data::DatasetError;
use crate::data::layouts::colmap::model::{Camera, Kind};
use crate::data::layouts::colmap::{Model, Points};
use crate::system::input::read_limited;
use crate::system::output::write_atomic;
use glam::{DQuat, DVec3};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::io::ErrorKind;
use std::path::Path;

/// Maximum number of bytes of a file of shared cameras; reading a larger file is an error.
const MAX_BYTES: u64 = 1 << 30;

/// Reconstruction adjusted to one camera (set of intrinsics) per device, as stored in the file of shared cameras.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Shared {
    /// Checksum of the reconstruction before it was adjusted.
    pub(super) model: u64,
    pub(super) devices: Vec<Adjusted>,
    /// Mean reprojection error before and after the adjustment, pixels.
    pub(super) reprojection_error_px: [f64; 2],
    /// Median and largest movement of a camera by the adjustment, divided by the median depth of the points it sees.
    pub(super) moved: [f64; 2],
    /// For each camera: width and height in pixels, and the parameters of COLMAP's camera model `OPENCV`.
    pub(super) cameras: Vec<(u64, u64, [f64; 8])>,
    /// For each photograph's name: index in `cameras`, and world-to-camera rotation (w, x, y, z) and translation.
    pub(super) photographs: BTreeMap<String, (u32, [f64; 4], [f64; 3])>,
    /// For each point: `POINT3D_ID`, position, and mean reprojection error in pixels.
    pub(super) points: Vec<(u64, [f64; 3], f64)>,
}

/// Focal lengths of a device before and after the adjustment.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Adjusted {
    pub(super) photographs: usize,
    /// Focal lengths of the device's photographs before the adjustment, pixels: median, smallest and largest.
    pub(super) focal_before: [f64; 3],
    pub(super) focal: f64,
}

/// Returns `origin` rotated by a camera's world-to-camera rotation (w, x, y, z). Adding the result to the camera's
/// translation gives the translation for coordinates relative to `origin`.
pub(super) fn turned_origin([w, x, y, z]: [f64; 4], origin: DVec3) -> DVec3 {
    DQuat::from_xyzw(x, y, z, w).normalize() * origin
}

impl Shared {
    /// Reads `file`; `None` if it does not exist, states a checksum other than `model`, or has a bad camera index.
    pub(super) fn read(file: &Path, model: u64) -> Result<Option<Self>, DatasetError> {
        let bytes = match read_limited(file, MAX_BYTES) {
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
            bytes => bytes.map_err(|source| DatasetError::io(file, source))?,
        };
        let shared: Self = serde_json::from_slice(&bytes).map_err(|error| {
            let expected = "shared cameras as `fit` writes them (delete the file, or name another blob)";
            DatasetError::value(file, "content", expected, error)
        })?;
        let known = |(camera, ..): &(u32, [f64; 4], [f64; 3])| (*camera as usize) < shared.cameras.len();
        Ok((shared.model == model && shared.photographs.values().all(known)).then_some(shared))
    }

    pub(super) fn write(&self, file: &Path) -> Result<(), DatasetError> {
        let bytes = serde_json::to_vec(self).map_err(std::io::Error::from);
        let bytes = bytes.map_err(|source| DatasetError::io(file, source))?;
        write_atomic(file, &bytes).map_err(|error| DatasetError::io(file, error.source))
    }

    pub(super) fn in_words(&self) -> String {
        let of_device = |device: &Adjusted| {
            let Adjusted { photographs, focal_before: [median, least, largest], focal } = device;
            format!(
                "one camera for {photographs} photographs: focal length {focal:.1} px, before {median:.1} ({least:.1} to \
                 {largest:.1})"
            )
        };
        let devices: Vec<String> = self.devices.iter().map(of_device).collect();
        let ([before, after], [moved, most]) = (self.reprojection_error_px, self.moved);
        format!(
            "{}; mean reprojection error {after:.2} px, before {before:.2}; cameras moved by {:.1} % of their distance to \
             what they see, at most {:.1} %",
            devices.join("; "),
            100.0 * moved,
            100.0 * most
        )
    }

    pub(super) fn apply(self, model: &mut Model, points: &mut Points) {
        let opencv = Kind::by_name("OPENCV");
        let cameras = self.cameras.into_iter().zip(0u32..);
        model.cameras = cameras
            .filter_map(|((w, h, p), index)| Some((index, Camera::new(opencv?, w, h, p.to_vec())?)))
            .collect();
        for image in &mut model.images {
            if let Some(&(camera, rotation, translation)) = self.photographs.get(&image.name) {
                let back = turned_origin(rotation, points.origin).to_array();
                let translation = std::array::from_fn(|i| translation[i] - back[i]);
                (image.camera, image.rotation, image.translation) = (camera, rotation, translation);
            }
        }
        let places = points.numbers();
        for (number, position, error) in self.points {
            if let Some(&place) = places.get(&number) {
                let (_, point) = &mut points.kept[place as usize];
                (point.position, point.error) = (position.map(|v| v as f32), error as f32);
            }
        }
    }
}
