//! Checkpoint: the state from which a run resumes exactly where it stopped.
//!
//! Runs with the same output path use one checkpoint file; [`Checkpoint::check_belongs`] refuses that of another run.

use super::average::Average;
use super::photographs::Photographs;
use super::{CurvePoint, Progressed, Snapshot, psnr_db_of_mse};
use crate::data::Dataset;
use crate::model::config::{MAX_OCCUPANCY_RESOLUTION, MAX_TABLE_VALUES};
use crate::model::engine::OptimiserState;
use crate::system::input::{MAX_CHECKPOINT_BYTES, read_regular};
use crate::system::output::{OutputError, write_atomic};
use crate::train::occupancy::Occupancy;
use anyhow::{Context, anyhow};
use nerf_core::camera::{Lens, Projection};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::fmt::Display;
use std::path::Path;

/// First bytes of a checkpoint file; the last byte is the format's version.
const MAGIC: [u8; 8] = *b"NERFCKP\x0e";

/// Size of the largest state, bytes: five f32 per table value (parameter, moments, accumulated gradient, average), and
/// at most nine bytes per occupancy cell (index, density, bits). The rest is small.
const MOST_BYTES: u64 = 20 * MAX_TABLE_VALUES as u64 + 9 * (MAX_OCCUPANCY_RESOLUTION as u64).pow(3);
// The limit for reading is above the size of any checkpoint that is written.
const _: () = assert!(MOST_BYTES + (64 << 20) <= MAX_CHECKPOINT_BYTES);

/// State of a fit of a scene or 2D field, taken between two steps.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Checkpoint {
    /// Settings of the run as JSON, written by the function `settings`.
    pub config: String,
    pub data: String,
    pub fingerprint: u64,
    pub optimiser: OptimiserState,
    pub state: State,
    pub seconds: f64,
}

/// Parts of a run's state that change from step to step, except the optimiser's state.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct State {
    pub average: Average,
    pub occupancy: Option<Occupancy>,
    pub photographs: Photographs,
    pub progressed: Progressed,
    pub curve: Vec<CurvePoint>,
    /// Snapshots taken; their images are in the report's folder.
    pub snapshots: Vec<Snapshot>,
}

impl State {
    pub fn train_psnr_db(&self) -> f64 {
        psnr_db_of_mse(self.progressed.mse)
    }

    /// Returns the point of the training curve at the present step.
    pub fn point(&self, seconds: f64, val_psnr_db: Option<f64>) -> CurvePoint {
        let (step, train_psnr_db) = (self.progressed.step, self.train_psnr_db());
        CurvePoint { step, seconds, train_psnr_db, val_psnr_db, ..CurvePoint::default() }
    }

    /// Adds a point without validation to the curve, unless the step is 0 or the curve has a point at the present step.
    pub fn note(&mut self, seconds: f64) {
        let step = self.progressed.step;
        if step > 0 && self.curve.last().is_none_or(|last| last.step != step) {
            self.curve.push(self.point(seconds, None));
        }
    }

    /// Returns the last point of the curve that has a validation PSNR, and this PSNR, dB; `None` before any validation.
    pub fn last_validation(&self) -> Option<(&CurvePoint, f64)> {
        self.curve.iter().rev().find_map(|point| Some((point, point.val_psnr_db?)))
    }
}

impl Checkpoint {
    pub fn write(&self, path: &Path) -> Result<(), OutputError> {
        write_atomic(path, &self.to_bytes())
    }

    /// Returns the contents of a checkpoint file: magic number with version, checksum, serialised state.
    pub fn to_bytes(&self) -> Vec<u8> {
        // Most of the bytes: five f32 per parameter.
        let mut bytes = Vec::with_capacity(20 * self.optimiser.parameters.len() + (1 << 20));
        bytes.extend(MAGIC);
        bytes.extend([0; 4]);
        // Serialising plain data to memory cannot fail.
        let mut bytes = postcard::to_extend(self, bytes).expect("plain data");
        let (head, body) = bytes.split_at_mut(MAGIC.len() + 4);
        head[MAGIC.len()..].copy_from_slice(&crc(body).to_le_bytes());
        bytes
    }

