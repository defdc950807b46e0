//! The commands of COLMAP that find the poses of photographs.

use std::ffi::{OsStr, OsString};
use std::path::{Path, PathBuf};

/// Options that COLMAP 3.13 has renamed: old name, new name.
const NEWER: [(&str, &str); 4] = [
    ("--SiftExtraction.use_gpu", "--FeatureExtraction.use_gpu"),
    ("--SiftExtraction.num_threads", "--FeatureExtraction.num_threads"),
    ("--SiftMatching.use_gpu", "--FeatureMatching.use_gpu"),
    ("--SiftMatching.num_threads", "--FeatureMatching.num_threads"),
];

pub(in crate::data) const RENAMED: &str =
    "since COLMAP 3.13 it is --FeatureExtraction.use_gpu and --FeatureMatching.use_gpu";

#[derive(Debug)]
pub(crate) struct Stage {
    pub(crate) name: &'static str,
    options: Vec<(&'static str, OsString)>,
    /// Options that are left out if the installed version of COLMAP does not know them.
    optional: Vec<(&'static str, OsString)>,
}

#[derive(Debug)]
pub(crate) struct Place {
    pub(crate) images: PathBuf,
    pub(crate) work: PathBuf,
}

/// Strategy by which COLMAP matches features and reconstructs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Way {
    Exhaustive,
    /// Matches each photograph with its neighbours in the order of names.
    Sequential,
    /// Reuses the matches of `Exhaustive` or `Sequential`, but reconstructs from another first pair of photographs.
    OtherPair {
        sequential: bool,
    },
    /// Keeps only distinctive matches, and only pairs of photographs with at least 30 matches.
    Strict {
        sequential: bool,
    },
}

impl Way {
    /// Returns the strategies to try, in order: the requested one (`sequential` or exhaustive), then the alternatives.
    pub(crate) fn all(sequential: bool) -> Vec<Self> {
        let others = [Self::OtherPair { sequential }, Self::Strict { sequential }];
        let asked: &[Self] =
            if sequential { &[Self::Sequential] } else { &[Self::Exhaustive, Self::Sequential] };
        asked.iter().copied().chain(others).collect()
    }

    pub(crate) fn in_words(self) -> &'static str {
        match self {
            Self::Exhaustive => "all photographs against all",
            Self::Sequential => "each photograph against its neighbours in the order of names",
            Self::OtherPair { .. } => "another initial pair",
            Self::Strict { .. } => "stricter matches",
        }
    }

    /// Returns the strategy that made the matches: for `OtherPair` the strategy whose matches are reused, else `self`.
    fn matches(self) -> Self {
        match self {
            Self::OtherPair { sequential: false } => Self::Exhaustive,
            Self::OtherPair { sequential: true } => Self::Sequential,
            own => own,
        }
    }
}

impl Place {
    pub(crate) fn features(&self) -> PathBuf {
        self.work.join("database.db")
    }

    /// Returns the path of COLMAP's database with the matches that `way` uses.
    pub(crate) fn database(&self, way: Way) -> PathBuf {
        self.work.join(match way.matches() {
            Way::Exhaustive => "exhaustive.db",
            Way::Sequential => "sequential.db",
            _ => "strict.db",
        })
    }

    /// Returns the folder for the results of `way`. COLMAP writes reconstructions to the folder `sparse` in it.
    pub(crate) fn models(&self, way: Way) -> PathBuf {
        self.work.join(match way {
            Way::Exhaustive => "exhaustive",
            Way::Sequential => "sequential",
            Way::OtherPair { .. } => "pair",
            Way::Strict { .. } => "strict",
        })
    }
}

/// Makes the command that extracts features on the CPU. `list`: file that names the photographs to read; `None`: all.
pub(crate) fn features(place: &Place, list: Option<&Path>) -> Stage {
    let mut stage = extraction(&place.images, &place.features(), true);
    stage.options.extend(list.map(|list| ("--image_list_path", list.into())));
    stage
}

fn extraction(images: &Path, database: &Path, one_camera: bool) -> Stage {
    let mut options = vec![
        ("--image_path", images.into()),
        ("--database_path", database.into()),
        ("--ImageReader.camera_model", "OPENCV".into()),
    ];
    options.extend(one_camera.then(|| ("--ImageReader.single_camera", "1".into())));
    options.push(("--SiftExtraction.use_gpu", "0".into()));
    Stage { name: "feature_extractor", options, optional: Vec::new() }
}

