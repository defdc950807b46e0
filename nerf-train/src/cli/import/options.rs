//! What the file cannot say, by flag or TOML file.

use crate::cli::common::{parse_background, parse_numbers};
use crate::data::Axes;
use crate::model::import::{AngleFactor, Identity, Order, RawDensity, Settings};
use crate::system::input;
use anyhow::Context;
use clap::Args;
use serde::{Deserialize, Deserializer};
use std::path::Path;

/// The same fields as flags and as a TOML file; what is absent stays as nerf-pytorch has it.
#[derive(Clone, Debug, Default, Args, Deserialize)]
#[command(next_help_heading = "What the file cannot say (flags, or a TOML file with the same names)")]
#[serde(deny_unknown_fields, default)]
pub struct Guesses {
    /// The factor s in sin(2^k s x): 1 (nerf-pytorch) or pi [default: 1].
    #[arg(long, value_enum, value_name = "S", hide_possible_values = true)]
    pub angle_scale: Option<AngleFactor>,
    /// Order of the sines and cosines [default: level, as nerf-pytorch].
    #[arg(long, value_enum)]
    pub order: Option<Order>,
    /// Where the inputs themselves stand among them [default: in front, if the widths say that they are
    /// there].
    #[arg(long, value_enum)]
    pub identity: Option<Identity>,
    /// Levels of the position's encoding, checked against the file [default: as the file].
    #[arg(long, value_name = "L")]
    pub position_levels: Option<u8>,
    /// Levels of the direction's encoding, checked against the file [default: as the file].
    #[arg(long, value_name = "L")]
    pub direction_levels: Option<u8>,
    /// From the density layer's output to sigma [default: relu].
    #[arg(long, value_enum)]
    pub density: Option<RawDensity>,
    /// What is behind the scene: black, white, red, #RRGGBB or R,G,B (0 to 255) [default: black].
    #[arg(long, value_name = "COLOUR", value_parser = parse_background)]
    #[serde(deserialize_with = "background")]
    pub background: Option<[f32; 3]>,
    /// Where rays begin, world units along the ray [default: 2].
    #[arg(long, value_name = "T")]
    pub near: Option<f32>,
    /// Where rays end, world units along the ray [default: 6].
    #[arg(long, value_name = "T")]
    pub far: Option<f32>,
    /// The scene box, world units; outside of it nothing is [default: -1.5,-1.5,-1.5,1.5,1.5,1.5].
    #[arg(
        long = "box",
        value_name = "X0,Y0,Z0,X1,Y1,Z1",
        value_parser = parse_numbers::<6, f32>,
        allow_hyphen_values = true
    )]
    #[serde(rename = "box")]
    pub scene_box: Option<[f32; 6]>,
    /// Samples a ray [default: 192; with --coarse 128, which are drawn from it].
    #[arg(long, value_name = "N")]
    pub samples: Option<u16>,
    /// Samples a ray of the network of --coarse [default: 64].
    #[arg(long, value_name = "N", requires = "coarse")]
    pub coarse_samples: Option<u16>,
    /// Convention of the poses of --check: opengl or opencv [default: as is usual for the layout].
    #[arg(long, value_name = "CONVENTION")]
    pub axes: Option<Axes>,
    /// Cells of the occupancy grid along the longest side of the box, where one is built [default: 128].
    #[arg(long, value_name = "N")]
    pub occupancy_resolution: Option<u16>,
    /// A cell of such an occupancy grid is kept where density times bin width exceeds this [default: 0.01].
    #[arg(long, value_name = "X")]
    pub occupancy_threshold: Option<f32>,
}

fn background<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<[f32; 3]>, D::Error> {
    let text = String::deserialize(deserializer)?;
    parse_background(&text)
        .map(Some)
        .map_err(|expected| serde::de::Error::custom(format!("background: {expected}, found \"{text}\"")))
}

