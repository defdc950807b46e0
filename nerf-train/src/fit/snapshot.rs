//! Pictures of validation views on the way, and the sheet of them.

use crate::data::Dataset;
use crate::data::rgb::Picture;
use crate::show::contact_sheet::{Cell, contact_sheet};
use crate::show::names::FileNames;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Longer side of a picture on the sheet, pixels: larger ones are reduced.
const SHEET_SIDE: usize = 400;
/// Stands for a picture that is not there.
const NOTHING: [f32; 3] = [0.88; 3];

/// Which pictures are taken on the way.
#[derive(Clone, Debug, PartialEq)]
pub struct SnapshotOptions {
    /// The report's folder; pictures go into `snapshots` in it.
    pub folder: PathBuf,
    /// Steps to take them at; if empty, with every validation on the way.
    pub steps: Vec<u32>,
    /// Indices into the validation split; if empty, the views that the run watches anyway.
    pub views: Vec<usize>,
}

/// Why pictures cannot be taken.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SnapshotError {
    /// There is nothing to take pictures of.
    #[error("--snapshots: expected validation views to show, found none in {data}")]
    NoViews {
        /// The data's name.
        data: String,
    },
    /// A view that is not there.
    #[error(
        "--snapshot-views: expected indices below {views} (the validation views of {data}), found {found}"
    )]
    View {
        /// The data's name.
        data: String,
        /// How many there are.
        views: usize,
        /// What was asked for.
        found: usize,
    },
}

/// A picture that was taken.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Snapshot {
    /// Steps done.
    pub step: u32,
    /// Seconds since the start.
    pub seconds: f64,
    /// Index into the validation split.
    pub view: usize,
    /// dB.
    pub psnr_db: f64,
}

impl SnapshotOptions {
    /// Indices of the views to show, each once; `watched` where none were named.
    ///
    /// # Errors
    /// [`SnapshotError`] on views that are not there, and on steps that were named without any views.
    pub fn views_of(&self, dataset: &Dataset, watched: &[usize]) -> Result<Vec<usize>, SnapshotError> {
        let (data, views) = (&dataset.name, dataset.val.len());
        let asked = !self.steps.is_empty() || !self.views.is_empty();
        if asked && views == 0 {
            return Err(SnapshotError::NoViews { data: data.clone() });
        }
        if let Some(&found) = self.views.iter().find(|&&view| view >= views) {
            return Err(SnapshotError::View { data: data.clone(), views, found });
        }
        let mut chosen: Vec<usize> = Vec::new();
        for &view in if self.views.is_empty() { watched } else { &self.views } {
            if !chosen.contains(&view) {
                chosen.push(view);
            }
        }
        Ok(chosen)
    }

    /// The steps that were named and of which `taken` has nothing, ascending.
    pub fn missed(&self, taken: &[Snapshot]) -> Vec<u32> {
        let steps: BTreeSet<u32> = self.steps.iter().copied().collect();
        steps.into_iter().filter(|&step| taken.iter().all(|snapshot| snapshot.step != step)).collect()
    }
}

impl Snapshot {
    /// Its file in the report's `folder`; `dataset` is the one it was taken of.
    pub fn path(&self, folder: &Path, dataset: &Dataset) -> PathBuf {
        let names = FileNames::of(&dataset.val);
        folder.join("snapshots").join(format!("step_{:06}_{}.png", self.step, names.at(self.view)))
    }
}

