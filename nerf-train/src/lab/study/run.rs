//! Passes of a study. A pass renders points (choices of settings) on views. Times are measured on a few of the views,
//! the timing views, which every pass renders.
//!
//! ```text
//! pass 1   every view:      exact, base, each knob on its own        slow settings on the timing views only
//! pass 2   every view:      base, combinations chosen from pass 1    exact on the timing views
//! pass 3…  timing views:    everything, as often as time allows
//! ```
//!
//! Slow settings are those without an occupancy grid, and those of the portable kernel that reads weights directly from
//! the blob. If the blob has no grid, only the timing views are rendered.
//!
//! A pass renders all points on one view before the next view, so that a machine that slows down slows all points.
//! After pass 1, the order of the points changes from view to view. Errors come from a point's first rendering of a
//! view, times from all renderings of the timing views.

use super::combine::{Choices, combinations};
use super::front::{Price, cheapest_within, pareto, thin};
use super::knobs::{KNOBS, difference, fits_blob};
use crate::data::View;
use crate::measure::bench::Variants;
use crate::measure::frame::Frame;
use crate::measure::point::{Clock, Origin, Point, Settings, Totals, ViewErrors};
use anyhow::bail;
use nerf_core::Kernel;
use nerf_core::blob::{FrontPoint, MAX_FRONT};
use nerf_core::camera::{Camera, Intrinsics};
use nerf_core::plan::Preset;
use std::time::{Duration, Instant};

/// Largest predicted loss of PSNR against the base settings at which a combination is rendered, dB.
const COMBINATION_LOSS_DB: f64 = 2.5;
/// Largest loss of PSNR, against the exact rendering, of a point on a blob's Pareto front, dB.
pub const BLOB_LOSS_DB: f64 = 3.0;
/// Loss of PSNR against the exact rendering, dB, up to which a point of a blob's Pareto front must not march in longer
/// steps than training did. The reason is that the loss from longer steps differs from view to view.
pub const TRAINED_STEP_LOSS_DB: f32 = Preset::Balanced.loss_db();
/// Maximum number of combinations of all knobs, and maximum number of combinations of the knobs that a blob stores.
const COMBINATIONS: usize = 12;
/// Side of the square in which the exact rendering is compared with the portable kernel, pixels.
const ORACLE_SIDE: u32 = 16;

#[derive(Clone, Copy, Debug)]
pub struct Effort {
    pub timing_views: usize,
    /// Number of rounds of timing, unless the time limit comes first.
    pub repeats: usize,
    /// Time limit of the study. A further round of timing begins only if it is expected to end within this time.
    pub limit: Duration,
    /// Clock whose times are the costs on the Pareto front.
    pub clock: Clock,
}

#[derive(Clone, Copy, Debug)]
pub struct Progressed<'a> {
    pub pass: &'a str,
    pub done: usize,
    pub total: usize,
}

#[derive(Debug)]
pub struct Study<'a, 'b> {
    pub lab: &'a Variants<'b>,
    pub views: Vec<&'a View>,
    /// Indices in `views` of the timing views, which every round of timing renders.
    pub timing: Vec<usize>,
    pub background: [f32; 3],
    pub effort: Effort,
    /// All points, in this order: the exact rendering, the base settings, the base with one knob changed, combinations.
    pub points: Vec<Point>,
    pub exact: Vec<Frame>,
    pub rounds_left_out: usize,
    /// Largest difference of display-encoded channels, in [0, 1], between exact rendering and portable kernel.
    pub oracle_max: f64,
    truth: Vec<Vec<[f32; 3]>>,
    passes: usize,
}

