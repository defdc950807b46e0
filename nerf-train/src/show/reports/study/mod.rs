//! Report of a study: points.csv, report.md, a plot of the Pareto front, pictures of the front's ends, summary.json.

mod beside;
mod markdown;
mod pictures;
mod tables;

use crate::lab::study::Study;
use crate::measure::point::{Clock, Point, Totals};
use crate::show::plot::{Label, LinePlot, Marker, Reference, Series};
use crate::system::output::write_atomic;
use crate::system::summary;
pub use beside::front_of;
use serde::Serialize;
use std::path::Path;

/// Largest loss of PSNR, dB, of a point that may set the span of a Pareto front. The span is the speed-up of the
/// fastest point within this loss. Loss and speed-up are relative to the exact rendering.
pub const SPAN_LOSS_DB: f64 = 1.0;

/// Data, machine and duration of a study, for its report.
#[derive(Clone, Debug)]
pub struct Setting<'a> {
    pub blob: String,
    pub data: &'a str,
    pub split: &'a str,
    pub background: String,
    pub cpu: String,
    pub seconds: f64,
    /// Pareto fronts of other studies, drawn in the same plot.
    pub beside: Vec<Series>,
}

/// Results of a study that several files of the report use.
pub struct Findings<'s, 'a, 'b> {
    pub study: &'s Study<'a, 'b>,
    pub totals: Vec<Totals>,
    /// Indices of the points on the Pareto front over time.
    pub front: Vec<usize>,
    /// Indices of the points on the Pareto front over multiply-adds; the scene file stores this front.
    pub blob_front: Vec<usize>,
    /// Render time of each point, divided by the render time of the exact rendering.
    pub times: Vec<f64>,
}

impl<'s, 'a, 'b> Findings<'s, 'a, 'b> {
    pub fn of(study: &'s Study<'a, 'b>) -> Self {
        let times = study.times().into_iter().map(|price| price.cost).collect();
        let (totals, front, (blob_front, _)) = (study.totals(), study.front(), study.blob_front());
        Self { study, totals, front, blob_front, times }
    }

    /// Returns speed-up and index of the fastest point that `keep` accepts and whose loss is at most [`SPAN_LOSS_DB`];
    /// `None` if there is no such point. Speed-up and loss are relative to the exact rendering.
    pub fn span(&self, keep: impl Fn(&Point) -> bool) -> Option<(f64, usize)> {
        let point = self.study.cheapest(SPAN_LOSS_DB, keep)?;
        Some((1.0 / self.times[point], point))
    }

    /// Plots PSNR over seconds per view: points coloured by file size, and the Pareto front through numbered points.
    fn plot(&self, setting: &Setting<'_>) -> LinePlot {
        let clock = self.study.effort.clock;
        let name = if clock == Clock::Wall { "seconds a view" } else { "CPU seconds a view" };
        let title = format!("{}: what accuracy costs in time", setting.data);
        let mut plot = LinePlot::new(title, name, format!("PSNR, dB, on {}", setting.background));
        let exact = self.study.points[0].seconds(clock).map_or(1.0, |s| s.median);
        // Times are relative to the exact rendering in the same round, so that the machine's load cancels out.
        let place = |i: usize| (self.times[i] * exact, self.totals[0].psnr_db - self.totals[i].loss_db);
        let series = |name: &str, which: Vec<usize>, marker| Series {
            name: name.into(),
            points: which.into_iter().map(place).collect(),
            marker,
        };
        // File size is the third axis, shown as colour.
        let kib = |i: usize| (self.study.points[i].memory.file as f64 / 1024.0).round() as u64;
        let all = || 0..self.study.points.len();
        let mut sizes: Vec<u64> = all().map(kib).collect();
        // Points of small files are drawn last, on top: a larger file often takes the same time.
        sizes.sort_unstable_by(|a, b| b.cmp(a));
        sizes.dedup();
        let of_size = |&size: &u64| {
            series(
                &format!("file of {size} KiB"),
                all().filter(|&i| kib(i) == size).collect(),
                Marker::Points,
            )
        };
        // The Pareto front is drawn first, so that its line covers no point.
        plot.series = vec![series("front", self.front.clone(), Marker::Line)];
        plot.series.extend(setting.beside.iter().cloned());
        plot.series.extend(sizes.iter().map(of_size));
        plot.log_x = true;
        // Names would cover the points. Points on the Pareto front are labelled with numbers, which a note explains.
        let label = |text: String, i: usize| Label { text, at: place(i) };
        plot.labels = [0, 1].map(|i| label(self.study.points[i].label.clone(), i)).to_vec();
        let numbered = || self.front.iter().copied().filter(|&i| i > 1);
        plot.labels.extend(numbered().map(|i| label(i.to_string(), i)));
        let named: Vec<String> = numbered().map(|i| format!("{i}: {}", self.study.points[i].label)).collect();
        plot.notes = vec![named.join("; ")];
        plot.references = vec![Reference {
            label: format!("exact less {SPAN_LOSS_DB} dB"),
            y: self.totals[0].psnr_db - SPAN_LOSS_DB,
        }];
        plot
    }

