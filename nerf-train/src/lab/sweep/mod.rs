//! Many runs that differ in a few settings, and what they say of them.
//!
//! lists of values → their combinations → one run each, kept as one small file → table, plots, sheet
//!
//! A folder holds a sweep: `sweep.json` says what all of its runs share, `runs/` has a record and a
//! picture for each finished one. A record is never made twice, whoever made it: runs can be spread
//! over machines ([`Shard`](super::Shard)) into one folder or into several that are merged.

mod combinations;
mod folder;
mod job;
mod record;

#[cfg(test)]
mod tests;

pub use combinations::{Combinations, CombinationsError, Knob, Mode, Point};
pub use folder::{Folder, LabError};
pub use job::{Job, JobError, Runner};
pub use record::{Header, Kind, Record, Status};

/// All finished runs, ordered by their settings.
///
/// # Errors
/// [`LabError::Format`] names the file that holds something else.
pub fn records(folder: &Folder) -> Result<Vec<Record>, LabError> {
    let mut records = folder.runs()?;
    // No value is NaN: JSON has none.
    let order = |a: &Record, b: &Record| a.point.partial_cmp(&b.point);
    records.sort_by(|a, b| order(a, b).unwrap_or(std::cmp::Ordering::Equal));
    Ok(records)
}
