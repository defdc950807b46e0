//! A `transforms.json` of nerfstudio or instant-ngp: all views in one file.

use crate::data::layouts::folders::every_eighth;
use crate::data::layouts::transforms::{Header, Transforms};
use crate::data::names::{file_name, listed};
use crate::data::pictures::found::Found;
use crate::data::{Axes, Dataset, DatasetError, Format, ReadOptions, View, Watch, scene_name};
use std::collections::HashSet;
use std::path::Path;

pub(crate) const FILE: &str = "transforms.json";

/// Reads a `transforms.json`. Without lists of file names, every eighth view in the order of paths is for validation.
pub(crate) fn read(file: &Path, options: &ReadOptions, watch: &Watch) -> Result<Dataset, DatasetError> {
    let axes = options.axes.unwrap_or(Axes::Opengl);
    let mut found = Found::default();
    let transforms = Transforms::read(file)?;
    watch.expect(transforms.len());
    let origin = options.origin_for(transforms.positions());
    let mut views = transforms.views(file, options, (Some(options.downscale), origin), watch, &mut found)?;
    let (mut notes, mut warnings) = found.into_sentences();
    views.sort_by(|a, b| a.name.cmp(&b.name));
    let count = (views.len(), transforms.len());
    notes.insert(0, format!("{}: {} of {} frames have a picture", file_name(file), count.0, count.1));
    say_fields(&transforms.header, &mut notes);
    let header = &transforms.header;
    let lists = [&header.train_filenames, &header.val_filenames, &header.test_filenames];
    let [train, val, test] = if lists.iter().any(|list| list.is_some()) {
        split_by_lists(views, lists, &mut warnings)
    } else {
        let (train, val) = every_eighth(views, options, &mut notes);
        [train, val, Vec::new()]
    };
    let usual = file.file_name().is_some_and(|name| name == FILE);
    let folder = file.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    Ok(Dataset {
        train,
        val,
        test,
        near: header.near,
        far: header.far,
        notes,
        warnings,
        ..Dataset::empty(scene_name(if usual { folder } else { file }), Format::Nerfstudio, axes)
    }
    .counted_from(origin))
}

/// Adds notes on the fields of the json that are ignored, with the reasons.
fn say_fields(header: &Header, notes: &mut Vec<String>) {
    let identity = |rows: &Vec<Vec<f64>>| {
        rows.iter()
            .enumerate()
            .all(|(i, row)| row.iter().enumerate().all(|(j, &v)| v == f64::from(u8::from(i == j))))
    };
    if header.applied_transform.as_ref().is_some_and(|rows| !identity(rows)) {
        notes.push(
            "applied_transform is not undone: results are in the coordinates of the json's own matrices"
                .into(),
        );
    }
    if let Some(scale) = header.aabb_scale {
        notes.push(format!("aabb_scale {scale} is not needed: bounds come from the cameras"));
    }
}

/// Splits views by the json's `lists` of file names: train, val, test. Views in no list are left out, with a warning.
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
