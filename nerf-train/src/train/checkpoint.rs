//! Everything a run needs to go on as if it had not stopped.
//!
//! Two runs with one output share their checkpoint's name too. The last to write it wins whole, and
//! [`Checkpoint::check_belongs`] keeps the other from going on from it: no run is ever a mix of two.

use super::average::Average;
use super::exposure::{ExposureFound, Gains};
use super::moving::Moving;
use super::poses::{Poses, PosesFound};
use super::{CurvePoint, Progressed};
use crate::data::Dataset;
use crate::model::config::Config;
use crate::model::engine::OptimiserState;
use crate::system::input::{MAX_CHECKPOINT_BYTES, read_limited};
use crate::system::output::{OutputError, write_atomic};
use crate::train::Snapshot;
use crate::train::occupancy::Occupancy;
use nerf_core::camera::{Lens, Projection};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::path::{Path, PathBuf};

/// First bytes of a checkpoint; the last is the version.
const MAGIC: [u8; 8] = *b"NERFCKP\x0b";

/// A run, stopped between two steps.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Checkpoint {
    pub config: Config,
    pub data: String,
    /// [`fingerprint`] of its data.
    pub fingerprint: u64,
    /// Parameters and Adam's memory.
    pub optimiser: OptimiserState,
    pub average: Average,
    pub occupancy: Option<Occupancy>,
    pub gains: Option<Gains>,
    /// Measured spread of the photographs' exposure, once it is known.
    pub exposure: Option<ExposureFound>,
    pub poses: Option<Poses>,
    pub poses_found: Option<PosesFound>,
    pub moving: Option<Moving>,
    pub progressed: Progressed,
    pub curve: Vec<CurvePoint>,
    /// Pictures taken so far; they themselves lie in the report's folder.
    pub snapshots: Vec<Snapshot>,
    /// Seconds used so far.
    pub seconds: f64,
}

/// Why a checkpoint cannot be taken up.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CheckpointError {
    #[error("checkpoint {path}: {source}")]
    Read { path: PathBuf, source: std::io::Error },
    #[error(
        "checkpoint {path}: expected a whole checkpoint of this version, found {found}; --restart in place of \
         --resume begins anew and replaces it"
    )]
    Format { path: PathBuf, found: String },
    #[error("checkpoint {path}: {field} differs from this run's (in the file: {found}; now: {expected})")]
    Other { path: PathBuf, field: String, expected: String, found: String },
}

impl Checkpoint {
    /// Writes it whole or not at all.
    ///
    /// # Errors
    /// As [`write_atomic`].
    pub fn write(&self, path: &Path) -> Result<(), OutputError> {
        write_atomic(path, &self.to_bytes())
    }

    /// The file's bytes.
    pub fn to_bytes(&self) -> Vec<u8> {
        pack(MAGIC, self)
    }

    /// Reads one back.
    ///
    /// # Errors
    /// [`CheckpointError`] names the file.
    pub fn read(path: &Path) -> Result<Self, CheckpointError> {
        unpack(MAGIC, path)
    }

    /// Refuses a checkpoint of other data or settings.
    ///
    /// `data`: its name and [`fingerprint`]. Limits on steps and time may differ: that is how a run is continued.
    ///
    /// # Errors
    /// [`CheckpointError::Other`] names the first difference.
    pub fn check_belongs(
        &self,
        path: &Path,
        config: &Config,
        data: (&str, u64),
    ) -> Result<(), CheckpointError> {
        check_data(path, data, (&self.data, self.fingerprint))?;
        // JSON and not TOML, which has no u64 for the seed.
        let tree = |config: &Config| {
            let mut config = config.clone();
            config.optimiser.steps = 1;
            if config.network.grid.is_some() {
                // They follow from the steps across the box, which are named in their place.
                config.sampling.samples = 1;
            }
            serde_json::to_value(config).expect("plain data")
        };
        check_settings(path, &tree(config), &tree(&self.config))
    }
}

/// A checkpoint's file: what it is and its version, a checksum, the state.
pub(crate) fn pack(magic: [u8; 8], state: &impl Serialize) -> Vec<u8> {
    // Serialising plain data to memory has no way to fail.
    let body = postcard::to_stdvec(state).expect("plain data");
    let mut bytes = Vec::with_capacity(body.len() + 12);
    bytes.extend(magic);
    bytes.extend(crc(&body).to_le_bytes());
    bytes.extend(body);
    bytes
}

