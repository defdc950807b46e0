//! File names derived from names of views; counts and lists of names in messages.

use crate::data::View;
use std::collections::HashSet;
use std::path::Path;

/// File name stems of a report's own files, for example `views` of the contact sheet `views.png`.
const RESERVED: [&str; 4] = ["views", "curve", "curve_steps", "snapshots"];

/// Maximum length of a stem, bytes. A file name of 255 bytes then has room for `step_0000000000_` and `_z_depth.png`.
const MAX_BYTES: usize = 200;

/// File name stems of the views of a split; no two are equal, even if case is ignored.
///
/// `./train/r_3.png` becomes `train_r_3`. Letters of any script are kept. A stem that an earlier view has, or that the
/// report needs for itself, gets a number: `照片/一.png` and `照片_一.jpg` become `照片_一` and `照片_一_2`. The stems depend on
/// the whole split, so that a view has the same stem in every command.
#[derive(Clone, Debug)]
pub struct FileNames<'v> {
    views: &'v [View],
    stems: Vec<String>,
}

impl<'v> FileNames<'v> {
    pub fn of(views: &'v [View]) -> Self {
        Self { views, stems: stems(views.iter().map(|view| view.name.as_str())) }
    }

    /// Returns the file name stem of the view at `index`; panics if there is none.
    pub fn at(&self, index: usize) -> &str {
        &self.stems[index]
    }

    /// Returns the file name stem of `view`; panics if it is not one of the views.
    pub fn stem(&self, view: &View) -> &str {
        // Names may occur twice in a data set; views are distinguished by their addresses.
        let index = self.views.iter().position(|other| std::ptr::eq(other, view));
        self.at(index.expect("a view of the split"))
    }
}

fn stems<'n>(names: impl Iterator<Item = &'n str>) -> Vec<String> {
    let plain: Vec<String> = names.map(plain).collect();
    let fold = |stem: &str| stem.to_lowercase();
    let mut taken: HashSet<String> = RESERVED.into_iter().map(str::to_owned).collect();
    // A numbered stem must not equal the plain stem of another view.
    let own: HashSet<String> = plain.iter().map(|stem| fold(stem)).collect();
    let with_depth = |stem: &str| [fold(stem), fold(stem) + "_z_depth"];
    let mut assign = |stem: &str| {
        let free = |stem: &str| with_depth(stem).iter().all(|file| !taken.contains(file));
        let mut numbered = (2u64..).map(|n| format!("{stem}_{n}"));
        let found = if free(stem) {
            stem.to_owned()
        } else {
            numbered.find(|stem| free(stem) && !own.contains(&fold(stem))).unwrap_or_default()
        };
        taken.extend(with_depth(&found));
        found
    };
    plain.iter().map(|stem| assign(stem)).collect()
}

/// Returns `name` without extension, cut to [`MAX_BYTES`] bytes; characters other than letters and digits become `_`.
fn plain(name: &str) -> String {
    let stem = Path::new(name).with_extension("");
    let letter = |c: char| if c.is_alphanumeric() { c } else { '_' };
    let mut stem: String = stem.to_string_lossy().trim_start_matches("./").chars().map(letter).collect();
    while stem.len() > MAX_BYTES {
        stem.pop();
    }
    match stem.trim_end_matches('_') {
        "" => "view".to_owned(),
        stem => stem.to_owned(),
    }
}

pub(crate) fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// Returns a number with its noun: `1 view`, `2 views`.
pub(crate) fn count(n: usize, what: &str) -> String {
    if n == 1 { format!("1 {what}") } else { format!("{n} {what}s") }
}

/// Joins the first eight names with commas, and appends the number of further names, if any: `a, …, h and 3 more`.
pub(crate) fn listed(names: &[impl AsRef<str>]) -> String {
    const SHOWN: usize = 8;
    let shown: Vec<&str> = names.iter().take(SHOWN).map(AsRef::as_ref).collect();
    let more = if names.len() > SHOWN { format!(" and {} more", names.len() - SHOWN) } else { String::new() };
    shown.join(", ") + &more
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(names: &[&str]) -> Vec<String> {
        stems(names.iter().copied())
    }

    #[test]
    fn names_that_do_not_collide_stay() {
        assert_eq!(
            of(&["./train/r_3.png", "images_val[1]", "b.c.jpg"]),
            ["train_r_3", "images_val_1", "b_c"]
        );
    }

    #[test]
    fn no_two_views_share_a_file() {
        let long = ["a".repeat(300), "a".repeat(301)];
        let mut names: Vec<&str> =
            "a/x.png a_x.png a_x.jpg a_x_2.png A_X 照片/一.png 照片_一.png 照片/二.png é.png \
             e\u{301}.png .. ___ views.png Curve p p_z_depth q_z_depth q q r_0.5 r_0.7"
                .split_whitespace()
                .collect();
        names.extend(["", &long[0], &long[1]]);
        let stems = of(&names);
        assert_eq!(stems[..5], ["a_x", "a_x_3", "a_x_4", "a_x_2", "A_X_5"]);
        let files = stems.iter().flat_map(|stem| [format!("{stem}.png"), format!("{stem}_z_depth.png")]);
        let mut files: Vec<String> = files.map(|file| file.to_lowercase()).collect();
        files.extend(RESERVED.map(|stem| format!("{stem}.png")));
        let count = files.len();
        assert!(files.iter().all(|file| file.len() + "step_0000000000_".len() <= 255));
        files.sort();
        files.dedup();
        assert_eq!(files.len(), count, "{stems:?}");
        assert_eq!(of(&names), stems);
    }
}
