//! A Blender (NeRF-synthetic) folder: one json for each split.

use crate::data::layouts::transforms::Transforms;
use crate::data::pictures::found::Found;
use crate::data::{Axes, Dataset, DatasetError, Downscale, Format, ReadOptions, Watch, scene_name};
use std::path::{Path, PathBuf};

/// Name of the file with the training views. The file is required unless an existing field is evaluated.
pub(crate) const TRAIN: &str = "transforms_train.json";
const VAL: &str = "transforms_val.json";
const TEST: &str = "transforms_test.json";
/// Names of the split files. A path to one is read as its folder if [`TRAIN`] exists or an existing field is evaluated.
pub(crate) const SPLITS: [&str; 3] = [TRAIN, VAL, TEST];

pub(crate) fn is_here(folder: &Path) -> bool {
    SPLITS.iter().any(|name| folder.join(name).is_file())
}

pub(crate) fn read(folder: &Path, options: &ReadOptions, watch: &Watch) -> Result<Dataset, DatasetError> {
    let axes = options.axes.unwrap_or(Axes::Opengl);
    let mut found = Found::default();
    // All lists are read before the first picture, so that the number of pictures is known.
    let list = |name: &str| {
        let file = folder.join(name);
        let needed = name == TRAIN && !options.to_measure;
        let transforms = if needed || file.is_file() { Some(Transforms::read(&file)?) } else { None };
        watch.expect(transforms.as_ref().map_or(0, Transforms::len));
        Ok::<_, DatasetError>((file, transforms))
    };
    let lists = [list(TRAIN)?, list(VAL)?, list(TEST)?];
    let all = || lists.iter().filter_map(|(_, transforms)| transforms.as_ref());
    let origin = options.origin_for(all().flat_map(Transforms::positions));
    let headers = || all().map(|transforms| &transforms.header);
    let near = headers().find_map(|header| header.near);
    let far = headers().find_map(|header| header.far);
    // Published PSNRs are measured at the original size. Pictures are therefore made smaller only on request.
    let downscale = Some(options.downscale).filter(|downscale| *downscale != Downscale::Auto);
    let mut views = |(file, transforms): &(PathBuf, Option<Transforms>)| match transforms {
        Some(transforms) => transforms.views(file, options, (downscale, origin), watch, &mut found),
        None => Ok(Vec::new()),
    };
    let (train, val, test) = (views(&lists[0])?, views(&lists[1])?, views(&lists[2])?);
    let (notes, mut warnings) = found.into_sentences();
    if val.is_empty() && !options.to_measure {
        warnings.push(format!("no pictures of {VAL}: no validation views"));
    }
    Ok(Dataset {
        train,
        val,
        test,
        near,
        far,
        notes,
        warnings,
        ..Dataset::empty(scene_name(folder), Format::Blender, axes)
    }
    .counted_from(origin))
}