/// Reads one back.
pub(crate) fn unpack<T: DeserializeOwned>(magic: [u8; 8], path: &Path) -> Result<T, CheckpointError> {
    let bytes = read_limited(path, MAX_CHECKPOINT_BYTES)
        .map_err(|source| CheckpointError::Read { path: path.into(), source })?;
    let format = |found: &str| CheckpointError::Format { path: path.into(), found: found.into() };
    let rest = bytes.strip_prefix(&magic).ok_or_else(|| format("another kind of file or version"))?;
    let (stored, body) = rest.split_first_chunk::<4>().ok_or_else(|| format("a truncated file"))?;
    if u32::from_le_bytes(*stored) != crc(body) {
        return Err(format("a damaged file (checksum)"));
    }
    match postcard::take_from_bytes(body) {
        Ok((state, [])) => Ok(state),
        _ => Err(format("a body of another shape")),
    }
}

/// Refuses a checkpoint of other data, each a name and a fingerprint.
pub(crate) fn check_data(path: &Path, now: (&str, u64), then: (&str, u64)) -> Result<(), CheckpointError> {
    let other = |expected: String, found: String| {
        Err(CheckpointError::Other { path: path.into(), field: "data".into(), expected, found })
    };
    if then.0 != now.0 {
        return other(now.0.into(), then.0.into());
    }
    if then.1 != now.1 {
        let text = |print: u64| format!("pictures and cameras {print:016x}");
        return other(text(now.1), text(then.1));
    }
    Ok(())
}

/// Refuses a checkpoint of other settings, both as JSON.
pub(crate) fn check_settings(path: &Path, now: &Value, then: &Value) -> Result<(), CheckpointError> {
    match difference(now, then) {
        Some((field, expected, found)) => {
            Err(CheckpointError::Other { path: path.into(), field, expected, found })
        }
        None => Ok(()),
    }
}

/// The first field that differs, as `network.width`, with both values.
pub(crate) fn difference(now: &Value, then: &Value) -> Option<(String, String, String)> {
    match (now, then) {
        (Value::Object(a), Value::Object(b)) if a.keys().eq(b.keys()) => {
            a.iter().zip(b.values()).find_map(|((key, now), then)| {
                let (field, now, then) = difference(now, then)?;
                Some((if field.is_empty() { key.clone() } else { format!("{key}.{field}") }, now, then))
            })
        }
        _ => (now != then).then(|| (String::new(), now.to_string(), then.to_string())),
    }
}

/// A checksum of what decides a run: training pictures, near, far, background, and the cameras of
/// all splits, which the scene box is found from.
pub fn fingerprint(data: &Dataset) -> u64 {
    const CRC: crc::Crc<u64> = crc::Crc::<u64>::new(&crc::CRC_64_XZ);
    let mut digest = CRC.digest();
    let mut numbers = |numbers: &[f32]| numbers.iter().for_each(|x| digest.update(&x.to_le_bytes()));
    numbers(&[data.near.unwrap_or(-1.0), data.far.unwrap_or(-1.0)]);
    for camera in data.cameras() {
        let (i, lens) = (camera.intrinsics(), camera.lens());
        numbers(&[i.width as f32, i.height as f32, i.fx, i.fy, i.cx, i.cy]);
        numbers(&[lens.k1, lens.k2, lens.p1, lens.p2]);
        if *lens != (Lens { k1: lens.k1, k2: lens.k2, p1: lens.p1, p2: lens.p2, ..Lens::NONE }) {
            let fisheye = f32::from(u8::from(lens.projection == Projection::Fisheye));
            numbers(&[lens.k3, lens.k4, lens.k5, lens.k6, fisheye]);
        }
        camera.pose().to_rows().iter().for_each(|row| numbers(row));
    }
    for point in &data.points {
        numbers(&point.position);
        numbers(&[point.error, point.track as f32]);
    }
    for key in data.train.iter().flat_map(|view| &view.key_points) {
        numbers(&[key.x, key.y, key.point as f32]);
    }
    for view in &data.train {
        digest.update(view.pixels.as_flattened());
        let mask = view.mask.iter().flatten().map(|&kept| u8::from(kept)).collect::<Vec<_>>();
        digest.update(&mask);
    }
    digest.update(data.background.to_string().as_bytes());
    digest.finalize()
}

fn crc(bytes: &[u8]) -> u32 {
    static CRC: crc::Crc<u32, crc::Table<16>> = crc::Crc::<u32, crc::Table<16>>::new(&crc::CRC_32_ISO_HDLC);
    CRC.checksum(bytes)
}
