//! Settings from a TOML file and from `--set`.

use crate::model::config::{Config, Preset, Surroundings};
use crate::system::input;
use anyhow::{Context, anyhow};
use clap::Args;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::path::Path;

/// Settings given by `--set`; each overrides the TOML file's setting of the same name.
#[derive(Debug, Default, Args)]
pub struct SetOption {
    /// Override one setting, such as optimiser.beta2=0.99; may be repeated (`config` prints the names for scenes).
    #[arg(long = "set", value_name = "PATH=VALUE", value_parser = parse_set)]
    pub tables: Vec<toml::Table>,
}

/// Parses `optimiser.beta2=0.9` to a table; a value that is not valid TOML is taken as a string.
fn parse_set(text: &str) -> Result<toml::Table, String> {
    let (path, value) = text.split_once('=').ok_or("expected PATH=VALUE, such as optimiser.rate=0.01")?;
    let table = |value: &str| format!("{path} = {value}").parse::<toml::Table>();
    table(value).or_else(|_| table(&format!("{value:?}"))).map_err(|error| error.message().to_owned())
}

impl SetOption {
    /// Returns `settings` overridden by the values of `--set`. Fails at the first name or value that is not valid.
    pub fn over<T: Serialize + DeserializeOwned>(&self, settings: T) -> anyhow::Result<T> {
        merged(settings, self.tables.clone()).map_err(|error| match error.downcast_ref::<toml::de::Error>() {
            Some(toml) => anyhow!("--set: {}", input::toml_message("", toml)),
            None => error.context("--set"),
        })
    }

    /// Whether `--set` gives a value for the setting `path`, for example `network.grid.features`.
    pub fn names(&self, path: &str) -> bool {
        let mut keys = path.split('.');
        let first = keys.next().unwrap_or_default();
        let has = |value: &toml::Value| keys.clone().try_fold(value, |value, key| value.get(key)).is_some();
        self.tables.iter().any(|set| set.get(first).is_some_and(has))
    }
}

/// Returns the preset adapted to `surroundings`, overridden by the TOML file's values and then by the values of `set`.
///
/// Values in the file or in `set` can change `surroundings`. If `sampling.contraction` is given, the scene is taken as
/// unbounded. If `sampling.scene_box` or `occupancy.skip=false` is given, an unbounded scene is taken as a scene in a
/// box. If `occupancy.hull=false` is given, a known background is taken as unknown.
pub fn read_config(
    preset: Preset,
    file: Option<&Path>,
    set: &SetOption,
    surroundings: Surroundings,
) -> anyhow::Result<Config> {
    let read = |file: &Path| {
        input::read_text(file, input::MAX_TOML_BYTES)
            .with_context(|| format!("cannot read {}", file.display()))
    };
    let text = file.map(read).transpose()?.unwrap_or_default();
    let parse = || -> anyhow::Result<Config> {
        let mut given: toml::Table = text.parse()?;
        set.tables.iter().for_each(|table| merge(&mut given, table.clone()));
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
        // If the file has a grid and the preset has none, missing values of the grid come from the preset `grid`.
        // Later, a check refuses a network that does not fit the grid.
        if given.get("network").is_some_and(|network| network.get("grid").is_some()) {
            start.network.grid = start.network.grid.or(Preset::Grid.config().network.grid);
        }
        merged(start, [given])
    };
    let place = file.map_or_else(|| "--set".into(), |file| file.display().to_string());
    parse().map_err(|error| match error.downcast_ref::<toml::de::Error>() {
        Some(toml) => anyhow!("{place}: {}", input::toml_message(&text, toml)),
        None => error.context(place),
    })
}

fn merged<T: Serialize + DeserializeOwned>(
    settings: T,
    tables: impl IntoIterator<Item = toml::Table>,
) -> anyhow::Result<T> {
    let mut merged = toml::Table::try_from(settings)?;
    tables.into_iter().for_each(|table| merge(&mut merged, table));
    Ok(merged.try_into()?)
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
