//! Checks that the settings of a run are within their limits.

use super::{Config, Density, Jitter, NetworkConfig, OccupancyConfig, SamplingConfig, TableConfig};
use glam::Vec3;
use nerf_core::blob::MAX_SAMPLES;
use nerf_core::encoding::{
    GridEncoding, MAX_GRID_LEVELS, MAX_GRID_RESOLUTION, MAX_HARMONICS_DEGREE, MAX_LEVELS, MAX_LOG2_ENTRIES,
};
use nerf_core::network::{MAX_TRUNK, MAX_WIDTH};
use nerf_core::space::Contraction;
use std::fmt::Display;
use std::ops::RangeInclusive;

/// Largest number of samples of a training step. Positions of this many samples take 1.5 GiB.
const MAX_STEP_SAMPLES: usize = 1 << 27;
/// Largest number of table values of a trained grid: half of the file format's limit.
pub const MAX_TABLE_VALUES: usize = 1 << 26;
/// Largest number of cells of the occupancy grid along the longest side of the scene box.
pub const MAX_OCCUPANCY_RESOLUTION: u16 = 512;

#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{field}: expected {expected}, found {found}")]
pub struct ConfigError {
    pub field: &'static str,
    pub expected: String,
    pub found: String,
}

impl ConfigError {
    /// Returns the error for the settings of a 2D field, whose names lack the prefix `network.`: `network.grid.levels`
    /// becomes `grid.levels`.
    pub(crate) fn of_picture(self) -> Self {
        Self { field: self.field.trim_start_matches("network."), ..self }
    }
}

pub(super) fn check(config: &Config) -> Result<(), ConfigError> {
    let (n, s, g) = (&config.network, &config.sampling, &config.occupancy);
    check_network(n)?;
    if let Some(grid) = &n.grid {
        check_beside_grid(n, grid, g)?;
    }
    for (field, weight) in [("sampling.distortion", s.distortion), ("sampling.smoothness", s.smoothness)] {
        rule(field, weight.is_finite() && weight >= 0.0, "finite, at least 0", weight)?;
    }
    let depth = config.capture.depth;
    rule("capture.depth", depth.is_finite() && depth >= 0.0, "finite, at least 0", depth)?;
    if let Some(power) = s.contraction {
        check_contraction(power, n, s, g)?;
    }
    check_sampling(s)?;
    check_occupancy(g)?;
    config.optimiser.check()?;
    if let Jitter::Width(width) = s.jitter
        && !(width.is_finite() && width >= 0.0)
    {
        let (expected, found) = ("a finite width of at least 0".into(), width.to_string());
        return Err(ConfigError { field: "sampling.jitter", expected, found });
    }
    Ok(())
}

fn check_network(n: &NetworkConfig) -> Result<(), ConfigError> {
    within("network.depth", usize::from(n.grid.is_none())..=MAX_TRUNK, n.depth)?;
    within("network.width", 1..=MAX_WIDTH, n.width)?;
    rule("network.skip_after", n.skip_after < n.depth.max(1), "less than the depth", n.skip_after)?;
    at_most("network.position_levels", MAX_LEVELS, n.position_levels)?;
    at_most("network.direction_levels", MAX_LEVELS, n.direction_levels)?;
    at_most("network.colour_width", MAX_WIDTH, n.colour_width)?;
    let scale = n.density_scale;
    rule("network.density_scale", positive(scale.into()), "a finite number above 0", scale)?;
    rule("network.density_bias", n.density_bias.is_finite(), "a finite number", n.density_bias)
}

fn check_beside_grid(n: &NetworkConfig, grid: &TableConfig, g: &OccupancyConfig) -> Result<(), ConfigError> {
    check_table(grid)?;
    // A cube has more table values than any other box with the same longest side.
    check_table_values(&grid.encoding(Vec3::ONE), "a cube")?;
    let levels = n.position_levels;
    rule("network.position_levels", levels == 0, "0 beside a grid, which takes their place", levels)?;
    rule("network.skip_after", n.skip_after == 0, "0 beside a grid", n.skip_after)?;
    rule("network.feature", !n.feature, "false beside a grid", n.feature)?;
    let degree = n.direction_levels;
    let most = format!("at most degree {MAX_HARMONICS_DEGREE} beside a grid");
    rule("network.direction_levels", degree <= MAX_HARMONICS_DEGREE, most, degree)?;
    let density = n.density == Density::Exponential;
    rule("network.density", density, "exponential beside a grid", format!("{:?}", n.density))?;
    rule("network.density_scale", n.density_scale == 1.0, "1 beside a grid", n.density_scale)?;
    // The loss of a learned grid has no term for points in empty cells.
    rule("occupancy.empty_share", g.empty_share == 0.0, "0 beside a grid", g.empty_share)
}

