//! Settings out of a TOML file.

use crate::model::config::{Config, Preset, Surroundings};
use crate::system::input;
use anyhow::Context;
use std::path::Path;

/// The preset for what lies around the scene, with the TOML file's values put over it.
///
/// A file that turns the hull off, or sets a contraction or a box, gets the defaults of that case for what it does not set.
pub fn read_config(
    preset: Preset,
    file: Option<&Path>,
    surroundings: Surroundings,
) -> anyhow::Result<Config> {
    let Some(file) = file else { return Ok(preset.config().around(surroundings)) };
    let text = input::read_text(file, input::MAX_TOML_BYTES)
        .with_context(|| format!("cannot read {}", file.display()))?;
    let parse = || -> anyhow::Result<Config> {
        let given: toml::Table = text.parse()?;
        let preset = match given.get("preset") {
            Some(named) => named.clone().try_into::<Preset>()?,
            None => preset,
        };
        let without = |key| {
            let switch = given.get("occupancy").and_then(|table| table.get(key));
            switch.and_then(toml::Value::as_bool) == Some(false)
        };
        let names = |key| given.get("sampling").is_some_and(|table| table.get(key).is_some());
        let surroundings = match surroundings {
            _ if names("contraction") => Surroundings::Unbounded,
            Surroundings::Unbounded if names("scene_box") || without("skip") => Surroundings::Unknown,
            Surroundings::Known if without("hull") => Surroundings::Unknown,
            other => other,
        };
        let mut start = preset.config().around(surroundings);
        // A file's own grid over a preset without one is filled up from the preset that has one; the rest of the
        // network is then checked to go with it.
        if given.get("network").is_some_and(|network| network.get("grid").is_some()) {
            start.network.grid = start.network.grid.or(Preset::Grid.config().network.grid);
        }
        let mut merged = toml::Table::try_from(start)?;
        merge(&mut merged, given);
        Ok(merged.try_into()?)
    };
    parse().map_err(|error| match error.downcast_ref::<toml::de::Error>() {
        Some(toml) => anyhow::anyhow!("{}: {}", file.display(), input::toml_message(&text, toml)),
        None => error.context(file.display().to_string()),
    })
}

fn merge(into: &mut toml::Table, from: toml::Table) {
    for (key, value) in from {
        match (into.get_mut(&key), value) {
            (Some(toml::Value::Table(into)), toml::Value::Table(from)) => merge(into, from),
            (_, value) => {
                into.insert(key, value);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_of_the_firmware_are_settings_for_the_demo() {
        for (name, is_grid) in [("scene.toml", false), ("grid.toml", true)] {
            let firmware = Path::new(env!("CARGO_MANIFEST_DIR")).join("../nerf-core/examples/firmware");
            let file = firmware.join(name);
            let config = read_config(Preset::Grid, Some(&file), Surroundings::Known).expect("settings");
            config.check().unwrap_or_else(|error| panic!("{name}: {error}"));
            assert_eq!(config.network.grid.is_some(), is_grid, "{name}");
        }
    }

    #[test]
    fn a_file_without_hull_starts_as_gently_as_the_flag() {
        let folder = tempfile::tempdir().expect("a folder");
        let read = |text: &str| {
            let file = folder.path().join("run.toml");
            std::fs::write(&file, text).expect("written");
            read_config(Preset::Small, Some(&file), Surroundings::Known).expect("a config")
        };
        let gentle = read_config(Preset::Small, None, Surroundings::Unknown).expect("a config");
        assert_eq!(gentle, Preset::Small.config().without_hull());
        assert_eq!(read("[occupancy]\nhull = false"), gentle);
        assert_eq!(read("[occupancy]\nhull = true"), Preset::Small.config());
        assert_eq!(read("seed = 0"), Preset::Small.config());
        // What the file says itself counts.
        let mut own = gentle.clone();
        (own.occupancy.from, own.optimiser.rate) = (77, 2e-3);
        assert_eq!(read("[occupancy]\nhull = false\nfrom = 77\n[optimiser]\nrate = 2e-3"), own);
        // A grid's own table over a preset without one is filled up; what does not go with it is refused by name.
        let mixed = read("[network.grid]\nlevels = 4");
        let grid = Preset::Grid.config().network.grid.expect("a grid");
        assert_eq!(mixed.network.grid, Some(crate::model::config::TableConfig { levels: 4, ..grid }));
        assert_eq!(mixed.check().expect_err("contradictory").field, "network.position_levels");
        let whole = "[network]\nposition_levels = 0\ndensity = \"exponential\"\ndensity_scale = 1.0\n[network.grid]\n\
                     features = 4\n[occupancy]\nempty_share = 0.0";
        read(whole).check().expect("a grid with the network that goes with it");
        // The other way round a preset is named: TOML has no word for nothing.
        let back = read("preset = \"seed\"\n[network]\nwidth = 8");
        assert_eq!(back.network.grid, None);
        // What a config writes of itself reads back as it is.
        for preset in [Preset::Grid, Preset::Small, Preset::Seed] {
            let written = toml::to_string(&preset.config()).expect("TOML");
            assert_eq!(read(&written), preset.config());
            assert_eq!(written.contains("[network.grid]"), preset == Preset::Grid);
        }
        // The seed preset carves none and starts as it always does.
        let seed = "preset = \"seed\"\n[occupancy]\nhull = false";
        assert_eq!(read(seed), Preset::Seed.config());
    }
}