    pub fn read(path: &Path) -> anyhow::Result<Self> {
        let bytes = read_regular(path, MAX_CHECKPOINT_BYTES)
            .with_context(|| format!("checkpoint {}", path.display()))?;
        let format = |found| damaged(path, found);
        let rest = bytes.strip_prefix(&MAGIC).ok_or_else(|| format("another kind of file or version"))?;
        let (stored, body) = rest.split_first_chunk::<4>().ok_or_else(|| format("a truncated file"))?;
        if u32::from_le_bytes(*stored) != crc(body) {
            return Err(format("a damaged file (checksum)"));
        }
        match postcard::take_from_bytes(body) {
            Ok((state, [])) => Ok(state),
            _ => Err(format("a body of another shape")),
        }
    }

    /// Returns an error that names the first difference if the checkpoint is of a run with other settings (`config`,
    /// from `settings`) or `data` (name and fingerprint). Limits on steps and time may differ.
    pub fn check_belongs(&self, path: &Path, config: &str, data: (&str, u64)) -> anyhow::Result<()> {
        let other = |field: &str, expected: &str, found: &str| {
            let path = path.display();
            anyhow!(
                "checkpoint {path}: {field} differs from this run's (in the file: {found}; now: {expected})"
            )
        };
        if self.data != data.0 {
            return Err(other("data", data.0, &self.data));
        }
        if self.fingerprint != data.1 {
            let text = |print: u64| format!("pictures and cameras {print:016x}");
            return Err(other("data", &text(data.1), &text(self.fingerprint)));
        }
        // Text that is not JSON becomes null, and differs as a whole.
        let tree = |config: &str| serde_json::from_str::<Value>(config).unwrap_or_default();
        match difference(&tree(config), &tree(&self.config)) {
            Some((field, expected, found)) => Err(other(&field, &expected, &found)),
            None => Ok(()),
        }
    }

    /// Returns the name of the first part of the checkpoint that contradicts another part, or the resuming run's
    /// `average`; `None` if all parts fit. A valid checksum does not prove that this program wrote the file.
    pub(super) fn wrong_part(&self, average: &Average) -> Option<&'static str> {
        let State { average: averaged, progressed, curve, .. } = &self.state;
        let step = progressed.step;
        let ascending = curve.is_sorted_by_key(|point| point.step);
        let parts = [
            ("counters", u64::from(step) == self.optimiser.steps),
            ("averaged parameters", averaged.is_like(average, step)),
            ("points of the curve", ascending && curve.last().is_none_or(|point| point.step <= step)),
        ];
        parts.into_iter().find(|&(_, fits)| !fits).map(|(part, _)| part)
    }
}

pub(crate) fn damaged(path: &Path, found: impl Display) -> anyhow::Error {
    anyhow!(
        "checkpoint {}: expected a whole checkpoint of this version, found {found}; --restart in place of --resume begins \
         anew and replaces it",
        path.display()
    )
}

/// Returns the settings that must not change when a run is resumed, as JSON, since TOML cannot store the seed, a u64.
/// Settings that may change are set to 1: number of steps and, with a learned grid, number of samples per ray.
pub(crate) fn settings(config: &impl Serialize) -> String {
    let mut tree = serde_json::to_value(config).expect("plain data");
    tree["optimiser"]["steps"] = 1.into();
    if tree.pointer("/network/grid").is_some_and(|grid| !grid.is_null()) {
        tree["sampling"]["samples"] = 1.into();
    }
    tree.to_string()
}

/// Returns path, such as `network.width`, and both values of the first field that differs; `None` if all are equal.
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

/// Returns the checksum of the data that determine a run: training photographs with masks and key points, near and far
/// plane, background, sparse points, and the cameras of all splits. The scene box is found from all these cameras.
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
