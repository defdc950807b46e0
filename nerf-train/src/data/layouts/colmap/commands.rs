//! The commands of COLMAP that find the poses of photographs.

use std::ffi::{OsStr, OsString};
use std::path::Path;

/// Options that COLMAP 3.13 has renamed: before, since.
const NEWER: [(&str, &str); 4] = [
    ("--SiftExtraction.use_gpu", "--FeatureExtraction.use_gpu"),
    ("--SiftExtraction.num_threads", "--FeatureExtraction.num_threads"),
    ("--SiftMatching.use_gpu", "--FeatureMatching.use_gpu"),
    ("--SiftMatching.num_threads", "--FeatureMatching.num_threads"),
];

/// The same, for messages.
pub(in crate::data) const RENAMED: &str =
    "since COLMAP 3.13 it is --FeatureExtraction.use_gpu and --FeatureMatching.use_gpu";

/// How many photographs are compared with as many at a time, in versions that have it: few, to see how far it is.
const BLOCK: (&str, &str) = ("--ExhaustiveMatching.block_size", "10");

/// A command with its options.
#[derive(Debug)]
pub(crate) struct Stage {
    /// COLMAP's name of it.
    pub(crate) name: &'static str,
    options: Vec<(&'static str, OsString)>,
}

/// Features, matches and models, in this order: from the photographs in `images` to folders in `models`.
///
/// Nothing needs a GPU. `one_camera`: whether one has taken all of them; `sequential`: whether only neighbours in the
/// order of names are compared.
pub(crate) fn stages(
    images: &Path,
    database: &Path,
    models: &Path,
    one_camera: bool,
    sequential: bool,
) -> [Stage; 3] {
    let database = || ("--database_path", database.into());
    let images = || ("--image_path", images.into());
    let no_gpu = |option| (option, "0".into());
    let mut extraction = vec![images(), database(), ("--ImageReader.camera_model", "OPENCV".into())];
    extraction.extend(one_camera.then(|| ("--ImageReader.single_camera", "1".into())));
    extraction.push(no_gpu("--SiftExtraction.use_gpu"));
    [
        Stage { name: "feature_extractor", options: extraction },
        Stage {
            name: if sequential { "sequential_matcher" } else { "exhaustive_matcher" },
            options: vec![database(), no_gpu("--SiftMatching.use_gpu")],
        },
        Stage { name: "mapper", options: vec![images(), database(), ("--output_path", models.into())] },
    ]
}

impl Stage {
    /// With at most so many threads.
    pub(crate) fn with_threads(mut self, threads: usize) -> Self {
        let option = match self.name {
            "feature_extractor" => "--SiftExtraction.num_threads",
            "mapper" => "--Mapper.num_threads",
            _ => "--SiftMatching.num_threads",
        };
        self.options.push((option, threads.to_string().into()));
        self
    }

    /// The arguments of `colmap`, for the version whose help on the command this is.
    pub(crate) fn arguments(&self, help: &str) -> Vec<OsString> {
        let named = |option: &'static str| {
            let newer = NEWER
                .iter()
                .find(|(before, since)| *before == option && !help.contains(before) && help.contains(since));
            newer.map_or(option, |(_, since)| since)
        };
        let options = self.options.iter();
        let options = options.flat_map(|(option, value)| [named(option).into(), value.clone()]);
        let block = help.contains(BLOCK.0).then_some([BLOCK.0.into(), BLOCK.1.into()]);
        std::iter::once(self.name.into()).chain(options).chain(block.into_iter().flatten()).collect()
    }

    /// A line of shell.
    pub(crate) fn line(&self) -> String {
        let arguments = self.arguments("");
        let words = arguments.iter().map(quoted);
        std::iter::once("colmap".to_owned()).chain(words).collect::<Vec<_>>().join(" ")
    }
}

/// As one word of shell.
pub(in crate::data) fn quoted(word: impl AsRef<OsStr>) -> String {
    let word = word.as_ref().to_string_lossy();
    let plain = |c: char| c.is_alphanumeric() || "-_./+:@%,".contains(c);
    if !word.is_empty() && word.chars().all(plain) {
        return word.into_owned();
    }
    format!("'{}'", word.replace('\'', r"'\''"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_have_the_names_of_the_installed_version() {
        let [extraction, matching, _] =
            stages(Path::new("i"), Path::new("d"), Path::new("m"), false, true).map(|s| s.with_threads(3));
        let has = |stage: &Stage, help, option: &str| stage.arguments(help).iter().any(|word| word == option);
        for (help, family) in
            [("", "Sift"), ("--SiftExtraction.use_gpu --SiftExtraction.num_threads", "Sift")]
        {
            assert!(has(&extraction, help, &format!("--{family}Extraction.use_gpu")));
        }
        let newer = "--FeatureExtraction.use_gpu arg (=1)\n --FeatureExtraction.num_threads arg (=-1)";
        assert!(has(&extraction, newer, "--FeatureExtraction.use_gpu"), "{:?}", extraction.arguments(newer));
        assert!(!has(&extraction, newer, "--SiftExtraction.num_threads"));
        assert!(has(&matching, "--FeatureMatching.use_gpu", "--FeatureMatching.use_gpu"));
        assert!(!has(&extraction, "", "--ImageReader.single_camera"));
    }

    #[test]
    fn names_are_one_word_of_shell_each() {
        let stage = &stages(Path::new("my pictures"), Path::new("it's.db"), Path::new("-m"), true, false)[0];
        assert_eq!(
            stage.line(),
            r"colmap feature_extractor --image_path 'my pictures' --database_path 'it'\''s.db' --ImageReader.camera_model OPENCV --ImageReader.single_camera 1 --SiftExtraction.use_gpu 0"
        );
    }
}
