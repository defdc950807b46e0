use super::common::{Global, print};
use crate::model::config::Preset;
use anyhow::Context;
use clap::Args;
use std::fmt::Write as _;
use std::process::ExitCode;

/// Print a preset as an annotated TOML file for --config.
#[derive(Debug, Args)]
#[command(after_help = "Example: nerf-train config --preset small > run.toml")]
pub struct PrintConfig {
    /// Preset: grid (hash grid), small (small network, sinusoidal encoding), seed (classic NeRF, 8 layers of 256).
    #[arg(long, value_enum, default_value = "grid", hide_possible_values = true)]
    preset: Preset,
}

/// Source files that declare the settings: their doc comments become the comments of the TOML file.
const SOURCES: &str = concat!(
    include_str!("../model/config/mod.rs"),
    include_str!("../model/config/table.rs"),
    include_str!("../model/config/optimiser.rs")
);

/// Tables of the TOML file, outermost first: path of the table, and name of the struct that declares its settings.
const TABLES: [(&str, &str); 7] = [
    ("", "Config"),
    ("network", "NetworkConfig"),
    ("network.grid", "TableConfig"),
    ("sampling", "SamplingConfig"),
    ("occupancy", "OccupancyConfig"),
    ("capture", "CaptureConfig"),
    ("optimiser", "OptimiserConfig"),
];

impl PrintConfig {
    pub fn run(&self, global: &Global) -> anyhow::Result<ExitCode> {
        let config = self.preset.config();
        let settings = toml::Table::try_from(&config)?;
        global.finish_with(&config, || print(commented(&settings)?.trim_end()))
    }
}

/// Returns the settings as TOML, each after its comment. An unset setting becomes a comment, `# near is not set`.
pub fn commented(settings: &toml::Table) -> anyhow::Result<String> {
    let mut text = String::new();
    for (path, name) in TABLES {
        let find = |table: Option<toml::Table>, key: &str| table?.get(key)?.as_table().cloned();
        let keys = path.split('.').filter(|key| !key.is_empty());
        let Some(table) = keys.fold(Some(settings.clone()), find) else { continue };
        if !path.is_empty() {
            writeln!(text, "\n[{path}]")?;
        }
        for (comments, key) in fields(name).with_context(|| name.to_owned())? {
            let own = if path.is_empty() { key.to_owned() } else { format!("{path}.{key}") };
            if TABLES.iter().any(|(path, _)| *path == own) {
                continue;
            }
            comments.iter().try_for_each(|comment| writeln!(text, "# {comment}"))?;
            match table.get(key) {
                Some(value) => writeln!(text, "{key} = {value}")?,
                None => writeln!(text, "# {key} is not set")?,
            }
        }
    }
    Ok(text)
}

/// Returns (comment lines, name) of each field of the struct `name` in [`SOURCES`]; `None` if no such struct exists.
fn fields(name: &str) -> Option<Vec<(Vec<&'static str>, &'static str)>> {
    let (_, body) = SOURCES.split_once(&format!("pub struct {name} {{\n"))?;
    let (body, _) = body.split_once("\n}")?;
    let (mut fields, mut comments) = (Vec::new(), Vec::new());
    for line in body.lines().map(str::trim) {
        if let Some(comment) = line.strip_prefix("/// ") {
            comments.push(comment);
        } else if let Some((key, _)) = line.strip_prefix("pub ").and_then(|line| line.split_once(':')) {
            fields.push((std::mem::take(&mut comments), key));
        }
    }
    Some(fields)
}
