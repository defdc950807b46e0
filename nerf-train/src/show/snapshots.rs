//! The sheet of pictures taken during training.

use super::contact_sheet::{Cell, contact_sheet};
use crate::data::Dataset;
use crate::data::pictures::rgb::Picture;
use crate::train::Snapshot;
use std::collections::BTreeSet;
use std::path::Path;

/// Longer side of a picture on the sheet, pixels: larger ones are reduced.
const SHEET_SIDE: usize = 400;
/// Colour of the cell of a missing picture.
const NOTHING: [f32; 3] = [0.88; 3];

/// A sheet with a row per view, a column per step, and ground truth over `background` last; `None` without snapshots.
///
/// The pictures are read back from the report's `folder`, so that those from before a resumed run are there, too. A
/// missing picture becomes an empty cell that says so.
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
                // A picture of every N-th pixel is smaller: it is enlarged to the size of the others.
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

    #[test]
    fn a_sheet_has_a_row_a_view_and_the_truth_last() {
        let (dataset, folder) = (demo::small(1, 3, 24), tempfile::tempdir().expect("a folder"));
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
