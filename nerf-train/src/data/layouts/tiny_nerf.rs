//! `tiny_nerf_data.npz` of the original notebook: pictures in floats, OpenGL poses, no splits.

use crate::data::layouts::cs180;
use crate::data::layouts::npz::Archive;
use crate::data::{Axes, Dataset, DatasetError, Format, ReadOptions, scene_name};

/// The notebook's file has this many views, of which it fits the first 100.
const NOTEBOOK_VIEWS: usize = 106;
/// Of the notebook's file, validation begins here: with the view every figure of it shows.
const NOTEBOOK_VALIDATION: usize = 101;
/// Of any other file of this layout, this many views at the end are validation.
const LAST: usize = 6;

/// Reads `images`, `poses` and `focal`.
///
/// Of the notebook's own 106 views, 0..100 are training and 101..106 validation (100 is unused,
/// as there); of other files the last six are validation, or none if that leaves no training.
pub(crate) fn read(archive: &mut Archive, options: &ReadOptions) -> Result<Dataset, DatasetError> {
    let axes = options.axes.unwrap_or(Axes::Opengl);
    let focal = archive.scalar("focal")?;
    let c2ws = archive.matrices("poses")?;
    let origin = options.origin_for(c2ws.iter().map(cs180::position));
    let world = cs180::World { axes, origin };
    let array = archive.array("images")?;
    let mut train = cs180::views(archive, ("images", &array), ("poses", &c2ws), focal, world)?;
    let mut warnings = Vec::new();
    let val = if train.len() == NOTEBOOK_VIEWS {
        let val = train.split_off(NOTEBOOK_VALIDATION);
        train.truncate(100);
        val
    } else if train.len() > LAST {
        train.split_off(train.len() - LAST)
    } else {
        warnings.push(format!("only {} views: no validation views", train.len()));
        Vec::new()
    };
    Ok(Dataset { train, val, warnings, ..Dataset::empty(scene_name(&archive.file), Format::TinyNerf, axes) }
        .counted_from(origin))
}
