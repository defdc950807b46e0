//! Resolution of a learned grid, chosen from the scene's size in the photographs, pixels, and the length of the run.
//!
//! Measured on lego at 100², 200², 400² and 800² pixels, on two cores of Sapphire Rapids. PSNR is over every tenth
//! training photograph, held out. The table compares the preset `grid`, chosen at 200², with [`for_pixels`].
//!
//! | pixels | seconds | preset | [`for_pixels`] |
//! | --- | ---: | ---: | ---: |
//! | 400² | 30 | 30.85 dB | 31.63 dB |
//! | 800² | 60 | 29.89 dB | 31.20 dB |
//!
//! Alternatives to [`for_pixels`] at 800², after 60 s: 30.70 dB with 724 cells in the finest level, 2^19 entries and
//! 424 march steps across the box; 30.85 dB with 512, 2^17 and 220; 31.00 dB with ten levels of up to 768 cells.
//!
//! For photographs smaller than 200², [`for_pixels`] keeps the preset's settings. PSNR at 100² after 15 s is 32.62 dB;
//! half the entries and 0.7 times the cells give 32.66 dB, no clear gain.
//!
//! [`for_long_run`] shortens the march steps to 3/4, and changes the preset's table entries from 2^16 in f16 to 2^17 in
//! int8. The following table gives PSNR in dB by number of entries and storage, before the march steps were shortened.
//! Measured on lego at 200², with every tenth training photograph held out, on two cores, with AVX-512:
//!
//! | seconds | 2^16 entries, f16 | 2^17, f16 | 2^17, int8 | 2^18, f16 |
//! | ---: | ---: | ---: | ---: | ---: |
//! | 15 | 32.44 | 32.48 | | |
//! | 30 | 33.22 | 33.41 | | |
//! | 60 | 33.55 | 33.96 | 33.86 | |
//! | 120 | 33.91 | 34.27 | | 34.46 |
//!
//! PSNR in dB by the number of march steps across the scene box, with 2^17 entries in int8. In the last column, the
//! photographs held out are ten whose nearest other photograph is 10 degrees away:
//!
//! | march steps | 60 s | 120 s | 120 s, `--max-bytes 1m` | 120 s, 10 degrees |
//! | ---: | ---: | ---: | ---: | ---: |
//! | 150 | 34.04 | 34.31 | 34.37 | 33.24 |
//! | 200 | 34.26 | 34.50 | 34.46 | 33.42 |
//! | 250 | | 34.42 | | 33.48 |

use super::size::Chosen;
use crate::data::cameras::bundle::median;
use crate::data::{Dataset, View};
use crate::model::config::Config;
use crate::model::quantise::TableStorage;
use crate::train::schedule::Budget;
use nerf_core::space::SceneBox;

/// Number of pixels that the longest side of lego's box spans at 200 × 200 pixels, for which the preset was chosen.
const PRESET_PIXELS: f32 = 175.0;
/// Largest binary logarithm of a level's number of entries. A table of 2^19 entries already exceeds a core's cache.
const MOST_LOG2_ENTRIES: u8 = 19;
/// Upper limit, in [`for_pixels`], of the ratio of a scene's pixels to [`PRESET_PIXELS`]. Without a limit, the ratio
/// would grow without bound as cameras come near the middle of the box.
const MOST_PIXELS: f32 = 8.0;
/// Multiple to which the finest level's number of cells along the longest side is rounded, so that data sets whose
/// photographs are almost the same size have the same grid.
const ROUNDED_CELLS: f32 = 32.0;
/// Multiple to which the number of march steps across the scene box is rounded.
const ROUNDED_STEPS: f32 = 10.0;

/// Returns the number of pixels that the longest side of the scene box spans in a photograph, at the distance from the
/// camera to the box's middle: the median over the training views. `None` if it is not finite.
pub fn pixels_across(dataset: &Dataset, scene_box: &SceneBox) -> Option<f32> {
    let middle = 0.5 * (scene_box.min + scene_box.max);
    let side = (scene_box.max - scene_box.min).max_element();
    let of_view = |view: &View| {
        let intrinsics = view.camera.intrinsics();
        side * intrinsics.fx.max(intrinsics.fy) / view.camera.pose().position.distance(middle)
    };
    Some(median(dataset.train.iter().map(of_view)) as f32).filter(|pixels| pixels.is_finite())
}

/// Adapts the preset's settings to a scene that spans `pixels` pixels. Each doubling of `pixels` doubles the entries of
/// a level, and multiplies the cells of the finest level and the march steps across the scene box by √2. Settings that
/// differ from the preset's, or that are set in `chosen`, do not change. Below `PRESET_PIXELS`, nothing changes.
pub fn for_pixels(mut config: Config, chosen: Chosen, pixels: f32) -> Config {
    let preset = config.preset.config();
    let (Some(grid), Some(own)) = (&mut config.network.grid, &preset.network.grid) else { return config };
    let more = (pixels / PRESET_PIXELS).clamp(1.0, MOST_PIXELS);
    let scaled =
        |value: u16, rounded: f32| ((f32::from(value) * more.sqrt() / rounded).round() * rounded) as u16;
    if !chosen.entries && grid.log2_entries == own.log2_entries {
        let doublings = more.log2().round() as u8;
        grid.log2_entries = (own.log2_entries + doublings).min(MOST_LOG2_ENTRIES.max(own.log2_entries));
    }
    if !chosen.finest && grid.finest == own.finest {
        grid.finest = scaled(own.finest, ROUNDED_CELLS).max(own.finest);
    }
    let steps = &mut config.sampling.steps_across;
    if !chosen.steps && *steps == preset.sampling.steps_across {
        *steps = scaled(*steps, ROUNDED_STEPS).max(*steps);
    }
    config
}

