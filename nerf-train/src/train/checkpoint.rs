//! Everything a run needs to go on as if it had not stopped.

use super::{CurvePoint, Progressed};
use crate::config::Config;
use crate::engine::OptimiserState;
use crate::occupancy::Occupancy;
use crate::output::{OutputError, write_atomic};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// First bytes of a checkpoint; the last is the version.
const MAGIC: [u8; 8] = *b"NERFCKP\x01";

/// A run, stopped between two steps.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Checkpoint {
    /// Its settings.
    pub config: Config,
    /// Name of its data.
    pub data: String,
    /// Parameters and Adam's memory.
    pub optimiser: OptimiserState,
    /// Exponential average of the parameters, not yet corrected for its start.
    pub average: Vec<f32>,
    /// The grid.
    pub occupancy: Option<Occupancy>,
    /// Counters of the loop.
    pub progressed: Progressed,
    /// The curve so far.
    pub curve: Vec<CurvePoint>,
    /// Seconds used so far.
    pub seconds: f64,
}

/// Why a checkpoint cannot be taken up.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CheckpointError {
    /// It cannot be read.
    #[error("checkpoint {path}: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// It is no checkpoint of this version, or damaged.
    #[error("checkpoint {path}: expected a whole checkpoint of this version, found {found}")]
    Format {
        /// The file.
        path: PathBuf,
        /// What was there.
        found: &'static str,
    },
    /// It belongs to another run.
    #[error("checkpoint {path}: {field} differs from this run's (in the file: {found}; now: {expected})")]
    Other {
        /// The file.
        path: PathBuf,
        /// Which setting.
        field: &'static str,
        /// This run's.
        expected: String,
        /// The file's.
        found: String,
    },
}

impl Checkpoint {
    /// Writes it whole or not at all.
    ///
    /// # Errors
    /// As [`write_atomic`].
    pub fn write(&self, path: &Path) -> Result<(), OutputError> {
        // Serialising plain data to memory has no way to fail.
        let body = postcard::to_stdvec(self).expect("plain data");
        let mut bytes = Vec::with_capacity(body.len() + 12);
        bytes.extend(MAGIC);
        bytes.extend(crc(&body).to_le_bytes());
        bytes.extend(body);
        write_atomic(path, &bytes)
    }

    /// Reads one back.
    ///
    /// # Errors
    /// [`CheckpointError`] names the file.
    pub fn read(path: &Path) -> Result<Self, CheckpointError> {
        let bytes =
            std::fs::read(path).map_err(|source| CheckpointError::Read { path: path.into(), source })?;
        let format = |found| CheckpointError::Format { path: path.into(), found };
        let rest = bytes.strip_prefix(&MAGIC).ok_or_else(|| format("another kind of file or version"))?;
        let (stored, body) = rest.split_first_chunk::<4>().ok_or_else(|| format("a truncated file"))?;
        if u32::from_le_bytes(*stored) != crc(body) {
            return Err(format("a damaged file (checksum)"));
        }
        postcard::from_bytes(body).map_err(|_| format("a body of another shape"))
    }

    /// Refuses a checkpoint of other data or settings.
    ///
    /// Limits on steps and time may differ: that is how a run is continued.
    ///
    /// # Errors
    /// [`CheckpointError::Other`] names the first difference.
    pub fn check_belongs(&self, path: &Path, config: &Config, data: &str) -> Result<(), CheckpointError> {
        let other = |field, expected: String, found: String| {
            Err(CheckpointError::Other { path: path.into(), field, expected, found })
        };
        if self.data != data {
            return other("data", data.into(), self.data.clone());
        }
        let text = |config: &Config| {
            let mut config = config.clone();
            config.optimiser.steps = 1;
            toml::to_string(&config).unwrap_or_default()
        };
        let (now, then) = (text(config), text(&self.config));
        match now.lines().zip(then.lines()).find(|(a, b)| a != b) {
            Some((a, b)) => other("a setting", a.into(), b.into()),
            None => Ok(()),
        }
    }
}

fn crc(bytes: &[u8]) -> u32 {
    crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(bytes)
}