impl<'a, 'b> Study<'a, 'b> {
    /// Studies `lab`'s scene on `views`; fails without views. Calls the function `each` after every frame. The time
    /// limit counts from `start`.
    pub fn run(
        lab: &'a Variants<'b>,
        mut views: Vec<&'a View>,
        effort: Effort,
        start: Instant,
        each: &mut dyn FnMut(Progressed<'_>),
    ) -> anyhow::Result<Self> {
        if views.is_empty() {
            bail!("views: expected at least one, found none");
        }
        let background = lab.scene.background;
        let count = effort.timing_views.clamp(1, views.len());
        // Timing views are in the middles of `count` equal parts of the views.
        let mut timing: Vec<usize> = (0..count).map(|i| (2 * i + 1) * views.len() / (2 * count)).collect();
        if Settings::base().is_slow(lab.has_occupancy(0)) {
            // Without an occupancy grid all renderings are slow: only the timing views are rendered.
            views = timing.iter().map(|&view| views[view]).collect();
            timing = (0..count).collect();
        }
        let truth = views.iter().map(|view| view.composite_over(background)).collect();
        let mut study = Self {
            lab,
            views,
            timing,
            background,
            effort,
            points: Vec::new(),
            exact: Vec::new(),
            rounds_left_out: 0,
            oracle_max: f64::NAN,
            truth,
            passes: 0,
        };
        study.add_rows();
        study.pass("knobs", &study.all(), false, each)?;
        study.check_oracle()?;
        let known = study.points.len();
        study.add_combinations();
        if known < study.points.len() {
            let mut which = vec![0, 1];
            which.extend(known..study.points.len());
            study.pass("combinations", &which, false, each)?;
        }
        for round in 1..effort.repeats {
            if start.elapsed().as_secs_f64() + study.round_seconds() > effort.limit.as_secs_f64() {
                study.rounds_left_out = effort.repeats - round;
                break;
            }
            study.pass("timing", &study.all(), true, each)?;
        }
        Ok(study)
    }

    /// Returns the expected wall-clock seconds of one round of timing.
    fn round_seconds(&self) -> f64 {
        let medians = self.points.iter().filter_map(|point| Some(point.seconds(Clock::Wall)?.median));
        medians.sum::<f64>() * self.timing.len() as f64
    }

    fn all(&self) -> Vec<usize> {
        (0..self.points.len()).collect()
    }

    fn add(&mut self, origin: Origin, settings: Settings) {
        let base = Settings::base();
        if self.points.iter().any(|point| point.settings == settings) {
            return;
        }
        let label = match origin {
            Origin::Exact => "exact".into(),
            Origin::Base => "base".into(),
            _ => difference(self.lab, &base, &settings),
        };
        self.points.push(Point::new(origin, settings, label, self.views.len()));
    }

    fn add_rows(&mut self) {
        let base = Settings::base();
        self.add(Origin::Exact, Settings::exact(&self.lab.blob));
        self.add(Origin::Base, base);
        for (index, knob) in KNOBS.iter().enumerate() {
            for settings in (knob.values)(self.lab, base) {
                self.add(Origin::Knob(index), settings);
            }
        }
    }

    /// Returns, for each knob that is combined with others, the tried values with losses of PSNR and costs relative to
    /// the base. `in_blob`: whether to take only knobs that a blob stores.
    fn choices(&self, in_blob: bool) -> Vec<Choices> {
        let base = self.points[1].totals(&self.points[0]);
        let of_knob = |index: usize| {
            let row = |point: &&Point| point.origin == Origin::Knob(index) && !self.is_slow(&point.settings);
            let price = |point: &Point| {
                let totals = point.totals(&self.points[0]);
                let cost = totals.counters.macs as f64 / base.counters.macs as f64;
                (point.settings, Price { loss_db: totals.loss_db - base.loss_db, cost })
            };
            self.points.iter().filter(row).map(price).collect()
        };
        let knobs = KNOBS.iter().enumerate();
        let wanted = knobs.filter(|(_, knob)| knob.combines && (knob.in_blob || !in_blob));
        let choices = wanted.map(|(knob, _)| Choices { knob, rows: of_knob(knob) });
        choices.filter(|choices| !choices.rows.is_empty()).collect()
    }

    fn add_combinations(&mut self) {
        let base = Settings::base();
        let found = |in_blob| combinations(base, &self.choices(in_blob), COMBINATION_LOSS_DB, COMBINATIONS);
        let (all, plain) = (found(false), found(true));
        let rounding = Kernel::all().filter(|kernel| kernel.rounds());
        let rounded: Vec<Settings> = rounding
            .flat_map(|kernel| all.iter().map(move |settings| Settings { kernel, ..*settings }))
            .collect();
        for settings in plain.into_iter().chain(all).chain(rounded) {
            self.add(Origin::Combination, settings);
        }
    }

    fn is_slow(&self, settings: &Settings) -> bool {
        // Slow settings are rendered on the timing views only. If these are all views, nothing is left out.
        self.timing.len() < self.views.len() && settings.is_slow(self.lab.has_occupancy(settings.variant))
    }

    /// Whether a pass renders `point` on the view of index `view`. On a timing view, every point is rendered. On
    /// another view, no point is rendered if `only_timing`. Otherwise, the exact point is rendered if the view lacks
    /// it, and any other point if its settings are not slow.
    fn wanted(&self, point: &Point, view: usize, only_timing: bool) -> bool {
        let timed = self.timing.contains(&view);
        let first = point.views[view].is_none();
        let slow = self.is_slow(&point.settings) && point.origin != Origin::Exact;
        timed || (!only_timing && !slow && (first || point.origin != Origin::Exact))
    }

    fn pass(
        &mut self,
        name: &str,
        which: &[usize],
        only_timing: bool,
        each: &mut dyn FnMut(Progressed<'_>),
    ) -> anyhow::Result<()> {
        let pass = self.passes;
        self.passes += 1;
        let settings: Vec<Settings> = which.iter().map(|&i| self.points[i].settings).collect();
        let mut order: Vec<(usize, usize)> = Vec::new();
        for view in 0..self.views.len() {
            // A missing exact frame comes first. Otherwise the order rotates, so that a point's predecessor changes.
            let turn = if view < self.exact.len() { pass + view } else { 0 };
            let turned = (0..which.len()).map(|i| which[(i + turn) % which.len()]);
            let wanted = turned.filter(|&i| self.wanted(&self.points[i], view, only_timing));
            order.extend(wanted.map(|i| (view, i)));
        }
        for point in &mut self.points {
            // New points have no times in earlier passes.
            point.rounds.resize(self.passes, vec![None; self.timing.len()]);
        }
        let lab = self.lab;
        lab.prepared(&settings, |bench| {
            let total = order.len();
            for (done, &(view, i)) in order.iter().enumerate() {
                let point = &mut self.points[i];
                let camera = &self.views[view].camera;
                let (frame, clocked, memory) = bench.render(&point.settings, camera, self.background)?;
                point.memory = memory;
                if let Some(place) = self.timing.iter().position(|&timing| timing == view) {
                    point.rounds[pass][place] = Some(clocked);
                }
                if point.origin == Origin::Exact && self.exact.len() == view {
                    self.exact.push(frame.clone());
                }
                if point.views[view].is_none() {
                    point.views[view] = Some(ViewErrors::of(&frame, &self.truth[view], &self.exact[view]));
                }
                each(Progressed { pass: name, done: done + 1, total });
            }
            Ok(())
        })
    }

    /// Renders a square in the middle of the first view exactly and with the portable kernel, and sets `oracle_max`.
    fn check_oracle(&mut self) -> anyhow::Result<()> {
        let camera = &self.views[0].camera;
        let i = *camera.intrinsics();
        let (width, height) = (i.width.min(ORACLE_SIDE), i.height.min(ORACLE_SIDE));
        let (left, top) = ((i.width - width) / 2, (i.height - height) / 2);
        // With (cx, cy) shifted, the rays are those of the whole view, as the lens is relative to (cx, cy).
        let (cx, cy) = (i.cx - left as f32, i.cy - top as f32);
        let cut = Camera::new(Intrinsics { width, height, cx, cy, ..i }, *camera.lens(), *camera.pose())?;
        let exact = Settings::exact(&self.lab.blob);
        let scalar = Settings { kernel: Kernel::IN_PLACE, ..exact };
        let background = self.background;
        self.oracle_max = self.lab.prepared(&[exact, scalar], |bench| {
            let (exact, ..) = bench.render(&exact, &cut, background)?;
            let (scalar, ..) = bench.render(&scalar, &cut, background)?;
            let pairs = exact.rgb.as_flattened().iter().zip(scalar.rgb.as_flattened());
            Ok(pairs.map(|(a, b)| f64::from(a - b).abs()).fold(0.0, f64::max))
        })?;
        Ok(())
    }

    /// Returns the errors and cost of each point, in the order of [`Self::points`].
    pub fn totals(&self) -> Vec<Totals> {
        self.points.iter().map(|point| point.totals(&self.points[0])).collect()
    }

    /// Returns, for each point, PSNR lost against the exact rendering, dB, and ratio of render times (point / exact).
    pub fn times(&self) -> Vec<Price> {
        let price = |point: &Point| {
            let cost = point.relative_time(&self.points[0], self.effort.clock).unwrap_or(f64::NAN);
            Price { loss_db: point.totals(&self.points[0]).loss_db, cost }
        };
        self.points.iter().map(price).collect()
    }

    /// Returns the indices of the points on the Pareto front of render time and loss of PSNR, slowest first.
    pub fn front(&self) -> Vec<usize> {
        pareto(&self.times())
    }

    /// Returns the indices of the points on the blob's Pareto front of multiply-adds and loss of PSNR, most expensive
    /// first, and the price of every point; the cost is NaN for points that cannot be on the front.
    ///
    /// The front has at most [`MAX_FRONT`] points. Each has settings that a blob can store, and loses at most
    /// `BLOB_LOSS_DB`. Points that lose at most `TRAINED_STEP_LOSS_DB` do not march in longer steps than training did.
    pub fn blob_front(&self) -> (Vec<usize>, Vec<Price>) {
        let base = Settings::base();
        let price = |point: &Point| {
            let totals = point.totals(&self.points[0]);
            let longer = self.lab.is_marched() && self.lab.step_share(&point.settings) > 1.0;
            // Losses of PSNR of points that lack a view are not comparable.
            let fits = fits_blob(self.lab, &base, &point.settings)
                && totals.views == self.views.len()
                && totals.loss_db <= BLOB_LOSS_DB
                && !(longer && totals.loss_db as f32 <= TRAINED_STEP_LOSS_DB);
            let cost = if fits { totals.relative_macs } else { f64::NAN };
            // Rounded as in the file: points that are equal in the file must not count as different.
            Price { loss_db: f64::from(totals.loss_db as f32), cost: f64::from(cost as f32) }
        };
        let prices: Vec<Price> = self.points.iter().map(price).collect();
        (thin(&prices, &pareto(&prices), MAX_FRONT), prices)
    }

    pub fn front_points(&self) -> heapless::Vec<FrontPoint, MAX_FRONT> {
        let (front, prices) = self.blob_front();
        let point = |i: usize| {
            let Price { loss_db, cost } = prices[i];
            let quality = &self.points[i].settings.quality;
            quality.front_point(&self.lab.blob, loss_db as f32, cost as f32)
        };
        front.into_iter().map(point).collect()
    }

    /// Returns the index of the fastest point that `keep` accepts and that loses at most `loss_db` dB against the exact
    /// rendering; `None` if no point does.
    pub fn cheapest(&self, loss_db: f64, keep: impl Fn(&Point) -> bool) -> Option<usize> {
        let mut times = self.times();
        for (price, point) in times.iter_mut().zip(&self.points) {
            if !keep(point) {
                price.cost = f64::NAN;
            }
        }
        cheapest_within(&times, loss_db)
    }
}