/// Least limit in seconds with which a run counts as long. From this time on, twice the table entries clearly raise
/// PSNR (see the second table of this module's documentation).
const LONG_SECONDS: f64 = 45.0;
/// Least limit in training steps with which a run counts as long.
const LONG_STEPS: u32 = 15_000;

/// Whether a run is long. A limit in seconds, if set, must be at least `LONG_SECONDS`; a limit in steps, if set, must
/// be at least `LONG_STEPS`.
pub fn is_long(budget: &Budget) -> bool {
    budget.seconds.is_none_or(|seconds| seconds >= LONG_SECONDS)
        && budget.steps.is_none_or(|steps| steps >= LONG_STEPS)
}

/// Adapts the settings to a long run, which learns more detail. Shortens the march steps to 3/4 of their length.
/// Doubles the number of entries of each level, and stores them in int8, so that the file is no larger. The number
/// changes only if it equals the preset's; the format changes only if number and format equal the preset's. Settings
/// that are set in `chosen` do not change.
pub fn for_long_run(mut config: Config, chosen: Chosen) -> Config {
    let preset = config.preset.config();
    let (Some(grid), Some(own)) = (&mut config.network.grid, &preset.network.grid) else { return config };
    if !chosen.steps {
        config.sampling.steps_across = config.sampling.steps_across.saturating_mul(4) / 3;
    }
    if !chosen.entries && grid.log2_entries == own.log2_entries {
        grid.log2_entries += 1;
        if !chosen.storage && grid.storage == own.storage {
            grid.storage = TableStorage::Int8;
        }
    }
    config
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::config::Preset;

    #[test]
    fn more_pixels_are_worth_entries_cells_and_steps() {
        let of = |pixels| {
            let config = for_pixels(Preset::Grid.config(), Chosen::default(), pixels);
            let grid = config.network.grid.expect("a grid");
            (grid.log2_entries, grid.finest, config.sampling.steps_across)
        };
        assert_eq!(of(20.0), (16, 256, 150));
        assert_eq!(of(176.0), (16, 256, 150));
        assert_eq!(of(350.0), (17, 352, 210));
        assert_eq!(of(700.0), (18, 512, 300));
        assert_eq!(of(1e9), (19, 736, 420));
    }

    #[test]
    fn a_long_run_is_worth_entries_and_steps() {
        let long = |seconds, steps| is_long(&Budget { steps, seconds });
        assert!(!long(Some(44.0), None) && long(Some(45.0), None));
        assert!(!long(None, Some(14_999)) && long(None, Some(15_000)) && !long(Some(10.0), Some(15_000)));
        let of = |config, chosen| {
            let config = for_long_run(config, chosen);
            let grid = config.network.grid.expect("a grid");
            (grid.log2_entries, grid.storage, config.sampling.steps_across)
        };
        let grid = |chosen| of(Preset::Grid.config(), chosen);
        let none = Chosen::default();
        assert_eq!(grid(none), (17, TableStorage::Int8, 200));
        assert_eq!(grid(Chosen { storage: true, ..none }), (17, TableStorage::F16, 200));
        assert_eq!(grid(Chosen { entries: true, ..none }), (16, TableStorage::F16, 200));
        assert_eq!(grid(Chosen { steps: true, ..none }), (17, TableStorage::Int8, 150));
        // Tables that `for_pixels` has enlarged do not change.
        let pixels = for_pixels(Preset::Grid.config(), none, 700.0);
        assert_eq!(of(pixels, none), (18, TableStorage::F16, 400));
        let small = Preset::Small.config();
        assert_eq!(for_long_run(small.clone(), Chosen::default()), small);
    }

    #[test]
    fn what_somebody_has_chosen_stays() {
        let chosen = Chosen { entries: true, finest: true, steps: true, ..Chosen::default() };
        let config = Preset::Grid.config();
        assert_eq!(for_pixels(config.clone(), chosen, 700.0), config);
        let mut finer = config.clone();
        finer.network.grid.as_mut().expect("a grid").finest = 300;
        finer.sampling.steps_across = 99;
        let found = for_pixels(finer, Chosen::default(), 700.0);
        assert_eq!((found.network.grid.expect("a grid").finest, found.sampling.steps_across), (300, 99));
        let small = Preset::Small.config();
        assert_eq!(for_pixels(small.clone(), Chosen::default(), 700.0), small);
    }
}
