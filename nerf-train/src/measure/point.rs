//! Settings of a rendering, and the errors and times measured with them.

use crate::measure::bench::{Clocked, Memory};
use crate::measure::frame::Frame;
use crate::measure::metrics::{gain_db, mse, psnr_db, ssim};
use crate::train::psnr_db_of_mse;
use nerf_core::Kernel;
use nerf_core::blob::Blob;
use nerf_core::math::MathBackend;
use nerf_core::plan::Quality;
use nerf_core::render::Counters;

/// Opacity in the exact rendering above which a pixel is solid. Distances are compared at solid pixels only.
const SOLID: f32 = 0.5;

/// Errors of one view against ground truth and against the exact rendering ([`Settings::exact`]).
#[derive(Clone, Copy, Debug)]
pub struct ViewErrors {
    pub psnr_db: f64,
    pub ssim: f64,
    /// Mean squared error of the colours against the exact rendering.
    pub exact_mse: f64,
    pub exact_max: f64,
    /// Absolute error of `ray_distance` against the exact rendering, summed over solid pixels, world units.
    pub distance_sum: f64,
    pub distance_max: f64,
    pub solid: u64,
    pub counters: Counters,
}

impl ViewErrors {
    /// Returns the errors of a frame against ground truth and against the exact frame of the same view.
    pub fn of(frame: &Frame, truth: &[[f32; 3]], exact: &Frame) -> Self {
        let difference = |(a, b): (&f32, &f32)| f64::from(a - b).abs();
        // Returns NaN if a value is NaN, unlike `max`.
        let larger = |a: f64, b: f64| if b > a || b.is_nan() { b } else { a };
        let colours = frame.rgb.as_flattened().iter().zip(exact.rgb.as_flattened());
        let distances = frame.ray_distance.iter().zip(&exact.ray_distance).map(difference);
        let solid = exact.opacity.iter().zip(distances).filter(|(opacity, _)| **opacity > SOLID);
        let (mut distance_sum, mut distance_max, mut count) = (0.0, 0.0, 0);
        for (_, distance) in solid {
            (distance_sum, distance_max, count) =
                (distance_sum + distance, larger(distance_max, distance), count + 1);
        }
        Self {
            psnr_db: psnr_db(&frame.rgb, truth),
            ssim: ssim(&frame.rgb, truth, frame.width, frame.height),
            exact_mse: mse(&frame.rgb, &exact.rgb),
            exact_max: colours.map(difference).fold(0.0, larger),
            distance_sum,
            distance_max,
            solid: count,
            counters: frame.counters,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Origin {
    Exact,
    /// The renderer's default settings.
    Base,
    /// The default settings with one setting changed. The number is the index of this setting in `KNOBS`.
    Knob(usize),
    Combination,
}

/// Settings of a rendering, and the errors and times measured with them.
#[derive(Clone, Debug)]
pub struct Point {
    pub origin: Origin,
    pub settings: Settings,
    /// Settings that differ from the default settings, as text: `samples 48`, for example.
    pub label: String,
    /// Errors of each view; `None` for a view that was not rendered.
    pub views: Vec<Option<ViewErrors>>,
    /// Render times, `[round of timing][timed view]`; `None` for a view that the round did not render.
    pub rounds: Vec<Vec<Option<Clocked>>>,
    pub memory: Memory,
}

/// Errors and cost of a point over the views that were rendered with its settings.
#[derive(Clone, Copy, Debug)]
pub struct Totals {
    pub views: usize,
    pub psnr_db: f64,
    /// Loss of PSNR against the exact rendering, dB: mean PSNR of the exact rendering of these views minus `psnr_db`.
    pub loss_db: f64,
    pub ssim: f64,
    /// PSNR against the exact rendering, dB, computed from the mean squared error over all views.
    pub exact_psnr_db: f64,
    /// Largest difference of a colour channel from the exact rendering.
    pub exact_max: f64,
    /// Mean absolute error of `ray_distance` against the exact rendering over pixels of opacity > 1/2, world units.
    pub distance_mean: f64,
    pub distance_max: f64,
    pub counters: Counters,
    /// Number of multiply-adds, divided by the exact rendering's number for the same views.
    pub relative_macs: f64,
}

/// Render time per view in the rounds of timing, seconds. Each round has one value: the mean over the timed views.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Seconds {
    pub rounds: usize,
    pub median: f64,
    pub low: f64,
    pub high: f64,
}

impl Point {
    pub fn new(origin: Origin, settings: Settings, label: String, views: usize) -> Self {
        let memory = Memory::default();
        Self { origin, settings, label, views: vec![None; views], rounds: Vec::new(), memory }
    }

    /// Summarises errors and cost over the views rendered both for this point and for `exact`, the exact rendering.
    pub fn totals(&self, exact: &Self) -> Totals {
        let pairs: Vec<(&ViewErrors, &ViewErrors)> =
            self.views.iter().zip(&exact.views).filter_map(|(own, e)| own.as_ref().zip(e.as_ref())).collect();
        let n = pairs.len() as f64;
        let sum = |of: &dyn Fn(&ViewErrors) -> f64| pairs.iter().map(|(own, _)| of(own)).sum::<f64>();
        let largest =
            |of: &dyn Fn(&ViewErrors) -> f64| pairs.iter().map(|(own, _)| of(own)).fold(0.0, f64::max);
        let (mut counters, mut dense) = (Counters::default(), Counters::default());
        for (own, exact) in &pairs {
            counters += own.counters;
            dense += exact.counters;
        }
        let psnr_db = sum(&|v| v.psnr_db) / n;
        Totals {
            views: pairs.len(),
            psnr_db,
            loss_db: gain_db(pairs.iter().map(|(_, exact)| exact.psnr_db).sum::<f64>() / n, psnr_db),
            ssim: sum(&|v| v.ssim) / n,
            exact_psnr_db: psnr_db_of_mse(sum(&|v| v.exact_mse) / n),
            exact_max: largest(&|v| v.exact_max),
            distance_mean: sum(&|v| v.distance_sum) / sum(&|v| v.solid as f64),
            distance_max: largest(&|v| v.distance_max),
            counters,
            // In an empty scene all renderings have 0 multiply-adds, and the ratio would be NaN.
            relative_macs: if counters.macs == dense.macs {
                1.0
            } else {
                counters.macs as f64 / dense.macs as f64
            },
        }
    }

    /// Returns the seconds per view, measured by `clock`; `None` if no round of timing is complete.
    pub fn seconds(&self, clock: Clock) -> Option<Seconds> {
        let rounds: Vec<f64> = self.rounds.iter().filter_map(|round| mean(round, clock)).collect();
        Some(Seconds {
            rounds: rounds.len(),
            median: median(&rounds)?,
            low: rounds.iter().copied().fold(f64::INFINITY, f64::min),
            high: rounds.iter().copied().fold(0.0, f64::max),
        })
    }

    /// Returns the ratio of this point's render time to that of `exact`, median over the rounds of timing. `None` if no
    /// round timed both points completely.
    pub fn relative_time(&self, exact: &Self, clock: Clock) -> Option<f64> {
        let both = self.rounds.iter().zip(&exact.rounds);
        let ratios: Vec<f64> =
            both.filter_map(|(own, exact)| Some(mean(own, clock)? / mean(exact, clock)?)).collect();
        median(&ratios)
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Clock {
    /// Wall-clock time.
    Wall,
    /// CPU time of all cores together: steadier than wall-clock time on a shared machine.
    Cpu,
}

impl Clock {
    fn of(self, clocked: &Clocked) -> f64 {
        match self {
            Self::Wall => clocked.wall,
            Self::Cpu => clocked.cpu,
        }
    }
}

/// Returns the mean time over a round's views, seconds. `None` without views, or if a time is missing or not finite.
fn mean(round: &[Option<Clocked>], clock: Clock) -> Option<f64> {
    let seconds: Option<Vec<f64>> = round.iter().map(|c| c.as_ref().map(|c| clock.of(c))).collect();
    let seconds = seconds.filter(|seconds| !seconds.is_empty())?;
    Some(seconds.iter().sum::<f64>() / seconds.len() as f64).filter(|mean| mean.is_finite())
}

/// Returns the median of the values; for an even number, the mean of the two in the middle. `None` without values.
fn median(values: &[f64]) -> Option<f64> {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let n = sorted.len();
    (n > 0).then(|| 0.5 * (sorted[(n - 1) / 2] + sorted[n / 2]))
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Precision {
    /// The scene file's weights, which are rounded to f16.
    Rounded,
    /// The f32 weights before rounding.
    Unrounded,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    pub quality: Quality,
    pub kernel: Kernel,
    /// Index of the scene file's variant in `Variants`; 0 is the unchanged file.
    pub variant: usize,
    pub precision: Precision,
    /// Size at which a view is rendered, in quarters of its width and height. The result is then enlarged to full size.
    pub quarters: u32,
    pub rays: u16,
}

impl Settings {
    /// Returns the settings of the exact rendering. Every sample inside the scene box is evaluated and coloured, and no
    /// ray ends early. The occupancy grid is used only if the scene file requires the grid (`occupancy_required`).
    /// Sines are polynomial. The arithmetic is f32 with the fastest instruction set.
    pub fn exact(blob: &Blob<'_>) -> Self {
        Self { quality: Quality::exact(blob), ..Self::base() }
    }

    /// Returns the renderer's default settings, in f32 with the fastest instruction set.
    pub fn base() -> Self {
        Self {
            quality: Quality::default(),
            kernel: Kernel::detect(),
            variant: 0,
            precision: Precision::Rounded,
            quarters: 4,
            rays: 1,
        }
    }

    /// Whether these settings are slow: without an occupancy grid, or with the portable kernel that reads weights
    /// directly from the blob's bytes. With slow settings, a study renders only its timing views.
    pub fn is_slow(&self, has_occupancy: bool) -> bool {
        self.kernel == Kernel::IN_PLACE || !(has_occupancy && self.quality.occupancy)
    }
}

/// Names of the maths backends on the command line and in tables.
pub const MATHS: [(&str, MathBackend); 4] = [
    ("polynomial", MathBackend::Polynomial),
    ("libm", MathBackend::Libm),
    ("micromath", MathBackend::Micromath),
    ("recurrence", MathBackend::Recurrence),
];

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(values: [f32; 4], distance: f32) -> Frame {
        Frame {
            width: 2,
            height: 2,
            rgb: values.map(|v| [v; 3]).to_vec(),
            opacity: vec![1.0, 1.0, 0.4, 1.0],
            ray_distance: vec![3.0, 3.0 + distance, 9.0 * distance, 3.0],
            z_depth: vec![3.0; 4],
            median_distance: Vec::new(),
            normals: Vec::new(),
            counters: Counters { macs: 10, ..Counters::default() },
        }
    }

    #[test]
    fn errors_are_those_of_colours_and_of_solid_pixels_distances() {
        let exact = frame([0.5; 4], 0.0);
        let other = frame([0.5, 0.6, 0.5, 0.5], 0.5);
        let truth = vec![[0.5; 3]; 4];
        let errors = ViewErrors::of(&other, &truth, &exact);
        assert!((errors.exact_max - 0.1).abs() < 1e-6);
        assert!((errors.exact_mse - 0.01 / 4.0).abs() < 1e-6);
        // The pixel of opacity 0.4 does not count.
        assert_eq!((errors.solid, errors.distance_max, errors.distance_sum), (3, 0.5, 0.5));
        assert!(ViewErrors::of(&exact, &truth, &exact).psnr_db.is_infinite());
        let nan = ViewErrors::of(&frame([f32::NAN, 0.5, 0.5, 0.5], 0.0), &truth, &exact);
        assert!(nan.exact_max.is_nan() && nan.psnr_db.is_nan());
    }

    #[test]
    fn losses_compare_the_views_that_both_have() {
        let base = Settings::base();
        let point = |psnr: [Option<f64>; 3]| {
            let mut point = Point::new(Origin::Base, base, String::new(), 3);
            let errors = ViewErrors::of(&frame([0.5; 4], 0.0), &[[0.4; 3]; 4], &frame([0.5; 4], 0.0));
            point.views = psnr.map(|db| db.map(|psnr_db| ViewErrors { psnr_db, ..errors })).to_vec();
            point
        };
        let exact = point([Some(30.0), Some(20.0), Some(25.0)]);
        let part = point([None, Some(19.0), Some(25.0)]);
        let totals = part.totals(&exact);
        assert_eq!((totals.views, totals.psnr_db, totals.loss_db), (2, 22.0, 0.5));
        assert_eq!(totals.relative_macs, 1.0);
        assert_eq!(exact.totals(&exact).loss_db, 0.0);
    }

    #[test]
    fn times_are_medians_of_rounds_and_ratios_are_taken_round_by_round() {
        let clocked = |wall: f64| Some(Clocked { wall, cpu: 2.0 * wall });
        let mut exact = Point::new(Origin::Exact, Settings::base(), String::new(), 2);
        let mut other = exact.clone();
        // The machine slows down threefold in the second round.
        exact.rounds = vec![vec![clocked(10.0), clocked(20.0)], vec![clocked(30.0), clocked(60.0)]];
        other.rounds = vec![vec![clocked(1.0), clocked(2.0)], vec![clocked(3.0), clocked(6.0)]];
        assert_eq!(other.relative_time(&exact, Clock::Wall), Some(0.1));
        let seconds = other.seconds(Clock::Cpu).expect("timed");
        assert_eq!((seconds.rounds, seconds.low, seconds.median, seconds.high), (2, 3.0, 6.0, 9.0));
        // A round that lacks a view does not count.
        other.rounds[0][1] = None;
        assert_eq!(other.seconds(Clock::Wall).expect("timed").median, 4.5);
        assert_eq!(Point::new(Origin::Base, Settings::base(), String::new(), 1).seconds(Clock::Wall), None);
    }
}