/// A row per view, a column per step, ground truth over `background` last; `None` without snapshots.
///
/// The pictures are read back from the report's `folder`, so that those of a run that was taken up again are
/// there too; a picture that is not is shown as an empty cell that says so.
pub fn sheet(
    title: &str,
    folder: &Path,
    dataset: &Dataset,
    snapshots: &[Snapshot],
    background: [f32; 3],
) -> Option<Picture> {
    let steps: BTreeSet<u32> = snapshots.iter().map(|snapshot| snapshot.step).collect();
    let views: BTreeSet<usize> = snapshots.iter().map(|snapshot| snapshot.view).collect();
    let mut cells = Vec::new();
    for (index, view) in views.iter().filter_map(|&index| Some((index, dataset.val.get(index)?))) {
        let (width, height) = view.size();
        let (width, height) = (width as usize, height as usize);
        let truth = Picture { width, height, rgb: view.composite_over(background) };
        for &step in &steps {
            let taken = snapshots.iter().find(|taken| (taken.step, taken.view) == (step, index));
            let stored = taken.and_then(|taken| {
                let picture = Picture::read(taken.path(folder, dataset))?;
                // On a lattice of pixels it is smaller, and shown as large as the others.
                let fits = picture.width <= width && picture.height <= height;
                fits.then(|| (picture.enlarged(width / picture.width.max(1)), taken.psnr_db))
            });
            let (picture, said) = match stored {
                Some((picture, psnr_db)) => (picture, format!("{psnr_db:.2} dB")),
                None => (Picture::filled(width, height, NOTHING), "no picture".to_owned()),
            };
            let caption = format!("{}\nstep {step}\n{said}", view.name);
            cells.push(Cell::new(picture.reduced_to(SHEET_SIDE), caption));
        }
        cells.push(Cell::new(truth.reduced_to(SHEET_SIDE), format!("{}\nground truth", view.name)));
    }
    (!cells.is_empty()).then(|| contact_sheet(title, &cells, steps.len() + 1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::demo;
    use crate::data::demo::DemoSpec;

    fn scene() -> Dataset {
        let spec = DemoSpec { train: 1, val: 3, size: 24, ..DemoSpec::default() };
        demo::dataset(&spec).expect("a scene")
    }

    fn options(steps: &[u32], views: &[usize]) -> SnapshotOptions {
        SnapshotOptions { folder: PathBuf::new(), steps: steps.into(), views: views.into() }
    }

    #[test]
    fn views_are_those_named_or_those_watched() {
        let mut dataset = scene();
        assert_eq!(options(&[], &[]).views_of(&dataset, &[0, 2]), Ok(vec![0, 2]));
        assert_eq!(options(&[5], &[2, 1, 2]).views_of(&dataset, &[0]), Ok(vec![2, 1]));
        let error = options(&[], &[1, 3]).views_of(&dataset, &[0]).expect_err("three views").to_string();
        assert!(error.contains("--snapshot-views") && error.contains("below 3"), "{error}");
        dataset.val.clear();
        assert_eq!(options(&[], &[]).views_of(&dataset, &[]), Ok(vec![]));
        assert!(matches!(options(&[5], &[]).views_of(&dataset, &[]), Err(SnapshotError::NoViews { .. })));
        let taken = [Snapshot { step: 7, seconds: 0.0, view: 0, psnr_db: 9.0 }];
        assert_eq!(options(&[9, 7, 5, 9], &[]).missed(&taken), [5, 9]);
    }

    #[test]
    fn a_sheet_has_a_row_a_view_and_the_truth_last() {
        let (dataset, folder) = (scene(), tempfile::tempdir().expect("a folder"));
        std::fs::create_dir(folder.path().join("snapshots")).expect("a folder");
        assert!(sheet("a title", folder.path(), &dataset, &[], [0.0; 3]).is_none());
        let red = Picture::filled(24, 24, [1.0, 0.0, 0.0]);
        let taken = |step, view| Snapshot { step, seconds: 0.0, view, psnr_db: 10.0 };
        let snapshots = [taken(10, 0), taken(10, 2), taken(30, 2)];
        for snapshot in &snapshots[..2] {
            red.write_png(snapshot.path(folder.path(), &dataset)).expect("written");
        }
        let sheet = sheet("a title", folder.path(), &dataset, &snapshots, [0.0; 3]).expect("a sheet");
        let count = |colour: [f32; 3]| sheet.rgb.iter().filter(|rgb| **rgb == colour).count();
        // Enlarged eight times: two that are there, two that are not, and two truths.
        assert_eq!((count([1.0, 0.0, 0.0]), count(NOTHING)), (2 * 192 * 192, 2 * 192 * 192));
        assert!(sheet.width >= 3 * 192 && sheet.height >= 2 * 192);
    }
}