    pub fn summary(&self, setting: &Setting<'_>) -> Summary {
        let study = self.study;
        let within = self.span(|_| true);
        let [whole_size, whole_size_f32] =
            [self.span(whole), self.span(whole_f32)].map(|span| span.map(|(span, _)| span));
        let median = |i: usize, clock| study.points[i].seconds(clock).map_or(f64::NAN, |s| s.median);
        let points = |front: &[usize]| front.iter().map(|&i| self.point(i)).collect();
        Summary {
            front_span_within_1db: within.map(|(span, _)| span),
            front_span_point: within.map(|(_, point)| study.points[point].label.clone()),
            front_span_loss_db: within.map(|(_, point)| self.totals[point].loss_db),
            front_span_within_1db_whole_size: whole_size,
            front_span_within_1db_whole_size_f32: whole_size_f32,
            exact_psnr_db: self.totals[0].psnr_db,
            exact_wall_s_a_view: median(0, Clock::Wall),
            exact_cpu_s_a_view: median(0, Clock::Cpu),
            base_psnr_db: self.totals[1].psnr_db,
            base_wall_s_a_view: median(1, Clock::Wall),
            base_span: 1.0 / self.times[1],
            oracle_max_error: study.oracle_max,
            points: study.points.len(),
            views: study.views.len(),
            timing_views: study.timing.len(),
            timing_rounds_left_out: study.rounds_left_out,
            clock: if study.effort.clock == Clock::Wall { "wall" } else { "cpu" },
            data: setting.data.to_owned(),
            split: setting.split.to_owned(),
            background: setting.background.clone(),
            study_seconds: setting.seconds,
            threads: rayon::current_num_threads(),
            cpu: setting.cpu.clone(),
            front: points(&self.front),
            blob_front: points(&self.blob_front),
            blob: None,
        }
    }

    fn point(&self, i: usize) -> PointSummary {
        PointSummary {
            settings: self.study.points[i].label.clone(),
            psnr_db: self.totals[i].psnr_db,
            loss_db: self.totals[i].loss_db,
            relative_time: self.times[i],
            relative_macs: self.totals[i].relative_macs,
        }
    }

    /// Writes all files of the report into `folder`, which must exist.
    pub fn write(&self, setting: &Setting<'_>, folder: &Path) -> anyhow::Result<()> {
        tables::table(self).write_csv(folder.join("points.csv"))?;
        self.plot(setting).write(folder.join("front"))?;
        pictures::write(self, folder)?;
        write_atomic(folder.join("report.md"), markdown::markdown(self, setting).as_bytes())?;
        summary::write(&self.summary(setting), folder)?;
        Ok(())
    }
}

#[derive(Debug, Serialize)]
pub struct Summary {
    pub front_span_within_1db: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub front_span_point: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub front_span_loss_db: Option<f64>,
    pub front_span_within_1db_whole_size: Option<f64>,
    pub front_span_within_1db_whole_size_f32: Option<f64>,
    pub exact_psnr_db: f64,
    pub exact_wall_s_a_view: f64,
    pub exact_cpu_s_a_view: f64,
    pub base_psnr_db: f64,
    pub base_wall_s_a_view: f64,
    pub base_span: f64,
    pub oracle_max_error: f64,
    pub points: usize,
    pub views: usize,
    pub timing_views: usize,
    pub timing_rounds_left_out: usize,
    pub clock: &'static str,
    pub data: String,
    pub split: String,
    pub background: String,
    pub study_seconds: f64,
    pub threads: usize,
    pub cpu: String,
    pub front: Vec<PointSummary>,
    pub blob_front: Vec<PointSummary>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub blob: Option<String>,
}

#[derive(Debug, Serialize)]
pub struct PointSummary {
    pub settings: String,
    pub psnr_db: f64,
    pub loss_db: f64,
    pub relative_time: f64,
    pub relative_macs: f64,
}

fn whole(point: &Point) -> bool {
    point.settings.quarters == 4
}

fn whole_f32(point: &Point) -> bool {
    whole(point) && !point.settings.kernel.rounds()
}