fn check_contraction(
    power: u8,
    n: &NetworkConfig,
    s: &SamplingConfig,
    g: &OccupancyConfig,
) -> Result<(), ConfigError> {
    let field = "sampling.contraction";
    rule(field, Contraction::POWERS.contains(&power), "1, 2 or 4", power)?;
    rule(field, n.grid.is_some(), "none without a learned grid", power)?;
    rule(field, s.scene_box.is_none(), "none beside a scene box", power)?;
    rule(field, g.skip, "none where occupancy.skip is false", power)?;
    // The number of steps across the whole contracted scene is limited by the file format.
    let steps = (1.0 + f32::from(power)) * f32::from(s.steps_across);
    let most = format!("2 to {} beside a contraction of power {power}", MAX_SAMPLES / (1 + u16::from(power)));
    let fits = s.steps_across > 1 && steps <= f32::from(MAX_SAMPLES);
    rule("sampling.steps_across", fits, most, s.steps_across)
}

fn check_sampling(s: &SamplingConfig) -> Result<(), ConfigError> {
    rule("sampling.steps_across", s.steps_across > 0, "at least 1", s.steps_across)?;
    within("sampling.samples", 1..=4096, s.samples)?;
    within("sampling.rays", 1..=1_000_000, s.rays)?;
    let most = format!("at most {MAX_STEP_SAMPLES} samples a step");
    let fits = s.rays * usize::from(s.samples) <= MAX_STEP_SAMPLES;
    rule("sampling.rays", fits, most, format!("{} rays of {} samples", s.rays, s.samples))?;
    at_most("sampling.live_samples", 10_000_000, s.live_samples)
}

fn check_occupancy(g: &OccupancyConfig) -> Result<(), ConfigError> {
    within("occupancy.resolution", 0..=MAX_OCCUPANCY_RESOLUTION, g.resolution)?;
    rule("occupancy.every", g.every > 0, "at least 1", g.every)?;
    for (field, value) in [("occupancy.threshold", g.threshold), ("occupancy.empty_weight", g.empty_weight)] {
        rule(field, value.is_finite() && value >= 0.0, "a finite number of at least 0", value)?;
    }
    within("occupancy.decay", 0.0..=1.0, g.decay)?;
    within("occupancy.empty_share", 0.0..=1.0, g.empty_share)
}

pub(crate) fn check_table(grid: &TableConfig) -> Result<(), ConfigError> {
    let TableConfig { levels, features, log2_entries, coarsest, finest, storage: _, most_bytes: _ } = *grid;
    within("network.grid.levels", 1..=MAX_GRID_LEVELS, levels)?;
    rule("network.grid.features", matches!(features, 1 | 2 | 4), "1, 2 or 4", features)?;
    within("network.grid.log2_entries", 1..=MAX_LOG2_ENTRIES, log2_entries)?;
    rule("network.grid.coarsest", coarsest >= 1, "at least 1", coarsest)?;
    let most = format!("the coarsest level's {coarsest} to {MAX_GRID_RESOLUTION}");
    rule("network.grid.finest", (coarsest..=MAX_GRID_RESOLUTION).contains(&finest), most, finest)
}

/// Checks that a grid has at most [`MAX_TABLE_VALUES`] values. `what`: name of the grid's box or image in the error.
pub(crate) fn check_table_values(grid: &GridEncoding, what: &str) -> Result<(), ConfigError> {
    let values = grid.values();
    let most =
        format!("tables of at most {MAX_TABLE_VALUES} values over {what}: fewer entries, levels or features");
    rule("network.grid.log2_entries", values <= MAX_TABLE_VALUES, most, format!("{values} values"))
}

pub(super) fn positive(x: f64) -> bool {
    x.is_finite() && x > 0.0
}

pub(crate) fn within<T: PartialOrd + Display>(
    field: &'static str,
    range: RangeInclusive<T>,
    found: T,
) -> Result<(), ConfigError> {
    rule(field, range.contains(&found), format!("{} to {}", range.start(), range.end()), found)
}

pub(crate) fn at_most<T: PartialOrd + Display>(
    field: &'static str,
    most: T,
    found: T,
) -> Result<(), ConfigError> {
    rule(field, found <= most, format!("at most {most}"), found)
}

pub(crate) fn rule(
    field: &'static str,
    holds: bool,
    expected: impl Into<String>,
    found: impl ToString,
) -> Result<(), ConfigError> {
    let error = || ConfigError { field, expected: expected.into(), found: found.to_string() };
    if holds { Ok(()) } else { Err(error()) }
}
