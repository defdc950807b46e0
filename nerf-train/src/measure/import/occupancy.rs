//! The occupancy grid of an imported network: one it was trained with, or one asked of the network itself.

use crate::data::layouts::npz::read_npy;
use crate::model::import::{ImportError, Settings};
use crate::train::occupancy::{Ask, LiveCells, Occupancy};
use nerf_core::blob::MAX_OCCUPANCY_RESOLUTION;
use nerf_core::camera::SceneBox;
use std::path::Path;

/// Largest array that is read, bytes: the largest occupancy grid in f64.
const MAX_ARRAY_BYTES: u64 = 8 << 27;

fn scene_box(settings: &Settings) -> SceneBox {
    SceneBox { min: settings.min().into(), max: settings.max().into() }
}

/// Reads an occupancy grid of the scene box: an array `[x, y, z]` of truths, or of zeros and ones, in a `.npy` file.
///
/// # Errors
/// [`ImportError`] on a file that is no such array, a side beyond the format's, another number, and on a
/// occupancy grid without any live cell.
pub fn read(file: &Path, settings: &Settings) -> Result<LiveCells, ImportError> {
    let fail =
        |expected: String, found: String| Err(ImportError::Occupancy { file: file.into(), expected, found });
    let array = read_npy(file, MAX_ARRAY_BYTES)?;
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
    let cells = LiveCells::of(scene_box(settings), [*x, *y, *z], live);
    if cells.lookup().occupied_share() == 0.0 {
        return fail("at least one live cell".into(), "none".into());
    }
    Ok(cells)
}

/// Asks the network which cells hold something; `None` if none does.
pub fn build(settings: &Settings, ask: &Ask<'_>) -> Option<LiveCells> {
    let (bounds, resolution) = (scene_box(settings), settings.occupancy_resolution);
    let cells = Occupancy::asked(bounds, resolution, ask, settings.sigma_threshold()).into_live();
    (cells.lookup().occupied_share() > 0.0).then_some(cells)
}
