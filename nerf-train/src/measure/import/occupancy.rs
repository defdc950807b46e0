//! Occupancy grid of an imported network: the grid used in its training, or one built from its densities.

use super::refused;
use super::settings::Settings;
use crate::data::layouts::npz::read_npy;
use crate::train::occupancy::{DensityQuery, Occupancy, OccupiedCells};
use nerf_core::blob::MAX_OCCUPANCY_RESOLUTION;
use std::path::Path;

/// Largest size of an array in the file, bytes: the largest occupancy grid in f64.
const MAX_ARRAY_BYTES: u64 = 8 << 27;

/// Reads an occupancy grid of the scene box: a `.npy` array `[x, y, z]` of booleans, or of zeros and ones.
pub fn read(file: &Path, settings: &Settings) -> anyhow::Result<OccupiedCells> {
    let place = format!("{}: occupancy grid", file.display());
    let fail = |expected: String, found: String| Err(refused(&place, expected, found));
    let array = read_npy(file, Some(MAX_ARRAY_BYTES))?;
    let sides = array.shape.iter().map(|&side| u16::try_from(side).ok());
    let sides: Option<Vec<u16>> =
        sides.map(|side| side.filter(|s| (1..=MAX_OCCUPANCY_RESOLUTION).contains(s))).collect();
    let Some([x, y, z]) = sides.as_deref() else {
        let expected = format!("shape [x, y, z] with sides of 1 to {MAX_OCCUPANCY_RESOLUTION}");
        return fail(expected, format!("{:?}", array.shape));
    };
    let numbers = array.numbers().unwrap_or_default();
    if let Some(index) = numbers.iter().position(|&cell| cell != 0.0 && cell != 1.0) {
        return fail("truths, or zeros and ones".into(), format!("{} at index {index}", numbers[index]));
    }
    let live = numbers.iter().enumerate().filter(|&(_, &cell)| cell != 0.0).map(|(index, _)| index as u32);
    let cells = OccupiedCells::of(settings.bounds(), [*x, *y, *z], live);
    if cells.lookup().occupied_share() == 0.0 {
        return fail("at least one occupied cell".into(), "none".into());
    }
    Ok(cells)
}

/// Builds the grid of cells in which the density exceeds `threshold`, 1/world unit; `None` if no cell is occupied.
pub fn build(settings: &Settings, ask: &DensityQuery<'_>, threshold: f32) -> Option<OccupiedCells> {
    let cells =
        Occupancy::asked(settings.bounds(), settings.occupancy_resolution, ask, threshold).into_live();
    (cells.lookup().occupied_share() > 0.0).then_some(cells)
}
