//! Snapshots: images of validation views, rendered during training.

use crate::data::Dataset;
use crate::train::Snapshot;
use anyhow::bail;
use std::collections::BTreeSet;
use std::path::PathBuf;

#[derive(Clone, Debug, PartialEq)]
pub struct SnapshotOptions {
    /// Folder of the report; images are written to the folder `snapshots` inside this folder.
    pub folder: PathBuf,
    /// Steps of the snapshots. If empty: at validations, at most one per eighth of the budget, and at the end.
    pub steps: Vec<u32>,
    /// Indices, in the validation split, of the views to render; if empty, the views validated during training.
    pub views: Vec<usize>,
}

impl SnapshotOptions {
    /// Returns the indices of the views to render, without duplicates: those of the options or, if there are none,
    /// `watched`. Fails if an index is too large, or if snapshots are requested without validation views.
    pub fn views_of(&self, dataset: &Dataset, watched: &[usize]) -> anyhow::Result<Vec<usize>> {
        let (data, views) = (&dataset.name, dataset.val.len());
        let asked = !self.steps.is_empty() || !self.views.is_empty();
        if asked && views == 0 {
            bail!("--snapshots: expected validation views to show, found none in {data}");
        }
        if let Some(&found) = self.views.iter().find(|&&view| view >= views) {
            bail!(
                "--snapshot-views: expected indices below {views} (the validation views of {data}), found {found}"
            );
        }
        let mut chosen: Vec<usize> = Vec::new();
        for &view in if self.views.is_empty() { watched } else { &self.views } {
            if !chosen.contains(&view) {
                chosen.push(view);
            }
        }
        Ok(chosen)
    }

    /// Returns the requested steps at which no snapshot was taken, ascending. `taken`: the snapshots of the run.
    pub fn missed(&self, taken: &[Snapshot]) -> Vec<u32> {
        let steps: BTreeSet<u32> = self.steps.iter().copied().collect();
        steps.into_iter().filter(|&step| taken.iter().all(|snapshot| snapshot.step != step)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::demo;

    fn options(steps: &[u32], views: &[usize]) -> SnapshotOptions {
        SnapshotOptions { folder: PathBuf::new(), steps: steps.into(), views: views.into() }
    }

    #[test]
    fn views_are_those_named_or_those_watched() {
        let mut dataset = demo::small(1, 3, 24);
        assert_eq!(options(&[], &[]).views_of(&dataset, &[0, 2]).expect("views"), [0, 2]);
        assert_eq!(options(&[5], &[2, 1, 2]).views_of(&dataset, &[0]).expect("views"), [2, 1]);
        let error = options(&[], &[1, 3]).views_of(&dataset, &[0]).expect_err("three views").to_string();
        assert!(error.contains("--snapshot-views") && error.contains("below 3"), "{error}");
        dataset.val.clear();
        assert!(options(&[], &[]).views_of(&dataset, &[]).expect("none").is_empty());
        assert!(
            options(&[5], &[])
                .views_of(&dataset, &[])
                .is_err_and(|error| error.to_string().contains("found none"))
        );
        let taken = [Snapshot { step: 7, seconds: 0.0, view: 0, psnr_db: 9.0 }];
        assert_eq!(options(&[9, 7, 5, 9], &[]).missed(&taken), [5, 9]);
    }
}
