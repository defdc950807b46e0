//! Notes and warnings from reading pictures.

use crate::data::names::{file_name, listed};
use crate::data::pictures::photo::Loaded;
use std::collections::BTreeMap;
use std::path::Path;

#[derive(Default)]
pub(crate) struct Found {
    pub(crate) warnings: Vec<String>,
    pub(crate) notes: Vec<String>,
    transparent: usize,
    pictures: usize,
    /// Names of pictures without an alpha channel.
    opaque: Vec<String>,
    /// Number of reduced pictures for each pair of sizes: width and height before, then after the reduction, pixels.
    scaled: BTreeMap<[u32; 4], usize>,
    /// Number of pictures that are partly masked out.
    masked: usize,
    /// Names of pictures that are masked out entirely.
    hidden: Vec<String>,
    /// Number of views with each note. Key: name of the file that states the poses, and the note.
    said: BTreeMap<(String, String), usize>,
}

impl Found {
    /// Counts a loaded picture and its notes. `file` states the poses. Returns false if the mask hides all pixels.
    pub(crate) fn count(&mut self, file: &Path, loaded: &Loaded) -> bool {
        let Loaded { view, alpha, larger, notes } = loaded;
        self.pictures += 1;
        if !alpha {
            self.opaque.push(view.name.clone());
        } else if view.has_alpha() {
            self.transparent += 1;
        }
        if let Some((from_width, from_height)) = *larger {
            let (width, height) = view.size();
            *self.scaled.entry([from_width, from_height, width, height]).or_default() += 1;
        }
        for note in notes {
            *self.said.entry((file_name(file), note.clone())).or_default() += 1;
        }
        let Some(mask) = &view.mask else { return true };
        let some = mask.contains(&true);
        if some {
            self.masked += 1;
        } else {
            self.hidden.push(view.name.clone());
        }
        some
    }

    /// Returns all notes and warnings. Warns if some pictures are transparent and others have no alpha channel. A
    /// picture with an alpha channel of 255 everywhere is not named in this warning: an object may fill the picture.
    pub(crate) fn into_sentences(mut self) -> (Vec<String>, Vec<String>) {
        for ([a, b, c, d], count) in self.scaled {
            self.notes
                .push(format!("{count} pictures of {a}x{b} made smaller by area, to {c}x{d} (--downscale)"));
        }
        if self.masked > 0 {
            self.notes.push(format!(
                "{} pictures have masks: what is black in these is neither trained on nor measured",
                self.masked
            ));
        }
        if !self.hidden.is_empty() {
            let (count, names) = (self.hidden.len(), listed(&self.hidden));
            self.warnings.push(format!("skipped {count} pictures, whose masks leave no pixel: {names}"));
        }
        let said = self.said.into_iter();
        self.warnings.extend(said.map(|((file, note), count)| format!("{file}: {count} views: {note}")));
        if self.transparent > 0 && !self.opaque.is_empty() {
            self.warnings.push(format!(
                "alpha in only {} of {} pictures: the others count as opaque, their own background as part of the \
                 scene: {}",
                self.pictures - self.opaque.len(),
                self.pictures,
                listed(&self.opaque)
            ));
        }
        (self.notes, self.warnings)
    }
}
