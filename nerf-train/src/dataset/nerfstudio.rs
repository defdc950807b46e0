//! A `transforms.json` of nerfstudio or instant-ngp: all views in one file.

use super::found::Found;
use super::transforms::{Transforms, listed};
use super::{Axes, Background, Dataset, DatasetError, Format, ReadOptions, View, Watch, scene_name};
use std::collections::HashSet;
use std::path::Path;

/// The file's usual name.
pub(super) const FILE: &str = "transforms.json";

/// Without lists in the file, one view in this many is validation, as in LLFF.
const HOLD: usize = 8;

/// Reads one json; splits by its lists, or else every eighth view (of the views sorted by file
/// path, from the first) is validation.
pub(super) fn read(file: &Path, options: &ReadOptions, watch: &Watch) -> Result<Dataset, DatasetError> {
    let axes = options.axes.unwrap_or(Axes::Opengl);
    let mut found = Found::default();
    let transforms = Transforms::read(file)?;
    watch.expect(transforms.len());
    let mut views = transforms.views(file, options, watch, &mut found)?;
    let mut warnings = found.into_warnings();
    views.sort_by(|a, b| a.name.cmp(&b.name));
    let header = &transforms.header;
    let lists = [&header.train_filenames, &header.val_filenames, &header.test_filenames];
    let [train, val, test] = if lists.iter().any(|list| list.is_some()) {
        split_by_lists(views, lists, &mut warnings)
    } else {
        split_every_eighth(views)
    };
    let usual = file.file_name().is_some_and(|name| name == FILE);
    let folder = file.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    Ok(Dataset {
        name: scene_name(if usual { folder } else { file }),
        format: Format::Nerfstudio,
        axes,
        train,
        val,
        test,
        test_path: Vec::new(),
        near: header.near,
        far: header.far,
        background: Background::Unknown,
        warnings,
    })
}

/// A single view is for training.
fn split_every_eighth(views: Vec<View>) -> [Vec<View>; 3] {
    let hold = views.len() > 1;
    let [mut train, mut val] = [Vec::new(), Vec::new()];
    for (index, view) in views.into_iter().enumerate() {
        let split = if hold && index % HOLD == 0 { &mut val } else { &mut train };
        split.push(view);
    }
    [train, val, Vec::new()]
}

/// Views that no list names are left out, with a warning.
fn split_by_lists(
    views: Vec<View>,
    lists: [&Option<Vec<String>>; 3],
    warnings: &mut Vec<String>,
) -> [Vec<View>; 3] {
    let plain = |name: &str| name.trim_start_matches("./").to_owned();
    let sets = lists.map(|list| list.iter().flatten().map(|name| plain(name)).collect::<HashSet<_>>());
    let mut splits = [Vec::new(), Vec::new(), Vec::new()];
    let mut unused = Vec::new();
    for view in views {
        match sets.iter().position(|set| set.contains(&plain(&view.name))) {
            Some(split) => splits[split].push(view),
            None => unused.push(view.name),
        }
    }
    if !unused.is_empty() {
        warnings.push(format!(
            "{} views are in none of train_filenames, val_filenames, test_filenames and are left out: {}",
            unused.len(),
            listed(&unused)
        ));
    }
    splits
}