/// Makes the command that matches the features by `way`; `None` for `OtherPair`, which reuses matches.
pub(crate) fn matching(place: &Place, way: Way) -> Option<Stage> {
    let (sequential, strict) = match way {
        Way::Exhaustive => (false, false),
        Way::Sequential => (true, false),
        Way::Strict { sequential } => (sequential, true),
        Way::OtherPair { .. } => return None,
    };
    let mut stage = matcher(&place.database(way), sequential);
    stage.optional.extend(strict.then(|| ("--SiftMatching.max_ratio", "0.7".into())));
    Some(stage)
}

fn matcher(database: &Path, sequential: bool) -> Stage {
    Stage {
        name: if sequential { "sequential_matcher" } else { "exhaustive_matcher" },
        options: vec![("--database_path", database.into()), ("--SiftMatching.use_gpu", "0".into())],
        // Small blocks of compared photographs, so that progress is shown often.
        optional: vec![("--ExhaustiveMatching.block_size", "10".into())],
    }
}

/// Makes the command that reconstructs by `way`. `photographs`: number of photographs in the database.
pub(crate) fn mapping(place: &Place, way: Way, photographs: usize) -> Stage {
    let mut stage = mapper(&place.images, &place.database(way), &place.models(way).join("sparse"));
    match way {
        // Photographs have the numbers 1, 2, … in a database.
        Way::OtherPair { .. } => {
            stage.optional.push(("--Mapper.init_image_id1", (photographs / 2 + 1).to_string().into()));
        }
        Way::Strict { .. } => stage.optional.push(("--Mapper.min_num_matches", "30".into())),
        Way::Exhaustive | Way::Sequential => {}
    }
    stage
}

fn mapper(images: &Path, database: &Path, models: &Path) -> Stage {
    let options = vec![
        ("--image_path", images.into()),
        ("--database_path", database.into()),
        ("--output_path", models.into()),
    ];
    Stage { name: "mapper", options, optional: Vec::new() }
}

/// Makes the three commands for a user to run by hand. `one_camera`: whether one camera took all photographs.
pub(crate) fn by_hand(images: &Path, database: &Path, models: &Path, one_camera: bool) -> [Stage; 3] {
    [extraction(images, database, one_camera), matcher(database, false), mapper(images, database, models)]
}

impl Stage {
    pub(crate) fn with_threads(mut self, threads: usize) -> Self {
        let option = match self.name {
            "feature_extractor" => "--SiftExtraction.num_threads",
            "mapper" => "--Mapper.num_threads",
            _ => "--SiftMatching.num_threads",
        };
        self.options.push((option, threads.to_string().into()));
        self
    }

    /// Returns the arguments of `colmap`. `help`: the installed version's help text, which lists its options.
    pub(crate) fn arguments(&self, help: &str) -> Vec<OsString> {
        let named = |option: &'static str| {
            let newer = NEWER
                .iter()
                .find(|(before, since)| *before == option && !help.contains(before) && help.contains(since));
            newer.map_or(option, |(_, since)| since)
        };
        let optional = self.optional.iter().filter(|(option, _)| help.contains(named(option)));
        let options = self.options.iter().chain(optional);
        let options = options.flat_map(|(option, value)| [named(option).into(), value.clone()]);
        std::iter::once(self.name.into()).chain(options).collect()
    }

    pub(crate) fn line(&self) -> String {
        let arguments = self.arguments("");
        let words = arguments.iter().map(quoted);
        std::iter::once("colmap".to_owned()).chain(words).collect::<Vec<_>>().join(" ")
    }
}

/// Quotes `word` as one word of a shell command.
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
            by_hand(Path::new("i"), Path::new("d"), Path::new("m"), false).map(|s| s.with_threads(3));
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
        let stage = &by_hand(Path::new("my pictures"), Path::new("it's.db"), Path::new("-m"), true)[0];
        assert_eq!(
            stage.line(),
            r"colmap feature_extractor --image_path 'my pictures' --database_path 'it'\''s.db' --ImageReader.camera_model OPENCV --ImageReader.single_camera 1 --SiftExtraction.use_gpu 0"
        );
    }
}