impl Guesses {
    /// Reads a TOML file.
    pub fn read(file: &Path) -> anyhow::Result<Self> {
        let text = input::read_text(file, input::MAX_TOML_BYTES)
            .with_context(|| format!("cannot read {}", file.display()))?;
        toml::from_str(&text)
            .map_err(|error| anyhow::anyhow!("{}: {}", file.display(), input::toml_message(&text, &error)))
    }

    /// These, and where they say nothing `other`.
    pub fn or(self, other: Self) -> Self {
        Self {
            angle_scale: self.angle_scale.or(other.angle_scale),
            order: self.order.or(other.order),
            identity: self.identity.or(other.identity),
            position_levels: self.position_levels.or(other.position_levels),
            direction_levels: self.direction_levels.or(other.direction_levels),
            density: self.density.or(other.density),
            background: self.background.or(other.background),
            near: self.near.or(other.near),
            far: self.far.or(other.far),
            scene_box: self.scene_box.or(other.scene_box),
            samples: self.samples.or(other.samples),
            coarse_samples: self.coarse_samples.or(other.coarse_samples),
            axes: self.axes.or(other.axes),
            occupancy_resolution: self.occupancy_resolution.or(other.occupancy_resolution),
            occupancy_threshold: self.occupancy_threshold.or(other.occupancy_threshold),
        }
    }

    /// The settings of the import, with or without a coarse network.
    pub fn settings(&self, coarse: bool) -> Settings {
        let base = match coarse {
            true => Settings {
                samples: Settings::DRAWN_SAMPLES,
                coarse_samples: Some(self.coarse_samples.unwrap_or(Settings::COARSE_SAMPLES)),
                ..Settings::default()
            },
            false => Settings::default(),
        };
        Settings {
            angle: self.angle_scale.unwrap_or(base.angle),
            order: self.order.unwrap_or(base.order),
            identity: self.identity,
            position_levels: self.position_levels,
            direction_levels: self.direction_levels,
            density: self.density.unwrap_or(base.density),
            background: self.background.unwrap_or(base.background),
            near: self.near.unwrap_or(base.near),
            far: self.far.unwrap_or(base.far),
            scene_box: self.scene_box.unwrap_or(base.scene_box),
            samples: self.samples.unwrap_or(base.samples),
            coarse_samples: base.coarse_samples,
            occupancy_resolution: self.occupancy_resolution.unwrap_or(base.occupancy_resolution),
            occupancy_threshold: self.occupancy_threshold.unwrap_or(base.occupancy_threshold),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flags_win_over_the_file_and_the_file_over_the_default() {
        let file: Guesses = toml::from_str(
            "angle_scale = \"pi\"\norder = \"halves-by-input\"\nidentity = \"last\"\nbackground = \"white\"\n\
             near = 1\nbox = [-1, -2, -3, 1, 2, 3]\naxes = \"opencv\"\ndensity = \"softplus\"\n",
        )
        .expect("settings");
        let flags = Guesses { near: Some(0.5), order: Some(Order::Level), ..Guesses::default() };
        let all = flags.or(file);
        assert_eq!(all.axes, Some(Axes::Opencv));
        let expected = Settings {
            angle: AngleFactor::Pi,
            identity: Some(Identity::Last),
            density: RawDensity::Softplus,
            background: [1.0; 3],
            near: 0.5,
            scene_box: [-1.0, -2.0, -3.0, 1.0, 2.0, 3.0],
            ..Settings::default()
        };
        assert_eq!(all.settings(false), expected);
        let drawn = Settings { samples: 128, coarse_samples: Some(64), ..expected };
        assert_eq!(all.settings(true), drawn);
        let fewer = Guesses { samples: Some(32), coarse_samples: Some(16), ..all };
        assert_eq!(fewer.settings(true), Settings { samples: 32, coarse_samples: Some(16), ..drawn });
        for (wrong, word) in [("backgruond = \"white\"", "backgruond"), ("background = \"beige\"", "beige")] {
            let error = toml::from_str::<Guesses>(wrong).expect_err("wrong").to_string();
            assert!(error.contains(word), "{error}");
        }
    }
}
