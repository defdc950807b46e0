//! What the reading of pictures finds besides them.

use super::View;
use super::transforms::listed;

/// Things to say, over all files of a data set.
#[derive(Default)]
pub(super) struct Found {
    /// Sentences.
    pub(super) warnings: Vec<String>,
    /// Pictures that are transparent somewhere.
    transparent: usize,
    /// Pictures of any kind.
    pictures: usize,
    /// Names of pictures without an alpha channel.
    opaque: Vec<String>,
}

impl Found {
    /// Counts a view; `channel`: whether its file has an alpha channel.
    pub(super) fn count_alpha(&mut self, view: &View, channel: bool) {
        self.pictures += 1;
        if !channel {
            self.opaque.push(view.name.clone());
        } else if view.has_alpha() {
            self.transparent += 1;
        }
    }

    /// The sentences, and one where only some pictures have alpha.
    ///
    /// A picture whose alpha is 255 everywhere is none of those without: an object may fill it.
    pub(super) fn into_warnings(mut self) -> Vec<String> {
        if self.transparent > 0 && !self.opaque.is_empty() {
            self.warnings.push(format!(
                "alpha in only {} of {} pictures: the others count as opaque, their own background as part of the \
                 scene: {}",
                self.pictures - self.opaque.len(),
                self.pictures,
                listed(&self.opaque)
            ));
        }
        self.warnings
    }
}
