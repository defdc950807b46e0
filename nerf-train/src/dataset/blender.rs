//! A Blender (NeRF-synthetic) folder: one json for each split.

use super::transforms::Transforms;
use super::{Axes, Background, Dataset, DatasetError, Format, ReadOptions, scene_name};
use std::path::Path;

/// The file that makes a folder one of these.
pub(super) const TRAIN: &str = "transforms_train.json";
const VAL: &str = "transforms_val.json";
const TEST: &str = "transforms_test.json";

/// Whether a file of this name stands for its folder.
pub(super) fn is_split_file(name: &str) -> bool {
    [TRAIN, VAL, TEST].contains(&name)
}

/// Reads a folder with `transforms_train.json` and perhaps `_val` and `_test`.
pub(super) fn read(folder: &Path, options: &ReadOptions) -> Result<Dataset, DatasetError> {
    let axes = options.axes.unwrap_or(Axes::Opengl);
    let mut warnings = Vec::new();
    let (mut near, mut far) = (None, None);
    let mut split = |name: &str| {
        let file = folder.join(name);
        if name != TRAIN && !file.is_file() {
            return Ok(Vec::new());
        }
        let transforms = Transforms::read(&file)?;
        near = near.or(transforms.header.near);
        far = far.or(transforms.header.far);
        transforms.views(&file, axes, &mut warnings)
    };
    let (train, val, test) = (split(TRAIN)?, split(VAL)?, split(TEST)?);
    if val.is_empty() {
        warnings.push(format!("no pictures of {VAL}: no validation views"));
    }
    Ok(Dataset {
        name: scene_name(folder),
        format: Format::Blender,
        axes,
        train,
        val,
        test,
        test_path: Vec::new(),
        near,
        far,
        background: Background::Unknown,
        warnings,
    })
}
