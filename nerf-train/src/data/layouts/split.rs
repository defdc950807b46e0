//! Which views are held out where a data set does not say.

use crate::data::{ReadOptions, View};

/// One view in this many is held out, as the field does.
pub(crate) const HOLD: usize = 8;

/// Training and validation: of the views sorted by the bytes of their names, every eighth from
/// [`ReadOptions::hold_offset`] on is validation. A single view is for training.
pub(crate) fn every_eighth(
    mut views: Vec<View>,
    options: &ReadOptions,
    notes: &mut Vec<String>,
) -> (Vec<View>, Vec<View>) {
    views.sort_by(|a, b| a.name.cmp(&b.name));
    let offset = options.hold_offset % HOLD;
    if views.len() <= 1 + offset {
        return (views, Vec::new());
    }
    let [mut train, mut val] = [Vec::new(), Vec::new()];
    for (index, view) in views.into_iter().enumerate() {
        let split = if index % HOLD == offset { &mut val } else { &mut train };
        split.push(view);
    }
    notes.push(format!(
        "{} of {} held out: every eighth by name, from number {offset} on",
        val.len(),
        train.len() + val.len()
    ));
    (train, val)
}
